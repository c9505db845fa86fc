#include "render/frame_renderer.h"

#include <gtest/gtest.h>

#include <cmath>

#include "base/numeric.h"
#include "base/parallel.h"
#include "render/pixel_rays.h"
#include "render/screen_cover.h"
#include "tests/support/formula_field.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

/// A field whose reflectance changes with place, light and view.
Vec3 patterned(const Vec3& p, const Vec3& l, const Vec3& v) {
  return {0.3 + 0.2 * std::sin(5 * p.x) + 0.1 * l.z, 0.4 + 0.1 * p.y + 0.2 * std::max(0.0, dot(p, l)), 0.5 + 0.2 * v.x};
}

class FrameRendererTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<test::TemporaryFolder>();
    test::FormulaFieldOptions options;
    options.subdivision = 4;
    field_ = std::make_unique<test::FormulaField>(test::makeSphereField(*folder_ / "x.srf", options, patterned));
  }
  static void TearDownTestSuite() {
    field_.reset();
    folder_.reset();
  }
  static Camera<ObjectSpace> camera(int size = 40) {
    Camera<ObjectSpace> camera;
    camera.lens = pinholeFromFov(size, size, 36);
    camera.pose = *lookAt(Point<ObjectSpace>(0.5, -5, 1), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
    return camera;
  }
  static Deformation twist() {
    const char* text = R"([{"type":"twist","axis":[0,0,1],"degrees_per_unit":40}])";
    return AnimatedDeformation::parse(parseJson(text, "test"), ".", Reporter::silent()).at(0);
  }
  /// Many distant lights, a point light.
  static FrameLights lights() {
    FrameLights lights;
    for (int i = 0; i < 40; ++i)
      lights.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 40)), {0.1, 0.1, 0.2}});
    lights.near_lights.push_back({Point<ObjectSpace>(2, -3, 1), {3, 3, 3}});
    return lights;
  }
  static Frame render(const FrameSettings& settings, const Deformation& psi = twist(),
                      const FrameLights& lit = lights(), Reporter& reporter = Reporter::silent(),
                      const test::FormulaField& field = *field_) {
    DeformedModel deformed(field.model);
    deformed.deform(psi);
    FrameRenderer renderer(field.folder, field.manifest, field.model, settings, reporter);
    return renderer.render(camera(), deformed, lit);
  }

  static std::unique_ptr<test::TemporaryFolder> folder_;
  static std::unique_ptr<test::FormulaField> field_;
};
std::unique_ptr<test::TemporaryFolder> FrameRendererTest::folder_;
std::unique_ptr<test::FormulaField> FrameRendererTest::field_;

TEST_F(FrameRendererTest, NeitherThreadsNorMemoryChangeABit) {
  FrameSettings settings;
  settings.samples = 3;
  setThreadCount(1);
  const Frame want = render(settings);
  setThreadCount(3);
  test::recordHardCase(38, "a frame by 3 threads and by 1: 1 where a bit differs",
                       render(settings).rgba.data() != want.rgba.data(), test::atMost(0));
  settings.memory_bytes = 1 << 16;  // one block of texels, one block of pixels at a time
  test::recordHardCase(38, "a frame with 64 KiB of memory and with 1 GiB: 1 where a bit differs",
                       render(settings).rgba.data() != want.rgba.data(), test::atMost(0));
  setThreadCount(0);
}

TEST_F(FrameRendererTest, TheSecondFrameOfARendererEqualsTheFirst) {
  DeformedModel deformed(field_->model);
  deformed.deform(twist());
  FrameRenderer renderer(field_->folder, field_->manifest, field_->model, {}, Reporter::silent());
  const Frame first = renderer.render(camera(), deformed, lights());
  FrameLights others = lights();
  others.distant.pop_back();
  EXPECT_NE(renderer.render(camera(), deformed, others).rgba.data(), first.rgba.data());
  EXPECT_EQ(renderer.render(camera(), deformed, lights()).rgba.data(), first.rgba.data());
}

// No ray that meets the model may be left out, whatever the lens; and something must be left out.
TEST_F(FrameRendererTest, TheCoverHoldsEveryPixelThatShowsTheModel) {
  DeformedModel deformed(field_->model);
  deformed.deform(twist());
  std::vector<Camera<ObjectSpace>> cameras(5, camera(150));
  cameras[1].lens.model = CameraModel::opencv, cameras[1].lens.k1 = -0.2, cameras[1].lens.p1 = 0.01;
  cameras[2].lens.model = CameraModel::opencv_fisheye, cameras[2].lens.k1 = 0.05;
  cameras[3].lens.model = CameraModel::orthographic, cameras[3].lens.fl_x = cameras[3].lens.fl_y = 40;
  cameras[4].pose = *lookAt(Point<ObjectSpace>(0, -0.2, 0.1), Point<ObjectSpace>(0, 1, 0),
                            Vector<ObjectSpace>(0, 0, 1));  // from inside
  const std::vector<Vec2> pattern = samplePattern(4);
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    const ScreenCover cover(cameras[c], deformed);
    int left_out = 0, met = 0;
    for (int y = 0; y < 150; ++y)
      for (int x = 0; x < 150; ++x) {
        left_out += !cover.covers(x, y);
        PixelRays rays;
        rays.add(cameras[c], std::nullopt, pattern, x, y);
        std::vector<SurfaceHit> hits(rays.rays.size());
        deformed.intersect(rays.rays, hits);
        for (const SurfaceHit& hit : hits) {
          met += hit.count > 0;
          ASSERT_TRUE(hit.count == 0 || cover.covers(x, y)) << "camera " << c << ", pixel " << x << " " << y;
        }
      }
    EXPECT_GT(met, 1000);
    if (c < 4)
      EXPECT_GT(left_out, 3000) << "camera " << c;
    else
      EXPECT_EQ(left_out, 0);
  }
}

// Without layers operations are made before a hit's other views are known, with them afterwards.
TEST_F(FrameRendererTest, AskingForLayersChangesNoBitOfThePicture) {
  DeformedModel deformed(field_->model);
  deformed.deform(twist());
  const auto picture = [&](const std::set<std::string>& layers) {
    FrameSettings settings;
    settings.layers = layers;
    FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings, Reporter::silent());
    const ImageF rgba = renderer.render(camera(160), deformed, lights()).rgba;
    return std::vector<float>(rgba.data().begin(), rgba.data().end());
  };
  const std::vector<float> alone = picture({});
  EXPECT_GT(*std::max_element(alone.begin(), alone.end()), 0.1f);
  EXPECT_EQ(alone, picture({"P", "view"}));
}

class SparseShadingTest : public FrameRendererTest, public testing::WithParamInterface<Shading> {};
INSTANTIATE_TEST_SUITE_P(EveryKind, SparseShadingTest, testing::Values(Shading::sparse, Shading::sparser));

TEST_P(SparseShadingTest, TakesTheMeanOfNeighboursWhereTheSurfaceIsSmooth) {
  DeformedModel deformed(field_->model);
  deformed.deform(twist());
  const int size = GetParam() == Shading::sparse ? 160 : 320;  // shaded pixels lie as close on the object
  Reporter every_counted(ProgressMode::none, LogLevel::error), counted(ProgressMode::none, LogLevel::error);
  const auto picture = [&](const FrameSettings& settings, Reporter& reporter, const FrameEffects& effects = {}) {
    FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings, reporter);
    return renderer.render(camera(size), deformed, lights(), effects).rgba;
  };
  FrameSettings settings;
  const ImageF every = picture(settings, every_counted);
  settings.accuracy.shading = GetParam();
  setThreadCount(1);
  const ImageF got = picture(settings, counted);
  setThreadCount(3);
  settings.memory_bytes = 1 << 16;
  EXPECT_EQ(picture(settings, Reporter::silent()).data(), got.data()) << "by threads and memory";
  setThreadCount(0);
  int inside = 0, between = 0;
  double squares = 0;
  for (int y = 0; y < got.height(); ++y)
    for (int x = 0; x < got.width(); ++x) {
      ASSERT_EQ(got.at(x, y, 3), every.at(x, y, 3)) << "the outline, at " << x << " " << y;
      if (every.at(x, y, 3) == 0) continue;
      ++inside;
      bool same = true;
      for (int c = 0; c < 3; ++c) {
        same = same && got.at(x, y, c) == every.at(x, y, c);
        squares += square(got.at(x, y, c) - every.at(x, y, c));
      }
      if (same) continue;
      ++between;
      double least = 1;  // from the mean of some pairs on opposite sides
      for (int far = 1; far <= (GetParam() == Shading::sparse ? 1 : 2); ++far)
        for (const auto& pairs :
             {std::vector<std::array<int, 2>>{{1, 0}}, {{0, 1}}, {{1, 1}}, {{1, -1}}, {{1, 1}, {1, -1}}}) {
          double mean = 0;
          for (const auto& [dx, dy] : pairs)
            for (const int side : {-far, far})
              mean += got.at(x + side * dx, y + side * dy, 1) / (2.0 * static_cast<double>(pairs.size()));
          least = std::min(least, std::fabs(got.at(x, y, 1) - mean));
        }
      EXPECT_LT(least, 1e-6) << "at " << x << " " << y;
    }
  EXPECT_GT(between, (GetParam() == Shading::sparse ? 0.5 : 0.75) * inside);
  EXPECT_EQ(counted.counters()["hits"] + counted.counters()["pixels.between"], every_counted.counters()["hits"]);
  EXPECT_LT(squares / (3.0 * inside), 1e-4) << "40 dB of white";
  // With a ground, here one that is not seen, hits are divided after their blend: by distances in double.
  FrameEffects effects;
  effects.ground = GroundPlane{9};
  const ImageF with_ground = picture(settings, Reporter::silent(), effects);
  int others = 0;
  for (std::size_t i = 0; i < got.data().size(); i += 4) others += with_ground.data()[i + 1] != got.data()[i + 1];
  EXPECT_LT(others, inside / 1000);
  FrameSettings plain;
  plain.samples = settings.samples = 4;
  EXPECT_EQ(render(settings).rgba.data(), render(plain).rgba.data()) << "of several samples a pixel all are shaded";
}

TEST_F(FrameRendererTest, SharedLightWeightsStayNearTheExactOnes) {
  FrameSettings settings;
  settings.accuracy.light_sharing = 0;
  const Frame exact = render(settings);
  settings.accuracy.light_sharing = 1;
  const Frame shared = render(settings);
  double sum = 0;
  int count = 0;
  for (std::size_t i = 0; i < exact.rgba.data().size(); ++i) {
    if (!(exact.rgba.data()[i] > 0)) continue;
    sum += std::fabs(shared.rgba.data()[i] / exact.rgba.data()[i] - 1);
    ++count;
  }
  EXPECT_GT(sum, 0) << "nothing was shared";
  EXPECT_LT(sum / count, 0.003);
}

TEST_F(FrameRendererTest, LayersShowTheLookUp) {
  FrameSettings settings;
  for (const std::string& layer : knownLayers()) settings.layers.insert(layer);
  const Frame frame = render(settings);
  const auto at = [&](const std::string& channel, int x, int y) { return frame.layers.at(channel).at(x, y); };
  int inside = 0;
  for (int y = 0; y < 40; ++y)
    for (int x = 0; x < 40; ++x) {
      if (frame.rgba.at(x, y, 3) == 0) {
        EXPECT_EQ(at("view.0", x, y), -1);
        continue;
      }
      ++inside;
      // The sphere's normal is p0; L takes N there, and the direction to the camera to V.
      const Vec3 p0{at("P0.X", x, y), at("P0.Y", x, y), at("P0.Z", x, y)},
          p{at("P.X", x, y), at("P.Y", x, y), at("P.Z", x, y)};
      const Vec3 n{at("N.X", x, y), at("N.Y", x, y), at("N.Z", x, y)},
          v{at("V.X", x, y), at("V.Y", x, y), at("V.Z", x, y)};
      const Mat3 l = rotationFromQuaternion({at("L.W", x, y), at("L.X", x, y), at("L.Y", x, y), at("L.Z", x, y)});
      const Vec3 to_eye = Vec3{0.5, -5, 1} - p;
      EXPECT_GE(at("L.W", x, y), 0);
      EXPECT_EQ(at("handedness", x, y), 1);
      EXPECT_LT(length(l * n - p0 / length(p0)), 0.02);  // the mesh's normals are blended
      EXPECT_LT(length(l * (to_eye / length(to_eye)) - v), 1e-5);
      EXPECT_NEAR(at("Z", x, y), length(to_eye), 1e-5);
      double weights = 0;
      for (int i = 0; i < 4; ++i) weights += at("view.weight." + std::to_string(i), x, y);
      EXPECT_NEAR(weights, 1, 1e-6);
      double nearest = 180;  // of all acquired views, as formats.md has it
      for (const StoredView& acquired : field_->manifest.views)
        nearest = std::min(
            nearest, degrees(angleBetweenUnit(v, acquired.camera.viewDirection(Point<AcquisitionSpace>(p0)).raw())));
      EXPECT_NEAR(at("confidence", x, y), nearest, 0.01);
    }
  EXPECT_GT(inside, 300);
  EXPECT_TRUE(render({}).layers.empty());
}

TEST_F(FrameRendererTest, LayersShowTheSampleNearestToThePixelsMiddle) {
  const auto nearest = [](int samples) {
    const Vec2 first = samplePattern(samples)[0];
    return std::hypot(first.x - 0.5, first.y - 0.5);
  };
  EXPECT_NEAR(nearest(9), 0, 1e-15);
  EXPECT_NEAR(nearest(4), std::sqrt(0.125), 1e-15);  // all four lie there
  EXPECT_NEAR(nearest(16), std::sqrt(1 / 32.0), 1e-15);
  for (const int samples : {2, 3, 5, 6, 7, 8, 10, 12, 20})
    for (const Vec2& at : samplePattern(samples))
      EXPECT_LE(nearest(samples), std::hypot(at.x - 0.5, at.y - 0.5)) << samples;
  FrameSettings settings;
  settings.layers = {"P"};
  const Frame one = render(settings);
  settings.samples = 9;
  const Frame nine = render(settings);
  int inside = 0;
  for (int y = 0; y < 40; ++y)
    for (int x = 0; x < 40; ++x) {
      if (!(one.rgba.at(x, y, 3) > 0)) continue;
      ++inside;
      for (const char* channel : {"P.X", "P.Y", "P.Z"})
        EXPECT_EQ(nine.layers.at(channel).at(x, y), one.layers.at(channel).at(x, y));
    }
  EXPECT_GT(inside, 300);
}

/// Leaves points where they are and carries every tangent onto one line.
class FlatteningJacobian final : public SpaceMap {
 public:
  Vec3 map(const Vec3& p) const override { return p; }
  Mat3 jacobian(const Vec3&) const override { return {{Vec3{1, 1, 1}, Vec3{0, 0, 0}, Vec3{0, 0, 0}}}; }
  double lengthScale() const override { return 1; }
};

TEST_F(FrameRendererTest, LayersShowStretchShearMirroringAndCollapse) {
  FrameSettings settings;
  settings.layers = {"stretch", "shear", "handedness", "fallback", "overlap"};
  DeformedModel deformed(field_->model);
  FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings, Reporter::silent());
  // Seen from -y: the normal in the middle is -y there, its tangent plane that of x and z.
  Camera<ObjectSpace> from_front = camera();
  from_front.pose = *lookAt(Point<ObjectSpace>(0, -5, 0), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1));
  const auto middle = [&](const Deformation& psi) {
    deformed.deform(psi);
    const Frame frame = renderer.render(from_front, deformed, lights());
    std::map<std::string, float> values;
    for (const auto& [name, image] : frame.layers) values[name] = image.at(20, 20);
    return values;
  };
  const auto affine = [](const std::string& rows) {
    const std::string list = R"([{"type": "affine", "matrix": [)" + rows + ", [0, 0, 0, 1]]}]";
    return AnimatedDeformation::parse(parseJson(list, "test"), ".", Reporter::silent()).at(0);
  };
  auto at = middle(affine("[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.5, 0]"));
  EXPECT_NEAR(at["stretch.max"], 2, 0.01);
  EXPECT_NEAR(at["stretch.min"], 0.5, 0.01);
  EXPECT_EQ(at["handedness"], 1);
  EXPECT_EQ(at["fallback"], 0);
  EXPECT_EQ(at["overlap"], 1);
  // A shear of 1 has the singular values sqrt(5/4) +- 1/2; it skews a pair of tangents by up to asin(2 / sqrt(5)).
  at = middle(affine("[-1, 0, 1, 0], [0, 1, 0, 0], [0, 0, 1, 0]"));
  EXPECT_NEAR(at["stretch.max"], std::sqrt(1.25) + 0.5, 0.02);
  EXPECT_NEAR(at["stretch.min"], std::sqrt(1.25) - 0.5, 0.02);
  EXPECT_EQ(at["handedness"], -1);
  EXPECT_GT(std::fabs(at["shear"]), 1);
  EXPECT_LT(std::fabs(at["shear"]), degrees(std::asin(2 / std::sqrt(5.0))) + 1);
  at = middle(Deformation({std::make_shared<FlatteningJacobian>()}));
  EXPECT_EQ(at["fallback"], 1);
  EXPECT_EQ(at["stretch.min"], 0);
}

TEST_F(FrameRendererTest, AnExplainedPixelIsTheRenderedOneToTheBit) {
  for (const int samples : {1, 3})
    for (const double sharing : {0.0, 2.0}) {
      FrameSettings settings;
      settings.samples = samples;
      settings.accuracy.light_sharing = sharing;
      DeformedModel deformed(field_->model);
      deformed.deform(twist());
      FrameRenderer renderer(field_->folder, field_->manifest, field_->model, settings, Reporter::silent());
      const Frame frame = renderer.render(camera(), deformed, lights());
      int explained = 0;
      for (int y = 0; y < 40; y += 3)
        for (int x = 0; x < 40; x += 3) {
          const PixelExplanation why = renderer.explain(camera(), deformed, lights(), x, y);
          for (int c = 0; c < 4; ++c) ASSERT_EQ(why.rgba[c], frame.rgba.at(x, y, c)) << x << " " << y;
          for (const ExplainedHit& hit : why.hits) {
            ++explained;
            // The parts printed are the whole: texels times light weights, again from the store.
            Vec3 sum;
            double views = 0;
            for (const Rgb& part : hit.results) sum += Vec3{part[0], part[1], part[2]};
            for (const ChosenView& chosen : hit.chosen) views += chosen.weight;
            EXPECT_NEAR(length(sum - Vec3{hit.color[0], hit.color[1], hit.color[2]}), 0, 1e-12);
            EXPECT_NEAR(views, 1, 1e-12);
            Vec3 texels;
            for (const ExplainedTexel& texel : hit.texels)
              texels += double{texel.tap} * Vec3{texel.relit[0], texel.relit[1], texel.relit[2]};
            EXPECT_NEAR(length(texels - sum), 0, 1e-5 * length(sum));
            // The lights taken one by one, exactly, add up to the merged weights where nothing is shared.
            ASSERT_EQ(hit.lights.size(), lights().distant.size() + lights().near_lights.size());
            std::map<std::uint32_t, double> alone;
            for (const ExplainedLight& light : hit.lights)
              for (const LightEntry& entry : light.entries) alone[entry.light] += entry.weight[1];
            if (sharing > 0) continue;
            for (const LightEntry& entry : why.merged[hit.operations.front().lights])
              EXPECT_NEAR(entry.weight[1], alone[entry.light], 1e-5);
            EXPECT_EQ(why.merged[hit.operations.front().lights].size(), alone.size());
          }
        }
      EXPECT_GT(explained, 50);
    }
}

TEST_F(FrameRendererTest, ACapturedViewUnderACapturedLightIsReproduced) {
  const StoredView& view = field_->manifest.views[3];
  const Camera<ObjectSpace> same = atRest(view.camera);
  FrameLights lit;
  lit.distant.push_back({Direction<ObjectSpace>::fromUnit(field_->manifest.lights[10].direction.raw()), {1, 1, 1}});
  DeformedModel deformed(field_->model);
  FrameRenderer renderer(field_->folder, field_->manifest, field_->model, {}, Reporter::silent());
  const Frame frame = renderer.render(same, deformed, lit);
  double sum = 0;
  int count = 0;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) {
      const auto ray = view.camera.ray({x + 0.5, y + 0.5});
      const Vec3 o = ray->origin.raw(), d = ray->direction.raw();
      const double b = dot(o, d), root = b * b - (dot(o, o) - 1);
      if (root <= 0.05 || frame.rgba.at(x, y, 3) == 0) continue;  // the mesh is a little smaller than the sphere
      const Vec3 p = o + (-b - std::sqrt(root)) * d;
      const Vec3 want = patterned(p, field_->manifest.lights[10].direction.raw(), -d);
      for (int c = 0; c < 3; ++c) sum += square(frame.rgba.at(x, y, c) - want[c]);
      ++count;
    }
  EXPECT_GT(count, 800);
  EXPECT_GT(-10 * std::log10(sum / (3 * count)), 55);
}

TEST_F(FrameRendererTest, HitsThatNoViewSeesAreCountedAndKeepTheirAlpha) {
  test::FormulaField blind = *field_;
  blind.model.visible = VisibilityBits(blind.model.size(), blind.manifest.views.size());
  Reporter reporter(ProgressMode::none, LogLevel::error);
  const Frame stand_in = render({}, {}, lights(), reporter, blind);
  EXPECT_EQ(reporter.counters()["hits.no_visible_view"], reporter.counters()["hits"]);
  EXPECT_GT(stand_in.rgba.at(20, 20, 0), 0);
  // A captured light that no view holds leaves no picture at all.
  FrameLights unknown;
  blind.manifest.lights.push_back(blind.manifest.lights[0]);
  unknown.rest.push_back({LightId{static_cast<std::uint32_t>(blind.manifest.lights.size() - 1)}, 1});
  const Frame black = render({}, {}, unknown, reporter, blind);
  EXPECT_GT(reporter.counters()["hits.no_view"], 0u);
  EXPECT_EQ(black.rgba.at(20, 20, 0), 0);
  EXPECT_EQ(black.rgba.at(20, 20, 3), 1);
}

TEST_F(FrameRendererTest, AlphaIsTheShareOfSamplesThatHit) {
  for (const int samples : {1, 4, 5, 9}) {
    FrameSettings settings;
    settings.samples = samples;
    const Frame frame = render(settings);
    bool partial = false;
    for (int i = 0; i < 40 * 40; ++i) {
      const float alpha = frame.rgba.data()[4 * i + 3];
      EXPECT_NEAR(alpha * samples, std::round(alpha * samples), 1e-5);
      partial = partial || (alpha > 0 && alpha < 1);
    }
    EXPECT_EQ(partial, samples > 1);
  }
}

TEST_F(FrameRendererTest, ADistantLightsStrengthScalesThePictureEvenFarBeyondTheUsual) {
  const Frame one = render({});
  for (const double scale : {1e-20, 1e20}) {
    FrameLights scaled = lights();
    for (auto& light : scaled.distant) light.irradiance *= scale;
    for (auto& light : scaled.near_lights) light.intensity *= scale;
    const Frame frame = render({}, twist(), scaled);
    for (int i = 0; i < 40 * 40; ++i)
      for (int c = 0; c < 3; ++c) {
        const double want = one.rgba.data()[4 * i + c] * scale;
        EXPECT_NEAR(frame.rgba.data()[4 * i + c], want, 2e-6 * want);
      }
  }
}

}  // namespace
}  // namespace srf
