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

/// bilinearFetch where all four texels are covered.
void wholeFetch(const TexelPlace& place, Fetch& fetch) {
  const double x = place.part_x, y = place.part_y;
  fetch.x = static_cast<int>(place.floor_x), fetch.y = static_cast<int>(place.floor_y);
  fetch.tap[0] = static_cast<float>((1 - x) * (1 - y));
  fetch.tap[1] = static_cast<float>(x * (1 - y));
  fetch.tap[2] = static_cast<float>((1 - x) * y);
  fetch.tap[3] = static_cast<float>(x * y);
  fetch.covered = 1;
}

constexpr std::uint32_t kWhole = 0xffffffffu;  // in place of a fetch whose four texels are all covered

HitLanes hitLanes(const std::array<std::vector<double>, 11>& of) {
  const auto lane = [&of](std::size_t k) { return of[k].data(); };
  return {lane(0), lane(1), lane(2), lane(3), lane(4), lane(5), lane(6), lane(7), lane(8), lane(9), lane(10)};
}

/// Those of the pairs from `first` on.
ViewLanes viewLanes(ViewSelection::Scratch& s, std::size_t first) {
  const auto lane = [&s, first](std::size_t k) { return s.view_lanes[k].data() + first; };
  return {lane(0), lane(1), lane(2), lane(3), lane(4), lane(5), lane(6), lane(7), lane(8), lane(9), lane(10)};
}

/// Room for so many pairs, padded.
void holdPairs(std::size_t count, ViewSelection::Scratch& s) {
  count = paddedLanes(count);
  for (auto& lane : s.view_lanes)
    if (lane.size() < count) lane.resize(count);
  if (s.view.size() < count) s.view.resize(count);
  if (s.fetch.size() < count) s.fetch.resize(count);
}

double borderOf(const Intrinsics& lens, const Vec2& pixel) {
  return std::min({pixel.x, pixel.y, lens.width - pixel.x, lens.height - pixel.y});
}

/// Where p lies in a view whose lens bends lines; false: nowhere in its picture.
bool placeBent(const SourceView& view, const Point<AcquisitionSpace>& p, std::size_t i, const ViewLanes& to) {
  const auto projection = view.camera.project(p);
  if (!projection) return false;
  const Vec2& pixel = projection->pixel;
  const TexelPlace place = texelPlace(view.geometry, pixel);
  to.pixel_x[i] = pixel.x, to.pixel_y[i] = pixel.y;
  to.floor_x[i] = place.floor_x, to.floor_y[i] = place.floor_y;
  to.part_x[i] = place.part_x, to.part_y[i] = place.part_y;
  to.border[i] = borderOf(view.camera.lens, pixel);
  return to.border[i] > 0;
}

}  // namespace

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {
  for (const SourceView& view : views_)
    placed_.push_back({view.camera,
                       {static_cast<double>(view.geometry.crop_x), static_cast<double>(view.geometry.crop_y)},
                       bendsLines(view.camera.lens)});
}

double ViewSelection::seenShare(const ViewQuery& query, std::uint32_t view) const {
  double share = 0;
  for (std::size_t k = 0; k < query.points.size(); ++k)
    if (visible_.get(query.points[k], view)) share += query.point_weights[k];
  return std::min(share, 1.0);
}

void ViewSelection::lookAt(std::span<const ViewQuery> queries, const HitLanes& from, const std::uint32_t* hit_of,
                           std::size_t first, std::size_t count, Scratch& s) const {
  const ViewLanes to = viewLanes(s, first);
  const std::int32_t* const of = s.view.data() + first;
  const std::size_t words = visible_.wordsPerPoint();
  placeViews(placed_.data(), of, kLeastForeshortening, kBorderPixels, from, count, to);
  for (std::size_t i = 0; i < count; ++i) {
    if (of[i] < 0) {
      to.penalty[i] = kPenaltyCap;
      continue;
    }
    const auto view = static_cast<std::uint32_t>(of[i]);
    const SourceView& source = views_[view];
    if (placed_[view].bends && !placeBent(source, queries[hit_of[i]].p, i, to)) to.usable[i] = 0;
    const double usable = to.usable[i];
    if (usable == 0) {
      to.penalty[i] = kPenaltyCap;
      continue;
    }
    double share = 1;
    if (usable != 1) {
      const std::size_t h = hit_of[i];
      const bool all = s.by_all[h * words + view / 64] >> view % 64 & 1;
      share = all ? std::fabs(from.weight[i]) : seenShare(queries[h], view);
      if (to.border[i] < kBorderPixels) share *= smoothstep(0, kBorderPixels, to.border[i]);
    }
    s.fetch[first + i] = kWhole;
    if (!wholeAt(*source.coverage, {to.floor_x[i], to.floor_y[i], to.part_x[i], to.part_y[i]})) {
      s.fetch[first + i] = static_cast<std::uint32_t>(s.fetches.size());
      s.fetches.push_back(bilinearFetch(source, {to.pixel_x[i], to.pixel_y[i]}));
      // Where a matte covers p a little, its coverage is the answer.
      if (!source.matte) share *= s.fetches.back().covered;
    }
    if (share == 1) continue;
    const double penalty = to.penalty[i] / share;
    to.penalty[i] = penalty < kPenaltyCap ? penalty : kPenaltyCap;
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
  s.seen_lanes.resize(2 * words * stride);
  for (auto& lane : s.hit_lanes)
    if (lane.size() < stride) lane.resize(stride);
  for (auto& lane : s.near) lane.resize(stride);
  std::uint64_t *some = &s.seen[hits * words], *may = some + words;
  for (std::size_t v = 0; v < views_.size(); ++v) may[v / 64] |= std::uint64_t{allowed[v] != 0} << (v % 64);
  const Vec3 origin = queries[0].p.raw();
  for (std::size_t h = 0; h < hits; ++h) {
    const ViewQuery& query = queries[h];
    std::uint64_t in_part = 0;
    for (std::size_t w = 0; w < words; ++w) {
      std::uint64_t seen = 0, by_all = ~std::uint64_t{0};
      for (const std::uint32_t point : query.points) {
        const std::uint64_t row = visible_.row(point)[w];
        seen |= row, by_all &= row;
      }
      s.seen[h * words + w] = seen &= may[w];
      s.by_all[h * words + w] = by_all;
      in_part |= seen & ~by_all;
      s.seen_lanes[2 * w * stride + h] = static_cast<std::uint32_t>(seen);
      s.seen_lanes[(2 * w + 1) * stride + h] = static_cast<std::uint32_t>(seen >> 32);
      some[w] |= seen;
    }
    double weight = 0;
    for (const float of_point : query.point_weights) weight += of_point;
    weight = in_part ? -std::min(weight, 1.0) : std::min(weight, 1.0);
    const Vec3 &p = query.p.raw(), &v = query.view.raw(), &n = query.normal.raw();
    const double place[] = {p.x, p.y, p.z, v.x, v.y, v.z, n.x, n.y, n.z, query.eye_distance, weight};
    for (std::size_t k = 0; k < s.hit_lanes.size(); ++k) s.hit_lanes[k][h] = place[k];
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
  const std::size_t wanted = k_ < kMostNearViews ? static_cast<std::size_t>(k_) + 1 : 0;
  holdPairs(wanted * stride, s);
  s.fetches.clear();
  s.hit_of.clear();
  s.more_views.clear();
  constexpr float kTaken = std::numeric_limits<float>::infinity();
  if (wanted > 0) {
    s.bounds.resize(s.views.size() * stride);
    s.rest.resize(stride);
    const auto& n = s.near;
    nearestViews({s.centers[0].data(), s.centers[1].data(), s.centers[2].data(), s.views.data(), s.views.size()},
                 {n[0].data(), n[1].data(), n[2].data(), n[3].data(), n[4].data(), n[5].data(), n[6].data(),
                  s.seen_lanes.data()},
                 hits, stride, static_cast<int>(wanted), s.bounds.data(), s.view.data(), s.rest.data());
    for (std::size_t h = s.each_hit.size(); h < hits; ++h) s.each_hit.push_back(static_cast<std::uint32_t>(h));
    for (std::size_t j = 0; j < wanted; ++j)
      lookAt(queries, hitLanes(s.hit_lanes), s.each_hit.data(), j * stride, hits, s);
  }

  // Then all whose bound does not lie beyond the (k + 1)-th penalty found: no other can be among the k + 1 nearest or
  // tie with them.
  const std::size_t first_more = wanted * stride;
  const double* const penalties = viewLanes(s, 0).penalty;
  s.more.resize(hits);
  for (std::size_t h = 0; h < hits; ++h) {
    const auto begin = static_cast<std::uint32_t>(s.hit_of.size());
    const auto pair = [&](std::uint32_t view) {
      s.hit_of.push_back(static_cast<std::uint32_t>(h));
      s.more_views.push_back(static_cast<std::int32_t>(view));
    };
    if (wanted == 0) {
      each(&s.seen[h * words], pair);
    } else {
      double worst = 0;
      for (std::size_t i = h; i < first_more; i += stride) worst = std::max(worst, penalties[i]);
      if (s.rest[h] != kTaken && !(s.rest[h] > worst)) {
        for (std::size_t i = h; i < first_more; i += stride)
          if (s.view[i] >= 0) s.bounds[s.slot[s.view[i]] * stride + h] = kTaken;
        each(&s.seen[h * words], [&](std::uint32_t view) {
          const float bound = s.bounds[s.slot[view] * stride + h];
          if (bound <= worst && bound < kTaken) pair(view);
        });
      }
    }
    s.more[h] = {begin, static_cast<std::uint32_t>(s.hit_of.size())};
  }
  const std::size_t more = s.hit_of.size();
  holdPairs(first_more + more, s);
  std::copy(s.more_views.begin(), s.more_views.end(), s.view.begin() + static_cast<std::ptrdiff_t>(first_more));
  for (std::size_t k = 0; k < s.more_lanes.size(); ++k) {
    auto& lane = s.more_lanes[k];
    if (lane.size() < paddedLanes(more)) lane.resize(paddedLanes(more));
    for (std::size_t i = 0; i < more; ++i) lane[i] = s.hit_lanes[k][s.hit_of[i]];
  }
  lookAt(queries, hitLanes(s.more_lanes), s.hit_of.data(), first_more, more, s);

  const ViewLanes all = viewLanes(s, 0);
  chosen.views.reserve(hits * k_);
  chosen.first.reserve(hits + 1);
  chosen.result.reserve(hits);
  for (std::size_t h = 0; h < hits; ++h) {
    auto& order = s.ranked;
    order.clear();
    const auto rank = [&](std::size_t i) {
      if (!(all.penalty[i] < kPenaltyCap)) return;
      order.push_back({all.penalty[i], static_cast<std::uint32_t>(s.view[i]), static_cast<std::uint32_t>(i)});
      for (std::size_t j = order.size() - 1; j > 0 && order[j] < order[j - 1]; --j) std::swap(order[j], order[j - 1]);
    };
    for (std::size_t i = h; i < first_more; i += stride) rank(i);
    for (std::size_t i = s.more[h][0]; i < s.more[h][1]; ++i) rank(first_more + i);
    // lumigraphWeights of what is in order already.
    const std::size_t first = chosen.views.size(), nearest = std::min<std::size_t>(order.size(), k_);
    const double t = order.size() > nearest ? std::max(order[nearest].penalty, kLeastPenalty) : kPenaltyCap;
    double sum = 0;
    const auto take = [&](std::uint32_t i, double weight) {
      weight *= all.foreshortening[i];
      sum += weight;
      ChosenView& view = chosen.views.emplace_back();
      view.view = static_cast<std::uint32_t>(s.view[i]), view.weight = weight;
      view.angle = all.angle[i], view.penalty = all.penalty[i];
      view.foreshortening = all.foreshortening[i];
      if (s.fetch[i] == kWhole)
        wholeFetch({all.floor_x[i], all.floor_y[i], all.part_x[i], all.part_y[i]}, view.fetch);
      else
        view.fetch = s.fetches[s.fetch[i]];
    };
    for (std::size_t i = 0; i < nearest; ++i) {
      const double weight = 1 / std::max(order[i].penalty, kLeastPenalty) - 1 / t;
      if (!(weight > 0)) break;
      take(order[i].pair, weight);
    }
    if (chosen.views.size() == first)
      for (const Ranked& tied : order)
        if (tied.penalty <= t) take(tied.pair, 1);
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
    if (!projection || !(borderOf(views_[view].camera.lens, projection->pixel) > 0)) continue;
    const Fetch fetch = bilinearFetch(views_[view], projection->pixel);
    if (!(fetch.covered > 0 || views_[view].matte)) continue;
    chosen = {view, 1, angle, std::numeric_limits<double>::infinity(), 1, fetch};
    return true;
  }
  return false;
}

}  // namespace srf
