// Hold-out: a field without some of its views and lights, what it makes of them, and how far that is from the stored
// photographs. What `srf study --capture` and the benchmark of real captures share.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "base/image_metrics.h"
#include "field/srf_folder.h"
#include "render/light_set.h"

namespace srf {

/// By ViewId and LightId; 1: left out.
struct LeftOut {
  std::vector<std::uint8_t> views, lights;
};
/// The field as it would be without them: such views give their silhouette alone, such lights stand for no others.
SrfManifest without(const SrfManifest& field, const LeftOut& out);

/// The light as the scene's own, where its place is known; else as it shone in the photographs.
FrameLights asSceneLight(const SrfManifest& field, LightId light);

struct StoredPhotograph {
  ImageF rgb;     ///< radiance; 0 outside the stored part
  ImageF inside;  ///< 1 where the object wholly covers the pixel, else 0
};
/// As the store holds it (a lossy store: what is left of it). `at`: position in the view's lights.
StoredPhotograph storedPhotograph(const std::filesystem::path& srf_folder, const StoredView& view, std::size_t at);

struct PredictionScore {
  MetricFigures figures;   ///< PSNR, SSIM, FLIP of compareImages, inside
  double difference2 = 0;  ///< sum of squared differences inside, all channels
  double square2 = 0;      ///< of the photograph's squares
};
/// `picture`: a rendered frame's rgba or rgb. Pixels where it shows nothing count as black. Throws as compareImages.
PredictionScore scorePrediction(const ImageF& picture, const ImageF& photograph, const ImageF& inside);

/// Indices so that the first n of them lie far apart, for any n: each is the one furthest from all before it.
std::vector<std::size_t> farthestFirst(std::span<const Vec3> directions);

/// error = factor * count^-exponent, the least squares of the logarithms.
struct PowerLaw {
  double factor = 0, exponent = 0;
  double at(double count) const;
};
/// At least two pairs (count, error), all positive and of differing count.
PowerLaw fitPowerLaw(std::span<const std::array<double, 2>> measured);

}  // namespace srf
