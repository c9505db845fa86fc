// Cameras from the photographs' own features: COLMAP (Schoenberger and Frahm, CVPR 2016), run as a program, without a
// display or a graphics card; and the scale that it cannot know.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "acquire/board.h"
#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

struct StructureFromMotionOptions {
  std::filesystem::path photos;      ///< the folder that `names` are relative to
  std::vector<std::string> names;    ///< of the photographs
  std::vector<std::string> cameras;  ///< of each photograph: photographs of one camera and size share a lens
  std::filesystem::path masks;       ///< empty, or a folder of masks: name.jpg.png or name.png; black has no features
  std::filesystem::path workspace;   ///< database, masks, models; what is there is gone on from
  CameraModel lens = CameraModel::simple_radial;
  std::optional<Intrinsics> known_lens;  ///< held in place of fitting one
  int most_features = 8192;              ///< of a photograph
  int largest_side = 3200;               ///< pixels: larger photographs are searched at this size
  std::string program = "colmap";
};

/// Runs extraction, matching and mapping, and returns the folder of the largest model. Interrupted runs go on from the
/// database; where photographs, masks or options changed it is begun anew. Warns of photographs that were not
/// registered, by name. Throws failed where COLMAP is missing or fails, with what it means and COLMAP's last words,
/// and interrupted after Ctrl-C, when COLMAP has ended too.
std::filesystem::path runStructureFromMotion(const StructureFromMotionOptions& options, Reporter& reporter);

/// The mask of the photograph `name` (its path below the folder of photographs): name.jpg.png, name.png, or a file of
/// the same name; empty where there is none.
std::filesystem::path maskFileOf(const std::filesystem::path& masks, const std::string& name);

/// What COLMAP's end means: `stage` as it is called ("mapper"), `exit_code` (134 for an abort), its last lines.
std::string colmapFailure(const std::string& stage, int exit_code, const std::string& last_lines);

/// x -> scale rotation x + shift.
struct Similarity {
  double scale = 1;
  Mat3 rotation;
  Vec3 shift;
  Vec3 operator*(const Vec3& x) const { return scale * (rotation * x) + shift; }
};
/// Least squares (Umeyama, PAMI 1991); nothing where the points are fewer than 3 or lie on a line.
std::optional<Similarity> fitSimilarity(const std::vector<Vec3>& from, const std::vector<Vec3>& to);
/// Moves cameras, bounds and lights.
void applySimilarity(Capture& capture, const Similarity& similarity);

/// A place that is seen in photographs: the point nearest to the rays, and the root mean square of its distances to
/// them. Nothing where fewer than two rays come from different places or they are parallel.
struct Triangulated {
  Point<AcquisitionSpace> point;
  double distance = 0;
};
std::optional<Triangulated> triangulate(const std::vector<Ray<AcquisitionSpace>>& rays);

/// A board seen by posed cameras gives the similarity to its own space (in `millimetre` of the capture's units).
struct BoardAlignment {
  Similarity similarity;
  double residual = 0;  ///< root mean square distance of the corners from the board's, units
  std::size_t corners = 0;
};
/// `seen[view]`: what each view shows of the board. Throws bad_input where fewer than 4 corners are seen by 2 views.
BoardAlignment alignWithBoard(const Capture& capture, const Board& board, double millimetre,
                              const std::vector<std::optional<BoardCorners>>& seen);

}  // namespace srf
