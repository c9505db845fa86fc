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

double borderOf(const Intrinsics& lens, const Vec2& pixel) {
  return std::min({pixel.x, pixel.y, lens.width - pixel.x, lens.height - pixel.y});
}

}  // namespace

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {}

double ViewSelection::covered(std::uint32_t view, const Vec2& pixel, double border, const TexelPlace& place,
                              bool& whole) const {
  const SourceView& source = views_[view];
  whole = false;
  if (!(border > 0)) return 0;
  const double inside = border >= kBorderPixels ? 1 : smoothstep(0, kBorderPixels, border);
  const Coverage& coverage = *source.coverage;
  if (place.floor_x >= 0 && place.floor_y >= 0 && place.floor_x < coverage.width() - 1 &&
      place.floor_y < coverage.height() - 1) {
    whole = coverage.whole(static_cast<int>(place.floor_x), static_cast<int>(place.floor_y));
    if (whole) return inside;
  }
  if (source.matte) return inside;  // where it covers p a little, its coverage is the answer
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
  std::size_t most = 0;
  for (std::size_t v = 0; v < views; ++v) {
    most = std::max<std::size_t>(most, s.begin[v + 1]);
    s.begin[v + 1] += s.begin[v];
  }
  s.order.resize(pairs);
  for (std::size_t i = 0; i < pairs; ++i)
    s.order[s.begin[s.view_of[begin + i]]++] = static_cast<std::uint32_t>(begin + i);
  const std::size_t lanes = paddedLanes(most);
  for (auto& lane : s.hit_lanes)
    if (lane.size() < lanes) lane.resize(lanes);
  for (auto& lane : s.view_lanes)
    if (lane.size() < lanes) lane.resize(lanes);
  auto& hit = s.hit_lanes;
  const HitLanes from{hit[0].data(), hit[1].data(), hit[2].data(), hit[3].data(), hit[4].data(),
                      hit[5].data(), hit[6].data(), hit[7].data(), hit[8].data(), hit[9].data()};
  auto& lane = s.view_lanes;
  const ViewLanes to{lane[0].data(), lane[1].data(), lane[2].data(), lane[3].data(), lane[4].data(), lane[5].data(),
                     lane[6].data(), lane[7].data(), lane[8].data(), lane[9].data(), lane[10].data()};
  for (std::size_t slot = 0, at = 0; slot < views; ++slot) {
    const std::size_t count = s.begin[slot] - at;
    if (count == 0) continue;
    const std::uint32_t view = s.views[slot];
    const SourceView& source = views_[view];
    for (std::size_t k = 0; k < hit.size(); ++k)
      for (std::size_t i = 0; i < count; ++i) hit[k][i] = s.hits[k][s.hit_of[s.order[at + i]]];
    placeViews(source.camera,
               {static_cast<double>(source.geometry.crop_x), static_cast<double>(source.geometry.crop_y)},
               kLeastForeshortening, from, count, to);
    const bool distorted = bendsLines(source.camera.lens);
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint32_t pair = s.order[at + i], h = s.hit_of[pair];
      Tried& tried = s.tried[pair];
      tried.view = view, tried.whole = false, tried.penalty = kPenaltyCap;
      tried.angle = to.angle[i], tried.foreshortening = to.foreshortening[i];
      tried.pixel.x = to.pixel_x[i], tried.pixel.y = to.pixel_y[i];
      tried.place.floor_x = to.floor_x[i], tried.place.floor_y = to.floor_y[i];
      tried.place.part_x = to.part_x[i], tried.place.part_y = to.part_y[i];
      double border = to.border[i];
      if (distorted) {
        const auto projection = source.camera.project(queries[h].p);
        if (!projection) continue;
        tried.pixel = projection->pixel;
        tried.place = texelPlace(source.geometry, tried.pixel);
        border = borderOf(source.camera.lens, tried.pixel);
      } else if (to.usable[i] == 0) {
        continue;
      }
      double seen = s.weight[h];
      if (!(s.by_all[h * words + view / 64] >> view % 64 & 1)) {
        seen = 0;
        const ViewQuery& query = queries[h];
        for (std::size_t k = 0; k < query.points.size(); ++k)
          if (visible_.get(query.points[k], view)) seen += query.point_weights[k];
        seen = std::min(seen, 1.0);
      }
      const double usable = seen * covered(view, tried.pixel, border, tried.place, tried.whole);
      const double penalty = viewPenalty(tried.angle, to.resolution[i], usable);
      if (penalty < kPenaltyCap) tried.penalty = penalty;
    }
    at += count;
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
  for (auto& lane : s.hits) lane.resize(stride);
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
    const double lanes[] = {p.x, p.y, p.z, v.x, v.y, v.z, n.x, n.y, n.z, query.eye_distance};
    for (std::size_t k = 0; k < s.hits.size(); ++k) s.hits[k][h] = lanes[k];
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

  chosen.views.reserve(hits * k_);
  chosen.first.reserve(hits + 1);
  chosen.result.reserve(hits);
  for (std::size_t h = 0; h < hits; ++h) {
    auto& order = s.ranked;
    order.clear();
    for (const auto& [begin, end] : {s.first[h], s.second[h]})
      for (std::uint32_t i = begin; i < end; ++i) {
        if (!(s.tried[i].penalty < kPenaltyCap)) continue;
        order.push_back({{s.tried[i].penalty, s.tried[i].view}, i});
        for (std::size_t j = order.size() - 1; j > 0 && order[j].first < order[j - 1].first; --j)
          std::swap(order[j], order[j - 1]);
      }
    // lumigraphWeights of what is in order already.
    const std::size_t first = chosen.views.size(), nearest = std::min<std::size_t>(order.size(), k_);
    const double t = order.size() > nearest ? std::max(order[nearest].first.penalty, kLeastPenalty) : kPenaltyCap;
    double sum = 0;
    const auto take = [&](std::uint32_t i, double weight) {
      const Tried& tried = s.tried[i];
      weight *= tried.foreshortening;
      sum += weight;
      ChosenView& view = chosen.views.emplace_back();
      view.view = tried.view, view.weight = weight, view.angle = tried.angle, view.penalty = tried.penalty;
      fetch(tried.view, tried.pixel, tried.place, tried.whole, view.fetch);
    };
    for (std::size_t i = 0; i < nearest; ++i) {
      const double weight = 1 / std::max(order[i].first.penalty, kLeastPenalty) - 1 / t;
      if (!(weight > 0)) break;
      take(order[i].second, weight);
    }
    if (chosen.views.size() == first)
      for (const auto& [view, i] : order)
        if (view.penalty <= t) take(i, 1);
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
    if (!projection) continue;
    const Vec2& pixel = projection->pixel;
    const TexelPlace place = texelPlace(views_[view].geometry, pixel);
    if (!(covered(view, pixel, borderOf(views_[view].camera.lens, pixel), place, whole) > 0)) continue;
    chosen = {view, 1, angle, std::numeric_limits<double>::infinity(), {}};
    fetch(view, pixel, place, whole, chosen.fetch);
    return true;
  }
  return false;
}

}  // namespace srf
