// Cameras from photographs of a board: each lens by Zhang's method (PAMI 2000, OpenCV's calibrateCamera), then lenses,
// the cameras' fixed places in their rig and the board's motion together by least squares, with their uncertainty.
// The board's motion is free, or that of a turntable: then the axis and the step are fitted in its place.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "acquire/board.h"
#include "base/camera.h"
#include "base/image_io.h"
#include "base/reporter.h"

namespace srf {

/// The space in which a rig's cameras stand still: that of its first camera; with a turntable the board's at stop 0.
struct RigSpace;

/// What one photograph shows of the board.
struct BoardSighting {
  std::string name;            ///< of the photograph, as told to the user
  std::filesystem::path file;  ///< may be empty (corners that were computed)
  std::size_t camera = 0, shot = 0;
  BoardCorners corners;
};

/// A turntable that carries the board: at stop s it stands at s times the step.
struct TurntableMotion {
  std::vector<double> stops;   ///< of each shot, in steps
  std::optional<double> step;  ///< radians, counter-clockwise about the axis; held where given, else fitted
};

struct BoardCalibrationInput {
  Board board;
  double millimetre = 0.001;  ///< in the units of the result
  std::vector<std::string> cameras;
  std::vector<ImageSize> sizes;                       ///< of each camera's photographs
  std::vector<std::optional<Intrinsics>> known_lens;  ///< held where given; empty: none is
  CameraModel lens = CameraModel::opencv;             ///< pinhole, simple_radial or opencv
  std::vector<std::string> shots;                     ///< moments: the board lies still in each
  std::vector<BoardSighting> sightings;
  std::optional<TurntableMotion> turntable;
};

/// A lens parameter and its standard deviation.
struct LensParameter {
  std::string name;  ///< as in transforms.json: "fl_x" ..
  double value = 0, deviation = 0;
};

/// Standard deviations of a pose: of the rotation about the camera's axes (radians), of the camera's centre in the
/// space that it is posed in (units).
struct PoseDeviation {
  Vec3 rotation, center;
};

struct CalibratedCamera {
  std::string name;
  Intrinsics lens;
  std::vector<LensParameter> parameters;  ///< those that were fitted
  Rigid<RigSpace, CameraSpace> pose;      ///< rig_from_camera
  PoseDeviation deviation;                ///< zero for the first camera of a rig: the rig's space is its own
  double rms = 0;                         ///< pixels, over all corners: the root of the mean squared distance
  std::size_t corners = 0;
  double opencv_rms = 0;  ///< of OpenCV's calibration of this camera alone; 0 where the lens was given
};

struct CalibratedShot {
  bool seen = false;                 ///< whether any camera found the board
  Rigid<BoardSpace, RigSpace> pose;  ///< board_from_rig
  PoseDeviation deviation;           ///< free motion: "camera" is the rig; zero for a turntable
};

struct SightingResidual {
  double rms = 0, largest = 0;    ///< pixels
  std::vector<Vec2> reprojected;  ///< where the fitted model puts the corners
  bool stands_out = false;        ///< far worse than the others
};

struct TurntableFit {
  Point<BoardSpace> point;              ///< on the axis, in the board's space at stop 0
  Direction<BoardSpace> axis;           ///< on the board's printed side where it lies flat, else upwards in the picture
  double step = 0, step_deviation = 0;  ///< radians, counter-clockwise about the axis
  double axis_deviation = 0;            ///< radians, the larger of two tilts
  double point_deviation = 0;           ///< units, the larger of two shifts across the axis
  std::optional<double> free_step;      ///< what a fit finds where the step was given
  double free_step_deviation = 0;
};

struct BoardCalibration {
  std::vector<CalibratedCamera> cameras;
  std::vector<CalibratedShot> shots;
  std::vector<SightingResidual> residuals;  ///< of each sighting of the input
  std::optional<TurntableFit> turntable;
  double rms = 0;  ///< pixels, over all corners of all cameras
  bool converged = false;
  /// Covariance of all fitted parameters, row-major, and their names ("left.fl_x", "right.rotation.x", "01.center.z",
  /// "turntable.step" ..).
  std::vector<std::string> parameter_names;
  std::vector<double> covariance;
};

/// Throws bad_input where a camera has too few sightings, where cameras share no shots, where a rig or turntable is
/// given a board that looks alike when turned by half a turn, and where a parameter is not determined (naming it).
BoardCalibration calibrateWithBoard(const BoardCalibrationInput& input);

/// Indices of values far above the others: their logarithm lies above the median by more than 4 robust deviations
/// (1.4826 median absolute deviations, at least 0.15). Needs 4 values to judge.
std::vector<std::size_t> outliers(const std::vector<double>& values);

}  // namespace srf
