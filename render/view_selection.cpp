#include "render/view_selection.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr double kBorderPixels = 4;  // over which a view fades towards the border of its picture
constexpr double kLeastForeshortening =
    0.05;  // theory 14: foreshortening in the weight pays; a grazing view stays usable
// Least coverage of a texel (formats.md): pixels over black are premultiplied and only lose precision; others hold
// background colour.
constexpr int kLeastBlack = 128, kLeastOther = 250;

}  // namespace

Fetch bilinearFetch(const SourceView& view, const Vec2& pixel) {
  Fetch fetch;
  const double u = pixel.x - 0.5 - view.geometry.crop_x, v = pixel.y - 0.5 - view.geometry.crop_y;
  // Off the rectangle, also far off (before the conversion to int).
  if (!(u > -1 && v > -1 && u < view.geometry.cropWidth() && v < view.geometry.cropHeight())) return fetch;
  // The rounding of a projection must not make one texel two.
  const auto split = [](double at, int& cell) {
    const double nearest = std::round(at);
    const double snapped = std::fabs(at - nearest) < 1e-6 ? nearest : at;
    cell = static_cast<int>(std::floor(snapped));
    return snapped - cell;
  };
  const double fx = split(u, fetch.x), fy = split(v, fetch.y);
  const double bilinear[4] = {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy};
  const int least = view.black_background ? kLeastBlack : kLeastOther;
  double denominator = 0;
  bool used[4];
  for (int t = 0; t < 4; ++t) {
    const int x = fetch.x + t % 2, y = fetch.y + t / 2;
    const bool inside = x >= 0 && y >= 0 && x < view.coverage->width() && y < view.coverage->height();
    const int coverage = inside ? view.coverage->at(x, y) : 0;
    used[t] = bilinear[t] > 0 && coverage >= least;
    if (!used[t]) continue;
    fetch.covered += bilinear[t];
    denominator += view.black_background ? bilinear[t] * coverage / 255 : bilinear[t];
  }
  for (int t = 0; t < 4; ++t) fetch.tap[t] = used[t] ? static_cast<float>(bilinear[t] / denominator) : 0.f;
  return fetch;
}

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {
  for (const SourceView& view : views_) {
    const bool perspective = !view.camera.lens.isOrthographic();
    const Vec3 at = perspective ? view.camera.center().raw() : -view.camera.forward().raw();
    x_.push_back(at.x);
    y_.push_back(at.y);
    z_.push_back(at.z);
    perspective_.push_back(perspective ? 1 : 0);
  }
}

double ViewSelection::usable(const ViewQuery& query, std::uint32_t view, ChosenView& tried) const {
  const SourceView& source = views_[view];
  const auto projection = source.camera.project(query.p);
  if (!projection) return 0;
  const Vec2& pixel = projection->pixel;
  const double border =
      std::min({pixel.x, pixel.y, source.camera.lens.width - pixel.x, source.camera.lens.height - pixel.y});
  const double inside = smoothstep(0, kBorderPixels, border);
  if (inside == 0) return 0;
  tried.fetch = bilinearFetch(source, pixel);
  return inside * tried.fetch.covered *
         std::max(kLeastForeshortening, dot(query.normal, source.camera.viewDirection(query.p)));
}

ViewSelection::Result ViewSelection::select(const ViewQuery& query, std::span<const std::uint8_t> allowed, Scratch& s,
                                            std::vector<ChosenView>& chosen) const {
  const std::size_t count = views_.size();
  chosen.clear();
  s.bound.resize(count);
  s.distance.resize(count);
  {
    // A lower bound of every view's penalty: the chord to v is at most the angle.
    const Vec3 p = query.p.raw(), v = query.view.raw();
    const double inverse_eye = 1 / query.eye_distance;
    for (std::size_t i = 0; i < count; ++i) {
      const double dx = x_[i] - perspective_[i] * p.x, dy = y_[i] - perspective_[i] * p.y,
                   dz = z_[i] - perspective_[i] * p.z;
      const double length = std::sqrt(dx * dx + dy * dy + dz * dz), inverse = 1 / length;
      const double ex = dx * inverse - v.x, ey = dy * inverse - v.y, ez = dz * inverse - v.z;
      const double resolution = kResolutionPenalty * (length * inverse_eye - 1);
      s.distance[i] = length;
      s.bound[i] = std::sqrt(ex * ex + ey * ey + ez * ez) + (resolution > 0 ? perspective_[i] * resolution : 0);
    }
  }
  // Only views that see one of the hit's points are candidates.
  s.seen.assign(visible_.wordsPerPoint(), 0);
  for (const std::uint32_t point : query.points)
    for (std::size_t w = 0; w < s.seen.size(); ++w) s.seen[w] |= visible_.row(point)[w];
  const auto further = [](const Penalised& a, const Penalised& b) { return b < a; };
  s.open.clear();
  for (std::size_t w = 0; w < s.seen.size(); ++w)
    for (std::uint64_t bits = s.seen[w]; bits; bits &= bits - 1) {
      const auto view = static_cast<std::uint32_t>(64 * w + std::countr_zero(bits));
      if (allowed[view]) s.open.push_back({s.bound[view] * (1 - 1e-12), view});
    }
  std::make_heap(s.open.begin(), s.open.end(), further);

  // Full penalties by rising bound, until no other view can be among the k + 1 nearest or tie with them. A view's
  // factor is at most 1, so its penalty is at least its bound.
  s.penalised.clear();
  s.tried.clear();
  std::vector<Penalised>& open = s.open;
  const std::size_t wanted = k_ + std::size_t{1};
  double worst = kPenaltyCap;  // of the k + 1 nearest so far
  while (!open.empty() && open.front().penalty <= worst) {
    std::pop_heap(open.begin(), open.end(), further);
    const std::uint32_t view = open.back().source;
    open.pop_back();
    ChosenView tried;
    tried.view = view;
    double factor = 0;
    for (std::size_t i = 0; i < query.points.size(); ++i)
      if (visible_.get(query.points[i], view)) factor += query.point_weights[i];
    factor = std::min(factor, 1.0) * usable(query, view, tried);
    if (!(factor > 0)) continue;
    tried.angle = angleBetween(query.view, views_[view].camera.viewDirection(query.p));
    const double resolution = perspective_[view] > 0 ? resolutionPenalty(s.distance[view], query.eye_distance) : 0;
    const double penalty = viewPenalty(tried.angle, resolution, factor);
    if (!(penalty < kPenaltyCap)) continue;
    s.tried.push_back(tried);
    s.penalised.push_back({penalty, view});
    for (std::size_t j = s.penalised.size() - 1; j > 0 && s.penalised[j] < s.penalised[j - 1]; --j)
      std::swap(s.penalised[j], s.penalised[j - 1]);
    if (s.penalised.size() >= wanted) worst = s.penalised[wanted - 1].penalty;
  }
  lumigraphWeights(s.penalised, k_, s.weights);
  for (const Weighted& w : s.weights)
    for (const ChosenView& tried : s.tried)
      if (tried.view == w.source) {
        chosen.push_back(tried);
        chosen.back().weight = w.weight;
      }
  if (!chosen.empty()) return Result::seen;

  // Deformation shows what no photograph saw: the nearest picture that covers p stands in, and is counted.
  s.open.clear();
  for (std::uint32_t i = 0; i < count; ++i)
    if (allowed[i] && views_[i].coverage && std::isfinite(s.bound[i])) s.open.push_back({s.bound[i], i});
  std::sort(s.open.begin(), s.open.end());
  for (const Penalised& candidate : s.open) {
    ChosenView tried;
    tried.view = candidate.source;
    if (!(usable(query, candidate.source, tried) > 0)) continue;
    tried.weight = 1;
    tried.angle = angleBetween(query.view, views_[candidate.source].camera.viewDirection(query.p));
    chosen.push_back(tried);
    return Result::not_seen;
  }
  return Result::none;
}

}  // namespace srf
