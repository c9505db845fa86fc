#include "render/view_selection.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/numeric.h"
#include "render/view_kernels.h"

namespace srf {
namespace {

constexpr double kBorderPixels = 4;  // over which a view fades towards the border of its picture
// A view that sees the surface at a slant has fewer pixels on it: its weight falls with the square root of n0 . v_i
// (tried on an independent capture: no factor, the root and n0 . v_i itself give 0.78, 0.87 and 0.91 dB over the
// reference figures in the mean, but -0.29, -0.29 and -0.44 dB at worst). A grazing view stays usable.
constexpr double kLeastForeshortening = 0.05;

/// Where a pixel lies among the texels of the stored rectangle: the first of its 2 x 2 and the way to the next ones.
/// As bilinearFetch has it.
struct TexelPlace {
  double floor_x, floor_y, fx, fy;
};
TexelPlace texelPlace(const StoreGeometry& geometry, const Vec2& pixel) {
  const auto split = [](double at, double& floor) {
    const double nearest = std::floor(at + 0.5);
    const double snapped = std::fabs(at - nearest) < 1e-6 ? nearest : at;
    floor = std::floor(snapped);
    return snapped - floor;
  };
  TexelPlace place;
  place.fx = split(pixel.x - 0.5 - geometry.crop_x, place.floor_x);
  place.fy = split(pixel.y - 0.5 - geometry.crop_y, place.floor_y);
  return place;
}

}  // namespace

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {}

double ViewSelection::covered(std::uint32_t view, const Vec2& pixel, bool& whole) const {
  const SourceView& source = views_[view];
  const Intrinsics& lens = source.camera.lens;
  whole = false;
  const double border = std::min({pixel.x, pixel.y, lens.width - pixel.x, lens.height - pixel.y});
  if (!(border > 0)) return 0;
  const double inside = border >= kBorderPixels ? 1 : smoothstep(0, kBorderPixels, border);
  const TexelPlace place = texelPlace(source.geometry, pixel);
  const Coverage& coverage = *source.coverage;
  if (place.floor_x >= 0 && place.floor_y >= 0 && place.floor_x < coverage.width() - 1 &&
      place.floor_y < coverage.height() - 1) {
    const int x = static_cast<int>(place.floor_x), y = static_cast<int>(place.floor_y);
    whole = (coverage.at(x, y) & coverage.at(x + 1, y) & coverage.at(x, y + 1) & coverage.at(x + 1, y + 1)) == 255;
    if (whole) return inside;
  }
  if (source.matte) return inside;  // where it covers p a little, its coverage is the answer
  return inside * bilinearFetch(source, pixel).covered;
}

Fetch ViewSelection::fetch(std::uint32_t view, const Vec2& pixel, bool whole) const {
  if (!whole) return bilinearFetch(views_[view], pixel);
  const TexelPlace place = texelPlace(views_[view].geometry, pixel);
  Fetch fetch;
  fetch.x = static_cast<int>(place.floor_x), fetch.y = static_cast<int>(place.floor_y);
  fetch.tap[0] = static_cast<float>((1 - place.fx) * (1 - place.fy));
  fetch.tap[1] = static_cast<float>(place.fx * (1 - place.fy));
  fetch.tap[2] = static_cast<float>((1 - place.fx) * place.fy);
  fetch.tap[3] = static_cast<float>(place.fx * place.fy);
  fetch.covered = 1;
  return fetch;
}

void ViewSelection::lookAt(std::span<const ViewQuery> queries, std::size_t begin, Scratch& s) const {
  const std::size_t pairs = s.hit_of.size() - begin, views = s.views.size();
  s.tried.resize(s.hit_of.size());
  if (pairs == 0) return;
  // Distributed by view: the kernel takes many hits of one view.
  s.begin.assign(views + 1, 0);
  for (std::size_t i = 0; i < pairs; ++i) ++s.begin[s.view_of[begin + i] + 1];
  for (std::size_t v = 0; v < views; ++v) s.begin[v + 1] += s.begin[v];
  s.order.resize(pairs);
  for (std::size_t i = 0; i < pairs; ++i)
    s.order[s.begin[s.view_of[begin + i]]++] = static_cast<std::uint32_t>(begin + i);
  const std::size_t lanes = paddedLanes(pairs);
  for (auto& lane : s.hit_lanes)
    if (lane.size() < lanes) lane.resize(lanes);
  for (auto& lane : s.view_lanes)
    if (lane.size() < lanes) lane.resize(lanes);
  auto& hit = s.hit_lanes;
  const HitLanes from{hit[0].data(), hit[1].data(), hit[2].data(), hit[3].data(), hit[4].data(),
                      hit[5].data(), hit[6].data(), hit[7].data(), hit[8].data(), hit[9].data()};
  auto& lane = s.view_lanes;
  const ViewLanes to{lane[0].data(), lane[1].data(), lane[2].data(), lane[3].data(), lane[4].data(), lane[5].data()};
  for (std::size_t slot = 0, at = 0; slot < views; ++slot) {
    const std::size_t count = s.begin[slot] - at;
    if (count == 0) continue;
    const std::uint32_t view = s.views[slot];
    const Camera<AcquisitionSpace>& camera = views_[view].camera;
    for (std::size_t i = 0; i < count; ++i) {
      const ViewQuery& query = queries[s.hit_of[s.order[at + i]]];
      const Vec3 &p = query.p.raw(), &v = query.view.raw(), &n = query.normal.raw();
      hit[0][i] = p.x, hit[1][i] = p.y, hit[2][i] = p.z;
      hit[3][i] = v.x, hit[4][i] = v.y, hit[5][i] = v.z;
      hit[6][i] = n.x, hit[7][i] = n.y, hit[8][i] = n.z;
      hit[9][i] = query.eye_distance;
    }
    placeViews(camera, kLeastForeshortening, from, count, to);
    const bool distorted = bendsLines(camera.lens);
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint32_t pair = s.order[at + i];
      const ViewQuery& query = queries[s.hit_of[pair]];
      Tried& tried = s.tried[pair];
      tried = {view, false, kPenaltyCap, to.angle[i], to.foreshortening[i], to.pixel_x[i], to.pixel_y[i]};
      if (to.usable[i] == 0 && !distorted) continue;
      if (distorted) {
        const auto projection = camera.project(query.p);
        if (!projection) continue;
        tried.pixel_x = projection->pixel.x, tried.pixel_y = projection->pixel.y;
      }
      double seen = 0;
      for (std::size_t k = 0; k < query.points.size(); ++k)
        if (visible_.get(query.points[k], view)) seen += query.point_weights[k];
      const double usable = std::min(seen, 1.0) * covered(view, {tried.pixel_x, tried.pixel_y}, tried.whole);
      const double penalty = viewPenalty(tried.angle, to.resolution[i], usable);
      if (penalty < kPenaltyCap) tried.penalty = penalty;
    }
    at += count;
  }
}

void ViewSelection::select(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& s,
                           Chosen& chosen) const {
  const std::size_t hits = queries.size(), words = visible_.wordsPerPoint();
  chosen.views.clear();
  chosen.first.assign(1, 0);
  chosen.result.clear();
  if (hits == 0) return;

  // Only views that see one of a hit's points are candidates.
  s.seen.assign((hits + 2) * words, 0);
  std::uint64_t *some = &s.seen[hits * words], *may = some + words;
  for (std::size_t v = 0; v < views_.size(); ++v) may[v / 64] |= std::uint64_t{allowed[v] != 0} << (v % 64);
  for (std::size_t h = 0; h < hits; ++h)
    for (std::size_t w = 0; w < words; ++w) {
      std::uint64_t seen = 0;
      for (const std::uint32_t point : queries[h].points) seen |= visible_.row(point)[w];
      s.seen[h * words + w] = seen &= may[w];
      some[w] |= seen;
    }
  const auto each = [words](const std::uint64_t* bits, const auto& act) {
    for (std::size_t w = 0; w < words; ++w)
      for (std::uint64_t rest = bits[w]; rest; rest &= rest - 1)
        act(static_cast<std::uint32_t>(64 * w + std::countr_zero(rest)));
  };
  s.views.clear();
  s.slot.resize(views_.size());
  each(some, [&](std::uint32_t view) {
    s.slot[view] = static_cast<std::uint32_t>(s.views.size());
    s.views.push_back(view);
  });

  // A lower bound of the penalty of all these, in float about one of the points: the chord to v is at most the angle,
  // and visibility and coverage only add to the penalty.
  const std::size_t stride = paddedLanes(s.views.size()), wanted = k_ + std::size_t{1};
  const Vec3 origin = queries[0].p.raw();
  for (auto* axis : {&s.x, &s.y, &s.z}) axis->assign(stride, 0);
  for (std::size_t slot = 0; slot < s.views.size(); ++slot) {
    const Vec3 center = views_[s.views[slot]].camera.center().raw() - origin;
    s.x[slot] = static_cast<float>(center.x), s.y[slot] = static_cast<float>(center.y);
    s.z[slot] = static_cast<float>(center.z);
  }
  s.bounds.resize(hits * stride);
  s.hit_of.clear();
  s.view_of.clear();
  s.tried.clear();
  s.first.clear();
  s.second.assign(hits, {0, 0});
  const auto pair = [&s](std::size_t h, std::uint32_t slot) {
    s.hit_of.push_back(static_cast<std::uint32_t>(h));
    s.view_of.push_back(slot);
  };
  constexpr float kTaken = std::numeric_limits<float>::infinity();
  for (std::size_t h = 0; h < hits; ++h) {
    const ViewQuery& query = queries[h];
    const Vec3 p = query.p.raw() - origin, v = query.view.raw();
    const NearQuery near{{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)},
                         {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)},
                         query.eye_distance > 0 ? static_cast<float>(1 / query.eye_distance) : 0.f};
    float* bound = &s.bounds[h * stride];
    penaltyBounds(s.x.data(), s.y.data(), s.z.data(), s.views.size(), near, bound);
    // The k + 1 least of them first: by bound, then by slot, in one number (floats of 0 and above are ordered as their
    // bits are).
    s.least.assign(wanted, ~std::uint64_t{0});
    std::uint64_t* const least = s.least.data();
    std::size_t taken = 0;
    each(&s.seen[h * words], [&](std::uint32_t view) {
      const std::uint32_t slot = s.slot[view];
      if (views_[view].camera.lens.isOrthographic()) bound[slot] = 0;
      std::uint64_t candidate = std::uint64_t{std::bit_cast<std::uint32_t>(bound[slot])} << 32 | slot;
      ++taken;
      if (candidate >= least[wanted - 1]) return;
      for (std::size_t j = 0; j < wanted; ++j) {
        const std::uint64_t less = std::min(least[j], candidate);
        candidate = std::max(least[j], candidate);
        least[j] = less;
      }
    });
    const auto begin = static_cast<std::uint32_t>(s.hit_of.size());
    for (std::size_t j = 0; j < std::min(taken, wanted); ++j) {
      const auto slot = static_cast<std::uint32_t>(least[j]);
      pair(h, slot);
      bound[slot] = kTaken;
    }
    s.first.push_back({begin, static_cast<std::uint32_t>(s.hit_of.size())});
  }
  lookAt(queries, 0, s);

  // Then all whose bound does not lie beyond the (k + 1)-th penalty found: no other can be among the k + 1 nearest or
  // tie with them.
  const std::size_t looked_at = s.hit_of.size();
  for (std::size_t h = 0; h < hits; ++h) {
    const auto [begin, end] = s.first[h];
    if (end - begin < wanted) continue;  // those were all
    double worst = 0;
    for (std::size_t i = begin; i < end; ++i) worst = std::max(worst, s.tried[i].penalty);
    const auto second = static_cast<std::uint32_t>(s.hit_of.size());
    const float* bound = &s.bounds[h * stride];
    each(&s.seen[h * words], [&](std::uint32_t view) {
      if (bound[s.slot[view]] <= worst && bound[s.slot[view]] < kTaken) pair(h, s.slot[view]);
    });
    s.second[h] = {second, static_cast<std::uint32_t>(s.hit_of.size())};
  }
  lookAt(queries, looked_at, s);

  for (std::size_t h = 0; h < hits; ++h) {
    s.penalised.clear();
    const std::array<std::array<std::uint32_t, 2>, 2> ranges{s.first[h], s.second[h]};
    for (const auto& [begin, end] : ranges)
      for (std::uint32_t i = begin; i < end; ++i) {
        if (!(s.tried[i].penalty < kPenaltyCap)) continue;
        s.penalised.push_back({s.tried[i].penalty, s.tried[i].view});
        for (std::size_t j = s.penalised.size() - 1; j > 0 && s.penalised[j] < s.penalised[j - 1]; --j)
          std::swap(s.penalised[j], s.penalised[j - 1]);
      }
    lumigraphWeights(s.penalised, k_, s.weights);
    const std::size_t first = chosen.views.size();
    double sum = 0;
    for (const Weighted& w : s.weights)
      for (const auto& [begin, end] : ranges)
        for (std::uint32_t i = begin; i < end; ++i) {
          const Tried& tried = s.tried[i];
          if (tried.view != w.source) continue;
          const double weight = tried.foreshortening * w.weight;
          sum += weight;
          chosen.views.push_back({tried.view, weight, tried.angle, tried.penalty,
                                  fetch(tried.view, {tried.pixel_x, tried.pixel_y}, tried.whole)});
        }
    for (std::size_t i = first; i < chosen.views.size(); ++i) chosen.views[i].weight /= sum;
    Result result = Result::seen;
    if (chosen.views.size() == first) {
      // Deformation shows what no photograph saw: the nearest picture that covers p stands in, and is counted.
      ChosenView instead;
      result = standIn(queries[h], allowed, s, instead) ? Result::not_seen : Result::none;
      if (result == Result::not_seen) chosen.views.push_back(instead);
    }
    chosen.result.push_back(result);
    chosen.first.push_back(static_cast<std::uint32_t>(chosen.views.size()));
  }
}

bool ViewSelection::standIn(const ViewQuery& query, std::span<const std::uint8_t> allowed, Scratch& s,
                            ChosenView& chosen) const {
  s.standing_in.clear();
  for (std::uint32_t view = 0; view < views_.size(); ++view) {
    const Camera<AcquisitionSpace>& camera = views_[view].camera;
    if (!allowed[view] || (!camera.lens.isOrthographic() && !(distance(camera.center(), query.p) > 0))) continue;
    s.standing_in.push_back({angleBetween(query.view, camera.viewDirection(query.p)), view});
  }
  std::sort(s.standing_in.begin(), s.standing_in.end());
  for (const auto& [angle, view] : s.standing_in) {
    const auto projection = views_[view].camera.project(query.p);
    bool whole = false;
    if (!projection || !(covered(view, projection->pixel, whole) > 0)) continue;
    chosen = {view, 1, angle, std::numeric_limits<double>::infinity(), fetch(view, projection->pixel, whole)};
    return true;
  }
  return false;
}

}  // namespace srf
