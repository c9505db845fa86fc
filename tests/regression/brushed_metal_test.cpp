// A ball of brushed copper, deformed: what both frame modes show of it, against exact pictures under two rules for
// where the brush goes: by the mode itself (Eq. 10), and along the stretched tangent, as grooves in the metal would.
#include <gtest/gtest.h>

#include "acquire/synthetic_reference.h"
#include "base/numeric.h"
#include "render/frame_renderer.h"
#include "render/look_up.h"
#include "tests/support/formula_field.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

constexpr int kSize = 64;
constexpr SyntheticMaterial kCopper = SyntheticMaterial::conductor;

enum class Rule { bisector, polar, stretched };
const char* const kRuleNames[] = {"bisector", "polar", "stretched tangent"};

class RuledWarp final : public ReferenceWarp {
 public:
  RuledWarp(const Deformation& psi, Rule rule) : psi_(psi), rule_(rule) {}
  Point<ObjectSpace> map(const Point<AcquisitionSpace>& p0) const override { return psi_.map(p0); }
  Linear<ObjectSpace, AcquisitionSpace> jacobian(const Point<AcquisitionSpace>& p0) const override {
    return psi_.jacobian(p0);
  }
  Orthogonal<AcquisitionSpace, ObjectSpace> lookUp(const Linear<ObjectSpace, AcquisitionSpace>& jacobian,
                                                   const Direction<AcquisitionSpace>& n0) const override {
    SurfaceHit hit;
    // On the unit sphere a point is its normal; the material's tangent is that of the brush.
    const auto brushed = [&] { return shadingPointOf(kCopper, Point<AcquisitionSpace>(n0.raw()), n0).tangent; };
    hit.acquisition_from_tangent = rule_ == Rule::stretched ? restFrame(n0, brushed()) : restFrame(n0);
    const Vector<ObjectSpace> u = jacobian * (hit.acquisition_from_tangent * Vector<TangentSpace>(1, 0, 0)),
                              v = jacobian * (hit.acquisition_from_tangent * Vector<TangentSpace>(0, 1, 0));
    // Given u and what lies across it, either mode keeps to u.
    hit.tangents = {u, rule_ == Rule::stretched ? cross(cross(u, v), u) : v, 1};
    return srf::lookUp(hit, rule_ == Rule::polar ? FrameMode::polar : FrameMode::bisector).acquisition_from_object;
  }

 private:
  const Deformation& psi_;
  Rule rule_;
};

// Lights are directional and a colour each, three to a picture, so that every channel is a picture of its own.
struct Lighting {
  Vec3 eye;
  Vec3 lights[3];
};

ReferenceLights referenceLights(const Lighting& lit) {
  ReferenceLights lights;
  for (int c = 0; c < 3; ++c) {
    Vec3 colour;
    colour[c] = 1;
    lights.distant.push_back({*normalize(Vector<ObjectSpace>(lit.lights[c])), colour});
  }
  return lights;
}
FrameLights frameLights(const Lighting& lit) {
  FrameLights lights;
  for (const auto& light : referenceLights(lit).distant) lights.distant.push_back({light.direction, light.irradiance});
  return lights;
}

Camera<ObjectSpace> cameraOf(const Lighting& lit) {
  Camera<ObjectSpace> camera;
  camera.lens = pinholeFromFov(kSize, kSize, 44);
  camera.pose = *lookAt(Point<ObjectSpace>(lit.eye), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
  return camera;
}

// How far the brush, as the frame mode shows it, is turned from the stretched tangent, degrees about the normal; and
// the largest such angle.
struct BrushError {
  ImageF degrees{kSize, kSize, 1};
  double largest = 0;
};
BrushError brushError(const DeformedModel& deformed, const Deformation& psi, const Camera<ObjectSpace>& camera,
                      FrameMode mode) {
  BrushError error;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const Ray<ObjectSpace> ray = *camera.ray({x + 0.5, y + 0.5});
      SurfaceHit hit;
      deformed.intersect({&ray, 1}, {&hit, 1});
      if (hit.count == 0) continue;
      const Direction<AcquisitionSpace> n0 = *normalize(Vector<AcquisitionSpace>(hit.p0.raw()));
      const auto brush = shadingPointOf(kCopper, Point<AcquisitionSpace>(n0.raw()), n0).tangent;
      const LookUp look_up = lookUp(hit, mode);
      const auto back = look_up.acquisition_from_object.inverse();
      const Vec3 shown = (back * brush).raw(), normal = (back * look_up.normal).raw();
      const Vec3 carried = (psi.jacobian(hit.p0) * Vector<AcquisitionSpace>(brush)).raw();
      // A brush has no sign.
      const double turn = std::atan2(dot(cross(carried, shown), normal), dot(carried, shown));
      const double off = degrees(std::remainder(turn, kPi));
      error.degrees.at(x, y) = static_cast<float>(off);
      error.largest = std::max(error.largest, std::fabs(off));
    }
  return error;
}

TEST(BrushedMetal, DeformationCostsNothingByItsOwnRule) {
  const test::TemporaryFolder folder;
  test::FormulaFieldOptions options;
  options.views = 48;
  options.lights = 96;
  const auto field = test::makeSphereField(folder / "x.srf", options, [](const Vec3& p, const Vec3& l, const Vec3& v) {
    const auto n = Direction<AcquisitionSpace>::fromUnit(p);
    return std::max(0.0, dot(p, l)) * brdf(shadingPointOf(kCopper, Point<AcquisitionSpace>(p), n),
                                           Direction<AcquisitionSpace>::fromUnit(l),
                                           Direction<AcquisitionSpace>::fromUnit(v));
  });
  // Views and lights all around: in the mean, no pose is nearer to the captured directions than another.
  std::vector<Lighting> lit;
  const int pictures = test::sized(3, 16);
  for (int i = 0; i < pictures; ++i) {
    Lighting one{4 * test::fibonacci(i, pictures), {}};
    const Vec3 to_eye = one.eye / length(one.eye);
    for (int c = 0; c < 3; ++c) one.lights[c] = to_eye + 0.9 * test::fibonacci(3 * i + c, 3 * pictures);
    lit.push_back(one);
  }
  const SyntheticObject copper_ball(SyntheticShape::sphere, kCopper);
  const struct {
    const char *name, *list;
  } poses[] = {
      {"rest", ""},
      {"twisted", R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": 30})"},
      {"sheared", R"({"type": "affine", "matrix": [[1,0.5,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]})"},
      {"bent", R"({"type": "bend", "axis": [0,0,1], "toward": [1,0,0], "degrees_per_unit": 30})"},
  };
  ReferenceOptions exact;
  exact.shadows = ReferenceShadows::none;
  exact.supersampling = 3;
  FrameSettings settings;
  settings.samples = 4;
  settings.accuracy.light_sharing = 0;
  double at_rest = 0;
  std::printf("| pose | frame mode | PSNR by its own rule | by the stretched tangent | brush off it by at most |\n");
  for (const auto& pose : poses) {
    const Deformation psi =
        AnimatedDeformation::parse(parseJson("[" + std::string(pose.list) + "]", "test"), ".", Reporter::silent())
            .at(0);
    DeformedModel deformed(field.model);
    deformed.deform(psi);
    std::vector<ImageF> truth[3];
    for (const Rule rule : {Rule::bisector, Rule::polar, Rule::stretched})
      for (const Lighting& one : lit)
        truth[static_cast<int>(rule)].push_back(renderReference(copper_ball, RuledWarp(psi, rule), cameraOf(one),
                                                                referenceLights(one), exact, Reporter::silent()));
    ImageF shown;
    BrushError errors[2];
    for (const FrameMode mode : {FrameMode::bisector, FrameMode::polar}) {
      settings.accuracy.frame = mode;
      FrameRenderer renderer(field.folder, field.manifest, field.model, settings, Reporter::silent());
      double squares[2] = {}, count = 0, peak = 0;
      const int own = static_cast<int>(mode == FrameMode::polar ? Rule::polar : Rule::bisector);
      for (std::size_t i = 0; i < lit.size(); ++i) {
        const ImageF picture = renderer.render(cameraOf(lit[i]), deformed, frameLights(lit[i])).rgba;
        const ImageF* const against[2] = {&truth[own][i], &truth[static_cast<int>(Rule::stretched)][i]};
        for (int y = 0; y < kSize; ++y)
          for (int x = 0; x < kSize; ++x) {
            if (picture.at(x, y, 3) < 1 || against[0]->at(x, y, 3) < 1) continue;
            for (int c = 0; c < 3; ++c) {
              ++count;
              for (int r = 0; r < 2; ++r) squares[r] += square(picture.at(x, y, c) - against[r]->at(x, y, c));
              peak = std::max(peak, double{against[0]->at(x, y, c)});
            }
          }
        if (i == 0) shown = picture;
      }
      const auto psnr = [&](int r) { return -10 * std::log10(squares[r] / count); };
      BrushError& error = errors[static_cast<int>(mode)];
      error = brushError(deformed, psi, cameraOf(lit[0]), mode);
      std::printf("| %s | %s | %.1f dB | %.1f dB | %.1f degrees |   peak %.2f\n", pose.name, kRuleNames[own], psnr(0),
                  psnr(1), error.largest, peak);
      if (pose.list[0] == 0) {
        at_rest = psnr(0);
        EXPECT_LT(error.largest, 1);
        continue;
      }
      test::recordHardCase(44,
                           std::string("brushed ball ") + pose.name + ", " + kRuleNames[own] +
                               ": PSNR by its own rule below that of the ball at rest, dB",
                           at_rest - psnr(0), test::atMost(1));
    }
    if (pose.list[0] != 0)
      test::showHardCase(44, pose.name, shown, {{&errors[0].degrees, -20, 20}, {&errors[1].degrees, -20, 20}});
  }
}

}  // namespace
}  // namespace srf
