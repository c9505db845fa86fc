#include "field/lumigraph_weights.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "base/numeric.h"
#include "render/acquired_lights.h"
#include "render/view_kernels.h"
#include "render/view_selection.h"
#include "tests/support/hard_case.h"

namespace srf {
namespace {

std::map<std::uint32_t, double> weightsOf(std::vector<Penalised> candidates, int k) {
  std::vector<Weighted> weights;
  lumigraphWeights(candidates, k, weights);
  std::map<std::uint32_t, double> result;
  for (const Weighted& w : weights) result[w.source] += w.weight;
  return result;
}

/// The formula of theory.md 3 as it stands there.
std::map<std::uint32_t, double> bruteForce(std::vector<Penalised> all, int k) {
  std::erase_if(all, [](const Penalised& c) { return !(c.penalty < kPenaltyCap); });
  std::sort(all.begin(), all.end());
  const double t = static_cast<int>(all.size()) > k ? all[k].penalty : kPenaltyCap;
  std::map<std::uint32_t, double> result;
  double sum = 0;
  for (const Penalised& c : all) {
    const double w = std::max(0.0, 1 / std::max(c.penalty, 1e-6) - 1 / std::max(t, 1e-6));
    if (w > 0) sum += result[c.source] = w;
  }
  for (auto& [source, w] : result) w /= sum;
  return result;
}

Vec3 randomDirection(std::mt19937& random) {
  std::normal_distribution<double> normal;
  const Vec3 d{normal(random), normal(random), normal(random)};
  return d / length(d);
}

TEST(LumigraphWeights, MatchAllSourcesReference) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int trial = 0; trial < 2000; ++trial) {
    const int count = 1 + trial % 12, k = 1 + trial % 5;
    std::vector<Penalised> all;
    for (int i = 0; i < count; ++i)
      all.push_back({std::pow(10.0, 6 * uniform(random) - 5), static_cast<std::uint32_t>(i)});
    const auto want = bruteForce(all, k), got = weightsOf(all, k);
    ASSERT_EQ(got.size(), want.size());
    for (const auto& [source, w] : want) EXPECT_NEAR(got.at(source), w, 1e-14);
  }
}

TEST(LumigraphWeights, AreContinuousWhileSourcesEnterAndLeave) {
  // Penalties swing past each other and out of sight (usable -> 0); k is small against the count and, at times, not.
  const int steps = 200000, k = 3;
  std::map<std::uint32_t, double> before;
  double largest = 0;
  for (int s = 0; s <= steps; ++s) {
    const double x = static_cast<double>(s) / steps;
    std::vector<Penalised> all;
    for (std::uint32_t i = 0; i < 5; ++i) {
      const double angle = 0.5 + 0.4 * std::sin(7 * x + 1.3 * i), usable = std::max(0.0, std::sin(9 * x + 2.1 * i));
      if (usable > 0) all.push_back({viewPenalty(angle, 0, usable), i});
    }
    const auto now = weightsOf(all, k);
    if (s > 0)
      for (std::uint32_t i = 0; i < 5; ++i) {
        const auto a = std::as_const(before).find(i), b = std::as_const(now).find(i);
        largest = std::max(largest, std::fabs((a == before.end() ? 0 : a->second) - (b == now.end() ? 0 : b->second)));
      }
    before = now;
  }
  // A jump would show as some 0.1; a step moves penalties by 1e-4 relative, and the weights by a few times that. Where
  // all k + 1 meet the weights turn fastest.
  test::recordHardCase(20, "sources come into sight and leave it: largest step of a weight in 1/200,000 of the way",
                       largest, test::atMost(5e-3));
}

TEST(LumigraphWeights, DoNotDependOnTheOrderOfTheInput) {
  std::mt19937 random(2);
  int unlike = 0;
  for (int trial = 0; trial < 500; ++trial) {
    std::vector<Penalised> all;
    for (std::uint32_t i = 0; i < 9; ++i) all.push_back({0.1 * (1 + random() % 4), i});  // ties at every rank
    const auto want = weightsOf(all, 4);
    for (int shuffle = 0; shuffle < 5; ++shuffle) {
      std::shuffle(all.begin(), all.end(), random);
      unlike += weightsOf(all, 4) != want;
    }
  }
  test::recordHardCase(21, "ties at every rank, 2,500 shuffled inputs: weights that changed a bit", unlike,
                       test::atMost(0));
}

TEST(LumigraphWeights, IdenticalSourcesShareAlike) {
  test::Largest off;
  for (const double penalty : {0.0, 1e-9, 0.25}) {
    std::vector<Penalised> all;
    for (std::uint32_t i = 0; i < 6; ++i) all.push_back({penalty, i});
    const auto weights = weightsOf(all, 4);
    ASSERT_EQ(weights.size(), 6u);
    for (const auto& [source, w] : weights) off.add(std::fabs(w - 1.0 / 6));
  }
  test::recordHardCase(19, "6 identical cameras, k = 4, penalties 0, 1e-9 and 0.25: weights differ from 1/6 by",
                       off.value, test::atMost(1e-15));
}

TEST(LumigraphWeights, ACapturedViewTakesAllTheWeight) {
  const auto among_many = weightsOf({{0.1, 0}, {0, 1}, {0.2, 2}, {0.3, 3}, {0.15, 4}}, 4);
  EXPECT_GT(among_many.at(1), 1 - 1e-4);
  EXPECT_DOUBLE_EQ(weightsOf({{0, 7}}, 4).at(7), 1);
  EXPECT_DOUBLE_EQ(weightsOf({{2.5, 7}}, 4).at(7), 1);
}

TEST(LumigraphWeights, UnusableSourcesGiveNothing) {
  EXPECT_TRUE(weightsOf({}, 4).empty());
  EXPECT_TRUE(weightsOf({{NAN, 0}, {INFINITY, 1}, {kPenaltyCap, 2}}, 4).empty());
  EXPECT_EQ(weightsOf({{NAN, 0}, {0.5, 1}}, 4).size(), 1u);
  EXPECT_EQ(viewPenalty(0, 0, 0), INFINITY);
}

TEST(LumigraphWeights, ResolutionPunishesViewsFurtherAwayThanTheEye) {
  EXPECT_EQ(resolutionPenalty(1, 2), 0);
  EXPECT_EQ(resolutionPenalty(2, INFINITY), 0);
  EXPECT_DOUBLE_EQ(resolutionPenalty(4, 2), kResolutionPenalty);
}

// ---- acquired lights ------------------------------------------------------------------------------------------------

std::vector<CaptureLight> lightsOnASphere(int count, bool near_lights, std::mt19937& random) {
  std::vector<CaptureLight> lights;
  for (int i = 0; i < count; ++i) {
    CaptureLight light;
    const Vec3 d = randomDirection(random);
    light.kind = near_lights ? LightKind::point : LightKind::directional;
    light.direction = Direction<AcquisitionSpace>::fromUnit(d);
    light.position = Point<AcquisitionSpace>((2.5 + 0.5 * (i % 3)) * d);
    lights.push_back(light);
  }
  return lights;
}

std::vector<LightId> allOf(const std::vector<CaptureLight>& lights) {
  std::vector<LightId> ids;
  for (std::uint32_t i = 0; i < lights.size(); ++i) ids.push_back({i});
  return ids;
}

void expectNearestMatchesBruteForce(int count, bool near_lights, int k, int queries) {
  std::mt19937 random(count);
  const auto lights = lightsOnASphere(count, near_lights, random);
  Box<AcquisitionSpace> box;
  box.extend({-0.5, -0.5, -0.5});
  box.extend({0.5, 0.5, 0.5});
  const AcquiredLights list(allOf(lights), lights, box, k);
  std::uniform_real_distribution<double> uniform(-0.5, 0.5);
  std::vector<Penalised> scratch;
  std::vector<Weighted> weights;
  for (int q = 0; q < queries; ++q) {
    const auto direction = Direction<AcquisitionSpace>::fromUnit(randomDirection(random));
    const Point<AcquisitionSpace> p(uniform(random), uniform(random), uniform(random));
    std::vector<Penalised> all;
    for (std::uint32_t i = 0; i < lights.size(); ++i)
      all.push_back({angleBetween(direction, lights[i].directionFrom(p)), i});
    const auto want = bruteForce(all, k);
    list.nearest(direction, p, scratch, weights);
    ASSERT_EQ(weights.size(), want.size());
    for (const Weighted& w : weights) {
      ASSERT_TRUE(want.contains(w.source)) << "light " << w.source << " is not among the nearest";
      ASSERT_NEAR(w.weight, want.at(w.source), 1e-9);
    }
  }
}

TEST(AcquiredLights, NearestMatchesBruteForce) {
  expectNearestMatchesBruteForce(100, false, 4, 100000);
  expectNearestMatchesBruteForce(331, false, 3, 20000);
  expectNearestMatchesBruteForce(5, false, 4, 2000);
  expectNearestMatchesBruteForce(2, false, 4, 2000);
}

TEST(AcquiredLights, NearestOfNearLightsMatchesBruteForceAtEveryPoint) {
  expectNearestMatchesBruteForce(100, true, 4, 20000);
}

TEST(AcquiredLights, AnAcquiredDirectionIsItsOwnLight) {
  std::mt19937 random(5);
  const auto lights = lightsOnASphere(60, false, random);
  const AcquiredLights list(allOf(lights), lights, {}, 4);
  std::vector<Penalised> scratch;
  std::vector<Weighted> weights;
  for (std::uint32_t i = 0; i < 60; ++i) {
    list.nearest(lights[i].direction, {}, scratch, weights);
    EXPECT_EQ(weights[0].source, i);
    EXPECT_GT(weights[0].weight, 1 - 1e-3);
  }
}

TEST(AcquiredLights, ChordsAndTheirAnglesAreThoseOfTheLibrary) {
  std::mt19937 random(3);
  std::array<std::vector<double>, 3> lane;
  const Vec3 from = randomDirection(random);
  std::vector<Vec3> directions{from, -1.0 * from};
  while (directions.size() < 203) directions.push_back(randomDirection(random));
  for (const Vec3& d : directions)
    for (int c = 0; c < 3; ++c) lane[c].push_back(d[c]);
  std::vector<double> chord2(paddedLanes(directions.size()));
  squaredChords(from, lane[0].data(), lane[1].data(), lane[2].data(), directions.size(), chord2.data());
  std::vector<double> angle = chord2;
  chordAngles(angle.data(), directions.size());
  for (std::size_t i = 0; i < directions.size(); ++i) {
    const Vec3 difference = from - directions[i];
    EXPECT_EQ(chord2[i], dot(difference, difference));
    const double want = chord2[i] <= 2 ? 2 * std::asin(std::sqrt(chord2[i]) / 2)
                                       : kPi - 2 * std::asin(std::sqrt(std::max(0.0, 4 - chord2[i])) / 2);
    EXPECT_NEAR(angle[i], want, 1e-15 * want) << i;
  }
}

TEST(AcquiredLights, ACapturedIlluminationStandsForNoOther) {
  CaptureLight captured;
  captured.kind = LightKind::captured;
  const AcquiredLights list({LightId{0}}, {captured}, {}, 4);
  EXPECT_FALSE(list.relightable());
  std::vector<Penalised> scratch;
  std::vector<Weighted> weights(1);
  list.nearest(Direction<AcquisitionSpace>(), {}, scratch, weights);
  EXPECT_TRUE(weights.empty());
}

// ---- views ----------------------------------------------------------------------------------------------------------

/// Views on a sphere about the origin, all of whose pixels show something.
struct Views {
  std::vector<SourceView> views;
  Coverage coverage;
  VisibilityBits visible;
  explicit Views(int count, std::mt19937& random, std::size_t points = 1)
      : coverage(Image8(64, 64, 1, 255)), visible(points, count) {
    for (int i = 0; i < count; ++i) {
      SourceView view;
      view.camera.lens = pinholeFromFov(64, 64, 30);
      const Point<AcquisitionSpace> eye((3 + 0.2 * (i % 4)) * randomDirection(random));
      view.camera.pose = *lookAt(eye, Point<AcquisitionSpace>(), Vector<AcquisitionSpace>(0.1, 0.2, 1));
      view.geometry = {64, 64, 0, 0, 4, 4, 1};
      view.coverage = &coverage;
      views.push_back(view);
      for (std::size_t p = 0; p < points; ++p) visible.set(p, i);
    }
  }
};

/// Views of one hit by itself.
ViewSelection::Result select(const ViewSelection& selection, const ViewQuery& query,
                             const std::vector<std::uint8_t>& allowed, std::vector<ChosenView>& views) {
  static ViewSelection::Scratch scratch;
  ViewSelection::Chosen chosen;
  selection.select({&query, 1}, allowed, scratch, chosen);
  views = chosen.views;
  return chosen.result.front();
}

TEST(ViewSelection, MatchesBruteForceOverAllViews) {
  std::mt19937 random(9);
  Views field(80, random, 3);
  for (std::size_t p = 0; p < 3; ++p)
    for (auto& word : field.visible.words()) word &= random() | static_cast<std::uint64_t>(random()) << 32;
  const int counts[] = {4, 1, 8, 12};  // beyond kMostNearViews too
  std::vector<ViewSelection> selections;
  for (const int k : counts) selections.emplace_back(field.views, field.visible, k);
  const std::vector<std::uint8_t> allowed(80, 1);
  std::vector<ChosenView> chosen;
  std::uniform_real_distribution<double> uniform(-0.2, 0.2);
  for (int trial = 0; trial < 4000; ++trial) {
    const int k = counts[trial % 4];
    const std::uint32_t points[] = {0, 1, 2};
    const float weights[] = {0.5f, 0.3f, 0.2f};
    ViewQuery query;
    query.p = Point<AcquisitionSpace>(uniform(random), uniform(random), uniform(random));
    query.view = Direction<AcquisitionSpace>::fromUnit(randomDirection(random));
    query.normal = Direction<AcquisitionSpace>::fromUnit(randomDirection(random));
    query.eye_distance = 2.5;
    query.points = points;
    query.point_weights = weights;
    std::vector<Penalised> all;
    for (std::uint32_t i = 0; i < 80; ++i) {
      double usable = 0;
      for (int p = 0; p < 3; ++p) usable += weights[p] * field.visible.get(p, i);
      const auto& camera = field.views[i].camera;
      const Vec2 pixel = camera.project(query.p)->pixel;
      usable *= smoothstep(0, 4, std::min({pixel.x, pixel.y, 64 - pixel.x, 64 - pixel.y}));
      if (usable > 0)
        all.push_back({viewPenalty(angleBetween(query.view, camera.viewDirection(query.p)),
                                   resolutionPenalty(distance(camera.center(), query.p), 2.5), usable),
                       i});
    }
    auto want = bruteForce(all, k);
    double sum = 0;
    for (auto& [i, w] : want) {
      const double facing = dot(query.normal, field.views[i].camera.viewDirection(query.p));
      sum += w *= std::sqrt(std::max(0.05, facing));
    }
    for (auto& [i, w] : want) w /= sum;
    ASSERT_EQ(select(selections[trial % 4], query, allowed, chosen), ViewSelection::Result::seen);
    ASSERT_EQ(chosen.size(), want.size());
    for (const ChosenView& c : chosen) {
      ASSERT_TRUE(want.contains(c.view));
      ASSERT_NEAR(c.weight, want.at(c.view), 1e-9);
    }
  }
}

// Hits of one call share their vectors: what one gets must not depend on the others.
TEST(ViewSelection, ManyHitsAtOnceGetWhatEachGetsAlone) {
  std::mt19937 random(10);
  Views field(70, random, 5);
  for (auto& word : field.visible.words()) word &= random() | static_cast<std::uint64_t>(random()) << 32;
  field.views[3].camera.lens.k1 = 0.1;  // one of each kind of lens
  field.views[3].camera.lens.model = CameraModel::simple_radial;
  field.views[4].camera.lens.model = CameraModel::orthographic;
  field.views[4].camera.lens.fl_x = field.views[4].camera.lens.fl_y = 20;
  const ViewSelection selection(field.views, field.visible, 4);
  std::vector<std::uint8_t> allowed(70, 1);
  allowed[7] = 0;
  std::uniform_real_distribution<double> uniform(-0.4, 0.4);
  std::vector<std::array<std::uint32_t, 2>> points(333);
  const float weights[] = {0.7f, 0.3f};
  std::vector<ViewQuery> queries;
  for (auto& of_hit : points) {
    of_hit = {static_cast<std::uint32_t>(random() % 5), static_cast<std::uint32_t>(random() % 5)};
    ViewQuery query;
    query.p = Point<AcquisitionSpace>(uniform(random), uniform(random), uniform(random));
    query.view = Direction<AcquisitionSpace>::fromUnit(randomDirection(random));
    query.normal = query.view;
    if (random() % 2) query.eye_distance = 2.5;
    query.points = of_hit;
    query.point_weights = weights;
    queries.push_back(query);
  }
  ViewSelection::Scratch scratch;
  ViewSelection::Chosen together;
  selection.select(queries, allowed, scratch, together);
  ASSERT_EQ(together.result.size(), queries.size());
  int orthographic = 0, distorted = 0;
  for (std::size_t h = 0; h < queries.size(); ++h) {
    std::vector<ChosenView> alone;
    ASSERT_EQ(select(selection, queries[h], allowed, alone), together.result[h]);
    const auto of_hit = together.of(h);
    ASSERT_EQ(of_hit.size(), alone.size());
    for (std::size_t i = 0; i < alone.size(); ++i) {
      ASSERT_EQ(of_hit[i].view, alone[i].view);
      ASSERT_EQ(of_hit[i].weight, alone[i].weight);
      ASSERT_EQ(of_hit[i].fetch.x, alone[i].fetch.x);
      for (int t = 0; t < 4; ++t) ASSERT_EQ(of_hit[i].fetch.tap[t], alone[i].fetch.tap[t]);
      ASSERT_NE(alone[i].view, 7u);
      distorted += alone[i].view == 3;
      orthographic += alone[i].view == 4;
      // The fetch is that of the scalar form.
      const SourceView& source = field.views[alone[i].view];
      const Fetch want = bilinearFetch(source, source.camera.project(queries[h].p)->pixel);
      for (int t = 0; t < 4; ++t) ASSERT_NEAR(alone[i].fetch.tap[t], want.tap[t], 1e-6);
    }
  }
  EXPECT_GT(orthographic, 0);
  EXPECT_GT(distorted, 0);
}

ViewQuery queryFor(const Views& field, std::uint32_t view, const std::uint32_t& point, const float& weight) {
  ViewQuery query;
  query.view = field.views[view].camera.viewDirection(query.p);
  query.normal = query.view;
  query.points = {&point, 1};
  query.point_weights = {&weight, 1};
  return query;
}

TEST(ViewSelection, FewerViewsThanKAreEnough) {
  std::mt19937 random(3);
  const std::uint32_t point = 0;
  const float weight = 1;
  test::Largest off;
  for (int count = 1; count <= 4; ++count) {
    const Views field(count, random);
    const ViewSelection selection(field.views, field.visible, 4);
    std::vector<ChosenView> chosen;
    select(selection, queryFor(field, 0, point, weight), std::vector<std::uint8_t>(count, 1), chosen);
    double sum = 0;
    for (const ChosenView& c : chosen) sum += c.weight;
    off.add(std::fabs(sum - 1));
    EXPECT_EQ(chosen[0].view, 0u);
    EXPECT_GT(chosen[0].weight, 1 - 1e-4);
  }
  test::recordHardCase(20, "1 to 4 views for k = 4: sum of the weights differs from 1 by", off.value,
                       test::atMost(1e-12));
}

TEST(ViewSelection, WithoutAViewThatSeesTheNearestPictureStandsIn) {
  std::mt19937 random(4);
  Views field(12, random);
  field.visible = VisibilityBits(1, 12);
  const ViewSelection selection(field.views, field.visible, 4);
  std::vector<ChosenView> chosen;
  const std::uint32_t point = 0;
  const float weight = 1;
  const ViewQuery query = queryFor(field, 5, point, weight);
  EXPECT_EQ(select(selection, query, std::vector<std::uint8_t>(12, 1), chosen), ViewSelection::Result::not_seen);
  ASSERT_EQ(chosen.size(), 1u);
  EXPECT_EQ(chosen[0].view, 5u);
  EXPECT_EQ(chosen[0].weight, 1);
  EXPECT_EQ(select(selection, query, std::vector<std::uint8_t>(12, 0), chosen), ViewSelection::Result::none);
  EXPECT_TRUE(chosen.empty());
}

TEST(ViewSelection, WeightsAreContinuousAcrossTheBorderOfAPictureAndOfTheMask) {
  std::mt19937 random(6);
  Views field(7, random);
  Image8 mask(64, 64, 1, 255);
  for (int y = 0; y < 64; ++y)
    for (int x = 40; x < 64; ++x) mask.at(x, y) = 0;
  field.coverage = Coverage(mask);
  const ViewSelection selection(field.views, field.visible, 3);
  std::vector<ChosenView> chosen;
  const std::uint32_t point = 0;
  const float weight = 1;
  const std::vector<std::uint8_t> allowed(7, 1);
  std::map<std::uint32_t, double> before;
  double largest = 0;
  const int steps = 80000;
  int changes = 0;
  for (int s = 0; s <= steps; ++s) {
    ViewQuery query = queryFor(field, 2, point, weight);
    query.p = Point<AcquisitionSpace>(-1 + 2.0 * s / steps, 0.1, -0.1);
    const auto result = select(selection, query, allowed, chosen);
    std::map<std::uint32_t, double> now;
    if (result == ViewSelection::Result::seen)
      for (const ChosenView& c : chosen) now[c.view] = c.weight;
    if (s > 0 && !before.empty() && !now.empty()) {
      for (std::uint32_t i = 0; i < 7; ++i) largest = std::max(largest, std::fabs(before[i] - now[i]));
      changes +=
          std::count_if(now.begin(), now.end(), [&](const auto& w) { return w.second > 0 && !(before[w.first] > 0); });
    }
    before = now;
  }
  EXPECT_GT(changes, 2) << "the path crosses no border";
  // A step is 0.01 pixels; a jump would be several tenths.
  test::recordHardCase(20, "across the borders of pictures and masks: largest step of a weight in 0.01 pixels", largest,
                       test::atMost(0.02));
}

// The kernel against the formula of lumigraphWeights, to the bit: with ties, with few usable views, with none.
TEST(ViewSelection, WeightsOfManyHitsAreThoseOfEach) {
  std::mt19937 random(12);
  std::uniform_real_distribution<double> uniform(0.01, 1);
  constexpr std::size_t kHits = 1000, kStride = paddedLanes(kHits);
  for (int k = 1; k < kMostNearViews; ++k) {
    const std::size_t ranks = k + 1 + k % 3;
    std::vector<double> penalty(ranks * kStride, kPenaltyCap), foreshortening(ranks * kStride, 1), weight(k * kStride);
    std::vector<float> rest(kStride, INFINITY);
    std::vector<std::int64_t> pair(k * kStride), taken(kStride);
    for (double& p : penalty)
      p = random() % 5 == 0 ? kPenaltyCap : random() % 5 == 0 ? 0.1 * (1 + random() % 3) : uniform(random);
    for (double& f : foreshortening) f = uniform(random);
    for (float& r : rest) r = random() % 3 ? INFINITY : static_cast<float>(uniform(random));
    weighViews({penalty.data(), foreshortening.data(), rest.data(), ranks, kStride}, kHits, k, pair.data(),
               weight.data(), taken.data());
    int left = 0;
    for (std::size_t h = 0; h < kHits; ++h) {
      std::vector<Penalised> all;
      for (std::uint32_t j = 0; j < ranks; ++j) all.push_back({penalty[j * kStride + h], j});
      std::erase_if(all, [](const Penalised& p) { return !(p.penalty < kPenaltyCap); });
      std::sort(all.begin(), all.end());
      const double t = all.size() > static_cast<std::size_t>(k) ? all[k].penalty : kPenaltyCap;
      std::vector<std::pair<std::size_t, double>> want;
      double sum = 0;
      for (const Penalised& p : all) {
        const double w = 1 / p.penalty - 1 / t;
        if (!(w > 0) || want.size() == static_cast<std::size_t>(k)) break;
        want.push_back({p.source * kStride + h, w * foreshortening[p.source * kStride + h]});
        sum += want.back().second;
      }
      if (rest[h] <= t) want.clear();
      left += want.empty();
      ASSERT_EQ(taken[h], static_cast<std::int64_t>(want.size())) << "k " << k << ", hit " << h;
      for (std::size_t r = 0; r < want.size(); ++r) {
        ASSERT_EQ(pair[r * kStride + h], static_cast<std::int64_t>(want[r].first));
        ASSERT_EQ(weight[r * kStride + h], want[r].second / sum);
      }
    }
    EXPECT_GT(left, 0);
    EXPECT_LT(left, static_cast<int>(kHits));
  }
}

TEST(WholeTexels, AreThoseThatAreCoveredLikeTheirNeighbours) {
  std::mt19937 random(13);
  WholeTexels whole;
  int found = 0;
  for (const auto& [width, height] : {std::pair{64, 48}, std::pair{39, 50}, std::pair{16, 16}}) {
    Image8 mask(width, height, 1, 255);
    for (int hole = 0; hole < width / 8; ++hole) mask.at(random() % width, random() % height) = random() % 255;
    for (int x = 0; x < width / 3; ++x)
      for (int y = 0; y < height / 2; ++y) mask.at(x, y) = 0;
    const Coverage coverage(mask);
    Camera<AcquisitionSpace> camera;
    camera.lens = pinholeFromFov(width, height, 30);
    PlacedView view(camera);
    view.across = width, view.down = height, view.tiles_x = (width + kTile - 1) / kTile;
    view.first_tile = whole.add(coverage);
    for (int y = -1; y <= height; ++y)
      for (int x = -1; x <= width; ++x) {
        const bool inside = x >= 0 && y >= 0 && x < width - 1 && y < height - 1;
        const bool want =
            inside && (mask.at(x, y) & mask.at(x + 1, y) & mask.at(x, y + 1) & mask.at(x + 1, y + 1)) == 255;
        ASSERT_EQ(whole.at(view, x, y), want) << x << " " << y;
        found += want;
      }
  }
  EXPECT_GT(found, 1000);
}

TEST(BilinearFetch, LeavesOutTexelsWithoutCoverage) {
  Image8 mask(16, 16, 1, 255);
  Coverage coverage(mask);
  SourceView view;
  view.geometry = {100, 100, 32, 48, 1, 1, 1};
  view.coverage = &coverage;
  const Vec2 pixel{32 + 4.5 + 0.25, 48 + 6.5 + 0.5};  // between texels (4, 6) and (5, 7)
  Fetch fetch = bilinearFetch(view, pixel);
  EXPECT_EQ(fetch.x, 4);
  EXPECT_EQ(fetch.y, 6);
  EXPECT_NEAR(fetch.covered, 1, 1e-12);
  EXPECT_NEAR(fetch.tap[0], 0.375, 1e-7);
  EXPECT_NEAR(fetch.tap[3], 0.125, 1e-7);
  // Premultiplied: the sum of pixels over the sum of coverages; under one half a texel is left out.
  mask.at(4, 6) = 153;  // 0.6
  mask.at(5, 6) = 100;
  coverage = Coverage(mask);
  fetch = bilinearFetch(view, pixel);
  const double denominator = 0.375 * 0.6 + 0.375 + 0.125;
  EXPECT_NEAR(fetch.tap[0], 0.375 / denominator, 1e-6);
  EXPECT_EQ(fetch.tap[1], 0);
  EXPECT_NEAR(fetch.covered, 0.875, 1e-12);
  // Over another background only texels that are wholly covered count, and they hold no background.
  view.black_background = false;
  fetch = bilinearFetch(view, pixel);
  EXPECT_EQ(fetch.tap[0], 0);
  EXPECT_NEAR(fetch.tap[2], 0.75, 1e-6);
  EXPECT_NEAR(fetch.tap[3], 0.25, 1e-6);
}

TEST(BilinearFetch, OffTheStoredRectangleThereIsNothing) {
  const Coverage coverage(Image8(16, 16, 1, 255));
  SourceView view;
  view.geometry = {100, 100, 32, 48, 1, 1, 1};
  view.coverage = &coverage;
  for (const Vec2& pixel : {Vec2{0, 0}, Vec2{1e18, 50}, Vec2{-1e18, 50}, Vec2{50, 48 + 17}, Vec2{NAN, 50}})
    EXPECT_EQ(bilinearFetch(view, pixel).covered, 0);
  EXPECT_NEAR(bilinearFetch(view, {32, 50}).covered, 0.5, 1e-12);  // half of the first column
}

}  // namespace
}  // namespace srf
