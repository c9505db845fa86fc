// What `srf calibrate` is asked to do: its options but for those of lights and images, and which photographs they mean.
#pragma once

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "acquire/shoot.h"
#include "base/camera.h"
#include "base/error.h"

namespace srf {

class LightsAndImages;

struct CalibrationJob {
  std::filesystem::path photos, output, board_photos, lens_from, lights, print_board;
  std::string pattern, board_pattern, board, units = "m", world;
  std::vector<std::string> cameras, leave_out;
  std::optional<CameraModel> lens;  ///< default: opencv; simple_radial for structure from motion
  bool rig = false, turntable = false, copy = false, sfm = false;
  std::filesystem::path colmap_model, masks, points;
  std::vector<std::string> distance;  ///< two photographs and the distance between them
  std::optional<int> features, largest_side;
  bool developed = false;      ///< the photographs lie in the capture already, as linear images
  std::optional<double> step;  ///< degrees

  void addOptions(CLI::App& app);
  /// Throws usage where options contradict each other or would do nothing.
  void validate(const LightsAndImages& studio) const;
  bool byFeatures() const { return sfm || !colmap_model.empty(); }

  /// The photographs of a folder but for those left out, whose names go to `left_out`; with --camera NAME=PATTERN, of
  /// every such pattern.
  std::vector<ShootPhoto> photographs(const std::filesystem::path& folder, const std::string& of_pattern,
                                      std::set<std::string>& left_out) const;
  /// The name by which --leave-out means this file, if it does.
  std::optional<std::string> leavesOut(const std::filesystem::path& folder, const std::filesystem::path& file) const;
  /// Throws usage where a name of --leave-out was met by no photograph.
  void checkLeftOut(const std::set<std::string>& left_out) const;
};

/// Throws usage where the unit is not m, cm or mm.
double unitInMillimetres(const std::string& unit);

inline Error usage(const std::string& what) {
  return {ErrorKind::usage, what};
}

}  // namespace srf
