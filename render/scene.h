// scene.json: camera, deformation, lights, frames, output (doc: formats, Scene).
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "base/animated.h"
#include "base/camera.h"
#include "model/deformation.h"
#include "model/local_frame.h"
#include "render/effects.h"
#include "render/gltf_scene.h"

namespace srf {

struct LookAtCamera {
  int width = 0, height = 0;
  Animated<double> vfov;  ///< degrees
  Animated<Vec3> eye, target, up;
};
using SceneCamera = std::variant<LookAtCamera, Camera<ObjectSpace>, FileCamera>;

struct PointLight {
  Animated<Vec3> position, intensity;
};
struct DirectionalLight {
  Animated<Vec3> direction, irradiance;
};
struct EnvironmentLight {
  std::filesystem::path map;
  Animated<double> rotation;  ///< degrees about +z
  Animated<double> scale;
  int samples = 256;  ///< point-like lights taken from it; 0: every texel
};
struct CapturedLight {
  std::string light;
  Animated<double> scale;
};  ///< `light` empty: the one unnamed light
using SceneLight = std::variant<PointLight, DirectionalLight, EnvironmentLight, CapturedLight, FileLights>;

/// How values between the samples of the field are made.
enum class Interpolation {
  automatic,  ///< guided where the model holds a fit, else plain
  plain,      ///< the patent's
  guided,     ///< the patent's, of what the fitted model leaves over (render/guided_interpolation.h)
  model       ///< the fitted model alone, without the photographs
};
/// Which shadows fall on the surface.
enum class Shadows {
  automatic,  ///< guided: deformed where there is a deformation, else captured; plain: captured
  captured,   ///< the rest pose's, as the photographs hold them
  deformed,   ///< rays in the deformed model, instead of the rest pose's where that can be told
  both,       ///< plain alone: the photographs' own, and rays in the deformed model
  off
};

/// Which pixels are shaded: within smooth parts of the surface the others take the mean of those about them.
enum class Shading {
  every,
  sparse,  ///< a third of them: every second row and column
  sparser  ///< a seventh: every fourth, where the surface is that flat
};
/// What a scene's file calls them, in their order.
inline constexpr std::array<std::string_view, 3> kShadingWords{"every", "sparse", "sparser"};
/// As JSON has it: "sparse" in its quotes.
std::string shadingAsJson(Shading shading);

/// Every approximation, each with an exact setting (M18).
struct Accuracy {
  int views = 4;   ///< k nearest views
  int lights = 4;  ///< k nearest acquired lights; one less in the residual of guided interpolation
  FrameMode frame = FrameMode::bisector;
  double light_sharing = 2;    ///< degrees over which rotated light weights are shared; 0: exact
  double min_distance = 1e-3;  ///< least distance of a point light in A(d), of the object's diameter
  double texels = 2;           ///< of a photograph across a sample before a coarser level of it is taken; 0: never
  Shading shading = Shading::every;
  int shadow_rays = 32;  ///< most a hit for environments; of their other lights the captured ones' shadows tell
};

struct Scene {
  std::filesystem::path file;  ///< what relative paths refer to, and what errors name
  std::filesystem::path srf;
  SceneCamera camera;
  AnimatedDeformation deformation;
  std::vector<SceneLight> lights;
  std::vector<int> frames{0};
  double fps = 24;
  std::string output;  ///< pattern with ####; relative to the working directory
  int samples = 1;     ///< per pixel
  Interpolation interpolation = Interpolation::automatic;
  Shadows shadows = Shadows::automatic;
  Effects effects;
  Accuracy accuracy;
  std::uint64_t content_hash = 0;  ///< of the file's keys that a picture depends on (all but srf, frames, output), and
                                   ///< of the glTF files of its camera and lights

  Camera<ObjectSpace> cameraAt(double frame) const;
};

/// Reads scene.json; `overrides` are --set assignments. Throws bad_input naming file, key and what was expected.
Scene readScene(const std::filesystem::path& file, const std::vector<std::string>& overrides, Reporter& reporter);
/// "0-60", "0-60x2", "3", "1,3,10-20" to numbers, in the order given and each once; throws bad_input naming `where`, or
/// usage where that is an option ("--frames").
std::vector<int> parseFrames(const std::string& text, const std::string& where);
/// The file of a frame: #### (or %04d) replaced; a pattern without either gets .#### before its suffix.
std::filesystem::path frameFile(const std::string& pattern, int frame);

}  // namespace srf
