// The part of `srf calibrate` that finds lights and makes linear images; its options are its own.
#pragma once

#include <CLI/CLI.hpp>
#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "acquire/develop.h"
#include "acquire/light_calibration.h"
#include "acquire/shoot.h"
#include "base/color.h"
#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// A calibrated camera as the shoot names it; an empty view stands for every one.
struct PlacedCamera {
  std::string camera, view;
  Camera<AcquisitionSpace> at;
};

class LightsAndImages {
 public:
  void addOptions(CLI::App& app);
  /// Throws usage where options contradict each other.
  void validate() const;

  /// One camera that is not calibrated (--one-view): acquisition space has x right, y up and z towards it.
  bool oneView() const { return !one_view_.empty(); }
  Camera<AcquisitionSpace> oneViewCamera(const ImageSize& size) const;

  bool develops() const { return develop_; }
  bool undistorts() const { return undistort_; }
  /// What integer photographs of the capture mean; developed ones are linear.
  Transfer integerTransfer() const { return develop_ || encoding_ == "linear" ? Transfer::linear : Transfer::srgb; }
  /// One linear EXR for each camera, view and light, from all its exposures, in `output`/images; with --undistort by
  /// the lens of its camera. Returns them as a shoot.
  std::vector<ShootPhoto> developed(const std::vector<ShootPhoto>& photos, const std::vector<PlacedCamera>& cameras,
                                    const std::filesystem::path& output, Reporter& reporter);

  bool setsStrengths() const { return !strengths_.empty() || !white_.empty(); }
  bool findsLights() const { return !spheres_.empty() || !lp_.empty() || !dome_.empty(); }
  /// The lights of the ways asked for, with strengths (1 where nothing tells them). Call after developed().
  std::vector<CaptureLight> lights(const std::filesystem::path& folder, const std::vector<ShootPhoto>& photos,
                                   const std::vector<PlacedCamera>& cameras, Reporter& reporter);
  void setStrengthsOf(std::vector<CaptureLight>& lights, const std::filesystem::path& folder,
                      const std::vector<PlacedCamera>& cameras, Reporter& reporter);

 private:
  struct Prepared {  ///< what all pictures of the shoot share
    CameraResponse response;
    ImageF dark, flat;
    std::optional<ColorConversion> color;
    double largest_amount = 1;
    std::optional<std::array<float, 4>> white_balance;
    std::map<std::string, std::vector<double>> seconds;
    std::optional<bool> timed;  ///< whether the photographs' EXIF tells their exposure
  };
  Exposure exposureOf(const ShootPhoto& photo, bool bracketed, Prepared& prepared) const;
  Prepared& prepare(const std::vector<ShootPhoto>& photos, Reporter& reporter);
  Merged picture(const std::vector<ShootPhoto>& bracket, Prepared& prepared) const;
  std::vector<CaptureLight> fromSpheres(const std::filesystem::path& folder, const std::vector<PlacedCamera>& cameras,
                                        Prepared& prepared, Reporter& reporter) const;
  std::vector<CaptureLight> fromLp(const std::vector<ShootPhoto>& photos, const std::vector<PlacedCamera>& cameras,
                                   Reporter& reporter) const;

  bool develop_ = false, undistort_ = false, matt_ = false, keep_spheres_ = false;
  std::string one_view_, encoding_ = "srgb", input_space_ = "lin_rec709", spheres_, white_;
  std::filesystem::path exposures_, lp_, dome_, strengths_, sphere_mask_;
  std::vector<std::filesystem::path> dark_, flat_;
  std::vector<std::string> circles_;
  std::vector<double> ignored_, white_rectangle_, white_normal_, white_position_;
  double saturated_ = 0.985, sphere_radius_ = 0, white_reflectance_ = 0.9;
  std::optional<Prepared> prepared_;
};

}  // namespace srf
