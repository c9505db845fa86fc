#include "render/view_selection.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr double kBorderPixels = 4;  // over which a view fades towards the border of its picture
// A view that sees the surface at a slant has fewer pixels on it: its weight falls with the square root of n0 . v_i
// (tried on an independent capture: no factor, the root and n0 . v_i itself give 0.78, 0.87 and 0.91 dB over the
// reference figures in the mean, but -0.29, -0.29 and -0.44 dB at worst). A grazing view stays usable.
constexpr double kLeastForeshortening = 0.05;

}  // namespace

ViewSelection::ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k)
    : views_(std::move(views)), visible_(visible), k_(k) {}

bool ViewSelection::consider(const ViewQuery& query, std::uint32_t view, Candidate& candidate) const {
  const Camera<AcquisitionSpace>& camera = views_[view].camera;
  const bool orthographic = camera.lens.isOrthographic();
  const Vec3 to_view = orthographic ? -camera.forward().raw() : (camera.center() - query.p).raw();
  const double length = std::sqrt(dot(to_view, to_view));
  if (!(length > 0)) return false;  // p lies in the camera, or nowhere
  const Vec3 direction = to_view * (1 / length), chord = direction - query.view.raw();
  candidate.view = view;
  candidate.chord = std::sqrt(dot(chord, chord));
  candidate.resolution = orthographic ? 0 : resolutionPenalty(length, query.eye_distance);
  candidate.foreshortening = std::sqrt(std::clamp(dot(query.normal.raw(), direction), kLeastForeshortening, 1.0));
  // The chord to v is at most the angle, and visibility and coverage only add to the penalty. Less some roundings.
  candidate.bound = viewPenalty(candidate.chord, candidate.resolution, 1) * (1 - 1e-12);
  return true;
}

double ViewSelection::covered(const ViewQuery& query, std::uint32_t view, Fetch& fetch) const {
  const SourceView& source = views_[view];
  const auto projection = source.camera.project(query.p);
  if (!projection) return 0;
  const Vec2& pixel = projection->pixel;
  const Intrinsics& lens = source.camera.lens;
  const double border = std::min({pixel.x, pixel.y, lens.width - pixel.x, lens.height - pixel.y});
  const double inside = smoothstep(0, kBorderPixels, border);
  if (inside == 0) return 0;
  fetch = bilinearFetch(source, pixel);
  return inside * fetch.covered;
}

ViewSelection::Result ViewSelection::select(const ViewQuery& query, std::span<const std::uint8_t> allowed, Scratch& s,
                                            std::vector<ChosenView>& chosen) const {
  chosen.clear();
  const auto angle = [](const Candidate& c) { return 2 * std::asin(std::min(1.0, 0.5 * c.chord)); };
  const auto further = [](const Candidate& a, const Candidate& b) {
    return a.bound != b.bound ? a.bound > b.bound : a.view > b.view;
  };
  Candidate candidate;
  // Only views that see one of the hit's points are candidates.
  std::vector<Candidate>& open = s.open;
  open.clear();
  for (std::size_t w = 0; w < visible_.wordsPerPoint(); ++w) {
    std::uint64_t seen = 0;
    for (const std::uint32_t point : query.points) seen |= visible_.row(point)[w];
    for (; seen; seen &= seen - 1) {
      const auto view = static_cast<std::uint32_t>(64 * w + std::countr_zero(seen));
      if (!allowed[view]) continue;
      open.emplace_back();
      if (!consider(query, view, open.back())) open.pop_back();
    }
  }
  std::make_heap(open.begin(), open.end(), further);

  // Full penalties by rising bound, until no other view can be among the k + 1 nearest or tie with them.
  s.penalised.clear();
  s.tried.clear();
  const std::size_t wanted = k_ + std::size_t{1};
  double worst = kPenaltyCap;  // of the k + 1 nearest so far
  while (!open.empty() && open.front().bound <= worst) {
    std::pop_heap(open.begin(), open.end(), further);
    candidate = open.back();
    open.pop_back();
    double seen = 0;
    for (std::size_t i = 0; i < query.points.size(); ++i)
      if (visible_.get(query.points[i], candidate.view)) seen += query.point_weights[i];
    ChosenView tried{candidate.view, candidate.foreshortening, angle(candidate), 0, {}};
    const double usable = std::min(seen, 1.0) * covered(query, candidate.view, tried.fetch);
    const double penalty = viewPenalty(tried.angle, candidate.resolution, usable);
    if (!(penalty < kPenaltyCap)) continue;
    tried.penalty = penalty;
    s.tried.push_back(tried);
    s.penalised.push_back({penalty, candidate.view});
    for (std::size_t j = s.penalised.size() - 1; j > 0 && s.penalised[j] < s.penalised[j - 1]; --j)
      std::swap(s.penalised[j], s.penalised[j - 1]);
    if (s.penalised.size() >= wanted) worst = s.penalised[wanted - 1].penalty;
  }
  lumigraphWeights(s.penalised, k_, s.weights);
  double sum = 0;
  for (const Weighted& w : s.weights)
    for (const ChosenView& tried : s.tried)
      if (tried.view == w.source) {
        chosen.push_back(tried);
        sum += chosen.back().weight *= w.weight;
      }
  for (ChosenView& c : chosen) c.weight /= sum;
  if (!chosen.empty()) return Result::seen;

  // Deformation shows what no photograph saw: the nearest picture that covers p stands in, and is counted.
  open.clear();
  for (std::uint32_t view = 0; view < views_.size(); ++view)
    if (allowed[view] && consider(query, view, candidate)) open.push_back(candidate);
  std::sort(open.begin(), open.end(), [](const Candidate& a, const Candidate& b) {
    return a.chord != b.chord ? a.chord < b.chord : a.view < b.view;
  });
  for (const Candidate& c : open) {
    ChosenView tried{c.view, 1, angle(c), std::numeric_limits<double>::infinity(), {}};
    if (!(covered(query, c.view, tried.fetch) > 0)) continue;
    chosen.push_back(tried);
    return Result::not_seen;
  }
  return Result::none;
}

}  // namespace srf
