// A bowl, whose visual hull is a lid over it: points of the lid are on no surface, so that no reflectance model holds
// there. Guided interpolation must notice and do no worse than plain.
#include <gtest/gtest.h>

#include <algorithm>

#include "acquire/acquire_field.h"
#include "acquire/camera_import.h"
#include "acquire/synthetic_capture.h"
#include "acquire/synthetic_reference.h"
#include "apps/make_model.h"
#include "base/image_metrics.h"
#include "render/frame_renderer.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

class AtRest final : public ReferenceWarp {
 public:
  Point<ObjectSpace> map(const Point<AcquisitionSpace>& p0) const override { return Point<ObjectSpace>(p0.raw()); }
  Linear<ObjectSpace, AcquisitionSpace> jacobian(const Point<AcquisitionSpace>&) const override { return {}; }
  Orthogonal<AcquisitionSpace, ObjectSpace> lookUp(const Linear<ObjectSpace, AcquisitionSpace>&,
                                                   const Direction<AcquisitionSpace>&) const override {
    return {};
  }
};

// The colours of an image; or its coverage alone.
ImageF channels(const ImageF& rgba, int first, int count) {
  ImageF part(rgba.width(), rgba.height(), count);
  for (int y = 0; y < rgba.height(); ++y)
    for (int x = 0; x < rgba.width(); ++x)
      for (int c = 0; c < count; ++c) part.at(x, y, c) = rgba.at(x, y, first + c);
  return part;
}

TEST(ConcaveHull, GuidanceIsNoWorseThanPlainWhereTheHullFillsTheObject) {
  const test::TemporaryFolder folder;
  SyntheticCaptureOptions synthetic;
  synthetic.shape = SyntheticShape::bowl;
  synthetic.views = 48;
  synthetic.lights = 64;
  synthetic.size = 40;
  synthetic.supersampling = 2;
  writeSyntheticCapture(synthetic, folder / "bowl", Reporter::silent());
  AcquireOptions acquire;
  acquire.hull.resolution = 48;
  const SrfManifest acquired =
      acquireField(openCapture(folder / "bowl", Reporter::silent()), folder / "x.srf", acquire, Reporter::silent());
  makeModel(folder / "x.srf", "hull", {}, FitOptions(), Reporter::silent());
  const SrfManifest manifest = readManifest(folder / "x.srf");
  const DeformableModel model = loadModel(folder / "x.srf", manifest);
  const auto fit = loadFit(folder / "x.srf", manifest, model);
  ASSERT_TRUE(fit);
  const SyntheticObject object = readSyntheticObject(folder / "bowl");
  const DeformedModel at_rest(model);

  const auto nearest = [](const auto& all, const Vec3& to, const auto& direction) {
    return *std::max_element(all.begin(), all.end(), [&](const auto& a, const auto& b) {
      return dot(direction(a), to) < dot(direction(b), to);
    });
  };
  const auto unit = [](const Vec3& v) { return v / length(v); };
  double sum = 0;
  int cases = 0;
  for (const Vec3& eye : {Vec3{2.0, -3.6, 2.2}, Vec3{-3.1, -2.4, 1.5}, Vec3{0.5, 2.0, 3.0}})
    for (const Vec3& light : {Vec3{-0.3, -0.5, 0.8}, Vec3{0.8, -0.5, 0.2}})
      for (const bool captured_view : {false, true})
        for (const bool captured_light : {false, true}) {
          const auto centre = [&](const StoredView& view) { return unit(view.camera.center().raw()); };
          const StoredView near_view = nearest(manifest.views, unit(eye), centre);
          const double away = length(near_view.camera.center().raw());
          const Vec3 from = away * (captured_view ? centre(near_view) : unit(eye));
          const auto direction = [](const CaptureLight& l) { return l.direction.raw(); };
          const Vec3 to_light =
              captured_light ? direction(nearest(manifest.lights, unit(light), direction)) : unit(light);
          Camera<ObjectSpace> camera;
          camera.lens = pinholeFromFov(48, 48, 30);
          camera.pose = *lookAt(Point<ObjectSpace>(from), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
          FrameLights lights;
          lights.distant.push_back({Direction<ObjectSpace>::fromUnit(to_light), Vec3{3, 3, 3}});
          ReferenceLights same;
          same.distant.push_back({lights.distant[0].direction, lights.distant[0].irradiance});
          ReferenceOptions reference;
          reference.supersampling = 2;
          const ImageF truth = renderReference(object, AtRest(), camera, same, reference, Reporter::silent());
          const auto psnr = [&](const ReflectanceFit* guided_by) {
            FrameSettings settings;
            settings.fit = guided_by;
            settings.samples = 2;
            FrameRenderer renderer(folder / "x.srf", manifest, model, settings, Reporter::silent());
            const ImageF shown = renderer.render(camera, at_rest, lights).rgba;
            return compareImages(channels(shown, 0, 3), channels(truth, 0, 3), channels(truth, 3, 1)).inside.psnr;
          };
          const double plain = psnr(nullptr), gain = psnr(&*fit) - plain;
          std::printf("plain %.2f dB, guided %+.2f\n", plain, gain);
          // From a camera's own place plain interpolation is nearly right.
          EXPECT_GT(gain, captured_view ? -0.5 : -1) << "eye " << from.x << " " << from.y << " " << from.z << ", light "
                                                     << to_light.x << " " << to_light.y << " " << to_light.z;
          sum += gain, ++cases;
        }
  EXPECT_GE(sum / cases, 0);
}

// Beside shadow outlines, over the bowl's mouth, a lobe explains something at a fifth of the points, and of all
// together hardly anything: specks.
TEST(ConcaveHull, AMattBowlGetsNoHighlights) {
  const test::TemporaryFolder folder;
  SyntheticCaptureOptions synthetic;
  synthetic.shape = SyntheticShape::bowl, synthetic.material = SyntheticMaterial::white;
  synthetic.interreflection = true;
  synthetic.views = 16, synthetic.lights = 32, synthetic.size = 64;
  writeSyntheticCapture(synthetic, folder / "bowl", Reporter::silent());
  acquireField(openCapture(folder / "bowl", Reporter::silent()), folder / "x.srf", {}, Reporter::silent());
  makeModel(folder / "x.srf", "hull", {}, FitOptions(), Reporter::silent());
  const SrfManifest manifest = readManifest(folder / "x.srf");
  const auto fit = loadFit(folder / "x.srf", manifest, loadModel(folder / "x.srf", manifest));
  ASSERT_TRUE(fit);
  const auto glossy = std::count_if(fit->points.begin(), fit->points.end(), [](const FittedPoint& point) {
    const auto& lobe = point.reflectance.coefficient;
    return lobe[2] != std::array<float, 3>{} || lobe[3] != std::array<float, 3>{};
  });
  EXPECT_EQ(glossy, 0) << "of " << fit->points.size() << " points";
}

}  // namespace
}  // namespace srf
