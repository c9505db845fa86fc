// Surfels against triangles of the same object, in the picture.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "base/numeric.h"
#include "render/frame_renderer.h"
#include "tests/support/formula_field.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

/// A texture alone: the same under every light and from every side, with detail as fine as `wave` units.
test::ReflectanceFormula texture(double wave) {
  return [k = 2 * kPi / wave](const Vec3& p, const Vec3&, const Vec3&) {
    const double a = std::sin(k * p.x) * std::sin(k * p.y + 1), b = std::sin(k * p.z + 2);
    return Vec3{0.5 + 0.4 * a, 0.5 + 0.4 * b, 0.5 + 0.2 * (a + b)};
  };
}

class SurfelPictures : public ::testing::Test {
 protected:
  test::FormulaField field(double wave) const {
    test::FormulaFieldOptions options;
    options.lights = 8;
    options.size = 96;
    return test::makeSphereField(folder_ / "x.srf", options, texture(wave));
  }
  static DeformableModel surfelsOf(const test::FormulaField& field, std::size_t count) {
    ModelOptions options;
    options.kind = ModelKind::surfels;
    options.surfels = count;
    return buildModel(test::unitSphere(5), "sphere", 1e-6, field.manifest, options, Reporter::silent());
  }
  static Camera<ObjectSpace> camera(int size) {
    Camera<ObjectSpace> camera;
    camera.lens = pinholeFromFov(size, size, 26);
    camera.pose = *lookAt(Point<ObjectSpace>(0, -5, 0), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
    return camera;
  }
  static Deformation psi(const std::string& list) {
    return AnimatedDeformation::parse(parseJson("[" + list + "]", "test"), ".", Reporter::silent()).at(0);
  }
  static FrameLights lights() {
    FrameLights lights;
    for (int i = 0; i < 8; ++i)
      lights.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 8)), {0.125, 0.125, 0.125}});
    return lights;
  }

  test::TemporaryFolder folder_;
};

// The mean over pixels inside the object of the variance over the frames of a slow turn.
double flicker(const test::FormulaField& field, const DeformableModel& model, int samples,
               const Camera<ObjectSpace>& camera, const FrameLights& lights,
               const std::function<Deformation(int)>& psi) {
  FrameSettings settings;
  settings.samples = samples;
  FrameRenderer renderer(field.folder, field.manifest, model, settings, Reporter::silent());
  DeformedModel deformed(model);
  constexpr int kFrames = 32;
  const std::size_t values = static_cast<std::size_t>(camera.lens.width) * camera.lens.height * 4;
  std::vector<double> sum(values), squares(values);
  std::vector<char> inside(values, 1);
  for (int frame = 0; frame < kFrames; ++frame) {
    deformed.deform(psi(frame));
    const Frame picture = renderer.render(camera, deformed, lights);
    for (std::size_t i = 0; i < values; ++i) {
      const double value = picture.rgba.data()[i];
      sum[i] += value, squares[i] += value * value;
      inside[i] &= picture.rgba.data()[i / 4 * 4 + 3] == 1;
    }
  }
  double total = 0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < values; ++i) {
    if (!inside[i] || i % 4 == 3) continue;
    total += squares[i] / kFrames - sum[i] * sum[i] / kFrames / kFrames;
    ++count;
  }
  EXPECT_GT(count, 300u);
  return total / static_cast<double>(count);
}

TEST_F(SurfelPictures, SixteenSurfelsToAPixelFlickerNoMoreThanTrianglesOfSixteenSamples) {
  const test::FormulaField of = field(0.12);  // about a pixel
  const Camera<ObjectSpace> far = camera(20);
  const double footprint = far.pixelFootprint(4.3);
  const auto count = static_cast<std::size_t>(16 * 4 * kPi / square(footprint));
  const auto turn = [](int frame) {
    const double angle = radians(0.4 * frame);
    const std::string c = std::to_string(std::cos(angle)), s = std::to_string(std::sin(angle));
    return psi(R"({"type": "affine", "matrix": [[)" + c + ",-" + s + ",0,0],[" + s + "," + c +
               ",0,0],[0,0,1,0],[0,0,0,1]]}");
  };
  const double once = flicker(of, of.model, 1, far, lights(), turn);
  const double triangles = flicker(of, of.model, 16, far, lights(), turn);
  const double surfels = flicker(of, surfelsOf(of, count), 1, far, lights(), turn);
  std::printf("variance over a slow turn: triangles, 1 sample %.3g, 16 samples %.3g; %zu surfels %.3g\n", once,
              triangles, count, surfels);
  test::recordHardCase(45, "surfels 16 to a pixel over a slow turn: variance over that of triangles at 16 samples",
                       surfels / triangles, test::atMost(1));
  EXPECT_LT(triangles, 0.5 * once);  // the texture is one that aliases
}

// What doc/surfels.md says of the difference.
TEST_F(SurfelPictures, AgreeWithTrianglesAtRestAndTwisted) {
  const test::FormulaField of = field(0.6);
  const DeformableModel surfels = surfelsOf(of, 20000);
  FrameSettings settings;
  settings.samples = 4;
  for (const std::string& list :
       {std::string(), std::string(R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": 60})")}) {
    ImageF pictures[2];
    for (const DeformableModel* model : {&of.model, &surfels}) {
      DeformedModel deformed(*model);
      deformed.deform(psi(list));
      FrameRenderer renderer(of.folder, of.manifest, *model, settings, Reporter::silent());
      pictures[model == &surfels] = renderer.render(camera(96), deformed, lights()).rgba;
    }
    double squares = 0, most = 0, coverage = 0;
    std::size_t count = 0, edge = 0;
    for (int y = 0; y < 96; ++y)
      for (int x = 0; x < 96; ++x) {
        const double a = pictures[0].at(x, y, 3), b = pictures[1].at(x, y, 3);
        coverage = std::max(coverage, std::fabs(a - b));
        edge += a != b;
        if (a < 1 || b < 1) continue;
        for (int c = 0; c < 3; ++c) {
          const double difference = pictures[0].at(x, y, c) - pictures[1].at(x, y, c);
          squares += difference * difference, most = std::max(most, std::fabs(difference)), ++count;
        }
      }
    const double rms = std::sqrt(squares / static_cast<double>(count));
    std::printf("surfels against triangles: rms %.4f, most %.4f, %zu pixels of other coverage, by %.2f at most\n", rms,
                most, edge, coverage);
    EXPECT_GT(count, 3u * 3000);
    EXPECT_LE(rms, 0.002);
    EXPECT_LE(most, 0.03);
    EXPECT_LE(coverage, 0.5);
  }
}

}  // namespace
}  // namespace srf
