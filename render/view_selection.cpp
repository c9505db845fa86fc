#include "render/view_selection.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <tuple>

#include "base/numeric.h"
#include "render/view_kernels.h"

namespace srf {
namespace {

constexpr double kBorderPixels = 4;  // over which a view fades towards the border of its picture
// A view that sees the surface at a slant has fewer pixels on it: its weight falls with the square root of n0 . v_i
// (tried on an independent capture: no factor, the root and n0 . v_i itself give 0.78, 0.87 and 0.91 dB over the
// reference figures in the mean, but -0.29, -0.29 and -0.44 dB at worst). A grazing view stays usable.
constexpr double kLeastForeshortening = 0.05;

/// As bilinearFetch has it.
TexelPlace texelPlace(const StoreGeometry& geometry, const Vec2& pixel) {
  const auto split = [](double at, double& floor) {
    const double nearest = std::floor(at + 0.5);
    const double snapped = std::fabs(at - nearest) < 1e-6 ? nearest : at;
    floor = std::floor(snapped);
    return snapped - floor;
  };
  TexelPlace place;
  place.part_x = split(pixel.x - 0.5 - geometry.crop_x, place.floor_x);
  place.part_y = split(pixel.y - 0.5 - geometry.crop_y, place.floor_y);
  return place;
}

bool wholeAt(const Coverage& coverage, const TexelPlace& place) {
  return place.floor_x >= 0 && place.floor_y >= 0 && place.floor_x < coverage.width() - 1 &&
         place.floor_y < coverage.height() - 1 &&
         coverage.whole(static_cast<int>(place.floor_x), static_cast<int>(place.floor_y));
}

/// Those of the next view.
ViewLanes viewLanes(ViewSelection::Scratch& s) {
  const auto lane = [&s](std::size_t k) { return s.view_lanes[k].data() + s.lanes; };
  return {lane(0), lane(1), lane(2), lane(3), lane(4), lane(5), lane(6), lane(7), lane(8), lane(9), lane(10)};
}

double borderOf(const Intrinsics& lens, const Vec2& pixel) {
  return std::min({pixel.x, pixel.y, lens.width - pixel.x, lens.height - pixel.y});
}

}  // namespace

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {}

double ViewSelection::covered(std::uint32_t view, const Vec2& pixel, double border, bool whole) const {
  const SourceView& source = views_[view];
  if (!(border > 0)) return 0;
  const double inside = border >= kBorderPixels ? 1 : smoothstep(0, kBorderPixels, border);
  // Where a matte covers p a little, its coverage is the answer.
  if (whole || source.matte) return inside;
  return inside * bilinearFetch(source, pixel).covered;
}

void ViewSelection::fetch(std::uint32_t view, const Vec2& pixel, const TexelPlace& place, bool whole,
                          Fetch& fetch) const {
  if (!whole) {
    fetch = bilinearFetch(views_[view], pixel);
    return;
  }
  const double x = place.part_x, y = place.part_y;
  fetch.x = static_cast<int>(place.floor_x), fetch.y = static_cast<int>(place.floor_y);
  fetch.tap[0] = static_cast<float>((1 - x) * (1 - y));
  fetch.tap[1] = static_cast<float>(x * (1 - y));
  fetch.tap[2] = static_cast<float>((1 - x) * y);
  fetch.tap[3] = static_cast<float>(x * y);
  fetch.covered = 1;
}

void ViewSelection::lookAt(std::span<const ViewQuery> queries, std::size_t begin, Scratch& s) const {
  const std::size_t pairs = s.hit_of.size() - begin, views = s.views.size(), words = visible_.wordsPerPoint();
  s.tried.resize(s.hit_of.size());
  if (pairs == 0) return;
  // Distributed by view: the kernel takes many hits of one view.
  s.begin.assign(views + 1, 0);
  for (std::size_t i = 0; i < pairs; ++i) ++s.begin[s.view_of[begin + i] + 1];
  std::size_t most = 0, lanes = s.lanes;  // each view's begin at a whole vector
  for (std::size_t v = 0; v < views; ++v) {
    most = std::max<std::size_t>(most, s.begin[v + 1]);
    lanes += paddedLanes(s.begin[v + 1]);
    s.begin[v + 1] += s.begin[v];
  }
  s.order.resize(pairs);
  for (std::size_t i = 0; i < pairs; ++i)
    s.order[s.begin[s.view_of[begin + i]]++] = static_cast<std::uint32_t>(begin + i);
  double* hit[std::tuple_size_v<HitPlace>];
  for (std::size_t k = 0; k < s.hit_lanes.size(); ++k) {
    if (s.hit_lanes[k].size() < paddedLanes(most)) s.hit_lanes[k].resize(paddedLanes(most));
    hit[k] = s.hit_lanes[k].data();
  }
  const HitLanes from{hit[0], hit[1], hit[2], hit[3], hit[4], hit[5], hit[6], hit[7], hit[8], hit[9]};
  for (auto& lane : s.view_lanes)
    if (lane.size() < lanes) lane.resize(lanes);
  for (std::size_t slot = 0, at = 0; slot < views; ++slot) {
    const std::size_t count = s.begin[slot] - at;
    if (count == 0) continue;
    const std::uint32_t view = s.views[slot];
    const SourceView& source = views_[view];
    const Coverage& coverage = *source.coverage;
    for (std::size_t i = 0; i < count; ++i) {
      const HitPlace& place = s.hits[s.hit_of[s.order[at + i]]];
      for (std::size_t k = 0; k < place.size(); ++k) hit[k][i] = place[k];
    }
    const ViewLanes to = viewLanes(s);
    placeViews(source.camera,
               {static_cast<double>(source.geometry.crop_x), static_cast<double>(source.geometry.crop_y)},
               kLeastForeshortening, from, count, to);
    const bool distorted = bendsLines(source.camera.lens);
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint32_t pair = s.order[at + i], h = s.hit_of[pair];
      Tried& tried = s.tried[pair];
      tried = {kPenaltyCap, view, static_cast<std::uint32_t>(s.lanes + i), false};
      if (distorted) {
        const auto projection = source.camera.project(queries[h].p);
        if (!projection) continue;
        const Vec2& pixel = projection->pixel;
        const TexelPlace place = texelPlace(source.geometry, pixel);
        to.pixel_x[i] = pixel.x, to.pixel_y[i] = pixel.y;
        to.floor_x[i] = place.floor_x, to.floor_y[i] = place.floor_y;
        to.part_x[i] = place.part_x, to.part_y[i] = place.part_y;
        to.border[i] = borderOf(source.camera.lens, pixel);
      } else if (to.usable[i] == 0) {
        continue;
      }
      double usable = s.weight[h];
      if (!(s.by_all[h * words + view / 64] >> view % 64 & 1)) {
        usable = 0;
        const ViewQuery& query = queries[h];
        for (std::size_t k = 0; k < query.points.size(); ++k)
          if (visible_.get(query.points[k], view)) usable += query.point_weights[k];
        usable = std::min(usable, 1.0);
      }
      const TexelPlace place{to.floor_x[i], to.floor_y[i], to.part_x[i], to.part_y[i]};
      const double border = to.border[i];
      tried.whole = border > 0 && wholeAt(coverage, place);
      if (!(tried.whole && border >= kBorderPixels))
        usable *= covered(view, {to.pixel_x[i], to.pixel_y[i]}, border, tried.whole);
      const double penalty = viewPenalty(to.angle[i], to.resolution[i], usable);
      if (penalty < kPenaltyCap) tried.penalty = penalty;
    }
    at += count, s.lanes += paddedLanes(count);
  }
}

void ViewSelection::select(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& s,
                           Chosen& chosen) const {
  const std::size_t hits = queries.size(), words = visible_.wordsPerPoint(), stride = paddedLanes(hits);
  chosen.views.clear();
  chosen.first.assign(1, 0);
  chosen.result.clear();
  if (hits == 0) return;

  // Hits side by side, and which views see one of a hit's points: only those are candidates.
  s.seen.assign((hits + 2) * words, 0);
  s.by_all.resize(hits * words);
  s.weight.resize(hits);
  s.seen_lanes.resize(2 * words * stride);
  s.hits.resize(hits);
  for (auto& lane : s.near) lane.resize(stride);
  std::uint64_t *some = &s.seen[hits * words], *may = some + words;
  for (std::size_t v = 0; v < views_.size(); ++v) may[v / 64] |= std::uint64_t{allowed[v] != 0} << (v % 64);
  const Vec3 origin = queries[0].p.raw();
  for (std::size_t h = 0; h < hits; ++h) {
    const ViewQuery& query = queries[h];
    for (std::size_t w = 0; w < words; ++w) {
      std::uint64_t seen = 0, by_all = ~std::uint64_t{0};
      for (const std::uint32_t point : query.points) {
        const std::uint64_t row = visible_.row(point)[w];
        seen |= row, by_all &= row;
      }
      s.seen[h * words + w] = seen &= may[w];
      s.by_all[h * words + w] = by_all;
      s.seen_lanes[2 * w * stride + h] = static_cast<std::uint32_t>(seen);
      s.seen_lanes[(2 * w + 1) * stride + h] = static_cast<std::uint32_t>(seen >> 32);
      some[w] |= seen;
    }
    double weight = 0;
    for (const float of_point : query.point_weights) weight += of_point;
    s.weight[h] = std::min(weight, 1.0);
    const Vec3 &p = query.p.raw(), &v = query.view.raw(), &n = query.normal.raw();
    s.hits[h] = {p.x, p.y, p.z, v.x, v.y, v.z, n.x, n.y, n.z, query.eye_distance};
    const double inverse_eye = query.eye_distance > 0 ? 1 / query.eye_distance : 0;
    const double near[] = {p.x - origin.x, p.y - origin.y, p.z - origin.z, v.x, v.y, v.z, inverse_eye};
    for (std::size_t k = 0; k < s.near.size(); ++k) s.near[k][h] = static_cast<float>(near[k]);
  }
  const auto each = [words](const std::uint64_t* bits, const auto& act) {
    for (std::size_t w = 0; w < words; ++w)
      for (std::uint64_t rest = bits[w]; rest; rest &= rest - 1)
        act(static_cast<std::uint32_t>(64 * w + std::countr_zero(rest)));
  };
  s.views.clear();
  s.slot.resize(views_.size());
  for (auto& axis : s.centers) axis.clear();
  each(some, [&](std::uint32_t view) {
    s.slot[view] = static_cast<std::uint32_t>(s.views.size());
    s.views.push_back(view);
    const Camera<AcquisitionSpace>& camera = views_[view].camera;
    const Vec3 center = camera.center().raw() - origin;
    // Of an orthographic view the bound is 0.
    for (int k = 0; k < 3; ++k)
      s.centers[k].push_back(camera.lens.isOrthographic() ? std::numeric_limits<float>::quiet_NaN()
                                                          : static_cast<float>(center[k]));
  });

  // The k + 1 of least bound first: visibility and coverage only add to the penalty.
  const int wanted = k_ + 1;
  const bool ranked = wanted <= kMostNearViews;
  s.hit_of.clear();
  s.view_of.clear();
  s.tried.clear();
  s.lanes = 0;
  s.first.clear();
  s.second.assign(hits, {0, 0});
  const auto pair = [&s](std::size_t h, std::uint32_t slot) {
    s.hit_of.push_back(static_cast<std::uint32_t>(h));
    s.view_of.push_back(slot);
  };
  constexpr float kTaken = std::numeric_limits<float>::infinity();
  if (ranked) {
    s.bounds.resize(s.views.size() * stride);
    s.nearest.resize(wanted * stride);
    s.rest.resize(stride);
    const auto& n = s.near;
    nearestViews({s.centers[0].data(), s.centers[1].data(), s.centers[2].data(), s.views.data(), s.views.size()},
                 {n[0].data(), n[1].data(), n[2].data(), n[3].data(), n[4].data(), n[5].data(), n[6].data(),
                  s.seen_lanes.data()},
                 hits, stride, wanted, s.bounds.data(), s.nearest.data(), s.rest.data());
  }
  for (std::size_t h = 0; h < hits; ++h) {
    const auto begin = static_cast<std::uint32_t>(s.hit_of.size());
    if (!ranked) each(&s.seen[h * words], [&](std::uint32_t view) { pair(h, s.slot[view]); });
    for (int j = 0; ranked && j < wanted; ++j) {
      const std::int32_t slot = s.nearest[j * stride + h];
      if (slot < 0) break;
      pair(h, static_cast<std::uint32_t>(slot));
    }
    s.first.push_back({begin, static_cast<std::uint32_t>(s.hit_of.size())});
  }
  lookAt(queries, 0, s);

  // Then all whose bound does not lie beyond the (k + 1)-th penalty found: no other can be among the k + 1 nearest or
  // tie with them.
  const std::size_t looked_at = s.hit_of.size();
  for (std::size_t h = 0; ranked && h < hits; ++h) {
    const auto [begin, end] = s.first[h];
    double worst = 0;
    for (std::size_t i = begin; i < end; ++i) worst = std::max(worst, s.tried[i].penalty);
    if (s.rest[h] == kTaken || s.rest[h] > worst) continue;
    for (std::size_t i = begin; i < end; ++i) s.bounds[s.view_of[i] * stride + h] = kTaken;
    const auto second = static_cast<std::uint32_t>(s.hit_of.size());
    each(&s.seen[h * words], [&](std::uint32_t view) {
      const float bound = s.bounds[s.slot[view] * stride + h];
      if (bound <= worst && bound < kTaken) pair(h, s.slot[view]);
    });
    s.second[h] = {second, static_cast<std::uint32_t>(s.hit_of.size())};
  }
  lookAt(queries, looked_at, s);

  s.lanes = 0;
  const ViewLanes all = viewLanes(s);
  chosen.views.reserve(hits * k_);
  chosen.first.reserve(hits + 1);
  chosen.result.reserve(hits);
  for (std::size_t h = 0; h < hits; ++h) {
    auto& order = s.ranked;
    order.clear();
    for (const auto& [begin, end] : {s.first[h], s.second[h]})
      for (std::uint32_t i = begin; i < end; ++i) {
        if (!(s.tried[i].penalty < kPenaltyCap)) continue;
        order.push_back({s.tried[i].penalty, s.tried[i].view, i});
        for (std::size_t j = order.size() - 1; j > 0 && order[j] < order[j - 1]; --j) std::swap(order[j], order[j - 1]);
      }
    // lumigraphWeights of what is in order already.
    const std::size_t first = chosen.views.size(), nearest = std::min<std::size_t>(order.size(), k_);
    const double t = order.size() > nearest ? std::max(order[nearest].penalty, kLeastPenalty) : kPenaltyCap;
    double sum = 0;
    const auto take = [&](std::uint32_t i, double weight) {
      const Tried& tried = s.tried[i];
      const std::uint32_t lane = tried.lane;
      weight *= all.foreshortening[lane];
      sum += weight;
      ChosenView& view = chosen.views.emplace_back();
      view.view = tried.view, view.weight = weight, view.angle = all.angle[lane], view.penalty = tried.penalty;
      view.foreshortening = all.foreshortening[lane];
      fetch(tried.view, {all.pixel_x[lane], all.pixel_y[lane]},
            {all.floor_x[lane], all.floor_y[lane], all.part_x[lane], all.part_y[lane]}, tried.whole, view.fetch);
    };
    for (std::size_t i = 0; i < nearest; ++i) {
      const double weight = 1 / std::max(order[i].penalty, kLeastPenalty) - 1 / t;
      if (!(weight > 0)) break;
      take(order[i].pair, weight);
    }
    if (chosen.views.size() == first)
      for (const Ranked& ranked : order)
        if (ranked.penalty <= t) take(ranked.pair, 1);
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
    if (!projection) continue;
    const Vec2& pixel = projection->pixel;
    const TexelPlace place = texelPlace(views_[view].geometry, pixel);
    const double border = borderOf(views_[view].camera.lens, pixel);
    const bool whole = border > 0 && wholeAt(*views_[view].coverage, place);
    if (!(covered(view, pixel, border, whole) > 0)) continue;
    chosen = {view, 1, angle, std::numeric_limits<double>::infinity(), {}};
    fetch(view, pixel, place, whole, chosen.fetch);
    return true;
  }
  return false;
}

}  // namespace srf
