#include "acquire/visual_hull.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "acquire/hull_components.h"
#include "acquire/mesh_coverage.h"
#include "acquire/signed_silhouette.h"
#include "acquire/silhouette_contours.h"
#include "acquire/silhouette_field.h"
#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "base/text.h"

namespace srf {
namespace {

using Box3 = Box<AcquisitionSpace>;
using Point3 = Point<AcquisitionSpace>;

// Along the longest side, where the resolution is chosen here: 256 cells make some 800k triangles, beyond which the
// hull gains little and every frame pays.
constexpr int kLeastCells = 64, kMostCells = 256;
constexpr int kCoarseCells = 96;           // where the views are compared with each other
constexpr double kOutlierGap = 0.05;       // of IoU below the median, at least
constexpr double kCoveredByOthers = 0.97;  // share of a usual mask that a trial hull must cover
constexpr double kCarvedTooMuch = 0.95;    // share of a usual mask covered, below which the user is told
constexpr int kSmoothing = 10;             // Taubin steps for the normals

std::string percent(double share) {
  return fixedNumber(100 * share, 1) + " %";
}

// A view with what carving needs of it.
struct HullView {
  const SilhouetteView* view;
  std::unique_ptr<SignedSilhouette> silhouette;
  Vec2 centroid;
  double reach = 0;  // pixels from the centroid to the furthest corner of the silhouette's box
};

HullView prepare(const SilhouetteView& view) {
  const Image8& mask = view.mask;
  const Intrinsics& lens = view.camera.lens;
  if (mask.channels() != 1 || mask.width() != lens.width || mask.height() != lens.height)
    throw badInput(view.name, "the mask has " + std::to_string(mask.width()) + " x " + std::to_string(mask.height()) +
                                  " pixels, expected the camera's " + std::to_string(lens.width) + " x " +
                                  std::to_string(lens.height));
  double count = 0, sum_x = 0, sum_y = 0;
  Vec2 low{1e30, 1e30}, high{-1e30, -1e30};
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      if (mask.at(x, y) < 128) continue;
      count += 1, sum_x += x + 0.5, sum_y += y + 0.5;
      low = {std::min(low.x, double(x)), std::min(low.y, double(y))};
      high = {std::max(high.x, x + 1.0), std::max(high.y, y + 1.0)};
    }
  if (count == 0)
    throw badInput(view.name, "the mask is empty; expected the object's silhouette, or leave the view out");
  if (count == double(mask.width()) * mask.height())
    throw badInput(view.name, "the mask is all object; expected background around a silhouette, or leave the view out");
  HullView out{&view, std::make_unique<SignedSilhouette>(mask), {sum_x / count, sum_y / count}};
  out.reach = std::hypot(std::max(high.x - out.centroid.x, out.centroid.x - low.x),
                         std::max(high.y - out.centroid.y, out.centroid.y - low.y));
  return out;
}

double longestSide(const Box3& box) {
  return maxComponent(box.max - box.min);
}

using HullViews = std::vector<const HullView*>;

SilhouetteField makeField(const HullViews& views, int tolerance, const Box3& bounds) {
  std::vector<Camera<AcquisitionSpace>> cameras;
  std::vector<const SignedSilhouette*> silhouettes;
  for (const HullView* v : views) {
    cameras.push_back(v->view->camera);
    silhouettes.push_back(v->silhouette.get());
  }
  return {cameras, silhouettes, tolerance, bounds};
}

// Where the rays through the silhouettes' centres meet: least distances, not their squares, so that a few wrong
// silhouettes do not pull it away.
Point3 meetingPoint(const HullViews& views) {
  std::vector<Ray<AcquisitionSpace>> rays;
  for (const HullView* v : views)
    if (const auto ray = v->view->camera.ray(v->centroid)) rays.push_back(*ray);
  if (rays.empty()) throw badInput("visual hull", "no silhouette's centre lies within its lens; check the calibration");
  const Point3 base = rays[0].origin;
  Point3 center = base;
  std::vector<double> weight(rays.size(), 1);
  for (int round = 0; round < 20; ++round) {
    Mat3 a{{Vec3{}, Vec3{}, Vec3{}}};
    Vec3 b;
    double sum = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const Vec3 d = rays[i].direction.raw();
      const Mat3 across = Mat3{} + -1.0 * Mat3{{d.x * d, d.y * d, d.z * d}};
      a = a + weight[i] * across;
      b += weight[i] * (across * (rays[i].origin - base).raw());
      sum += weight[i];
    }
    if (!(determinant((1 / sum) * a) > 1e-8))
      throw badInput("visual hull", "all views look along one line, which does not bound the object; give its bounds");
    center = base + Vector<AcquisitionSpace>(inverse(a) * b);
    std::vector<double> off(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) off[i] = length(cross(rays[i].direction, center - rays[i].origin));
    const double usual = std::max(median(off), 1e-12 * distance(center, rays[0].origin));
    for (std::size_t i = 0; i < rays.size(); ++i) weight[i] = 1 / std::max(off[i], usual);
  }
  return center;
}

// A cube that should hold the object, from where and how large the silhouettes are.
Box3 guessBounds(const HullViews& views) {
  const Point3 center = meetingPoint(views);
  std::vector<double> radius;
  for (const HullView* v : views)
    if (const auto seen = v->view->camera.project(center); seen && seen->depth > 0)
      radius.push_back(v->reach * v->view->camera.pixelFootprint(seen->depth));
  if (radius.empty()) throw badInput("visual hull", "no view sees where the silhouettes meet; check the calibration");
  std::sort(radius.begin(), radius.end());
  const double half = 1.5 * radius[(radius.size() - 1) * 9 / 10];
  Box3 box;
  box.extend(center - Vector<AcquisitionSpace>(half, half, half));
  box.extend(center + Vector<AcquisitionSpace>(half, half, half));
  return box;
}

// The part of the box that no bound shows to lie outside, to a 32nd of its longest side.
Box3 occupied(const HullViews& views, int tolerance, const Box3& box) {
  const double cell = longestSide(box) / (32 * kBrick);
  Box3 found = makeField(views, tolerance, box).occupied(latticeAround(box, cell));
  for (int i = 0; i < 3; ++i) {
    found.min[i] = std::max(found.min[i], box.min[i]);
    found.max[i] = std::min(found.max[i], box.max[i]);
  }
  return found;
}

AcquisitionMesh carve(const HullViews& views, int tolerance, const Box3& tight, double cell, Reporter& reporter) {
  return makeField(views, tolerance, tight).surface(latticeAround(tight, cell), reporter);
}

// Cells of one pixel's footprint along the longest side of a box, between two bounds.
int pixelsAcross(const HullViews& views, const Box3& box, int least, int most) {
  std::vector<double> footprint;
  for (const HullView* v : views)
    if (const auto seen = v->view->camera.project(box.center()); seen && seen->depth > 0)
      footprint.push_back(v->view->camera.pixelFootprint(seen->depth));
  if (footprint.empty()) return least;
  return static_cast<int>(std::clamp<double>(std::ceil(longestSide(box) / median(footprint)), least, most));
}

// A tight box about what the views leave in a box: that of a rough surface, and of what finer cells find outside it.
// Blocks that straddle the edge of a picture cannot be told to be outside, so they alone would stay far too large.
Box3 shrunk(const HullViews& views, int tolerance, Box3 box) {
  constexpr int kRough = 32, kFine = 512, kMostRounds = 8;
  for (int round = 0; round < kMostRounds && !box.empty(); ++round) {
    const double side = longestSide(box), fine = side / pixelsAcross(views, box, 2 * kRough, kFine);
    const SilhouetteField field = makeField(views, tolerance, box);
    const Box3 rough = field.surface(latticeAround(box, side / kRough), Reporter::silent()).bounds();
    const Box3 found = field.extent(latticeAround(box, fine), rough);
    if (found.empty()) return box;
    for (int i = 0; i < 3; ++i) {  // a cell more, for tips between the corners
      box.min[i] = std::max(found.min[i] - fine, box.min[i]);
      box.max[i] = std::min(found.max[i] + fine, box.max[i]);
    }
    if (longestSide(box) > 0.75 * side) break;
  }
  return box;
}

bool touches(const Box3& found, const Box3& box) {
  const double margin = 0.02 * longestSide(box);
  return minComponent(found.min - box.min) < margin || minComponent(box.max - found.max) < margin;
}

// A tight box about what the views leave. Where no bounds are given the guess grows until the hull stays off its faces;
// `open`, unless null: whether it never does.
Box3 tightBounds(const HullViews& views, int tolerance, const std::optional<Box3>& given, bool* open = nullptr) {
  if (given) return shrunk(views, tolerance, occupied(views, tolerance, *given));
  Box3 box = guessBounds(views);
  for (int round = 0;; ++round) {
    const Box3 found = occupied(views, tolerance, box);
    if (found.empty()) return found;
    const bool goes_on = touches(found, box);
    if (!goes_on || round == 4) {
      if (open) *open = goes_on;
      return shrunk(views, tolerance, found);
    }
    const Vec3 more = 0.3 * (box.max - box.min);
    box.min -= more, box.max += more;
  }
}

// IoU and coverage from about `samples` pixels along a picture's longer side.
std::vector<ViewConsistency> compare(const AcquisitionMesh& mesh, const std::vector<const SilhouetteView*>& views,
                                     int samples) {
  std::vector<ViewConsistency> result(views.size());
  std::vector<SampledPicture> pictures;
  for (const SilhouetteView* view : views) pictures.push_back(SampledPicture::of(view->camera, samples));
  const auto covered = coveredSamples(mesh, pictures);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const Image8& mask = views[i]->mask;
    const SampledPicture& picture = pictures[i];
    std::size_t both = 0, either = 0, inside = 0;
    for (int y = 0; y < picture.rows; ++y)
      for (int x = 0; x < picture.columns; ++x) {
        const bool object = mask.at(picture.pixel(x), picture.pixel(y)) >= 128;
        const bool hit = covered[i][static_cast<std::size_t>(y) * picture.columns + x];
        both += object && hit;
        either += object || hit;
        inside += object;
      }
    result[i].name = views[i]->name;
    result[i].iou = either ? double(both) / double(either) : 0;
    result[i].covered = inside ? double(both) / double(inside) : 0;
  }
  return result;
}

std::vector<const SilhouetteView*> sources(const HullViews& views) {
  std::vector<const SilhouetteView*> out;
  for (const HullView* v : views) out.push_back(v->view);
  return out;
}

// How each view agrees with the coarse hull in a tight box; empty where nothing is left.
std::vector<ViewConsistency> coarseAgreement(const HullViews& views, int tolerance, const Box3& box) {
  if (box.empty()) return {};
  const auto mesh = carve(views, tolerance, box, longestSide(box) / kCoarseCells, Reporter::silent());
  return compare(mesh, sources(views), kCoarseCells);
}

// A trial hull that a few wrong views could not carve, and how each view agrees with it.
struct Trial {
  int tolerance = 0;
  Box3 box;  // tight about it
  std::vector<ViewConsistency> agreement;
  bool open = false;  // it goes on beyond the box
};
Trial tryTolerantHull(const HullViews& views, int tolerance, const std::optional<Box3>& bounds) {
  const int most = std::min<int>(static_cast<int>(views.size()) / 4, kMostTolerance);
  Trial trial;
  for (int m = std::min(std::max(2, tolerance), most);; m = std::min(2 * m, most)) {
    trial = {m, {}, {}};
    trial.box = tightBounds(views, m, bounds, &trial.open);
    trial.agreement = coarseAgreement(views, m, trial.box);
    if (!trial.agreement.empty()) {
      std::vector<double> covered;
      for (const auto& a : trial.agreement) covered.push_back(a.covered);
      if (median(covered) >= kCoveredByOthers) return trial;
    }
    if (m >= most) return trial;
  }
}

// Marks the views that contradict the others: their IoU with a tolerant hull lies far below the usual.
std::vector<bool> outliers(const std::vector<ViewConsistency>& agreement) {
  std::vector<double> iou, deviation;
  for (const auto& a : agreement) iou.push_back(a.iou);
  const double usual = median(iou);
  for (const double x : iou) deviation.push_back(std::fabs(x - usual));
  const double limit = usual - std::max(kOutlierGap, 5 * 1.4826 * median(deviation));
  std::vector<std::size_t> order(agreement.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return iou[a] < iou[b]; });
  std::vector<bool> out(agreement.size(), false);
  for (std::size_t k = 0; k < order.size() / 4; ++k) out[order[k]] = iou[order[k]] < limit;
  return out;
}

// Whether the hull of all views fills every silhouette: then none contradicts the others, whatever bulges a trial hull
// of few views has where some of them are overruled.
bool allAgree(const HullViews& views, const std::optional<Box3>& bounds) {
  const auto agreement = coarseAgreement(views, 0, tightBounds(views, 0, bounds));
  return !agreement.empty() && std::all_of(agreement.begin(), agreement.end(),
                                           [](const ViewConsistency& a) { return a.covered >= kCoveredByOthers; });
}

// Says that the hull has no end, and whose pictures cut the object.
void warnOfOpenHull(const HullViews& views, Reporter& reporter) {
  std::string names;
  std::size_t cut = 0;
  for (const HullView* v : views)
    if (reachesBorder(v->view->mask) && ++cut <= 3) names += (cut > 1 ? ", " : "") + v->view->name;
  if (cut > 3) names += ", ..";
  reporter.warn("the silhouettes do not bound the object: the hull goes on beyond what the pictures show" +
                (cut > 0 ? ", whose edge cuts the object in " + std::to_string(cut) + " of " +
                               std::to_string(views.size()) + " views (" + names + ")"
                         : std::string()) +
                "; give its bounds, as --bounds or as \"aabb\" in transforms.json");
}

// Names the views that disagree most with what the others leave.
Error nothingLeft(const HullViews& views, const std::optional<Box3>& bounds) {
  std::vector<ViewConsistency> agreement;
  if (views.size() >= 4) agreement = tryTolerantHull(views, 2, bounds).agreement;
  std::string worst = "few views to tell which";
  if (!agreement.empty()) {
    std::stable_sort(agreement.begin(), agreement.end(), [](const auto& a, const auto& b) { return a.iou < b.iou; });
    worst.clear();
    for (std::size_t i = 0; i < std::min<std::size_t>(3, agreement.size()); ++i)
      worst += (i ? ", " : "") + agreement[i].name + " (" + percent(agreement[i].iou) + ")";
  }
  return badInput("visual hull",
                  "the silhouettes leave nothing: no point lies in all of them; the views that disagree "
                  "most: " +
                      worst + "; check their masks and cameras, or the bounds");
}

}  // namespace

VisualHull carveVisualHull(const std::vector<SilhouetteView>& views, const HullOptions& options, Reporter& reporter) {
  if (views.empty()) throw badInput("visual hull", "there are no silhouettes to carve from");
  if (options.tolerance < 0 || options.tolerance > kMostTolerance)
    throw Error(ErrorKind::usage, "the tolerance is " + std::to_string(options.tolerance) + ", expected 0 to " +
                                      std::to_string(kMostTolerance) + " views");
  if (options.resolution < 0 || options.resolution > 4 * kMostCells)
    throw Error(ErrorKind::usage, "the resolution is " + std::to_string(options.resolution) +
                                      " cells, expected 0 (chosen here) to " + std::to_string(4 * kMostCells));
  std::vector<HullView> prepared(views.size());
  {
    Reporter::Stage stage(reporter, "silhouette distances", views.size());
    parallelFor(views.size(), 1, [&](std::size_t begin, std::size_t) {
      prepared[begin] = prepare(views[begin]);
      stage.advance();
    });
  }
  HullViews used;
  for (const HullView& v : prepared) used.push_back(&v);

  VisualHull hull;
  std::vector<bool> excluded(views.size(), false);
  std::optional<Box3> within;
  bool open = false;
  if (options.exclude_outliers && views.size() >= 4) {
    Reporter::Stage stage(reporter, "silhouette agreement", 1);
    const Trial trial = tryTolerantHull(used, options.tolerance, options.bounds);
    const auto& agreement = trial.agreement;
    if (!agreement.empty()) {
      excluded = outliers(agreement);
      if (std::find(excluded.begin(), excluded.end(), true) != excluded.end() && allAgree(used, options.bounds))
        excluded.assign(views.size(), false);
      used.clear();
      for (std::size_t i = 0; i < views.size(); ++i) {
        if (!excluded[i]) {
          used.push_back(&prepared[i]);
          continue;
        }
        reporter.warn("view " + views[i].name + " is left out of the hull: its silhouette agrees with the others by " +
                      percent(agreement[i].iou) + " only (intersection over union); check its mask and camera");
        reporter.count("hull.views_left_out");
      }
      // The more views may be overruled, the larger the hull: the trial holds that of the same views.
      if (used.size() == views.size() && options.tolerance <= trial.tolerance) within = trial.box, open = trial.open;
    }
    stage.advance();
  }

  const Box3 tight =
      within ? shrunk(used, options.tolerance, *within) : tightBounds(used, options.tolerance, options.bounds, &open);
  if (tight.empty()) throw nothingLeft(used, options.bounds);
  if (open && (!within || touches(tight, *within))) warnOfOpenHull(used, reporter);
  const int cells = options.resolution > 0 ? options.resolution : pixelsAcross(used, tight, kLeastCells, kMostCells);
  hull.cell = longestSide(tight) / cells;
  hull.mesh = carve(used, options.tolerance, tight, hull.cell, reporter);
  if (hull.mesh.triangles.empty()) throw nothingLeft(used, options.bounds);
  std::vector<Camera<AcquisitionSpace>> cameras;
  for (const HullView* v : used) cameras.push_back(v->view->camera);
  dropUnneededComponents(hull.mesh, cameras, reporter);
  // Normals of a smoothed copy: those of the carved surface carry the facets of the cones and the lattice.
  hull.mesh.normals = vertexNormals(smoothed(hull.mesh, kSmoothing));

  hull.views = silhouetteConsistency(hull.mesh, views);
  std::vector<double> covered;
  for (std::size_t i = 0; i < views.size(); ++i) {
    hull.views[i].excluded = excluded[i];
    if (!excluded[i]) covered.push_back(hull.views[i].covered);
  }
  if (median(covered) < kCarvedTooMuch)
    reporter.warn("the hull covers only " + percent(median(covered)) +
                  " of a usual silhouette: parts that some views miss are carved away; mend those masks, or let " +
                  std::to_string(options.tolerance + 2) + " views be overruled at every point (tolerance)");
  reporter.figure("hull.volume", meshVolume(hull.mesh));
  reporter.figure("hull.triangles", static_cast<double>(hull.mesh.triangles.size()));
  reporter.figure("hull.cell", hull.cell);
  return hull;
}

std::vector<ViewConsistency> silhouetteConsistency(const AcquisitionMesh& mesh,
                                                   const std::vector<SilhouetteView>& views) {
  std::vector<const SilhouetteView*> pointers;
  for (const SilhouetteView& view : views) pointers.push_back(&view);
  return compare(mesh, pointers, 256);
}

}  // namespace srf
