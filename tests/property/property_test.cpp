// Properties on drawn input, shrunk to the simplest that breaks them (rapidcheck): frames, rotations, weights, and
// files that were damaged at random. The draws are the same in every run; RC_PARAMS overrides them.
#include <gtest/gtest.h>
#include <rapidcheck.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/numeric.h"
#include "field/capture_file.h"
#include "field/lumigraph_weights.h"
#include "model/local_frame.h"
#include "render/scene.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

const int kSeeded =
    ::setenv("RC_PARAMS", test::nightly() ? "seed=7 max_success=100000" : "seed=7 max_success=1000", /*overwrite=*/0);

// Numbers of every magnitude that shrink to small whole ones.
rc::Gen<double> number() {
  return rc::gen::map(rc::gen::pair(rc::gen::inRange(-1000, 1001), rc::gen::inRange(-200, 201)),
                      [](const auto& drawn) { return std::scalbn(static_cast<double>(drawn.first), drawn.second); });
}
rc::Gen<double> moderate() {
  return rc::gen::map(rc::gen::inRange(-1000, 1001), [](int drawn) { return drawn / 100.0; });
}
Vec3 drawVec(const rc::Gen<double>& component) {
  return {*component, *component, *component};
}
Mat3 drawRotation() {
  const auto axis = normalize(Vector<ObjectSpace>(drawVec(moderate())));
  RC_PRE(axis.has_value());
  return rotationAbout(axis->raw(), *moderate());
}
bool orthonormal(const Mat3& m, int handedness, double bound) {
  const Mat3 gram = m * m.transposed();
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      if (!(std::fabs(gram.row[i][j] - (i == j)) <= bound)) return false;
  return std::fabs(determinant(m) - handedness) <= bound;
}
double differenceOf(const Mat3& a, const Mat3& b) {
  double most = 0;
  for (int i = 0; i < 3; ++i) most = std::fmax(most, length(a.row[i] - b.row[i]));
  return most;
}
Tangents<ObjectSpace> carried(const Mat3& map, const Mat3& r0) {
  return {Vector<ObjectSpace>(map * r0.column(0)), Vector<ObjectSpace>(map * r0.column(1)),
          determinant(map) < 0 ? -1 : 1};
}

RC_GTEST_PROP(Properties, ARotationComesBackFromItsRodriguesVector, ()) {
  const Mat3 r = drawRotation();
  const Vec3 r0 = rodriguesFromRotation(Orthogonal<AcquisitionSpace, TangentSpace>(r));
  RC_ASSERT(isFinite(r0));
  RC_ASSERT(differenceOf(rotationFromRodrigues(r0).raw(), r) <= 4e-6);
}

RC_GTEST_PROP(Properties, AnyVectorIsTheRodriguesVectorOfARotation, ()) {
  RC_ASSERT(orthonormal(rotationFromRodrigues(drawVec(number())).raw(), 1, 1e-14));
}

RC_GTEST_PROP(Properties, AnyTangentsGiveAnOrthonormalFrame, ()) {
  Tangents<ObjectSpace> tangents{Vector<ObjectSpace>(drawVec(number())), Vector<ObjectSpace>(drawVec(number())), 1};
  // Often nearly or wholly parallel: a draw alone hardly ever is.
  const int parallel = *rc::gen::inRange(0, 4);
  if (parallel > 1) tangents.v = *number() * tangents.u;
  if (parallel == 3) tangents.v = tangents.v + Vector<ObjectSpace>(drawVec(number()));
  tangents.handedness = *rc::gen::element(-1, 1);
  for (const FrameMode mode : {FrameMode::bisector, FrameMode::polar})
    RC_ASSERT(orthonormal(deformedFrame(tangents, mode).tangent_from_space.raw(), tangents.handedness, 1e-13));
}

// L of a deformation followed by a rotation is L of the deformation after the rotation's inverse; a scale says nothing.
RC_GTEST_PROP(Properties, AFrameTurnsWithTheSpaceAndForgetsItsScale, ()) {
  const Mat3 r0 = drawRotation(), turn = drawRotation();
  const Mat3 map = Mat3::fromColumns(drawVec(moderate()), drawVec(moderate()), drawVec(moderate()));
  const double scale = std::exp2(*rc::gen::inRange(-100, 101));
  const auto before = carried(map, r0), after = carried(scale * (turn * map), r0);
  const Vec3 u = before.u.raw(), v = before.v.raw();
  RC_PRE(length(cross(u, v)) > 1e-3 * length(u) * length(v));
  RC_PRE(std::fabs(determinant(map)) > 1e-6);
  for (const FrameMode mode : {FrameMode::bisector, FrameMode::polar}) {
    const Mat3 a = deformedFrame(before, mode).tangent_from_space.raw() * turn.transposed();
    RC_ASSERT(differenceOf(deformedFrame(after, mode).tangent_from_space.raw(), a) <= 1e-10);
  }
}

RC_GTEST_PROP(Properties, WeightsArePositiveSumToOneAndForgetTheOrder, ()) {
  const auto penalties = *rc::gen::container<std::vector<int>>(rc::gen::inRange(0, 40));
  const int k = *rc::gen::inRange(1, 6);
  std::vector<Penalised> all;
  for (std::size_t i = 0; i < penalties.size(); ++i)
    all.push_back({0.05 * penalties[i], static_cast<std::uint32_t>(i)});
  std::vector<Penalised> reversed(all.rbegin(), all.rend());
  std::vector<Weighted> weights, again;
  lumigraphWeights(all, k, weights);
  lumigraphWeights(reversed, k, again);
  RC_ASSERT(weights.empty() == penalties.empty());
  RC_ASSERT(weights.size() == again.size());
  const auto by_source = [](const Weighted& a, const Weighted& b) { return a.source < b.source; };
  std::sort(weights.begin(), weights.end(), by_source);
  std::sort(again.begin(), again.end(), by_source);
  double sum = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    RC_ASSERT(weights[i].weight > 0);
    RC_ASSERT(weights[i].source == again[i].source && weights[i].weight == again[i].weight);
    sum += weights[i].weight;
  }
  RC_ASSERT(penalties.empty() || std::fabs(sum - 1) <= 1e-12);
}

// Damage: values of the tree replaced, then characters of the text.
std::string damaged(const std::string& text) {
  nlohmann::json tree = nlohmann::json::parse(text);
  static const std::vector<std::string> kOdd{
      "null",       "true",   "-1",       "1e300",  "\"\"",        "[]",
      "{}",         "0",      "[0,0,0]",  "[1]",    "\"\\u0000\"", "3.5",
      "9999999999", "1e-300", "\"####\"", "[null]", "\"L0\"",      "{\"keys\": [[0, 1], [0, 2]]}"};
  for (int i = *rc::gen::inRange(0, 3); i > 0; --i) {
    const nlohmann::json flat = tree.flatten();
    const int which = *rc::gen::inRange(0, static_cast<int>(flat.size()));
    auto it = flat.begin();
    std::advance(it, which);
    nlohmann::json::json_pointer place(it.key());
    for (int up = *rc::gen::inRange(0, 3); up > 0 && !place.empty(); --up) place = place.parent_pointer();
    if (place.empty()) continue;
    const auto value = nlohmann::json::parse(*rc::gen::elementOf(kOdd));
    if (*rc::gen::inRange(0, 4) == 0 && tree.at(place.parent_pointer()).is_object())
      tree.at(place.parent_pointer()).erase(place.back());
    else
      tree.at(place) = value;
    if (tree.flatten().empty()) break;
  }
  std::string out = tree.dump();
  for (int i = *rc::gen::inRange(-2, 4); i > 0 && !out.empty(); --i) {
    const auto at = static_cast<std::size_t>(*rc::gen::inRange(0, static_cast<int>(out.size())));
    switch (*rc::gen::inRange(0, 3)) {
      case 0:
        out[at] = static_cast<char>(*rc::gen::inRange(0, 256));
        break;
      case 1:
        out.erase(at, static_cast<std::size_t>(*rc::gen::inRange(1, 40)));
        break;
      default:
        out.insert(at, 1, "{}[],:\"-e9"[*rc::gen::inRange(0, 10)]);
    }
  }
  return out;
}

constexpr const char* kScene = R"({"srf": "x.srf", "frames": "0-4", "fps": 24, "output": "f.####.exr", "samples": 2,
  "camera": {"w": 24, "h": 20, "vfov": 40, "look_at": {"eye": {"keys": [[0, [0, -4, 0]], [4, [1, -4, 0]]]},
             "target": [0, 0, 0], "up": [0, 0, 1]}},
  "deformation": [{"type": "twist", "axis": [0, 0, 1], "degrees_per_unit": {"keys": [[0, 0], [9, 90]], "interpolation": "cubic"}},
    {"type": "bend", "axis": [0, 0, 1], "toward": [1, 0, 0], "degrees_per_unit": 20, "range": [-1, 1]},
    {"type": "wave", "axis": [0, 0, 1], "direction": [1, 0, 0], "amplitude": 0.1, "wavelength": 1, "phase": 30},
    {"type": "taper", "axis": [0, 0, 1], "per_unit": 0.2},
    {"type": "affine", "matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
    {"type": "ffd", "min": [-1, -1, -1], "max": [1, 1, 1], "resolution": [2, 2, 2], "points": [[-1, -1, -1], [1, -1, -1],
      [-1, 1, -1], [1, 1, -1], [-1, -1, 1], [1, -1, 1], [-1, 1, 1], [1, 1, 1]]}],
  "lights": [{"type": "directional", "direction": [0, -1, 1], "irradiance": [1, 1, 1]},
    {"type": "point", "position": [2, -2, 2], "intensity": [10, 10, 10]}, {"type": "captured", "light": "L0", "scale": 1}],
  "accuracy": {"views": 4, "lights": 4, "frame": "polar", "light_sharing": 2, "min_distance": 0.001}})";

constexpr const char* kCapture = R"({"camera_model": "OPENCV", "w": 4, "h": 4, "fl_x": 5, "fl_y": 5, "cx": 2, "cy": 2,
  "k1": 0.01, "k2": 0, "p1": 0, "p2": 0, "units": "m", "color_space": "lin_rec709", "aabb": [[-1, -1, -1], [1, 1, 1]],
  "lights": [{"name": "L0", "type": "directional", "direction": [0, 0, 1], "irradiance": [1, 1, 1]},
             {"name": "L1", "type": "point", "position": [0, 0, 2], "intensity": [4, 4, 4]}],
  "frames": [{"file_path": "a.exr", "view": "v0", "light": "L0", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]]},
             {"file_path": "b.exr", "view": "v0", "light": "L1", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]]}]})";

// Reading either works or throws srf::Error; what was read can be used.
template <class Use>
void expectNoCrash(const std::string& text, const char* name, const Use& use) {
  static const test::TemporaryFolder folder;
  // Without the flush to the disk of writeTextFile.
  for (const char* photo : {"a.exr", "b.exr"}) std::ofstream(folder / photo);
  std::ofstream(folder / name, std::ios::binary) << text;
  bool refused = false;
  try {
    use(folder / name);
  } catch (const Error& e) {
    refused = true;
    RC_ASSERT(std::string(e.what()).find_first_not_of(' ') != std::string::npos);
  }
  RC_CLASSIFY(refused, "refused");
}

RC_GTEST_PROP(Properties, ADamagedSceneIsReadOrRefused, ()) {
  const std::string text = damaged(kScene);
  RC_LOG() << text;
  expectNoCrash(text, "scene.json", [](const std::filesystem::path& file) {
    const Scene scene = readScene(file, {}, Reporter::silent());
    for (const int frame : {-1, 0, 3, 1000}) {
      scene.cameraAt(frame);
      scene.deformation.at(frame).map(Point<AcquisitionSpace>(0.1, 0.2, 0.3));
    }
  });
}

RC_GTEST_PROP(Properties, ADamagedCaptureIsReadOrRefused, ()) {
  const std::string text = damaged(kCapture);
  RC_LOG() << text;
  expectNoCrash(text, "transforms.json", [](const std::filesystem::path& file) {
    const Capture capture = readCapture(file);
    for (const auto& view : capture.views) view.camera.project(Point<AcquisitionSpace>(0, 0, 0));
  });
}

}  // namespace
}  // namespace srf
