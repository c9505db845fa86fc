// A capture: calibrated views (i_c), calibrated lights (i_l), and which photograph shows which view under which light.
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/camera.h"
#include "base/image_io.h"
#include "base/space.h"

namespace srf {

/// Index of a view (i_c of Table B) and of a light (i_l): two types, because Table B holds them side by side.
struct ViewId {
  std::uint32_t value = 0;
  friend auto operator<=>(const ViewId&, const ViewId&) = default;
};
struct LightId {
  std::uint32_t value = 0;
  friend auto operator<=>(const LightId&, const LightId&) = default;
};

enum class LightKind {
  directional,  ///< `direction`, irradiance
  point,        ///< `position`, radiant intensity
  captured      ///< the one unknown illumination of a capture without lights
};

struct CaptureLight {
  std::string name;
  LightKind kind = LightKind::directional;
  Direction<AcquisitionSpace> direction;  ///< from the object to the light
  Point<AcquisitionSpace> position;
  Vec3 strength{1, 1, 1};  ///< directional: irradiance on a plane facing it; point: intensity; captured: 1

  /// l at the surface point p.
  Direction<AcquisitionSpace> directionFrom(const Point<AcquisitionSpace>& p) const {
    return kind == LightKind::point ? normalize(position - p).value_or(direction) : direction;
  }
  /// Irradiance at p on a plane facing the light, per channel: what a pixel is divided by to become reflectance.
  Vec3 irradianceAt(const Point<AcquisitionSpace>& p) const {
    if (kind != LightKind::point) return strength;
    const double d = distance(position, p);
    return strength / (d * d);
  }
};

struct Photo {
  std::filesystem::path file;    ///< absolute, or relative to the working directory
  std::optional<LightId> light;  ///< none: the photograph gives its silhouette alone
  std::string place{};           ///< "transforms.json: /frames/3/file_path"; empty where no such file names it
};

struct CaptureView {
  std::string name;
  Camera<AcquisitionSpace> camera;
  std::filesystem::path mask_file;  ///< empty where the capture has none: alpha or a plain background then tell
  std::string mask_place{};         ///< as Photo::place
  std::vector<Photo> photos;
};

struct Capture {
  std::filesystem::path folder;
  std::string units = "m";
  std::string color_space = "lin_rec709";
  Transfer integer_transfer = Transfer::srgb;  ///< how 8/16-bit photographs encode light; EXR is always linear
  std::vector<CaptureLight> lights;            ///< one of kind `captured` where the capture names none
  std::vector<CaptureView> views;
  /// What another program did to the poses that it was given, or an import to those of a file: rows of a 3 x 4 matrix
  /// from the old space to acquisition space, its scale included. A record; it is already in all that stands here.
  std::optional<std::array<double, 12>> applied_transform;
  std::optional<Box<AcquisitionSpace>> bounds;  ///< a box that holds the object, where the capture tells

  bool unknownIllumination() const { return lights.size() == 1 && lights[0].kind == LightKind::captured; }
};

}  // namespace srf
