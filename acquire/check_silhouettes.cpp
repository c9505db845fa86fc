#include "acquire/check_silhouettes.h"

#include <algorithm>
#include <cmath>

#include "acquire/check_section.h"
#include "base/error.h"
#include "base/numeric.h"
#include "base/text.h"

namespace srf {
namespace {

constexpr int kLeastCells = 48, kMostCells = 64;  // of the hull: enough to tell a wrong view
constexpr double kGood = 0.9;                     // IoU in the middle below which many silhouettes lack something
constexpr double kAgree = 0.8;                    // IoU of silhouettes that belong together, at this resolution
constexpr double kWrong = 0.93;      // IoU below which a view that most others surpass is named in any case
constexpr double kRollGain = 0.005;  // of IoU, below which a camera is not said to be turned about its axis
constexpr std::size_t kHinted = 16;  // views for which it is tried out what would make them fit

/// Half as many cells as pixels, within bounds.
int hullCells(const std::vector<SilhouetteView>& views) {
  int longest = 0;
  for (const SilhouetteView& view : views) longest = std::max({longest, view.mask.width(), view.mask.height()});
  return std::clamp(longest / 2, kLeastCells, kMostCells);
}

/// The hull of all views; nothing where none remains.
std::optional<VisualHull> hullOf(const std::vector<SilhouetteView>& views,
                                 const std::optional<Box<AcquisitionSpace>>& bounds, int tolerance,
                                 bool exclude_outliers, std::string& why_not) {
  HullOptions options;
  options.resolution = hullCells(views);
  options.exclude_outliers = exclude_outliers;
  options.tolerance = tolerance;
  options.bounds = bounds;
  try {
    return carveVisualHull(views, options, Reporter::silent());
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    why_not = e.what();
    return std::nullopt;
  }
}

std::vector<double> ious(const std::vector<ViewConsistency>& views) {
  std::vector<double> iou;
  for (const ViewConsistency& v : views) iou.push_back(v.iou);
  return iou;
}
double medianIou(const std::optional<VisualHull>& hull) {
  return hull ? median(ious(hull->views)) : 0;
}

/// Another way to read the poses of the file.
struct PoseReading {
  std::string found, mend;  // what it is when the silhouettes fit so, and what to do
  Vec3 before{1, 1, 1};     // signs of the camera's axes, taken before an inversion
  bool invert = false;
  Vec3 after{1, 1, 1};

  Rigid<AcquisitionSpace, CameraSpace> operator()(const Rigid<AcquisitionSpace, CameraSpace>& pose) const {
    const auto signs = [](const Vec3& s) { return Mat3{{Vec3{s.x, 0, 0}, Vec3{0, s.y, 0}, Vec3{0, 0, s.z}}}; };
    Mat3 r = pose.rotation().raw() * signs(before);
    Vec3 o = pose.origin().raw();
    if (invert) {
      r = r.transposed();
      o = -(r * o);
    }
    return {Orthogonal<AcquisitionSpace, CameraSpace>(r * signs(after)), Point<AcquisitionSpace>(o)};
  }
};

/// The readings that files of other programs call for. A reader has already turned OpenGL's camera; an inverse has to
/// be taken of what stood in the file.
const std::vector<PoseReading>& poseReadings() {
  static const Vec3 yz{1, -1, -1}, xy{-1, -1, 1}, xz{-1, 1, -1};
  static const std::vector<PoseReading> kReadings{
      {"the file has the OpenCV camera (y down, z forward)",
       "negate the second and third column of transform_matrix",
       yz,
       false,
       {1, 1, 1}},
      {"the pictures or the camera's x and y axes are turned by 180 degrees",
       "negate the first and second column of transform_matrix",
       xy,
       false,
       {1, 1, 1}},
      {"the camera's x and z axes are turned",
       "negate the first and third column of transform_matrix",
       xz,
       false,
       {1, 1, 1}},
      {"the file has world-to-camera", "store the inverse", yz, true, yz},
      {"the file has world-to-camera of the OpenCV camera",
       "store the inverse with the second and third column negated",
       {1, 1, 1},
       true,
       yz},
  };
  return kReadings;
}

std::vector<SilhouetteView> readAs(const PoseReading& reading, std::vector<SilhouetteView> views) {
  for (SilhouetteView& view : views) view.camera.pose = reading(view.camera.pose);
  return views;
}

/// Where no silhouette fits another, the poses are often in another convention: the usual ones are tried.
const PoseReading* fittingReading(const std::vector<SilhouetteView>& views, double& fit) {
  for (const PoseReading& reading : poseReadings()) {
    std::string unused;
    fit = medianIou(hullOf(readAs(reading, views), std::nullopt, 0, false, unused));
    if (fit > kAgree) return &reading;
  }
  return nullptr;
}

/// How a view that does not fit would: its silhouette turned, or its camera.
struct ViewHint {
  double iou = 0;
  std::string text;                                          // empty: nothing helps
  std::optional<Rigid<AcquisitionSpace, CameraSpace>> pose;  // where the camera turned
};

double iouOf(const AcquisitionMesh& mesh, const SilhouetteView& view) {
  return silhouetteConsistency(mesh, {view}).front().iou;
}

Image8 turnedMask(const Image8& mask, bool swap, bool flip_x, bool flip_y) {
  Image8 out(mask.width(), mask.height(), 1);
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      int i = swap ? y : x, j = swap ? x : y;
      if (flip_x) i = mask.width() - 1 - i;
      if (flip_y) j = mask.height() - 1 - j;
      out.at(x, y) = mask.at(i, j);
    }
  return out;
}

ViewHint hintFor(const AcquisitionMesh& mesh, const SilhouetteView& view) {
  ViewHint best{iouOf(mesh, view), "", std::nullopt};
  const double before = best.iou;
  // Its camera turned about its own centre, by ever finer steps about ever the best axis.
  SilhouetteView tried = view;
  Vec3 turn;  // degrees about the camera's x, y and z
  const auto posed = [&](const Vec3& t) {
    const double angle = length(t);
    const Mat3 r = angle > 0 ? rotationAbout(t / angle, radians(angle)) : Mat3{};
    return Rigid<AcquisitionSpace, CameraSpace>(
        Orthogonal<AcquisitionSpace, CameraSpace>(view.camera.pose.rotation().raw() * r), view.camera.pose.origin());
  };
  double reached = before;
  // About x and y first: about z a round silhouette says little, and it must gain more to count.
  for (const bool roll : {false, true})
    for (double step = 2; step > 0.04; step /= 2)
      for (int round = 0; round < 4; ++round) {
        const Vec3 from = turn;
        for (int axis = roll ? 2 : 0; axis < (roll ? 3 : 2); ++axis)
          for (const double way : {-step, step}) {
            Vec3 t = turn;
            t[axis] += way;
            tried.camera.pose = posed(t);
            if (const double iou = iouOf(mesh, tried); iou > reached + (roll ? kRollGain : 0)) reached = iou, turn = t;
          }
        if (turn == from) break;
      }
  if (reached - before > 0.02)
    best = {reached,
            "it fits (IoU " + fixedNumber(reached, 3) + ") when its camera is turned by " +
                fixedNumber(length(turn), 2) + " degrees about (" + fixedNumber(turn.x / length(turn), 2) + ", " +
                fixedNumber(turn.y / length(turn), 2) + ", " + fixedNumber(turn.z / length(turn), 2) +
                ") of camera space: the camera or the object was moved; calibrate this view again",
            posed(turn)};
  struct Way {
    const char* how;
    bool swap, flip_x, flip_y;
  };
  for (const Way& way :
       {Way{"turned by 180 degrees", false, true, true}, Way{"turned by 90 degrees clockwise", true, true, false},
        Way{"turned by 90 degrees counter-clockwise", true, false, true},
        Way{"mirrored left to right", false, true, false}, Way{"mirrored top to bottom", false, false, true}}) {
    if (way.swap && view.mask.width() != view.mask.height()) continue;
    tried = view;
    tried.mask = turnedMask(view.mask, way.swap, way.flip_x, way.flip_y);
    if (const double iou = iouOf(mesh, tried); iou > best.iou + 0.03)
      best = {iou,
              "its silhouette fits (IoU " + fixedNumber(iou, 3) + ") when the picture is taken to be " + way.how +
                  "; turn picture and mask back",
              std::nullopt};
  }
  return best;
}

/// By how many pixels a border must be off, all along, for a silhouette to lose all of its IoU: area over perimeter.
double pixelsOfBorderShift(const Image8& mask) {
  double area = 0, steps = 0;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      const bool in = mask.at(x, y) >= 128;
      area += in;
      steps += x + 1 < mask.width() && in != (mask.at(x + 1, y) >= 128);
      steps += y + 1 < mask.height() && in != (mask.at(x, y + 1) >= 128);
    }
  return area / std::max(1.0, 0.25 * kPi * steps);  // steps along rows and columns are 4 / pi too long on average
}

double cellPixels(const VisualHull& hull, const Camera<AcquisitionSpace>& camera) {
  const auto seen = camera.project(hull.mesh.bounds().center());
  return seen && seen->depth > 0 ? hull.cell / camera.pixelFootprint(seen->depth) : 1;
}

/// Views whose silhouettes the others' hull does not hold; of each its IoU with the hull of the others.
struct Agreement {
  std::optional<VisualHull> hull;  // of those that fit
  std::vector<double> iou;
  std::vector<std::size_t> apart;
  double middle = 0;
  int tolerance = 0;
};

/// A hull that two views may be overruled in holds every right silhouette whole; a wrong one stands out of it.
std::vector<bool> standOut(const std::vector<SilhouetteView>& views,
                           const std::optional<Box<AcquisitionSpace>>& bounds) {
  std::vector<bool> out(views.size(), false);
  std::string unused;
  const auto tolerant = views.size() >= 8 ? hullOf(views, bounds, 2, true, unused) : std::nullopt;
  if (!tolerant) return out;
  std::vector<double> covered, deviation;
  for (const ViewConsistency& v : tolerant->views) covered.push_back(v.covered);
  const double usual = median(covered);
  for (const double c : covered) deviation.push_back(std::fabs(c - usual));
  const double limit = usual - std::max(0.01, 6 * median(deviation));
  for (std::size_t i = 0; i < views.size(); ++i) out[i] = tolerant->views[i].excluded || covered[i] < limit;
  return out;
}

Agreement agreementOf(const std::vector<SilhouetteView>& views, const std::optional<Box<AcquisitionSpace>>& bounds,
                      std::string& why_not) {
  Agreement result;
  const auto out = standOut(views, bounds);
  std::vector<SilhouetteView> kept;
  for (std::size_t i = 0; i < views.size(); ++i)
    if (!out[i]) kept.push_back(views[i]);
  if (2 * kept.size() < views.size()) kept = views;
  result.hull = hullOf(kept, bounds, 0, /*exclude_outliers=*/views.size() < 8, why_not);
  if (!result.hull) return result;
  result.iou = ious(silhouetteConsistency(result.hull->mesh, views));
  result.middle = median(result.iou);
  // Where all silhouettes lack something here and there, the hull of all lacks it everywhere.
  if (result.middle < kGood && views.size() >= 8)
    for (const int tolerance : {1, 2, 4}) {
      std::string unused;
      const auto hull = 4 * static_cast<std::size_t>(tolerance) <= views.size()
                            ? hullOf(kept, bounds, tolerance, false, unused)
                            : std::nullopt;
      if (!hull) continue;
      const auto iou = ious(silhouetteConsistency(hull->mesh, views));
      if (median(iou) <= result.middle) continue;
      result.hull = hull;
      result.iou = iou;
      result.middle = median(iou);
      result.tolerance = tolerance;
    }
  // Told by how far the borders lie apart, not by IoU, which punishes slender silhouettes.
  std::vector<double> apart, spread;
  for (std::size_t i = 0; i < views.size(); ++i)
    apart.push_back((1 - result.iou[i]) * pixelsOfBorderShift(views[i].mask));
  const double usual = median(apart);
  for (const double a : apart) spread.push_back(std::fabs(a - usual));
  const double wide = std::max(6 * median(spread), 0.02 * usual);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const double cell = std::max(1.0, cellPixels(*result.hull, views[i].camera));
    if (apart[i] > usual + std::max(wide, cell) || (out[i] && apart[i] > usual + std::max(wide, 0.75 * cell)) ||
        (result.iou[i] < std::min(kWrong, result.middle) && apart[i] > std::max(1.0, 0.4 * cell)))
      result.apart.push_back(i);
  }
  return result;
}

void tellOfPoses(const Capture& capture, const std::vector<SilhouetteView>& views, const std::string& fault,
                 double middle, Section& section, CheckReport& report) {
  double fit = 0;
  const PoseReading* reading = fittingReading(views, fit);
  std::string mend = "see whether poses, masks and photographs belong together";
  if (reading) {
    mend = "they fit with an IoU of " + fixedNumber(fit, 2) + " when " + reading->found + "; " + reading->mend;
    for (CaptureView& view : report.mended.capture.views) view.camera.pose = (*reading)(view.camera.pose);
    report.mended.what.push_back("every pose: " + reading->found + ": " + reading->mend);
  }
  const std::string place = capture.folder.string();
  if (!fault.empty())
    section.fault(place, fault, mend);
  else
    section.add(reading ? Verdict::fault : Verdict::warning, place,
                "the hull of all silhouettes fits them by an IoU of " + fixedNumber(middle, 2) + " only", mend);
}

}  // namespace

std::optional<VisualHull> checkAgreement(const Capture& capture, std::vector<SilhouetteView>& views,
                                         const std::vector<std::size_t>& which, CheckReport& report) {
  Section section(report, "silhouettes agree");
  if (views.size() < 2) {
    section.warn("", "only " + counted(views.size(), "view") + " can be used: nothing to compare",
                 "mend the faults above, or add views");
    section.finish("");
    return std::nullopt;
  }
  std::string why_not;
  Agreement found = agreementOf(views, capture.bounds, why_not);
  if (!found.hull || found.middle < kAgree) {
    tellOfPoses(capture, views, found.hull ? "" : why_not, found.middle, section, report);
    section.finish("");
    // Mended poses go on to the lights.
    if (report.mended.what.empty()) return std::nullopt;
    for (std::size_t i = 0; i < views.size(); ++i)
      views[i].camera.pose = report.mended.capture.views[which[i]].camera.pose;
    found = agreementOf(views, std::nullopt, why_not);
    if (!found.hull) return std::nullopt;
    for (std::size_t i = 0; i < views.size(); ++i) report.view_iou[which[i]] = found.iou[i];
    return std::move(found.hull);
  }
  double least = 1;
  for (std::size_t i = 0; i < views.size(); ++i) {
    report.view_iou[which[i]] = found.iou[i];
    least = std::min(least, found.iou[i]);
  }
  for (std::size_t k = 0; k < found.apart.size(); ++k) {
    const std::size_t i = found.apart[k];
    const ViewHint hint = k < kHinted ? hintFor(found.hull->mesh, views[i]) : ViewHint{};
    const CaptureView& view = capture.views[which[i]];
    const auto& file = view.mask_file.empty() && !view.photos.empty() ? view.photos[0].file : view.mask_file;
    section.warn(
        view.name,
        "IoU with the hull of the others is " + fixedNumber(found.iou[i], 3) + ", usual is " +
            fixedNumber(found.middle, 3) + " (" + file.string() + ")",
        hint.text.empty() ? "look at its silhouette and pose; acquire leaves it out or tolerates it" : hint.text);
    if (hint.pose && hint.iou > found.middle - 0.03) {
      views[i].camera.pose = *hint.pose;
      report.mended.capture.views[which[i]].camera.pose = *hint.pose;
      report.mended.what.push_back("view '" + view.name + "': its camera turned so that its silhouette fits");
    }
  }
  if (found.middle < kGood)
    section.warn(capture.folder.string(),
                 "IoU with their hull is " + fixedNumber(found.middle, 2) + " in the middle and " +
                     fixedNumber(least, 2) + " at least",
                 "shadows may be cut out of the silhouettes: look at them, or let acquire keep what most views agree "
                 "on (--tolerance 2)");
  section.finish("IoU with their hull " + fixedNumber(found.middle, 3) + " in the middle, " + fixedNumber(least, 3) +
                 " at least (at " + std::to_string(hullCells(views)) + " cells)");
  return std::move(found.hull);
}

}  // namespace srf
