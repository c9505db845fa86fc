#include "acquire/camera_calibration.h"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>

#include "acquire/least_squares.h"
#include "base/check.h"
#include "base/error.h"
#include "base/numeric.h"

namespace srf {
namespace {

/// x_to = rotation (x_from - center): moved by small turns about the axes of `to` and shifts of the centre in `from`.
struct Pose {
  Mat3 rotation;
  Vec3 center;

  Vec3 operator*(const Vec3& x) const { return rotation * (x - center); }
  Pose moved(const double* delta) const {
    const Vec3 turn{delta[0], delta[1], delta[2]};
    const double angle = length(turn);
    const Mat3 small = angle > 0 ? rotationAbout(turn / angle, angle) : Mat3{};
    return {small * rotation, center + Vec3{delta[3], delta[4], delta[5]}};
  }
  Pose inverse() const { return {rotation.transposed(), -(rotation * center)}; }
};
Pose operator*(const Pose& a, const Pose& b) {
  return {a.rotation * b.rotation, b.center + b.rotation.transposed() * a.center};
}

/// The board on the table: at angle phi a point x of the board at stop 0 lies at point + R(axis, phi) (x - point).
struct Turn {
  Vec3 axis{0, 0, 1}, point;
  double step = 0;

  Vec3 at(double stop, const Vec3& x) const { return point + rotationAbout(axis, step * stop) * (x - point); }
  Vec3 side() const { return anyPerpendicular(Direction<BoardSpace>::fromUnit(axis)).raw(); }
  Turn moved(const double* delta) const {
    const Vec3 a = side(), b = cross(axis, a);
    Vec3 tilted = axis + delta[0] * a + delta[1] * b;
    tilted = tilted / length(tilted);
    return {tilted, point + delta[2] * a + delta[3] * b, step + delta[4]};
  }
};

struct LensMember {
  const char* name;
  double Intrinsics::*member;
  bool in_pixels;
};
constexpr LensMember kLensMembers[] = {
    {"fl_x", &Intrinsics::fl_x, true}, {"fl_y", &Intrinsics::fl_y, true}, {"cx", &Intrinsics::cx, true},
    {"cy", &Intrinsics::cy, true},     {"k1", &Intrinsics::k1, false},    {"k2", &Intrinsics::k2, false},
    {"p1", &Intrinsics::p1, false},    {"p2", &Intrinsics::p2, false},    {"k3", &Intrinsics::k3, false}};
int lensParameterCount(CameraModel model) {
  return model == CameraModel::pinhole ? 4 : model == CameraModel::simple_radial ? 5 : 9;
}

// The rotation nearest to a mean of rotations, by its singular values.
Mat3 nearestRotation(const Mat3& m) {
  cv::Matx33d a;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) a(i, j) = m.row[i][j];
  cv::Matx31d w;
  cv::Matx33d u, vt;
  cv::SVD::compute(a, w, u, vt);
  cv::Matx33d r = u * vt;
  if (cv::determinant(r) < 0) r = u * cv::Matx33d(1, 0, 0, 0, 1, 0, 0, 0, -1) * vt;
  Mat3 out;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out.row[i][j] = r(i, j);
  return out;
}

Pose poseFromOpenCv(const cv::Mat& rvec, const cv::Mat& tvec) {
  cv::Matx33d r;
  cv::Rodrigues(rvec, r);
  Mat3 rotation;
  for (int i = 0; i < 3; ++i) rotation.row[i] = {r(i, 0), r(i, 1), r(i, 2)};
  const Vec3 t{tvec.at<double>(0), tvec.at<double>(1), tvec.at<double>(2)};
  return {rotation, -(rotation.transposed() * t)};
}

class Calibrator {
 public:
  explicit Calibrator(const BoardCalibrationInput& input) : input_(input), lens_(input.cameras.size()) {
    check();
    for (int i = 0; i < input.board.cornerCount(); ++i)
      corners_.push_back(input.board.corner(i, input.millimetre).raw());
    out_.cameras.resize(input.cameras.size());
    out_.shots.resize(input.shots.size());
    for (std::size_t c = 0; c < input.cameras.size(); ++c) out_.cameras[c].name = input.cameras[c];
  }

  BoardCalibration run() {
    calibrateLenses();
    if (input_.turntable)
      placeOnTurntable();
    else
      placeInRig();
    LeastSquaresResult fit = adjust(held_step_);
    if (held_step_) freeStep();
    report(fit);
    return std::move(out_);
  }

 private:
  bool knownLens(std::size_t camera) const { return camera < input_.known_lens.size() && input_.known_lens[camera]; }

  void check() const {
    SRF_CHECK(input_.sizes.size() == input_.cameras.size());
    for (std::size_t c = 0; c < input_.cameras.size(); ++c) {
      const auto count = static_cast<int>(std::count_if(input_.sightings.begin(), input_.sightings.end(),
                                                        [&](const BoardSighting& s) { return s.camera == c; }));
      const int wanted = knownLens(c) ? 1 : 3;
      if (count < wanted)
        throw badInput("camera '" + input_.cameras[c] + "'",
                       "the board was found in " + std::to_string(count) + " photographs, and " +
                           std::to_string(wanted) +
                           " are the least, 10 to 20 better: photograph it from more sides, "
                           "tilted, filling the picture up to its corners");
    }
    if ((input_.turntable || input_.cameras.size() > 1) && input_.board.turnsIntoItself())
      throw badInput("board " + input_.board.text(),
                     "looks the same when turned by half a turn, so that its corners cannot be matched between "
                     "photographs of a rig or turntable; take one with an odd and an even number of inner corners, or "
                     "a ChArUco board");
  }

  void objectPoints(const BoardSighting& s, std::vector<cv::Point3f>& object, std::vector<cv::Point2f>& image) const {
    for (std::size_t i = 0; i < s.corners.ids.size(); ++i) {
      const Vec3& p = corners_[static_cast<std::size_t>(s.corners.ids[i])];
      // OpenCV counts from the centre of the first pixel.
      object.emplace_back(static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z));
      image.emplace_back(static_cast<float>(s.corners.pixels[i].x - 0.5),
                         static_cast<float>(s.corners.pixels[i].y - 0.5));
    }
  }

  void calibrateLenses() {
    camera_from_board_.resize(input_.sightings.size());
    for (std::size_t c = 0; c < input_.cameras.size(); ++c) {
      throwIfInterrupted();
      std::vector<std::vector<cv::Point3f>> object;
      std::vector<std::vector<cv::Point2f>> image;
      std::vector<std::size_t> of;
      for (std::size_t i = 0; i < input_.sightings.size(); ++i) {
        if (input_.sightings[i].camera != c) continue;
        of.push_back(i);
        objectPoints(input_.sightings[i], object.emplace_back(), image.emplace_back());
      }
      try {
        if (knownLens(c))
          placeKnown(c, of, object, image);
        else
          calibrateAlone(c, of, object, image);
      } catch (const cv::Exception& e) {
        throw badInput("camera '" + input_.cameras[c] + "'",
                       "OpenCV could not calibrate it (" + e.err +
                           "); photograph the board from more sides, tilted, not only straight on");
      }
    }
  }

  void placeKnown(std::size_t c, const std::vector<std::size_t>& of,
                  const std::vector<std::vector<cv::Point3f>>& object,
                  const std::vector<std::vector<cv::Point2f>>& image) {
    lens_[c] = *input_.known_lens[c];
    for (std::size_t k = 0; k < of.size(); ++k) {
      std::vector<cv::Point2f> ideal;  // of a lens of focal length 1
      for (const cv::Point2f& p : image[k]) {
        const auto d = lens_[c].unproject({p.x + 0.5, p.y + 0.5});
        const Vec3 ray = d ? d->raw() : Vec3{0, 0, 1};
        ideal.emplace_back(static_cast<float>(ray.x / ray.z), static_cast<float>(ray.y / ray.z));
      }
      cv::Mat rvec, tvec;
      cv::solvePnP(object[k], ideal, cv::Matx33d::eye(), cv::noArray(), rvec, tvec, false, cv::SOLVEPNP_IPPE);
      camera_from_board_[of[k]] = poseFromOpenCv(rvec, tvec);
    }
  }

  void calibrateAlone(std::size_t c, const std::vector<std::size_t>& of,
                      const std::vector<std::vector<cv::Point3f>>& object,
                      const std::vector<std::vector<cv::Point2f>>& image) {
    int flags = 0;
    if (input_.lens == CameraModel::pinhole) flags = cv::CALIB_FIX_K1;
    if (input_.lens != CameraModel::opencv) flags |= cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 | cv::CALIB_ZERO_TANGENT_DIST;
    cv::Mat matrix, coefficients;
    std::vector<cv::Mat> rvecs, tvecs;
    out_.cameras[c].opencv_rms =
        cv::calibrateCamera(object, image, {input_.sizes[c].width, input_.sizes[c].height}, matrix, coefficients, rvecs,
                            tvecs, flags, {cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 200, 1e-12});
    Intrinsics& lens = lens_[c];
    lens.model = input_.lens;
    lens.width = input_.sizes[c].width;
    lens.height = input_.sizes[c].height;
    lens.fl_x = matrix.at<double>(0, 0);
    lens.fl_y = matrix.at<double>(1, 1);
    lens.cx = matrix.at<double>(0, 2) + 0.5;
    lens.cy = matrix.at<double>(1, 2) + 0.5;
    lens.k1 = coefficients.at<double>(0);
    lens.k2 = coefficients.at<double>(1);
    lens.p1 = coefficients.at<double>(2);
    lens.p2 = coefficients.at<double>(3);
    lens.k3 = coefficients.at<double>(4);
    for (std::size_t k = 0; k < of.size(); ++k) camera_from_board_[of[k]] = poseFromOpenCv(rvecs[k], tvecs[k]);
    if (!std::isfinite(lens.fl_x) || !(lens.fl_x > 0) || !(lens.fl_y > 0))
      throw badInput("camera '" + input_.cameras[c] + "'",
                     "no lens explains the board's photographs; photograph it from more sides, tilted");
  }

  // The cameras' places from shots that they share, cameras with the most shots in common first.
  void placeInRig() {
    const std::size_t n = input_.cameras.size();
    rig_.assign(n, Pose{});
    std::vector<bool> placed(n, false);
    placed[0] = true;
    for (std::size_t round = 1; round < n; ++round) {
      std::size_t best = n, best_count = 0;
      std::vector<Pose> best_poses;
      for (std::size_t c = 0; c < n; ++c) {
        if (placed[c]) continue;
        std::vector<Pose> poses;
        for (std::size_t i = 0; i < input_.sightings.size(); ++i)
          for (std::size_t j = 0; j < input_.sightings.size(); ++j) {
            const auto &a = input_.sightings[i], &b = input_.sightings[j];
            if (a.camera != c || a.shot != b.shot || !placed[b.camera]) continue;
            poses.push_back(camera_from_board_[i] * camera_from_board_[j].inverse() * rig_[b.camera]);
          }
        if (poses.size() > best_count) best = c, best_count = poses.size(), best_poses = std::move(poses);
      }
      if (best == n) {
        std::string alone;
        for (std::size_t c = 0; c < n; ++c)
          if (!placed[c]) alone += (alone.empty() ? "'" : ", '") + input_.cameras[c] + "'";
        throw badInput("camera " + alone,
                       "sees the board in no shot together with '" + input_.cameras[0] +
                           "' or a camera tied to it; hold the board where both see it, or name the shots alike");
      }
      rig_[best] = meanPose(best_poses);
      placed[best] = true;
    }
    shot_.assign(input_.shots.size(), Pose{});
    for (std::size_t s = 0; s < input_.shots.size(); ++s) {
      std::vector<Pose> poses;
      for (std::size_t i = 0; i < input_.sightings.size(); ++i)
        if (input_.sightings[i].shot == s)
          poses.push_back(rig_[input_.sightings[i].camera].inverse() * camera_from_board_[i]);
      out_.shots[s].seen = !poses.empty();
      if (!poses.empty()) shot_[s] = poses.size() > 2 ? meanPose(poses) : poses.front();
    }
  }

  // Median of the centres, mean of the rotations that lie within 3 degrees of the middle one: one wrong shot is no
  // harm.
  static Pose meanPose(const std::vector<Pose>& poses) {
    Pose mean;
    for (int i = 0; i < 3; ++i) {
      std::vector<double> values;
      for (const Pose& p : poses) values.push_back(p.center[i]);
      mean.center[i] = median(values);
    }
    const auto angle = [](const Mat3& a, const Mat3& b) {
      const Quaternion q = quaternionFromRotation(a * b.transposed());
      return 2 * std::atan2(std::hypot(std::hypot(q.x, q.y), q.z), q.w);
    };
    std::size_t middle = 0;
    double least = INFINITY;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      double sum = 0;
      for (const Pose& p : poses) sum += angle(poses[i].rotation, p.rotation);
      if (sum < least) least = sum, middle = i;
    }
    Mat3 sum{{Vec3{}, Vec3{}, Vec3{}}};
    for (const Pose& p : poses)
      if (angle(p.rotation, poses[middle].rotation) < radians(3)) sum = sum + p.rotation;
    mean.rotation = nearestRotation(sum);
    return mean;
  }

  // The screw between the board's places in pairs of shots gives the axis; its pitch is 0 for a table.
  void placeOnTurntable() {
    const TurntableMotion& motion = *input_.turntable;
    SRF_CHECK(motion.stops.size() == input_.shots.size());
    held_step_ = motion.step.has_value();
    struct Pair {
      double stops, angle;
      Vec3 axis, point;  // in the board's space
    };
    rig_.assign(input_.cameras.size(), Pose{});
    bool found = false;
    double best = -1;
    Pair screw{};
    std::size_t base = 0;
    for (std::size_t i = 0; i < input_.sightings.size(); ++i)
      for (std::size_t j = 0; j < input_.sightings.size(); ++j) {
        const auto &a = input_.sightings[i], &b = input_.sightings[j];
        const double stops = motion.stops[b.shot] - motion.stops[a.shot];
        if (a.camera != b.camera || !(stops > 0)) continue;
        // Where b's board lies, in the coordinates of a's: x' = R x + t.
        const Pose moved = camera_from_board_[i].inverse() * camera_from_board_[j];
        const Quaternion q = quaternionFromRotation(moved.rotation);
        const Vec3 imaginary{q.x, q.y, q.z};
        const double sine = length(imaginary), angle = 2 * std::atan2(sine, q.w);
        // Near a quarter turn the axis is known best. Beyond one the turns of a step cannot be told without a guess.
        const double step_guess = motion.step.value_or(0);
        if (!(sine > 0.01)) continue;
        if (motion.step ? std::fabs(step_guess * stops) > radians(170) : stops > smallestGap(motion) + 1e-9) continue;
        const double quality = std::sin(angle) > 0.2 || angle < radians(90) ? sine : 0.2;
        if (quality <= best) continue;
        const Vec3 axis = imaginary / sine, t = moved * Vec3{};
        // The point of the axis nearest to the origin: (I - R) p = t across the axis.
        const Vec3 across = t - axis * dot(axis, t);
        const Vec3 point = 0.5 * (across + cross(axis, across) * (q.w / sine));
        best = quality;
        screw = {stops, angle, axis, point};
        base = i;
        found = true;
      }
    if (!found)
      throw badInput("turntable",
                     "no two photographs of one camera show the board at neighbouring stops, turned by 1 degree or "
                     "more; photograph the board at three stops or more, next to each other");
    // Up is where a flat board's printed side is, else upwards in the picture of the camera that saw it.
    const Vec3 up_in_picture = camera_from_board_[base].rotation.transposed() * Vec3{0, -1, 0};
    const double up = std::fabs(screw.axis.z) > 0.5 ? screw.axis.z : dot(screw.axis, up_in_picture);
    if (up < 0) screw.axis = -screw.axis, screw.angle = -screw.angle;
    turn_.axis = screw.axis;
    turn_.step = motion.step.value_or(screw.angle / screw.stops);
    if (std::fabs(screw.angle - turn_.step * screw.stops) > radians(20))
      throw badInput("turntable", "the given step is " + std::to_string(degrees(turn_.step)) +
                                      " degrees and the board's photographs show " +
                                      std::to_string(degrees(screw.angle / screw.stops)) +
                                      " (counter-clockwise seen from above is positive); give that, or check the "
                                      "photographs' numbers");
    turn_.point = screw.point;  // the axis stands still in the board's own space
    for (std::size_t c = 0; c < input_.cameras.size(); ++c) {
      std::vector<Pose> poses;
      for (std::size_t i = 0; i < input_.sightings.size(); ++i) {
        const auto& s = input_.sightings[i];
        if (s.camera != c) continue;
        // camera_from_room = camera_from_board(stop) * board(stop)_from_room
        const Mat3 turned = rotationAbout(turn_.axis, turn_.step * motion.stops[s.shot]);
        const Pose room_from_board{turned, turn_.point - turned.transposed() * turn_.point};
        poses.push_back(camera_from_board_[i] * room_from_board.inverse());
      }
      rig_[c] = poses.size() > 2 ? meanPose(poses) : poses.front();
    }
    for (const BoardSighting& s : input_.sightings) out_.shots[s.shot].seen = true;
  }

  static double smallestGap(const TurntableMotion& motion) {
    std::vector<double> stops = motion.stops;
    std::sort(stops.begin(), stops.end());
    double gap = INFINITY;
    for (std::size_t i = 1; i < stops.size(); ++i)
      if (stops[i] > stops[i - 1]) gap = std::min(gap, stops[i] - stops[i - 1]);
    return gap;
  }

  // ---- Everything together

  struct Layout {
    std::vector<int> lens, rig, shot;  // first parameter of each, -1: held
    int turn = -1;
    bool step_held = false;
    int count = 0;
  };

  Layout layout(bool step_held, LeastSquaresProblem* problem, std::vector<std::string>* names) const {
    Layout l;
    l.step_held = step_held;
    const double size = length(corners_.back() - corners_.front());
    const auto add = [&](const std::string& name, double scale) {
      if (problem) problem->scale.push_back(scale);
      if (names) names->push_back(name);
      ++l.count;
    };
    const auto addPose = [&](const std::string& name) {
      for (const char* axis : {"x", "y", "z"}) add(name + ".rotation." + axis, 1);
      for (const char* axis : {"x", "y", "z"}) add(name + ".center." + axis, size);
    };
    for (std::size_t c = 0; c < lens_.size(); ++c) {
      l.lens.push_back(knownLens(c) ? -1 : l.count);
      for (int k = 0; !knownLens(c) && k < lensParameterCount(lens_[c].model); ++k)
        add(input_.cameras[c] + "." + kLensMembers[k].name, kLensMembers[k].in_pixels ? lens_[c].fl_x : 1);
    }
    for (std::size_t c = 0; c < lens_.size(); ++c) {
      const bool held = c == 0 && !input_.turntable;
      l.rig.push_back(held ? -1 : l.count);
      if (!held) addPose(input_.cameras[c]);
    }
    for (std::size_t s = 0; s < input_.shots.size(); ++s) {
      const bool held = input_.turntable || !out_.shots[s].seen;
      l.shot.push_back(held ? -1 : l.count);
      if (!held) addPose(input_.shots[s]);
    }
    if (input_.turntable) {
      l.turn = l.count;
      add("turntable.axis.1", 1);
      add("turntable.axis.2", 1);
      add("turntable.point.1", size);
      add("turntable.point.2", size);
      if (!step_held) add("turntable.step", 1);
    }
    return l;
  }

  /// Residuals of one sighting where the parameters are `delta` away from the state; delta is in the order of
  /// parametersOf.
  std::vector<int> parametersOf(const Layout& l, const BoardSighting& s) const {
    std::vector<int> p;
    const auto add = [&](int first, int count) {
      for (int k = 0; first >= 0 && k < count; ++k) p.push_back(first + k);
    };
    add(l.lens[s.camera], lensParameterCount(lens_[s.camera].model));
    add(l.rig[s.camera], 6);
    add(l.shot[s.shot], 6);
    add(l.turn, l.step_held ? 4 : 5);
    return p;
  }

  void evaluate(const Layout& l, const BoardSighting& s, const double* delta, double* residuals,
                std::vector<Vec2>* pixels = nullptr) const {
    Intrinsics lens = lens_[s.camera];
    if (l.lens[s.camera] >= 0)
      for (int k = 0; k < lensParameterCount(lens.model); ++k) lens.*kLensMembers[k].member += *delta++;
    const bool a_lens = lens.fl_x > 0 && lens.fl_y > 0;
    Pose camera_from_rig = rig_[s.camera], rig_from_board = input_.turntable ? Pose{} : shot_[s.shot];
    if (l.rig[s.camera] >= 0) camera_from_rig = camera_from_rig.moved(delta), delta += 6;
    if (l.shot[s.shot] >= 0) rig_from_board = rig_from_board.moved(delta), delta += 6;
    Turn turn = turn_;
    if (l.turn >= 0) {
      const double with_step[5] = {delta[0], delta[1], delta[2], delta[3], l.step_held ? 0 : delta[4]};
      turn = turn.moved(with_step);
    }
    for (std::size_t i = 0; i < s.corners.ids.size(); ++i) {
      Vec3 x = corners_[static_cast<std::size_t>(s.corners.ids[i])];
      x = input_.turntable ? turn.at(input_.turntable->stops[s.shot], x) : rig_from_board * x;
      const auto pixel = a_lens ? lens.project(Point<CameraSpace>(camera_from_rig * x)) : std::nullopt;
      // Behind the camera or beyond the lens: a step that does this is refused, as its squares are huge.
      const Vec2 q = pixel.value_or(Vec2{1e5, 1e5});
      residuals[2 * i] = q.x - s.corners.pixels[i].x;
      residuals[2 * i + 1] = q.y - s.corners.pixels[i].y;
      if (pixels) pixels->push_back(q);
    }
  }

  LeastSquaresResult adjust(bool step_held) {
    LeastSquaresProblem problem;
    out_.parameter_names.clear();
    const Layout l = layout(step_held, &problem, &out_.parameter_names);
    for (const BoardSighting& s : input_.sightings)
      problem.blocks.push_back({parametersOf(l, s), static_cast<int>(2 * s.corners.ids.size()),
                                [this, &l, &s](const double* delta, double* r) { evaluate(l, s, delta, r); }});
    problem.accept = [&](const std::vector<double>& delta) {
      const double* d = delta.data();
      for (std::size_t c = 0; c < lens_.size(); ++c)
        for (int k = 0; l.lens[c] >= 0 && k < lensParameterCount(lens_[c].model); ++k)
          lens_[c].*kLensMembers[k].member += d[l.lens[c] + k];
      for (std::size_t c = 0; c < rig_.size(); ++c)
        if (l.rig[c] >= 0) rig_[c] = rig_[c].moved(d + l.rig[c]);
      for (std::size_t s = 0; s < l.shot.size(); ++s)
        if (l.shot[s] >= 0) shot_[s] = shot_[s].moved(d + l.shot[s]);
      if (l.turn < 0) return;
      const double turn[5] = {d[l.turn], d[l.turn + 1], d[l.turn + 2], d[l.turn + 3], step_held ? 0 : d[l.turn + 4]};
      turn_ = turn_.moved(turn);
    };
    LeastSquaresResult fit = minimize(problem);
    if (fit.covariance.empty()) {
      const std::string what = fit.undetermined >= 0 ? out_.parameter_names[fit.undetermined] : "its parameters";
      throw badInput(
          "the board's photographs",
          "do not determine " + what +
              (input_.turntable
                   ? "; a board that lies flat on a turntable shows one plane from one height: lean it by 20 "
                     "to 40 degrees, or hold the lens with --lens-from"
                   : "; photograph the board from more sides, tilted, nearer and farther, or hold the lens "
                     "with --lens-from"));
    }
    return fit;
  }

  // The step was given: what would the photographs say?
  void freeStep() {
    Calibrator other = *this;
    const LeastSquaresResult fit = other.adjust(false);
    out_.turntable.emplace();
    out_.turntable->free_step = other.turn_.step;
    out_.turntable->free_step_deviation = std::sqrt(fit.covariance.back());
  }

  void report(const LeastSquaresResult& fit) {
    std::vector<std::string> names;
    const Layout l = layout(held_step_, nullptr, &names);
    const auto n = static_cast<std::size_t>(l.count);
    const auto deviation = [&](int p) { return std::sqrt(fit.covariance[static_cast<std::size_t>(p) * (n + 1)]); };
    const auto poseDeviation = [&](int first) {
      PoseDeviation d;
      for (int k = 0; first >= 0 && k < 3; ++k) {
        d.rotation[k] = deviation(first + k);
        d.center[k] = deviation(first + 3 + k);
      }
      return d;
    };
    out_.converged = fit.converged;
    out_.covariance = fit.covariance;
    for (std::size_t c = 0; c < lens_.size(); ++c) {
      CalibratedCamera& camera = out_.cameras[c];
      camera.lens = lens_[c];
      for (int k = 0; l.lens[c] >= 0 && k < lensParameterCount(lens_[c].model); ++k)
        camera.parameters.push_back({kLensMembers[k].name, lens_[c].*kLensMembers[k].member, deviation(l.lens[c] + k)});
      camera.pose = {Orthogonal<RigSpace, CameraSpace>(rig_[c].rotation.transposed()), Point<RigSpace>(rig_[c].center)};
      camera.deviation = poseDeviation(l.rig[c]);
    }
    for (std::size_t s = 0; s < out_.shots.size(); ++s) {
      if (!out_.shots[s].seen || input_.turntable) continue;
      out_.shots[s].pose = {Orthogonal<BoardSpace, RigSpace>(shot_[s].rotation.transposed()),
                            Point<BoardSpace>(shot_[s].center)};
      out_.shots[s].deviation = poseDeviation(l.shot[s]);
    }
    if (input_.turntable) {
      if (!out_.turntable) out_.turntable.emplace();
      TurntableFit& t = *out_.turntable;
      t.axis = Direction<BoardSpace>::fromUnit(turn_.axis);
      t.point = Point<BoardSpace>(turn_.point);
      t.step = turn_.step;
      t.axis_deviation = std::max(deviation(l.turn), deviation(l.turn + 1));
      t.point_deviation = std::max(deviation(l.turn + 2), deviation(l.turn + 3));
      if (!held_step_) t.step_deviation = deviation(l.turn + 4);
      for (std::size_t s = 0; s < out_.shots.size(); ++s) {
        const Mat3 back = rotationAbout(turn_.axis, -turn_.step * input_.turntable->stops[s]);
        out_.shots[s].pose = {Orthogonal<BoardSpace, RigSpace>(back),
                              Point<BoardSpace>(turn_.point - back * turn_.point)};
      }
    }
    double squares = 0;
    std::size_t count = 0;
    std::vector<double> rms;
    std::vector<double> camera_squares(lens_.size(), 0.0);
    for (const BoardSighting& s : input_.sightings) {
      SightingResidual& residual = out_.residuals.emplace_back();
      std::vector<double> errors(2 * s.corners.ids.size());
      const std::vector<double> zero(32, 0.0);
      evaluate(l, s, zero.data(), errors.data(), &residual.reprojected);
      double sum = 0;
      for (std::size_t i = 0; i < errors.size(); i += 2) {
        const double e = square(errors[i]) + square(errors[i + 1]);
        sum += e;
        residual.largest = std::max(residual.largest, std::sqrt(e));
      }
      residual.rms = std::sqrt(sum / static_cast<double>(s.corners.ids.size()));
      rms.push_back(residual.rms);
      camera_squares[s.camera] += sum;
      out_.cameras[s.camera].corners += s.corners.ids.size();
      squares += sum;
      count += s.corners.ids.size();
    }
    for (std::size_t c = 0; c < lens_.size(); ++c)
      out_.cameras[c].rms = std::sqrt(camera_squares[c] / static_cast<double>(out_.cameras[c].corners));
    out_.rms = std::sqrt(squares / static_cast<double>(count));
    for (const std::size_t i : outliers(rms)) out_.residuals[i].stands_out = true;
    const auto worst = static_cast<std::size_t>(std::max_element(rms.begin(), rms.end()) - rms.begin());
    const ImageSize& size = input_.sizes[input_.sightings[worst].camera];
    if (out_.rms > 0.02 * std::max(size.width, size.height))
      throw badInput(
          input_.sightings[worst].name,
          "no cameras and no motion explain the board's photographs: the root mean square error is " +
              std::to_string(out_.rms) + " px, " + std::to_string(rms[worst]) +
              " px in this one; check the board's size, whether the cameras stood still, the stops' numbers, "
              "or leave it out with --leave-out");
  }

  const BoardCalibrationInput& input_;
  std::vector<Vec3> corners_;            // board space, units
  std::vector<Intrinsics> lens_;         // of each camera
  std::vector<Pose> camera_from_board_;  // of each sighting, from the camera alone
  std::vector<Pose> rig_;                // camera_from_rig
  std::vector<Pose> shot_;               // rig_from_board
  Turn turn_;
  bool held_step_ = false;
  BoardCalibration out_;
};

}  // namespace

BoardCalibration calibrateWithBoard(const BoardCalibrationInput& input) {
  return Calibrator(input).run();
}

std::vector<std::size_t> outliers(const std::vector<double>& values) {
  if (values.size() < 4) return {};
  std::vector<double> logs, away;
  for (const double v : values) logs.push_back(std::log(std::max(v, 1e-12)));
  const double middle = median(logs);
  for (const double v : logs) away.push_back(std::fabs(v - middle));
  const double deviation = std::max(1.4826 * median(away), 0.15);
  std::vector<std::size_t> out;
  for (std::size_t i = 0; i < logs.size(); ++i)
    if (logs[i] - middle > 4 * deviation) out.push_back(i);
  return out;
}

}  // namespace srf
