#include "field/capture_json.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "base/numeric.h"

namespace srf {
namespace {

using Pose = Rigid<AcquisitionSpace, CameraSpace>;

struct Coefficient {
  const char* key;
  double Intrinsics::*member;
};
constexpr Coefficient kCoefficients[] = {{"k1", &Intrinsics::k1}, {"k2", &Intrinsics::k2}, {"k3", &Intrinsics::k3},
                                         {"k4", &Intrinsics::k4}, {"p1", &Intrinsics::p1}, {"p2", &Intrinsics::p2}};

bool uses(CameraModel model, const std::string& key) {
  switch (model) {
    case CameraModel::simple_radial:
      return key == "k1";
    case CameraModel::opencv:
      return key != "k4";
    case CameraModel::opencv_fisheye:
      return key[0] == 'k';
    default:
      return false;
  }
}

// The names of formats.md and two that nerfstudio writes for the same lenses.
CameraModel readModel(const JsonNode& node) {
  const std::string name = node.string();
  if (name == "SIMPLE_PINHOLE") return CameraModel::pinhole;
  if (name == "RADIAL") return CameraModel::opencv;
  if (const auto model = cameraModelFromName(name)) return *model;
  throw node.error("found '" + name +
                   "', expected one of PINHOLE, SIMPLE_RADIAL, OPENCV, OPENCV_FISHEYE, ORTHOGRAPHIC; undistort the "
                   "photographs to one of these");
}

// How far the columns are from orthonormal.
double deviation(const Mat3& m) {
  const Mat3 product = m.transposed() * m;
  double most = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) most = std::fmax(most, std::fabs(product.row[i][j] - (i == j)));
  return most;
}

std::string shortNumber(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", x);
  return text;
}

}  // namespace

Json vec3Json(const Vec3& v) {
  return Json::array({v.x, v.y, v.z});
}

void writeLens(Json& object, const Intrinsics& lens) {
  object["camera_model"] = cameraModelName(lens.model);
  object["w"] = lens.width;
  object["h"] = lens.height;
  object["fl_x"] = lens.fl_x;
  object["fl_y"] = lens.fl_y;
  object["cx"] = lens.cx;
  object["cy"] = lens.cy;
  if (lens.skew != 0) object["skew"] = lens.skew;
  for (const auto& [key, member] : kCoefficients)
    if (lens.*member != 0) object[key] = lens.*member;
}

Intrinsics readLens(const std::vector<JsonNode>& scopes, const std::function<ImageSize()>& size_from_image) {
  const auto find = [&](std::string_view key) -> std::optional<JsonNode> {
    for (const JsonNode& scope : scopes)
      if (auto node = scope.find(key)) return node;
    return std::nullopt;
  };
  Intrinsics lens;
  const auto model = find("camera_model");
  if (model) lens.model = readModel(*model);
  const auto fisheye = find("is_fisheye");  // instant-ngp's way to say so
  if (!model && fisheye && fisheye->boolean()) lens.model = CameraModel::opencv_fisheye;

  const auto w = find("w"), h = find("h");
  if (w && h) {
    lens.width = static_cast<int>(w->integer(1, 65536));
    lens.height = static_cast<int>(h->integer(1, 65536));
  } else if (size_from_image) {
    const ImageSize size = size_from_image();
    lens.width = size.width;
    lens.height = size.height;
  } else {
    scopes.front()[w ? "h" : "w"];  // throws: the key is missing
  }

  // A frame's own angle wins over the focal length at the top.
  for (const JsonNode& scope : scopes) {
    const auto focal = [&](const char* key, const char* angle_key, int size) {
      if (const auto node = scope.find(key)) return node->positiveNumber();
      const auto node = scope.find(angle_key);
      if (!node) return 0.0;
      const double angle = node->positiveNumber();
      if (angle >= kPi) throw node->error("found " + shortNumber(angle) + ", expected an angle below pi in radians");
      return 0.5 * size / std::tan(0.5 * angle);
    };
    if (lens.fl_x == 0) lens.fl_x = focal("fl_x", "camera_angle_x", lens.width);
    if (lens.fl_y == 0) lens.fl_y = focal("fl_y", "camera_angle_y", lens.height);
    if (lens.fl_x != 0 || lens.fl_y != 0) break;
  }
  if (lens.fl_x == 0) lens.fl_x = lens.fl_y;
  if (lens.fl_y == 0) lens.fl_y = lens.fl_x;
  if (lens.fl_x == 0)
    throw scopes.front().error(
        "has no focal length: add fl_x (pixels) or camera_angle_x (radians), here or at the top");
  const auto cx = find("cx"), cy = find("cy"), skew = find("skew");
  lens.cx = cx ? cx->number() : 0.5 * lens.width;
  lens.cy = cy ? cy->number() : 0.5 * lens.height;
  if (skew) lens.skew = skew->number();

  for (const auto& [key, member] : kCoefficients) {
    const auto node = find(key);
    if (!node) continue;
    lens.*member = node->number();
    if (lens.*member == 0 || uses(lens.model, key)) continue;
    // nerfstudio and instant-ngp apply the coefficients whatever name the model has.
    if (lens.model == CameraModel::pinhole && uses(CameraModel::opencv, key))
      lens.model = CameraModel::opencv;
    else
      throw node->error("is not 0, yet camera_model " + cameraModelName(lens.model) +
                        " has no such coefficient; mend the model or remove the key");
  }
  return lens;
}

Json poseJson(const Pose& pose) {
  Json rows = Json::array();
  const Mat3& r = pose.rotation().raw();
  for (int i = 0; i < 3; ++i) rows.push_back({r.row[i][0], -r.row[i][1], -r.row[i][2], pose.origin().raw()[i]});
  rows.push_back({0, 0, 0, 1});
  return rows;
}

Pose readPose(const JsonNode& matrix) {
  constexpr double kTolerance = 1e-3;  // what matrices printed with few digits or kept in float need
  if (matrix.size() != 4 && matrix.size() != 3)
    throw matrix.error("has " + std::to_string(matrix.size()) + " rows, expected a 4x4 matrix");
  Mat3 r;
  Vec3 t;
  for (int i = 0; i < 3; ++i) {
    const auto row = matrix.at(i).numbers(4);
    r.row[i] = {row[0], row[1], row[2]};
    t[i] = row[3];
  }
  if (matrix.size() == 4) {
    const auto last = matrix.at(3).numbers(4);
    if (last[0] != 0 || last[1] != 0 || last[2] != 0 || last[3] != 1)
      throw matrix.at(3).error("found another last row, expected [0, 0, 0, 1]");
  }
  const double det = determinant(r);
  if (!(deviation(r) <= 2 * kTolerance) || !(det > 0)) {  // |M'M - 1| is twice the error of a length
    const std::string expected = "; expected a rotation (camera to world) and a translation: ";
    const double scale = std::cbrt(std::fabs(det));
    if (!(scale > 1e-6)) throw matrix.error("is singular" + expected + "export the pose of this frame again");
    if (deviation((1 / scale) * r) <= 2 * kTolerance && det > 0)
      throw matrix.error("scales by " + shortNumber(scale) + expected + "divide the upper left 3x3 by that scale");
    if (deviation(r) <= 2 * kTolerance)
      throw matrix.error("mirrors (determinant -1)" + expected + "negate one axis of the camera");
    throw matrix.error("has an upper left 3x3 that is not a rotation (its columns are off orthonormal by " +
                       shortNumber(deviation(r)) + ")" + expected + "orthonormalise it");
  }
  // Nearest rotation by Newton's iteration for the polar factor; a matrix that is one to rounding keeps its bits.
  for (int i = 0; i < 8 && deviation(r) > 1e-14; ++i) r = 0.5 * (r + inverse(r).transposed());
  for (Vec3& row : r.row) row = {row.x, -row.y, -row.z};  // OpenGL's camera looks along -z with y up
  return Pose(Orthogonal<AcquisitionSpace, CameraSpace>(r), Point<AcquisitionSpace>(t));
}

Json lightJson(const CaptureLight& light) {
  Json out;
  out["name"] = light.name;
  switch (light.kind) {
    case LightKind::directional:
      out["type"] = "directional";
      out["direction"] = vec3Json(light.direction.raw());
      out["irradiance"] = vec3Json(light.strength);
      break;
    case LightKind::point:
      out["type"] = "point";
      out["position"] = vec3Json(light.position.raw());
      out["intensity"] = vec3Json(light.strength);
      break;
    case LightKind::captured:
      out["type"] = "captured";
      break;
  }
  return out;
}

CaptureLight readLight(const JsonNode& node) {
  node.onlyKeys({"name", "type", "direction", "irradiance", "position", "intensity"});
  CaptureLight light;
  light.name = node["name"].string();
  if (light.name.empty()) throw node["name"].error("is empty, expected a name");
  light.kind = static_cast<LightKind>(node["type"].choice({"directional", "point", "captured"}));
  const auto strength = [&](const char* key) {
    const auto value = node.find(key);
    if (!value) return Vec3{1, 1, 1};
    const Vec3 v = value->vec3();
    if (!(minComponent(v) >= 0 && maxComponent(v) > 0))
      throw value->error("expected three numbers of at least 0, one of them above 0");
    return v;
  };
  const auto refuse = [&](std::initializer_list<const char*> keys, const std::string& kind) {
    for (const char* key : keys)
      if (const auto found = node.find(key)) throw found->error("does not belong to a " + kind + " light; remove it");
  };
  switch (light.kind) {
    case LightKind::directional: {
      refuse({"position", "intensity"}, "directional");
      const JsonNode direction = node["direction"];
      const Vec3 v = direction.vec3();
      const auto unit = normalize(Vector<AcquisitionSpace>(v));
      if (!unit) throw direction.error("has no length, expected a vector from the object to the light");
      light.direction = std::fabs(length(v) - 1) < 1e-15 ? Direction<AcquisitionSpace>::fromUnit(v) : *unit;
      light.strength = strength("irradiance");
      break;
    }
    case LightKind::point:
      refuse({"direction", "irradiance"}, "point");
      light.position = Point<AcquisitionSpace>(node["position"].vec3());
      light.strength = strength("intensity");
      break;
    case LightKind::captured:
      refuse({"direction", "irradiance", "position", "intensity"}, "captured");
      break;
  }
  return light;
}

}  // namespace srf
