// A sequence of frames (M16): what `srf render` and `srf pipeline` call.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "render/frame_renderer.h"
#include "render/scene.h"

namespace srf {

struct RenderedFrame {
  int frame = 0;
  std::filesystem::path file;
  double seconds = 0;
  bool kept = false;                    ///< found finished by --resume
  std::optional<FrameSupport> support;  ///< where the options ask for it
};

struct AnimationOptions {
  std::filesystem::path srf;        ///< the field; overrides the scene's
  std::string output;               ///< pattern of the frames; overrides the scene's
  std::vector<int> frames;          ///< overrides the scene's where not empty
  std::vector<std::string> layers;  ///< groups of knownLayers()
  bool resume = false;              ///< keep frames whose header carries the same settings and input hashes
  bool shortcuts = true;            ///< FrameSettings::shortcuts
  bool support = false;             ///< how much of each picture the capture supports; figures "support..." tell too
  std::size_t memory_bytes = std::size_t{1} << 30;
  std::string command;  ///< for the frames' headers
  /// Called with each frame as it is finished, and with how many are left.
  std::function<void(const RenderedFrame&, std::size_t left)> finished;
};

/// The active model's fit, where it guides the scene's interpolation. Throws bad_input where the scene asks for what
/// only a fit can give and there is none.
std::optional<ReflectanceFit> guidingFit(const Scene& scene, const std::filesystem::path& srf,
                                         const SrfManifest& manifest, const DeformableModel& model);
/// What the scene asks of a frame; `fit` must outlive what is made with it.
FrameSettings frameSettings(const Scene& scene, const std::optional<ReflectanceFit>& fit, std::size_t memory_bytes);

/// Renders the scene's frames; each appears when it is whole. Throws bad_input before anything is rendered where scene
/// and field do not fit (e.g. other lights than `captured` on a field of unknown illumination).
std::vector<RenderedFrame> renderAnimation(const Scene& scene, const AnimationOptions& options, Reporter& reporter);

/// A pixel of a frame with all that it comes from.
struct ExplainedFrame {
  SrfManifest field;
  DeformableModel model;
  std::vector<Tangents<ObjectSpace>> tangents;  ///< u, v of each model point
  std::vector<Point<ObjectSpace>> positions;    ///< p* of each model point
  FrameLights lights;
  PixelExplanation pixel;
};
/// The pixel (x, y) of `frame` as renderAnimation would make it. Throws usage where the picture has no such pixel.
ExplainedFrame explainPixel(const Scene& scene, const AnimationOptions& options, int frame, int x, int y,
                            Reporter& reporter);

}  // namespace srf
