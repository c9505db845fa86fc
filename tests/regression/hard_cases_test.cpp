// Rows of the hard-case list that need a whole picture, or that no other test is the place for. Each test names its row
// where it records what it measured; doc/hard_cases.md is made of these records.
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <clocale>
#include <cstdlib>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "field/capture_file.h"
#include "render/frame_renderer.h"
#include "tests/support/formula_field.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using test::atMost;
using test::Largest;
using test::recordHardCase;

/// Not symmetric in anything: a mirrored or turned picture differs from the right one everywhere.
Vec3 patterned(const Vec3& p, const Vec3& l, const Vec3& v) {
  const Vec3 h = (l + v) / std::max(length(l + v), 1e-9);
  const double cosine = std::max(0.0, dot(p, l));
  return cosine * (Vec3{0.3 + 0.2 * std::sin(4 * p.x + p.z), 0.3 + 0.2 * p.y, 0.2 + 0.1 * std::cos(3 * p.z)} +
                   0.3 * std::pow(std::max(0.0, dot(p, h)), 12) * Vec3{1, 1, 1});
}

Deformation psiOf(const std::string& list) {
  return AnimatedDeformation::parse(parseJson("[" + list + "]", "test"), ".", Reporter::silent()).at(0);
}

Camera<ObjectSpace> cameraFrom(const Vec3& eye, const Vec3& target = {}, int size = 48) {
  Camera<ObjectSpace> camera;
  camera.lens = pinholeFromFov(size, size, 36);
  camera.pose = *lookAt(Point<ObjectSpace>(eye), Point<ObjectSpace>(target), Vector<ObjectSpace>(0, 0, 1));
  return camera;
}

class HardCases : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<test::TemporaryFolder>();
    test::FormulaFieldOptions options;
    options.subdivision = 4;
    options.lights = 48;
    field_ = std::make_unique<test::FormulaField>(test::makeSphereField(*folder_ / "x.srf", options, patterned));
  }
  static void TearDownTestSuite() {
    field_.reset();
    folder_.reset();
  }
  static FrameLights lights() {
    FrameLights lights;
    lights.distant = {{*normalize(Vector<ObjectSpace>(1, -2, 1.5)), {1, 1, 1}},
                      {*normalize(Vector<ObjectSpace>(-2, -1, 0.3)), {0.5, 0.6, 0.7}}};
    lights.near_lights = {{Point<ObjectSpace>(0.5, -3, -1), {4, 3, 2}}};
    return lights;
  }
  static Frame render(const test::FormulaField& field, const Deformation& psi, const Camera<ObjectSpace>& camera,
                      const FrameLights& lit, const FrameSettings& settings = {},
                      Reporter& reporter = Reporter::silent()) {
    DeformedModel deformed(field.model);
    deformed.deform(psi);
    FrameRenderer renderer(field.folder, field.manifest, field.model, settings, reporter);
    return renderer.render(camera, deformed, lit);
  }
  /// The field again with surfels in place of triangles.
  static test::FormulaField surfelField() {
    test::FormulaField field = *field_;
    ModelOptions options;
    options.kind = ModelKind::surfels;
    options.surfels = 6000;
    field.model = buildModel(test::unitSphere(4), "sphere", 1e-6, field.manifest, options, Reporter::silent());
    return field;
  }

  static std::unique_ptr<test::TemporaryFolder> folder_;
  static std::unique_ptr<test::FormulaField> field_;
};
std::unique_ptr<test::TemporaryFolder> HardCases::folder_;
std::unique_ptr<test::FormulaField> HardCases::field_;

struct Difference {
  double largest = 0;  ///< relative to the pixel, or to 0.05 where that is darker
  int inside = 0;      ///< pixels that both cover
  double share = 0;    ///< of the pixels of either that only one covers or that differ by more than 1e-4
};
/// `same(x, y)`: the pixel of b that pixel (x, y) of a is compared with.
template <class Same>
Difference differenceOf(const Frame& a, const Frame& b, const Same& same) {
  Difference d;
  int either = 0, unlike = 0;
  Largest largest;
  for (int y = 0; y < a.rgba.height(); ++y)
    for (int x = 0; x < a.rgba.width(); ++x) {
      const auto [bx, by] = same(x, y);
      const bool in_a = a.rgba.at(x, y, 3) > 0, in_b = b.rgba.at(bx, by, 3) > 0;
      if (!in_a && !in_b) continue;
      ++either;
      if (in_a != in_b) {
        ++unlike;
        continue;
      }
      ++d.inside;
      double off = 0;
      for (int c = 0; c < 3; ++c) {
        const double want = a.rgba.at(x, y, c), got = b.rgba.at(bx, by, c);
        off = std::max(off, std::fabs(want - got) / std::max(want, 0.05));
      }
      largest.add(off);
      unlike += !(off <= 1e-4);
    }
  d.largest = largest.value;
  d.share = static_cast<double>(unlike) / std::max(1, either);
  return d;
}
Difference differenceOf(const Frame& a, const Frame& b) {
  return differenceOf(a, b, [](int x, int y) { return std::pair{x, y}; });
}

TEST_F(HardCases, DeformationsThatDoNothingLeaveThePicture) {
  const auto camera = cameraFrom({1, -5, 2});
  const Frame rest = render(*field_, {}, camera, lights());
  Largest off;
  for (const char* list :
       {R"({"type": "affine", "matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]})",
        R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": 0})",
        R"({"type": "taper", "axis": [0,0,1], "per_unit": 0})",
        R"({"type": "bend", "axis": [0,0,1], "toward": [1,0,0], "degrees_per_unit": 0})",
        R"({"type": "wave", "axis": [0,0,1], "direction": [1,0,0], "amplitude": 0, "wavelength": 1})"}) {
    const Difference d = differenceOf(rest, render(*field_, psiOf(list), camera, lights()));
    EXPECT_GT(d.inside, 300);
    off.add(d.share > 0 ? 1 : d.largest);
  }
  recordHardCase(1, "every kind of deformation with nothing to do: pixels differ by, relative", off.value,
                 atMost(1e-6));
}

TEST_F(HardCases, AMovedObjectEqualsTheRestUnderTheInverseSurroundings) {
  // The object alone is turned, under a sky; the same as camera and sky turned back about it.
  ImageF sky(32, 16, 3);
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 32; ++x)
      for (int c = 0; c < 3; ++c)
        sky.at(x, y, c) = static_cast<float>(0.3 + 0.2 * c + (x > 20 && y < 6 ? 5 : 0) + 0.02 * y);
  FrameLights lit;
  lit.distant = sampleEnvironment(sky, 64).lights;
  const Mat3 turn = rotationAbout({0, 0, 1}, radians(75)), back = turn.transposed();
  FrameLights turned_back = lit;
  for (DistantLight& light : turned_back.distant)
    light.direction = Direction<ObjectSpace>::fromUnit(back * light.direction.raw());
  const Vec3 eye{1, -5, 2};
  char matrix[300];
  std::snprintf(matrix, sizeof matrix,
                R"({"type": "affine", "matrix": [[%.17g,%.17g,0,0],[%.17g,%.17g,0,0],[0,0,1,0],[0,0,0,1]]})",
                turn.row[0].x, turn.row[0].y, turn.row[1].x, turn.row[1].y);
  const Frame moved = render(*field_, psiOf(matrix), cameraFrom(eye), lit);
  const Difference d = differenceOf(render(*field_, {}, cameraFrom(back * eye), turned_back), moved);
  EXPECT_GT(d.inside, 300);
  // Rays through edges may take either triangle.
  recordHardCase(3, "object turned under a sky against the sky turned back: share of pixels that differ by over 1e-4",
                 d.share, atMost(0.005));
}

TEST_F(HardCases, AMirroredSceneShowsTheMirroredPicture) {
  FrameLights mirrored = lights();
  const auto flip = [](const Vec3& a) { return Vec3{-a.x, a.y, a.z}; };
  for (DistantLight& light : mirrored.distant)
    light.direction = Direction<ObjectSpace>::fromUnit(flip(light.direction.raw()));
  for (NearLight& light : mirrored.near_lights) light.position = Point<ObjectSpace>(flip(light.position.raw()));
  const Vec3 eye{1, -5, 2};
  const char* mirror = R"({"type": "affine", "matrix": [[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]})";
  for (const bool polar : {false, true}) {
    FrameSettings settings;
    settings.accuracy.frame = polar ? FrameMode::polar : FrameMode::bisector;
    settings.accuracy.light_sharing = 0;
    const Frame rest = render(*field_, {}, cameraFrom(eye), lights(), settings);
    const Frame image = render(*field_, psiOf(mirror), cameraFrom(flip(eye)), mirrored, settings);
    const Difference d = differenceOf(rest, image, [](int x, int y) { return std::pair{47 - x, y}; });
    EXPECT_GT(d.inside, 300);
    recordHardCase(5,
                   std::string("object, camera and lights mirrored, ") + (polar ? "polar" : "bisector") +
                       ": share of pixels unlike the mirrored picture by over 1e-4",
                   d.share, atMost(0.005));
    EXPECT_GT(differenceOf(rest, image).share, 0.5) << "the picture is its own mirror image";
  }
}

/// Mirrors the half x < 0 at the plane x = -1.5, so that it lies beside the other; cuts out what lies between.
class HalfMirror final : public SpaceMap {
 public:
  Vec3 map(const Vec3& p) const override {
    if (std::fabs(p.x) < 0.1) return {std::nan(""), 0, 0};
    return p.x < 0 ? Vec3{-3 - p.x, p.y, p.z} : p;
  }
  Mat3 jacobian(const Vec3& p) const override {
    return p.x < 0 ? Mat3{{Vec3{-1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}} : Mat3{};
  }
  double lengthScale() const override { return 1; }
};

TEST_F(HardCases, HalfAnObjectMayBeMirrored) {
  for (const bool surfels : {false, true}) {
    const test::FormulaField field = surfels ? surfelField() : *field_;
    DeformedModel deformed(field.model);
    deformed.deform(Deformation({std::make_shared<HalfMirror>()}));
    std::size_t left = 0;
    for (const auto& p : field.model.p0) left += p.raw().x <= -0.1;
    EXPECT_EQ(deformed.statistics().mirrored, left);
    Largest off;
    int inside_out = 0, mirrored = 0, whole = 0;
    for (const Vec3& eye : {Vec3{6, -3, 1}, Vec3{-1.5, -9, 2}}) {
      const auto camera = cameraFrom(eye, {-1.5, 0, 0}, 96);
      std::vector<Ray<ObjectSpace>> rays;
      for (int y = 0; y < 96; ++y)
        for (int x = 0; x < 96; ++x) rays.push_back(*camera.ray({x + 0.5, y + 0.5}));
      std::vector<SurfaceHit> hits(rays.size());
      deformed.intersect(rays, hits);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        if (hits[i].count == 0) continue;
        const bool is_left = field.model.p0[hits[i].point[0]].raw().x < 0;
        const LookUp look_up = lookUp(hits[i], FrameMode::bisector);
        const Vec3 first = is_left ? Vec3{-1, 0, 0} : Vec3{1, 0, 0};
        off.add(length(look_up.acquisition_from_object.raw().row[0] - first));
        (is_left ? mirrored : whole) += 1;
        const Vec3 n = (look_up.acquisition_from_object.inverse() * look_up.normal).raw();
        const Vec3 outward = is_left ? hits[i].p_star.raw() - Vec3{-3, 0, 0} : hits[i].p_star.raw();
        inside_out += dot(n, outward) <= 0;
      }
    }
    EXPECT_GT(mirrored, 300);
    EXPECT_GT(whole, 300);
    const std::string kind = surfels ? "surfels" : "triangles";
    recordHardCase(5, "half an object mirrored, " + kind + ": L off the mirror or the identity by", off.value,
                   atMost(1e-12));
    recordHardCase(5, "half an object mirrored, " + kind + ": hits whose normal points inwards", inside_out, atMost(0));
    const Frame frame = render(field, Deformation({std::make_shared<HalfMirror>()}),
                               cameraFrom({-1.5, -9, 2}, {-1.5, 0, 0}, 96), lights());
    double bad = 0;
    for (const float value : frame.rgba.data()) bad += !std::isfinite(value) || value < 0;
    recordHardCase(5, "half an object mirrored, " + kind + ": values that are negative, NaN or infinite", bad,
                   atMost(0));
  }
}

/// Carries points on and all tangents onto one line, or onto nothing.
class Collapse final : public SpaceMap {
 public:
  explicit Collapse(double size) : size_(size) {}
  Vec3 map(const Vec3& p) const override { return p; }
  Mat3 jacobian(const Vec3& p) const override {
    return p.x < 0 ? Mat3{} : Mat3{{size_ * Vec3{1, 1, 1}, Vec3{}, Vec3{}}};
  }
  double lengthScale() const override { return 1; }

 private:
  double size_;
};

TEST_F(HardCases, CollapsedTangentsLeaveAPictureWithoutHolesOrNaN) {
  for (const double size : {1.0, 0.0}) {
    Reporter reporter(ProgressMode::none, LogLevel::error);
    const auto camera = cameraFrom({0, -5, 1});
    FrameSettings settings;
    settings.layers = {"fallback"};
    const Frame frame =
        render(*field_, Deformation({std::make_shared<Collapse>(size)}), camera, lights(), settings, reporter);
    const Frame rest = render(*field_, {}, camera, lights());
    double bad = 0, holes = 0, drawn = 0;
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 48; ++x) {
        for (int c = 0; c < 4; ++c) bad += !std::isfinite(frame.rgba.at(x, y, c));
        holes += frame.rgba.at(x, y, 3) != rest.rgba.at(x, y, 3);
        drawn += frame.layers.at("fallback").at(x, y);
      }
    const std::string what = size > 0 ? "tangents of half the object on one line" : "tangents of half the object zero";
    recordHardCase(8, what + ": values that are NaN or infinite, and holes", bad + holes, atMost(0));
    recordHardCase(8, what + ": fallback frames that are not both counted and drawn",
                   std::fabs(drawn - static_cast<double>(reporter.counters()["frame.collapsed"])), atMost(0));
    EXPECT_GT(drawn, 100);
  }
}

TEST_F(HardCases, SurfelsStretchedToNeedlesStayFinite) {
  const test::FormulaField field = surfelField();
  for (const char* matrix : {"[1e4,0,0,0],[0,1,0,0],[0,0,1e-4,0]", "[1e8,0,0,0],[0,1e8,0,0],[0,0,1,0]"}) {
    DeformedModel deformed(field.model);
    deformed.deform(psiOf(R"({"type": "affine", "matrix": [)" + std::string(matrix) + ",[0,0,0,1]]}"));
    const auto bounds = deformed.bounds();
    double bad = !isFinite(bounds.min) || !isFinite(bounds.max);
    const double size = bounds.diameter();
    const Frame frame = render(field, psiOf(R"({"type": "affine", "matrix": [)" + std::string(matrix) + ",[0,0,0,1]]}"),
                               cameraFrom({0.1 * size, -2 * size, size}), lights());
    for (const float value : frame.rgba.data()) bad += !std::isfinite(value);
    recordHardCase(10, "surfels stretched 1e8 : 1: values that are NaN or infinite", bad, atMost(0));
  }
}

// The same picture wherever and however large the capture and the scene are (rows 4, 11).
TEST_F(HardCases, PlaceAndSizeDoNotChangeThePicture) {
  const char* twist = R"({"type": "twist", "origin": ORIGIN, "axis": [0,0,1], "degrees_per_unit": AMOUNT})";
  const auto twistAt = [&](const Vec3& origin, double size) {
    char text[200];
    std::string list = twist;
    std::snprintf(text, sizeof text, "[%.17g,%.17g,%.17g]", origin.x, origin.y, origin.z);
    list.replace(list.find("ORIGIN"), 6, text);
    std::snprintf(text, sizeof text, "%.17g", 40 / size);
    list.replace(list.find("AMOUNT"), 6, text);
    return psiOf(list);
  };
  FrameSettings settings;
  settings.accuracy.light_sharing = 0;
  const Vec3 eye{1, -5, 2};
  FrameLights near_only = lights();
  const auto litAt = [&](const Vec3& offset, double size) {
    FrameLights lit = lights();
    for (NearLight& light : lit.near_lights) {
      light.position = Point<ObjectSpace>(offset + size * light.position.raw());
      light.intensity = size * size * light.intensity;
    }
    return lit;
  };
  const Frame want = render(*field_, twistAt({}, 1), cameraFrom(eye), lights(), settings);
  for (const auto& [offset, size] : {std::pair{1e6, 1.0}, {0.0, 1e-3}, {0.0, 1e3}, {1e3, 1e-3}}) {
    const Vec3 middle{offset, -offset, offset};
    test::FormulaFieldOptions options;
    options.subdivision = 4;
    options.lights = 48;
    options.middle = middle;
    options.radius = size;
    const test::TemporaryFolder folder;
    const auto field = test::makeSphereField(folder / "x.srf", options, patterned);
    const Frame found =
        render(field, twistAt(middle, size), cameraFrom(middle + size * eye, middle), litAt(middle, size), settings);
    const Difference d = differenceOf(want, found);
    EXPECT_GT(d.inside, 300);
    char what[120];
    std::snprintf(what, sizeof what, "capture and scene %g away, scaled by %g: share of pixels off by over 1e-4",
                  offset, size);
    recordHardCase(offset > 0 ? 11 : 4, what, d.share, atMost(0.005));  // rays through edges take either triangle
  }
}

/// z' = z + |x| / 2: a crease along x = 0.
class Crease final : public SpaceMap {
 public:
  Vec3 map(const Vec3& p) const override { return {p.x, p.y, p.z + 0.5 * std::fabs(p.x)}; }
  Mat3 jacobian(const Vec3& p) const override {
    return {{Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{p.x < 0 ? -0.5 : 0.5, 0, 1}}};
  }
  double lengthScale() const override { return 1; }
};

TEST_F(HardCases, ACreaseGivesAFrameBetweenItsSides) {
  for (const bool surfels : {false, true}) {
    const test::FormulaField field = surfels ? surfelField() : *field_;
    DeformedModel deformed(field.model);
    const Deformation psi({std::make_shared<Crease>()});
    deformed.deform(psi);
    const auto camera = cameraFrom({0.2, -3, 4}, {}, 96);
    Largest outside;
    int mixed = 0;
    for (int y = 0; y < 96; ++y)
      for (int x = 0; x < 96; ++x) {
        const Ray<ObjectSpace> ray = *camera.ray({x + 0.5, y + 0.5});
        SurfaceHit hit;
        deformed.intersect({&ray, 1}, {&hit, 1});
        if (hit.count == 0) continue;
        const Mat3& r0 = hit.acquisition_from_tangent.raw();
        Vec3 normal[2];  // of either side, for this rest frame
        for (const int side : {0, 1}) {
          const Mat3 j = psi.jacobian(Point<AcquisitionSpace>(side ? 1 : -1, 0, 0)).raw();
          normal[side] = cross(j * r0.column(0), j * r0.column(1));
          normal[side] = normal[side] / length(normal[side]);
        }
        const LookUp look_up = lookUp(hit, FrameMode::bisector);
        const Vec3 n = (look_up.acquisition_from_object.inverse() * look_up.normal).raw();
        // Between the two normals the sum of the angles is the angle between them.
        const double excess =
            angleBetweenUnit(n, normal[0]) + angleBetweenUnit(n, normal[1]) - angleBetweenUnit(normal[0], normal[1]);
        if (std::fabs(hit.p0.raw().x) < 0.03) {
          ++mixed;
          outside.add(excess);
        }
      }
    EXPECT_GT(mixed, 20);
    // The rest normals within a triangle or a splat differ by 0.05 to 0.1 rad, and the frame is blended from them.
    recordHardCase(13,
                   std::string("crease, ") + (surfels ? "surfels" : "triangles") +
                       ": normal on it outside the two sides' by, radians",
                   outside.value, atMost(0.1));
  }
}

TEST_F(HardCases, EachSheetOfAFoldShadesFromItsOwnRestPoint) {
  DeformedModel deformed(field_->model);
  // Folds where x > 1 / k = 0.5.
  const Deformation psi =
      psiOf(R"({"type": "bend", "axis": [0,0,1], "toward": [1,0,0], "degrees_per_unit": 114.59155902616465})");
  deformed.deform(psi);
  Largest off;
  int behind = 0, hit_count = 0;
  for (const Vec3& eye : {Vec3{1, -5, 2}, Vec3{5, 0.3, 1}, Vec3{-4, 1, -2}}) {
    const auto camera = cameraFrom(eye, {}, 64);
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        const Ray<ObjectSpace> ray = *camera.ray({x + 0.5, y + 0.5});
        SurfaceHit hit;
        deformed.intersect({&ray, 1}, {&hit, 1});
        if (hit.count == 0) continue;
        ++hit_count;
        off.add(distance(psi.map(hit.p0), hit.p_star));
        // Nothing lies before the hit.
        behind += deformed.rays().occluded(ray, 0, hit.distance * (1 - 1e-4));
      }
  }
  EXPECT_GT(hit_count, 1000);
  // Second order in the edge of a triangle, 0.1: half of |D^2 Psi|, which is 2 k = 4 a unit here.
  recordHardCase(15, "folded: Psi(p0) off the hit by, units", off.value, atMost(2 * 0.1 * 0.1));
  recordHardCase(15, "folded: hits with something before them", behind, atMost(0));
}

TEST_F(HardCases, ALoopOfFramesReturnsToItsFirstPicture) {
  for (const bool surfels : {false, true}) {
    const test::FormulaField field = surfels ? surfelField() : *field_;
    DeformedModel deformed(field.model);
    FrameRenderer renderer(field.folder, field.manifest, field.model, {}, Reporter::silent());
    const auto camera = cameraFrom({1, -5, 2});
    const auto poseAt = [](int frame) {
      return psiOf(R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": )" +
                   std::to_string(120 * std::sin(2 * kPi * frame / 250)) +
                   R"(}, {"type": "bend", "axis": [1,0,0], "toward": [0,0,1], "degrees_per_unit": )" +
                   std::to_string(30 + 20 * std::cos(2 * kPi * frame / 250)) + "}");
    };
    deformed.deform(poseAt(0));
    const Frame first = renderer.render(camera, deformed, lights());
    const int frames = test::sized(250, 10000);
    for (int frame = 1; frame < frames; ++frame) {
      deformed.deform(poseAt(frame % 250));
      if (frame % 50 == 7) renderer.render(camera, deformed, lights());
    }
    deformed.deform(poseAt(0));
    const Frame last = renderer.render(camera, deformed, lights());
    double changed = 0;
    for (std::size_t i = 0; i < first.rgba.data().size(); ++i) changed += first.rgba.data()[i] != last.rgba.data()[i];
    recordHardCase(16,
                   std::string("a loop of 250 (nightly 10,000) frames, ") + (surfels ? "surfels" : "triangles") +
                       ": values of the first frame whose bits changed",
                   changed, atMost(0));
  }
}

TEST_F(HardCases, PicturesForThePage) {
  // Nothing is measured here: the layers show what the other tests measure.
  if (!test::hardCasePictures()) GTEST_SKIP() << "skipped: no page is being made";
  FrameSettings settings;
  settings.layers = {"stretch", "shear", "handedness", "fallback", "overlap"};
  settings.samples = 4;
  struct Range {
    const char* channel;
    double low, high;
  };
  const auto show = [&](int row, const std::string& name, const test::FormulaField& field, const Deformation& psi,
                        const Camera<ObjectSpace>& camera, const std::vector<Range>& layers) {
    const Frame frame = render(field, psi, camera, lights(), settings);
    std::vector<test::ShownLayer> shown;
    for (const Range& range : layers) shown.push_back({&frame.layers.at(range.channel), range.low, range.high});
    test::showHardCase(row, name, frame.rgba, shown);
  };
  const Deformation twist = psiOf(R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": 100})");
  show(6, "twist", *field_, twist, cameraFrom({1, -5, 2}, {}, 160),
       {{"stretch.max", 1, 2.5}, {"stretch.min", 0.4, 1}, {"shear", -60, 60}});
  show(5, "half_mirrored", *field_, Deformation({std::make_shared<HalfMirror>()}),
       cameraFrom({-1.5, -7, 2}, {-1.5, 0, 0}, 160), {{"handedness", -1, 1}});
  show(8, "collapsed", *field_, Deformation({std::make_shared<Collapse>(1)}), cameraFrom({0, -5, 1}, {}, 160),
       {{"fallback", 0, 1}});
  show(13, "crease", *field_, Deformation({std::make_shared<Crease>()}), cameraFrom({0.2, -3, 4}, {}, 160),
       {{"stretch.max", 1, 1.2}, {"shear", -30, 30}});
  show(15, "fold", *field_,
       psiOf(R"({"type": "bend", "axis": [0,0,1], "toward": [1,0,0], "degrees_per_unit": 114.59155902616465})"),
       cameraFrom({5, 0.3, 1}, {}, 160), {{"handedness", -1, 1}});
  show(28, "surfels_twisted", surfelField(), twist, cameraFrom({1, -5, 2}, {}, 160), {{"overlap", 0, 12}});
}

TEST(HardCaseLights, OutsideTheCapturedCapWeightsStayFiniteAndPositive) {
  std::vector<CaptureLight> lights;
  std::vector<LightId> ids;
  for (int i = 0; i < 200; ++i) {
    const Vec3 d = test::fibonacci(i, 200);
    if (d.z < 0.7) continue;
    CaptureLight light;
    light.direction = Direction<AcquisitionSpace>::fromUnit(d);
    ids.push_back(LightId{static_cast<std::uint32_t>(lights.size())});
    lights.push_back(light);
  }
  const AcquiredLights list(ids, lights, {}, 4);
  std::vector<Penalised> scratch;
  std::vector<Weighted> weights;
  double bad = 0;
  Largest off;
  for (int i = 0; i < 5000; ++i) {
    list.nearest(Direction<AcquisitionSpace>::fromUnit(test::fibonacci(i, 5000)), {}, scratch, weights);
    double sum = 0;
    for (const Weighted& w : weights) {
      bad += !(w.weight >= 0 && std::isfinite(w.weight));
      sum += w.weight;
    }
    off.add(std::fabs(sum - 1));
  }
  recordHardCase(22, "lights from below a captured cap of 45 degrees: weights that are negative, NaN or infinite", bad,
                 atMost(0));
  recordHardCase(22, "lights from below a captured cap of 45 degrees: sum of the weights off 1 by", off.value,
                 atMost(1e-12));
}

TEST(HardCaseRays, SecondaryRaysLeaveTheirSurfaceAndMeetItsNeighbours) {
  // A ball of radius 1 wherever it lies: rays from points of its own triangles, at a tenth of a radian or more above
  // them; and a wall 2e-4 of its size away, which must be met.
  for (const double place : {1e-3, 1.0, 1e3, 1e6}) {
    const AcquisitionMesh sphere = test::unitSphere(4);
    const Vec3 middle = place / std::sqrt(3.0) * Vec3{1, -1, 1};
    std::vector<Point<ObjectSpace>> positions;
    std::vector<Triangle> triangles = sphere.triangles;
    for (const auto& p : sphere.positions) positions.emplace_back(middle + p.raw());
    // The wall: every triangle again, 2 x 2e-4 further out.
    const auto first = static_cast<std::uint32_t>(positions.size());
    const auto ball = RayScene<ObjectSpace>::ofTriangles(positions, triangles);
    for (const auto& p : sphere.positions) positions.emplace_back(middle + (1 + 4e-4) * p.raw());
    for (const Triangle& t : sphere.triangles) triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
    const auto walled = RayScene<ObjectSpace>::ofTriangles(positions, triangles);
    const double near = 1e-4 * 2;  // of the size 2
    int self = 0, missed = 0;
    for (std::size_t i = 0; i < sphere.triangles.size(); ++i) {
      const auto& [a, b, c] = sphere.triangles[i];
      const Vec3 e1 = (positions[b] - positions[a]).raw(), e2 = (positions[c] - positions[a]).raw();
      const Vec3 n = cross(e1, e2) / length(cross(e1, e2));
      const Point<ObjectSpace> p = positions[a] + (Vector<ObjectSpace>(0.3 * e1) + Vector<ObjectSpace>(0.37 * e2));
      for (int k = 0; k < 8; ++k) {
        const double angle = 2 * kPi * k / 8, rise = k % 2 ? 0.1 : 0.8;
        const Vec3 along = e1 / length(e1), across = cross(n, along);
        const Vec3 d = rise * n + std::sqrt(1 - rise * rise) * (std::cos(angle) * along + std::sin(angle) * across);
        const Ray<ObjectSpace> ray{p, Direction<ObjectSpace>::fromUnit(d / length(d))};
        self += ball.occluded(ray, near, 10);
        missed += !walled.occluded(ray, near, 10);
      }
    }
    char where[40];
    std::snprintf(where, sizeof where, "|p| near %g: ", place);
    recordHardCase(25, where + std::string("rays that met the surface they left"), self, atMost(0));
    recordHardCase(25, where + std::string("rays that missed a wall 2e-4 of the size away"), missed, atMost(0));
  }
}

TEST(HardCaseRays, OverlappingSurfacesAreMetAlikeByAnyNumberOfThreads) {
  // The same ball three times over, in triangles and in splats.
  const AcquisitionMesh sphere = test::unitSphere(3);
  std::vector<Point<ObjectSpace>> positions;
  std::vector<Vector<ObjectSpace>> u, v;
  std::vector<Triangle> triangles;
  for (int copy = 0; copy < 3; ++copy) {
    const auto first = static_cast<std::uint32_t>(positions.size());
    for (const auto& p : sphere.positions) {
      positions.emplace_back(p.raw());
      const Vec3 t = anyPerpendicular(Direction<ObjectSpace>::fromUnit(p.raw())).raw();
      u.emplace_back(0.2 * t);
      v.emplace_back(0.2 * cross(p.raw(), t));
    }
    for (const Triangle& t : sphere.triangles) triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
  }
  std::vector<Ray<ObjectSpace>> rays;
  for (int i = 0; i < 4000; ++i) {
    const Vec3 from = 3 * test::fibonacci(i, 4000), to = 0.9 * test::fibonacci(i * 7 % 4000, 4000);
    rays.push_back({Point<ObjectSpace>(from), *normalize(Vector<ObjectSpace>(to - from))});
  }
  std::vector<TriangleHit> want;
  std::vector<std::vector<SplatHit>> want_splats;
  double unlike = 0, unlike_splats = 0;
  for (const int threads : {1, 1, 2, 4}) {
    setThreadCount(threads);
    const auto of_triangles = RayScene<ObjectSpace>::ofTriangles(positions, triangles);
    const auto of_splats = RayScene<ObjectSpace>::ofSplats(positions, u, v, 1);
    std::vector<TriangleHit> hits(rays.size());
    std::vector<std::vector<SplatHit>> splats(rays.size());
    parallelFor(rays.size(), 64, [&](std::size_t begin, std::size_t end) {
      of_triangles.intersect(std::span(rays).subspan(begin, end - begin), std::span(hits).subspan(begin, end - begin));
      SplatLists lists;
      of_splats.gatherSplats(std::span(rays).subspan(begin, end - begin), 0.5, lists);
      for (std::size_t i = begin; i < end; ++i)
        splats[i].assign(lists.of(i - begin).begin(), lists.of(i - begin).end());
    });
    if (want.empty()) {
      want = hits, want_splats = splats;
      continue;
    }
    for (std::size_t i = 0; i < rays.size(); ++i) {
      unlike += hits[i].triangle != want[i].triangle || hits[i].distance != want[i].distance;
      bool same = splats[i].size() == want_splats[i].size();
      for (std::size_t k = 0; same && k < splats[i].size(); ++k)
        same = splats[i][k].splat == want_splats[i][k].splat && splats[i][k].distance == want_splats[i][k].distance;
      unlike_splats += !same;
    }
  }
  setThreadCount(0);
  recordHardCase(27, "one ball three times over, 1, 2 and 4 threads: triangle hits that differ", unlike, atMost(0));
  recordHardCase(27, "one ball three times over, 1, 2 and 4 threads: splat hits that differ", unlike_splats, atMost(0));
}

TEST_F(HardCases, TheSilhouetteOfSurfelsIsThatOfTrianglesToAPixel) {
  const auto camera = cameraFrom({1, -5, 2}, {}, 96);
  const char* const twist = R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": 60})";
  const char* const flat = R"({"type": "affine", "matrix": [[1,0,0,0],[0,1,0,0],[0,0,0.02,0],[0,0,0,1]]})";
  const test::FormulaField surfels = surfelField();
  for (const char* list : {"", twist, flat}) {
    const Frame a = render(*field_, psiOf(list), camera, lights()), b = render(surfels, psiOf(list), camera, lights());
    // Pixels that one covers and that have no covered pixel of the other among their neighbours.
    double apart = 0;
    const auto covers = [](const Frame& frame, int x, int y) {
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          const int nx = std::clamp(x + dx, 0, 95), ny = std::clamp(y + dy, 0, 95);
          if (frame.rgba.at(nx, ny, 3) > 0) return true;
        }
      return false;
    };
    for (int y = 0; y < 96; ++y)
      for (int x = 0; x < 96; ++x) {
        apart += a.rgba.at(x, y, 3) > 0 && !covers(b, x, y);
        apart += b.rgba.at(x, y, 3) > 0 && !covers(a, x, y);
      }
    recordHardCase(28, "silhouettes of surfels and triangles (at rest, twisted, flat): pixels further than 1 apart",
                   apart, atMost(0));
  }
}

TEST_F(HardCases, MemoryStaysWithinTheBudgetHoweverManyOperationsAFrameHas) {
  FrameSettings settings;
  settings.memory_bytes = std::size_t{32} << 20;
  settings.samples = test::sized(400, 2500);
  const auto camera = cameraFrom({1, -3.5, 1}, {}, test::sized(32, 128));
  Reporter reporter(ProgressMode::none, LogLevel::error);
  render(*field_, {}, camera, lights(), {}, reporter);  // what a frame needs anyway
  struct rusage before {
  }, after{};
  getrusage(RUSAGE_SELF, &before);
  Reporter counted(ProgressMode::none, LogLevel::error);
  render(*field_, {}, camera, lights(), settings, counted);
  getrusage(RUSAGE_SELF, &after);
  const double operations = static_cast<double>(counted.counters().at("operations"));
  // Each operation holds 32 bytes and a result of 12: unbounded, this is many times the budget.
  EXPECT_GT(operations, test::sized(100'000, 100'000'000));
  const double grown = 1024.0 * static_cast<double>(after.ru_maxrss - before.ru_maxrss);
  recordHardCase(39, "100,000 (nightly 100 million) operations in a frame: memory grown over the budget of 32 MB",
                 grown / static_cast<double>(settings.memory_bytes), atMost(2));
}

// A locale with a decimal comma is made for the test; paths hold letters beyond ASCII.
TEST(HardCaseLocale, ACommaForThePointAndForeignLettersChangeNothing) {
  const test::TemporaryFolder folder;
  const std::string made = "localedef -i de_DE -f UTF-8 " + (folder / "de_DE.UTF-8").string() + " >/dev/null 2>&1";
  const std::string before = std::setlocale(LC_ALL, nullptr);
  if (std::system(made.c_str()) > 256) GTEST_SKIP() << "skipped: no locale can be made here";
  ::setenv("LOCPATH", folder.path().c_str(), 1);
  const bool comma = std::setlocale(LC_ALL, "de_DE.UTF-8") != nullptr;
  ::unsetenv("LOCPATH");
  if (!comma) GTEST_SKIP() << "skipped: no locale can be made here";
  char text[20];
  std::snprintf(text, sizeof text, "%.1f", 0.5);
  ASSERT_STREQ(text, "0,5");

  double wrong = 0;
  const JsonNode node = parseJson(R"({"x": 0.1234567890123456, "y": 1e-3})", "test");
  wrong += node["x"].number() != 0.1234567890123456;
  wrong += node["y"].number() != 1e-3;
  const auto foreign = folder / "Ätna – 火山";
  std::filesystem::create_directories(foreign);
  const auto field =
      test::makeSphereField(foreign / "x.srf", {.views = 4, .lights = 4, .size = 24, .subdivision = 2}, patterned);
  const SrfManifest read = readManifest(foreign / "x.srf");
  wrong += read.views.size() != 4;
  for (std::size_t v = 0; v < std::min<std::size_t>(4, read.views.size()); ++v)
    wrong += read.views[v].camera.center() != field.manifest.views[v].camera.center();
  std::setlocale(LC_ALL, before.c_str());
  recordHardCase(42, "decimal comma and foreign letters in paths: numbers and files that come back otherwise", wrong,
                 atMost(0));

  double unnamed = 1;
  writeTextFile(foreign / "transforms.json", R"({"w": 4, "h": 4, "fl_x": 4, "frames": []})");
  try {
    readCapture(foreign / "transforms.json");
  } catch (const Error& e) {
    unnamed = std::string(e.what()).find("frames") == std::string::npos;
  }
  recordHardCase(42, "an empty list of views that is not refused by name", unnamed, atMost(0));
}

}  // namespace
}  // namespace srf
