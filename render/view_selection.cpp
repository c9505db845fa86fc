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

/// bilinearFetch where all four texels are covered.
void putWhole(const TexelAndPart& column, const TexelAndPart& row, std::size_t i, const ViewLanes& to) {
  const double x = column.part, y = row.part;
  to.x[i] = static_cast<int>(column.texel), to.y[i] = static_cast<int>(row.texel);
  to.tap[4 * i] = static_cast<float>((1 - x) * (1 - y));
  to.tap[4 * i + 1] = static_cast<float>(x * (1 - y));
  to.tap[4 * i + 2] = static_cast<float>((1 - x) * y);
  to.tap[4 * i + 3] = static_cast<float>(x * y);
}

constexpr std::uint32_t kWhole = 0xffffffffu;  // in place of a fetch whose four texels are all covered
constexpr std::size_t kAtOnce = ViewSelection::Scratch::kAtOnce;
constexpr std::size_t kMore = 4;  // views looked at together where the nearest do not suffice
static_assert(kAtOnce == paddedLanes(kAtOnce) && kMore <= kVectorLanes);

template <std::size_t kCount>
HitLanes hitLanes(const std::array<std::array<double, kCount>, 11>& of, const std::vector<std::uint32_t>& by_all) {
  const auto lane = [&of](std::size_t k) { return of[k].data(); };
  return {lane(0), lane(1), lane(2), lane(3),  lane(4),       lane(5), lane(6),
          lane(7), lane(8), lane(9), lane(10), by_all.data(), kCount};
}

/// Those of the pairs from `first` on.
ViewLanes viewLanes(ViewSelection::Scratch& s, std::size_t first) {
  const auto lane = [&s, first](std::size_t k) { return s.view_lanes[k].data() + first; };
  const auto texel = [&s, first](std::size_t k) { return s.texels[k].data() + first; };
  return {lane(0), lane(1), lane(2), lane(3), lane(4), lane(5), texel(0), texel(1), texel(2), s.tap.data() + 4 * first};
}

/// Room for so many pairs, and for what kernels write beyond them.
void holdPairs(std::size_t count, ViewSelection::Scratch& s) {
  count = paddedLanes(count) + kVectorLanes;
  if (s.view.size() >= count) return;
  for (auto& lane : s.view_lanes) lane.resize(count);
  for (auto& lane : s.texels) lane.resize(count);
  s.tap.resize(4 * count);
  s.view.resize(count);
  s.fetch.resize(count);
}

double borderOf(const Intrinsics& lens, const Vec2& pixel) {
  return std::min({pixel.x, pixel.y, lens.width - pixel.x, lens.height - pixel.y});
}

}  // namespace

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {
  for (const SourceView& view : views_) {
    PlacedView& placed = placed_.emplace_back(view.camera);
    if (!view.coverage) continue;
    placed.crop_x = view.geometry.crop_x, placed.crop_y = view.geometry.crop_y;
    placed.across = view.coverage->width(), placed.down = view.coverage->height();
    placed.tiles_x = (view.coverage->width() + kTile - 1) / kTile;
    placed.first_tile = whole_.add(*view.coverage);
  }
}

double ViewSelection::seenShare(const ViewQuery& query, std::uint32_t view) const {
  double share = 0;
  for (std::size_t k = 0; k < query.points.size(); ++k)
    if (visible_.get(query.points[k], view)) share += query.point_weights[k];
  return std::min(share, 1.0);
}

void ViewSelection::ask(const ViewQuery& query, const HitLanes& from, std::size_t i, std::size_t pair,
                        Scratch& s) const {
  const ViewLanes to = viewLanes(s, 0);
  const auto view = static_cast<std::uint32_t>(s.view[pair]);
  const SourceView& source = views_[view];
  bool whole = to.state[pair] == kViewAsked;
  if (placed_[view].bends) {
    const auto projection = source.camera.project(query.p);
    const double border = projection ? borderOf(source.camera.lens, projection->pixel) : 0;
    if (!(border > 0)) {
      to.penalty[pair] = kPenaltyCap;
      return;
    }
    to.border[pair] = border;
    to.pixel_x[pair] = projection->pixel.x, to.pixel_y[pair] = projection->pixel.y;
    const TexelAndPart x = texelAndPart(projection->pixel.x - 0.5 - source.geometry.crop_x),
                       y = texelAndPart(projection->pixel.y - 0.5 - source.geometry.crop_y);
    whole = whole_.at(placed_[view], x.texel, y.texel);
    if (whole) putWhole(x, y, pair, to);
  }
  double share = 1;
  if (placed_[view].bends || from.weight[i] < 0 || to.border[pair] < kBorderPixels) {
    const bool all = from.by_all[view / 32 * from.stride + i] >> view % 32 & 1;
    share = all ? std::fabs(from.weight[i]) : seenShare(query, view);
    if (to.border[pair] < kBorderPixels) share *= smoothstep(0, kBorderPixels, to.border[pair]);
  } else {
    to.penalty[pair] /= from.weight[i];
  }
  if (!whole) {
    s.fetch[pair] = static_cast<std::uint32_t>(s.fetches.size());
    s.fetches.push_back(bilinearFetch(source, {to.pixel_x[pair], to.pixel_y[pair]}));
    // Where a matte covers p a little, its coverage is the answer.
    if (!source.matte) share *= s.fetches.back().covered;
  }
  const double penalty = share == 1 ? to.penalty[pair] : to.penalty[pair] / share;
  to.penalty[pair] = penalty < kPenaltyCap ? penalty : kPenaltyCap;
}

void ViewSelection::lookAt(const ViewQuery* query, std::size_t step, const HitLanes& from, std::size_t first,
                           std::size_t count, Scratch& s) const {
  const ViewLanes to = viewLanes(s, first);
  placeViews(placed_.data(), whole_, s.view.data() + first, kLeastForeshortening, kBorderPixels, from, count, to);
  std::fill_n(s.fetch.begin() + static_cast<std::ptrdiff_t>(first), count, kWhole);
  for (std::size_t i = 0; i < count; ++i)
    if (to.state[i] >= kViewAsked) ask(query[i * step], from, i, first + i, s);
}

void ViewSelection::readHits(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed,
                             Scratch& s) const {
  const std::size_t hits = queries.size(), words = visible_.wordsPerPoint();
  s.seen.resize(2 * words * kAtOnce);
  s.by_all.resize(2 * words * kAtOnce);
  s.words.assign(2 * words, 0);
  std::uint64_t *const some = s.words.data(), *const may = some + words;
  for (std::size_t v = 0; v < views_.size(); ++v) may[v / 64] |= std::uint64_t{allowed[v] != 0} << (v % 64);
  const auto put = [](std::uint64_t word, std::uint32_t* low) {
    low[0] = static_cast<std::uint32_t>(word), low[kAtOnce] = static_cast<std::uint32_t>(word >> 32);
  };
  for (std::size_t h = 0; h < hits; ++h) {
    const ViewQuery& query = queries[h];
    // Views that see one of the hit's points: only those are candidates.
    std::uint64_t in_part = 0;
    for (std::size_t w = 0; w < words; ++w) {
      std::uint64_t seen = 0, by_all = ~std::uint64_t{0};
      for (const std::uint32_t point : query.points) {
        const std::uint64_t row = visible_.row(point)[w];
        seen |= row, by_all &= row;
      }
      seen &= may[w];
      some[w] |= seen;
      in_part |= seen & ~by_all;
      put(seen, &s.seen[2 * w * kAtOnce + h]);
      put(by_all, &s.by_all[2 * w * kAtOnce + h]);
    }
    double weight = 0;
    for (const float of_point : query.point_weights) weight += of_point;
    weight = in_part ? -std::min(weight, 1.0) : std::min(weight, 1.0);
    const Vec3 &p = query.p.raw(), &v = query.view.raw(), &n = query.normal.raw();
    const double lanes[] = {p.x, p.y, p.z, v.x, v.y, v.z, n.x, n.y, n.z, query.eye_distance, weight};
    for (std::size_t k = 0; k < s.hit.size(); ++k) s.hit[k][h] = lanes[k];
  }
  const Vec3 origin = queries[0].p.raw();
  for (std::size_t k = 0; k < 6; ++k) {
    const double from = k < 3 ? origin[static_cast<int>(k)] : 0;
    for (std::size_t h = 0; h < hits; ++h) s.near[k][h] = static_cast<float>(s.hit[k][h] - from);
  }
  for (std::size_t h = 0; h < hits; ++h) s.near[6][h] = static_cast<float>(s.hit[9][h] > 0 ? 1 / s.hit[9][h] : 0);

  s.views.clear();
  s.slot.resize(views_.size());
  for (auto& axis : s.centers) axis.clear();
  for (std::size_t w = 0; w < words; ++w)
    for (std::uint64_t rest = some[w]; rest; rest &= rest - 1) {
      const auto view = static_cast<std::uint32_t>(64 * w + std::countr_zero(rest));
      s.slot[view] = static_cast<std::uint32_t>(s.views.size());
      s.views.push_back(view);
      const Vec3 center = placed_[view].center - origin;
      // Of an orthographic view the bound is 0.
      for (int k = 0; k < 3; ++k)
        s.centers[k].push_back(placed_[view].orthographic ? std::numeric_limits<float>::quiet_NaN()
                                                          : static_cast<float>(center[k]));
    }
}

void ViewSelection::rankAll(const ViewQuery& query, std::size_t h, Scratch& s) const {
  constexpr float kLookedAt = std::numeric_limits<float>::infinity();
  const std::size_t ranks = nearViews(), words = 2 * visible_.wordsPerPoint();
  const double* const penalties = viewLanes(s, 0).penalty;
  auto& order = s.ranked;
  order.clear();
  const auto rank = [&](std::size_t pair) {
    if (!(penalties[pair] < kPenaltyCap)) return;
    order.push_back({penalties[pair], static_cast<std::uint32_t>(s.view[pair]), static_cast<std::uint32_t>(pair)});
    for (std::size_t j = order.size() - 1; j > 0 && order[j] < order[j - 1]; --j) std::swap(order[j], order[j - 1]);
  };
  for (std::size_t pair = h; pair < ranks * kAtOnce; pair += kAtOnce) {
    if (s.view[pair] < 0) continue;
    s.bounds[s.slot[s.view[pair]] * kAtOnce + h] = kLookedAt;
    rank(pair);
  }

  for (std::size_t k = 0; k < s.again.size(); ++k) s.again[k].fill(s.hit[k][h]);
  s.again_by_all.resize(words * kVectorLanes);
  for (std::size_t w = 0; w < words; ++w)
    std::fill_n(&s.again_by_all[w * kVectorLanes], kVectorLanes, s.by_all[w * kAtOnce + h]);
  const HitLanes from = hitLanes(s.again, s.again_by_all);
  // The nearest first, while one may lie no further than the (k + 1)-th found: visibility and coverage only add to the
  // penalty.
  for (std::size_t next = ranks * kAtOnce;;) {
    const double worst = order.size() > static_cast<std::size_t>(k_) ? order[k_].penalty : kPenaltyCap;
    std::pair<float, std::size_t> nearest[kMore];
    std::size_t count = 0;
    for (std::size_t v = 0; v < s.views.size(); ++v) {
      const float bound = s.bounds[v * kAtOnce + h];
      if (!(bound <= worst) || (count == kMore && !(bound < nearest[kMore - 1].first))) continue;
      std::size_t at = count < kMore ? count++ : kMore - 1;
      for (; at > 0 && bound < nearest[at - 1].first; --at) nearest[at] = nearest[at - 1];
      nearest[at] = {bound, v};
    }
    if (count == 0) break;
    for (std::size_t i = 0; i < count; ++i) {
      s.view[next + i] = static_cast<std::int32_t>(s.views[nearest[i].second]);
      s.bounds[nearest[i].second * kAtOnce + h] = kLookedAt;
    }
    lookAt(&query, 0, from, next, count, s);
    for (std::size_t i = 0; i < count; ++i) rank(next + i);
    next += count;
  }
}

void ViewSelection::choose(std::size_t pair, double weight, const Scratch& s, Chosen& chosen) const {
  const float* const tap = &s.tap[4 * pair];
  chosen.views.push_back({static_cast<std::uint32_t>(s.view[pair]),
                          weight,
                          s.view_lanes[0][pair],
                          s.view_lanes[1][pair],
                          s.view_lanes[2][pair],
                          {s.texels[1][pair], s.texels[2][pair], {tap[0], tap[1], tap[2], tap[3]}, 1}});
  if (s.fetch[pair] != kWhole) chosen.views.back().fetch = s.fetches[s.fetch[pair]];
}

PickedView ViewSelection::picked(std::size_t pair, double weight, const Scratch& s) const {
  const auto view = static_cast<std::uint32_t>(s.view[pair]);
  if (s.fetch[pair] != kWhole) return PickedView::of(view, weight, s.fetches[s.fetch[pair]]);
  return {view, static_cast<float>(weight), s.texels[1][pair], s.texels[2][pair], 0, true, &s.tap[4 * pair]};
}

void ViewSelection::selectSome(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& s,
                               Chosen& chosen, const Take& take, std::size_t first_hit) const {
  const std::size_t hits = queries.size(), ranks = nearViews();
  readHits(queries, allowed, s);
  s.bounds.resize(s.views.size() * kAtOnce);
  s.fetches.clear();
  holdPairs(ranks * kAtOnce + s.views.size(), s);
  const auto& n = s.near;
  nearestViews(
      {s.centers[0].data(), s.centers[1].data(), s.centers[2].data(), s.views.data(), s.views.size()},
      {n[0].data(), n[1].data(), n[2].data(), n[3].data(), n[4].data(), n[5].data(), n[6].data(), s.seen.data()}, hits,
      kAtOnce, static_cast<int>(ranks), s.bounds.data(), s.view.data(), s.rest.data());
  for (std::size_t j = 0; j < ranks; ++j) lookAt(queries.data(), 1, hitLanes(s.hit, s.by_all), j * kAtOnce, hits, s);
  const ViewLanes all = viewLanes(s, 0);
  const bool enough = ranks > static_cast<std::size_t>(k_);
  if (enough)
    weighViews({all.penalty, all.foreshortening, s.rest.data(), ranks, kAtOnce}, hits, k_, s.chosen_pair.data(),
               s.weight.data(), s.taken.data());

  for (std::size_t h = 0; h < hits; ++h) {
    Result result = Result::seen;
    const std::size_t first = chosen.views.size();
    if (enough && s.taken[h] > 0) {
      const auto count = static_cast<std::size_t>(s.taken[h]);
      if (take) {
        PickedView views[kMostNearViews];
        for (std::size_t r = 0; r < count; ++r)
          views[r] = picked(static_cast<std::size_t>(s.chosen_pair[r * kAtOnce + h]), s.weight[r * kAtOnce + h], s);
        if (take(first_hit + h, {views, count})) {
          chosen.result.push_back(result);
          chosen.first.push_back(static_cast<std::uint32_t>(first));
          continue;
        }
      }
      for (std::size_t r = 0; r < count; ++r)
        choose(static_cast<std::size_t>(s.chosen_pair[r * kAtOnce + h]), s.weight[r * kAtOnce + h], s, chosen);
    } else {
      rankAll(queries[h], h, s);
      // lumigraphWeights of what is in order already.
      const auto& order = s.ranked;
      const std::size_t nearest = std::min<std::size_t>(order.size(), k_);
      const double t = order.size() > nearest ? std::max(order[nearest].penalty, kLeastPenalty) : kPenaltyCap;
      double sum = 0;
      const auto take = [&](std::uint32_t pair, double weight) {
        weight *= s.view_lanes[2][pair];
        sum += weight;
        choose(pair, weight, s, chosen);
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
    }
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

void ViewSelection::select(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& s,
                           Chosen& chosen, const Take& take) const {
  chosen.views.clear();
  chosen.first.assign(1, 0);
  chosen.result.clear();
  if (!take) chosen.views.reserve(queries.size() * k_);
  chosen.first.reserve(queries.size() + 1);
  chosen.result.reserve(queries.size());
  s.chosen_pair.resize(static_cast<std::size_t>(k_) * kAtOnce);
  s.weight.resize(static_cast<std::size_t>(k_) * kAtOnce);
  for (std::size_t begin = 0; begin < queries.size(); begin += kAtOnce)
    selectSome(queries.subspan(begin, std::min(kAtOnce, queries.size() - begin)), allowed, s, chosen, take, begin);
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
