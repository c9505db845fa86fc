// Captures in the files and layouts of other programs and data sets (`srf import`). Nothing is re-centred or re-scaled;
// where a format itself holds a transform that has to be applied, it is told and recorded (Capture::applied_transform).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

struct ImportOptions {
  std::filesystem::path images;  ///< where the photographs lie; empty: beside the file, or in `images` there
  std::filesystem::path lights;  ///< openillumination: light_pos.npy; empty: in the folder or its `output`
  /// projections: coordinate of the first pixel's centre (OpenCV 0, COLMAP 0.5, MATLAB 1)
  double pixel_center = 0;
};

/// "transforms", "nrhints", "colmap", "middlebury", "projections", "metashape", "lp", "diligent", "diligent-mv",
/// "openillumination".
const std::vector<std::string>& importFormats();
/// The format of a file or folder by what it holds; throws bad_input that lists what was looked for.
std::string guessFormat(const std::filesystem::path& source);
/// Throws bad_input that names file and place; what is left out or assumed is told by warnings.
Capture importCapture(const std::string& format, const std::filesystem::path& source, const ImportOptions& options,
                      Reporter& reporter);

/// A 3 x 4 projection matrix of any sign and scale as lens and pose (RQ decomposition): pixels with the first pixel's
/// centre at `pixel_center` become this project's (0.5). Throws bad_input for a matrix without a finite centre.
Camera<AcquisitionSpace> cameraFromProjection(const Mat3& m, const Vec3& last_column, double pixel_center,
                                              const std::string& where);

}  // namespace srf
