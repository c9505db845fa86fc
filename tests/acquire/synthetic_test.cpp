#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <random>

#include "acquire/synthetic_capture.h"
#include "acquire/synthetic_indirect.h"
#include "acquire/synthetic_object.h"
#include "acquire/synthetic_reference.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/mesh_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "field/capture_file.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using P0 = Point<AcquisitionSpace>;
using Dir0 = Direction<AcquisitionSpace>;
using test::TemporaryFolder;

std::vector<SyntheticObject> everyObject() {
  std::vector<SyntheticObject> objects;
  for (std::size_t s = 0; s < syntheticShapeNames().size(); ++s)
    objects.emplace_back(static_cast<SyntheticShape>(s), SyntheticMaterial::lambert);
  return objects;
}
// Those that reflect where the light arrives, on any shape.
std::vector<SyntheticMaterial> everyReflectance() {
  std::vector<SyntheticMaterial> materials;
  for (std::size_t m = 0; m < syntheticMaterialNames().size(); ++m)
    if (const auto material = static_cast<SyntheticMaterial>(m);
        material != SyntheticMaterial::wax && material != SyntheticMaterial::glass)
      materials.push_back(material);
  return materials;
}
std::string name(const SyntheticObject& object) {
  return syntheticShapeNames()[static_cast<std::size_t>(object.shape())] + " " +
         syntheticMaterialNames()[static_cast<std::size_t>(object.material())];
}

Vec3 randomUnit(std::mt19937& random) {
  std::normal_distribution<double> normal;
  const Vec3 v{normal(random), normal(random), normal(random)};
  return v / length(v);
}

// Points evenly over the sphere, for quadrature.
std::vector<Vec3> spherePoints(int count) {
  std::vector<Vec3> points;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2.0 * i + 1) / count, r = std::sqrt(1 - z * z), a = 2.399963229728653 * i;
    points.push_back({r * std::cos(a), r * std::sin(a), z});
  }
  return points;
}

SyntheticCaptureOptions small(SyntheticShape shape, SyntheticMaterial material) {
  SyntheticCaptureOptions options;
  options.shape = shape;
  options.material = material;
  options.views = 3;
  options.lights = 3;
  options.size = 40;
  return options;
}

// Rotation, reflection and scaling of space: L is exact without any frame.
class SimilarityWarp : public ReferenceWarp {
 public:
  SimilarityWarp(const Mat3& orthogonal, double scale, const Vec3& shift)
      : orthogonal_(orthogonal), scale_(scale), shift_(shift) {}
  Point<ObjectSpace> map(const P0& p) const override {
    return Point<ObjectSpace>(scale_ * (orthogonal_ * p.raw()) + shift_);
  }
  Linear<ObjectSpace, AcquisitionSpace> jacobian(const P0&) const override {
    return Linear<ObjectSpace, AcquisitionSpace>(scale_ * orthogonal_);
  }
  Orthogonal<AcquisitionSpace, ObjectSpace> lookUp(const Linear<ObjectSpace, AcquisitionSpace>&,
                                                   const Dir0&) const override {
    return Orthogonal<AcquisitionSpace, ObjectSpace>(orthogonal_.transposed());
  }

 private:
  Mat3 orthogonal_;
  double scale_;
  Vec3 shift_;
};
const SimilarityWarp kIdentity(Mat3{}, 1, {});

Camera<ObjectSpace> testCamera(int size) {
  return {pinholeFromFov(size, size, 30),
          *lookAt(Point<ObjectSpace>(2.5, -3.2, 1.9), Point<ObjectSpace>(), Vector<ObjectSpace>(0, 0, 1))};
}
double largestDifference(const ImageF& a, const ImageF& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.data().size(); ++i)
    largest = std::max(largest, std::fabs(double{a.data()[i]} - double{b.data()[i]}));
  return largest;
}

TEST(SyntheticObject, TessellationIsClosedOutwardAndOnTheSurface) {
  for (const SyntheticObject& object : everyObject()) {
    SCOPED_TRACE(name(object));
    const AcquisitionMesh mesh = object.tessellate(24);
    const MeshTopology topology = meshTopology(mesh);
    EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
    const int components = object.shape() == SyntheticShape::ball_on_plate ? 2 : 1;
    EXPECT_EQ(topology.components, components);
    EXPECT_EQ(topology.euler_characteristic, object.shape() == SyntheticShape::torus ? 0 : 2 * components);
    EXPECT_GT(meshVolume(mesh), 0);
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      EXPECT_NEAR(object.implicit(mesh.positions[i]).value, 0, 1e-14);
      EXPECT_LT(length(mesh.positions[i].raw()), 1 + 1e-14);
    }
  }
}

TEST(SyntheticObject, NormalsAreTheGradientByDifferences) {
  for (const SyntheticObject& object : everyObject()) {
    SCOPED_TRACE(name(object));
    const AcquisitionMesh mesh = object.tessellate(9);
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      Vec3 difference;
      const double h = 1e-6;
      for (int k = 0; k < 3; ++k) {
        Vec3 step;
        step[k] = h;
        difference[k] = (object.implicit(P0(mesh.positions[i].raw() + step)).value -
                         object.implicit(P0(mesh.positions[i].raw() - step)).value) /
                        (2 * h);
      }
      // Rounding of the differences gives 1e-9. The rounded shapes bend within 0.04 units from flat to round: a
      // difference across that line is off by h / 0.04.
      EXPECT_LT(length(difference / length(difference) - mesh.normals[i].raw()), 5e-5);
      const ShadingPoint point = object.shadingPoint(mesh.positions[i]);
      EXPECT_NEAR(dot(point.normal, point.tangent), 0, 1e-14);
      EXPECT_NEAR(length(cross(point.tangent, point.bitangent) - Vector<AcquisitionSpace>(point.normal)), 0, 1e-14);
    }
  }
}

TEST(SyntheticObject, VolumesAreThoseOfTheFormulas) {
  const auto volume = [](SyntheticShape shape) {
    return meshVolume(SyntheticObject(shape, SyntheticMaterial::lambert).tessellate(96));
  };
  // An inscribed mesh of 96 cells a side loses about (cell angle)^2 / 4 = 7e-5 of the volume, the torus' tube (144
  // sides) 3e-4.
  EXPECT_NEAR(volume(SyntheticShape::sphere) / (4 * kPi / 3), 1, 3e-4);
  EXPECT_NEAR(volume(SyntheticShape::ellipsoid) / (4 * kPi / 3 * 0.75 * 0.55), 1, 3e-4);
  EXPECT_NEAR(volume(SyntheticShape::capsule) / (4 * kPi / 3 * 0.45 * 0.45 * 0.45 + kPi * 0.45 * 0.45 * 1.1), 1, 5e-4);
  EXPECT_NEAR(volume(SyntheticShape::torus) / (2 * kPi * kPi * 0.68 * 0.28 * 0.28), 1, 6e-4);
  // Half a shell, and as its rim half a torus whose tube is a half disc.
  const double shell = 2 * kPi / 3 * (0.9 * 0.9 * 0.9 - 0.78 * 0.78 * 0.78), rim = kPi * kPi * 0.84 * 0.06 * 0.06;
  EXPECT_NEAR(volume(SyntheticShape::bowl) / (shell + rim), 1, 1e-3);
  // Steiner's formula: a box of these sides, and all within r of it.
  const auto rounded = [](double a, double b, double c, double r) {
    return a * b * c + 2 * r * (a * b + b * c + c * a) + kPi * r * r * (a + b + c) + 4 * kPi / 3 * r * r * r;
  };
  EXPECT_NEAR(volume(SyntheticShape::slab) / rounded(1.48, 1, 0.1, 0.09), 1, 1e-3);
  const double ball = 4 * kPi / 3 * 0.45 * 0.45 * 0.45, plate = rounded(1.12, 1.12, 0.04, 0.04);
  EXPECT_NEAR(volume(SyntheticShape::ball_on_plate) / (ball + plate), 1, 1e-3);
}

TEST(SyntheticObject, RaysMeetTheSphereWhereTheFormulaSays) {
  const SyntheticObject sphere(SyntheticShape::sphere, SyntheticMaterial::lambert);
  std::mt19937 random(3);
  for (int i = 0; i < 200; ++i) {
    const Vec3 origin = 4.0 * randomUnit(random), target = 0.9 * randomUnit(random);
    const Vec3 d = (target - origin) / length(target - origin);
    const double b = dot(origin, d), exact = -b - std::sqrt(b * b - dot(origin, origin) + 1);
    const auto p = sphere.meet({P0(origin), Dir0::fromUnit(d)}, exact + 1e-3);
    ASSERT_TRUE(p);
    EXPECT_LT(length(p->raw() - (origin + exact * d)), 1e-11);
  }
  EXPECT_FALSE(sphere.meet({P0(4, 1.1, 0), Dir0::fromUnit({-1, 0, 0})}, 4));
}

TEST(SyntheticObject, ReflectanceIsReciprocalAndCreatesNoLight) {
  std::mt19937 random(5);
  const int count = 20000;
  const std::vector<Vec3> sphere = spherePoints(count);
  for (const SyntheticMaterial material : everyReflectance()) {
    const SyntheticObject object(SyntheticShape::sphere, material);
    SCOPED_TRACE(name(object));
    for (const double view_cosine : {1.0, 0.8, 0.5, 0.25, 0.1, 0.03}) {
      const ShadingPoint point = object.shadingPoint(P0(randomUnit(random)));
      const Vec3 across = point.tangent.raw() * 0.6 + point.bitangent.raw() * 0.8;
      const Dir0 view = Dir0::fromUnit(view_cosine * point.normal.raw() + std::sqrt(1 - square(view_cosine)) * across);
      Vec3 reflected;
      for (const Vec3& l : sphere) {
        const Dir0 light = Dir0::fromUnit(l);
        const double cosine = dot(point.normal, light);
        const Vec3 f = brdf(point, light, view);
        ASSERT_GE(minComponent(f), 0);
        reflected += (4 * kPi / count * std::max(cosine, 0.0)) * f;
        if (cosine <= 1e-3) continue;
        const Vec3 back = brdf(point, view, light);
        EXPECT_LE(length(f - back), 1e-12 * (1 + length(f)));
      }
      EXPECT_LE(maxComponent(reflected), 1.0) << "n.v = " << view_cosine;
      EXPECT_GE(maxComponent(reflected), 0.1) << "n.v = " << view_cosine;
    }
  }
}

TEST(SyntheticObject, BrushedMetalReflectsWhatItsFacetsDo) {
  // Facets drawn from the GGX distribution, seen from above: light leaves where they mirror it to, less what Smith's
  // term hides there.
  const double ax = 0.1, ay = 0.4;
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform;
  double expected = 0;
  const int facets = 400000;
  for (int i = 0; i < facets; ++i) {
    const double u = uniform(random), a = 2 * kPi * uniform(random), slope = std::sqrt(u / (1 - u));
    const Vec3 facet{ax * slope * std::cos(a), ay * slope * std::sin(a), 1};
    const Vec3 h = facet / length(facet), l = 2 * h.z * h - Vec3{0, 0, 1};
    if (l.z <= 0) continue;
    const double lambda = 0.5 * (std::sqrt(1 + (square(ax * l.x) + square(ay * l.y)) / square(l.z)) - 1);
    expected += (0.95 + 0.05 * std::pow(1 - h.z, 5)) / (1 + lambda) / facets;
  }
  const SyntheticObject object(SyntheticShape::sphere, SyntheticMaterial::conductor);
  const ShadingPoint point = object.shadingPoint(P0(0.6, 0, 0.8));
  double reflected = 0;
  const int count = 200000;
  for (const Vec3& l : spherePoints(count)) {
    const Dir0 light = Dir0::fromUnit(l);
    reflected += 4 * kPi / count * std::max(0.0, dot(point.normal, light)) * brdf(point, light, point.normal).x;
  }
  EXPECT_NEAR(reflected, expected, 2e-3);  // of the drawing: 0.3 / sqrt(400000) = 5e-4, 4 of them
  // Brushed around the axis: the highlight is narrow along the tangent, wide across.
  const auto off = [&](const Dir0& toward) {
    return brdf(point, *normalize(Vector<AcquisitionSpace>(point.normal) + 0.3 * toward), point.normal).x;
  };
  EXPECT_GT(off(point.bitangent), 3 * off(point.tangent));
}

TEST(SyntheticObject, MixedIsPatchesOfTheMaterialsItNames) {
  std::mt19937 random(17);
  const SyntheticObject mixed(SyntheticShape::sphere, SyntheticMaterial::mixed);
  const auto likeA = [&](SyntheticMaterial material, const P0& p, const Dir0& light, const Dir0& view) {
    return brdf(SyntheticObject(SyntheticShape::sphere, material).shadingPoint(p), light, view) ==
           brdf(mixed.shadingPoint(p), light, view);
  };
  int matt = 0, plastic = 0, metal = 0, rougher = 0;
  for (int i = 0; i < 4000; ++i) {
    const P0 p(randomUnit(random));
    const Dir0 n = mixed.normal(p), view = *normalize(Vector<AcquisitionSpace>(n) + 0.3 * anyPerpendicular(n));
    const bool is_matt = likeA(SyntheticMaterial::lambert, p, n, view);
    const bool is_plastic = likeA(SyntheticMaterial::plastic, p, n, view);
    const bool is_metal = likeA(SyntheticMaterial::conductor, p, n, view);
    matt += is_matt, plastic += is_plastic, metal += is_metal, rougher += !is_matt && !is_plastic && !is_metal;
  }
  for (const int count : {matt, plastic, metal, rougher}) EXPECT_GT(count, 4000 / 10);
  EXPECT_EQ(matt + plastic + metal + rougher, 4000);
}

TEST(SyntheticObject, GlossIsNarrowerThanTheSpacingOfItsLights) {
  // 64 lights are 26 degrees apart. The lobe falls to a half within 3 degrees of light: D does where
  // tan(half angle) = alpha sqrt(sqrt(2) - 1), i.e. 0.92 degrees of half vector.
  const SyntheticObject object(SyntheticShape::sphere, SyntheticMaterial::gloss);
  const ShadingPoint point = object.shadingPoint(P0(0.6, 0, 0.8));
  const auto at = [&](double degrees_off) {
    const double a = radians(degrees_off);
    const Dir0 light = *normalize(std::cos(a) * Vector<AcquisitionSpace>(point.normal) + std::sin(a) * point.tangent);
    return brdf(point, light, point.normal).x - point.albedo.x / kPi * square(0.96);
  };
  EXPECT_GT(at(1.8), 0.5 * at(0));
  EXPECT_LT(at(1.9), 0.5 * at(0));
  EXPECT_LT(at(26), 1e-3 * at(0));
}

TEST(SyntheticObject, GlassBallBendsRaysAsALensDoes) {
  const SyntheticObject object(SyntheticShape::ball_on_plate, SyntheticMaterial::glass);
  const P0 center(0, 0, 0.12);
  const double radius = 0.45, index = 1.5, plate_top = -0.36;
  // Paraxial: the focal length of a ball is n R / (2 (n - 1)), from its centre; the plate lies before the focus.
  const double focal = index * radius / (2 * (index - 1)), distance = center.raw().z - plate_top;
  for (const double h : {0.005, 0.02}) {
    const auto seen = object.seenAt(object.project(P0(h, 0, center.raw().z + radius)), Dir0());
    ASSERT_EQ(seen.size(), 2u);  // the mirrored ray goes up
    EXPECT_NEAR(seen[1].point.p.raw().x / (h * (1 - distance / focal)), 1, 0.01);
    EXPECT_NEAR(seen[1].point.p.raw().z, plate_top, 1e-9);
    EXPECT_NEAR(seen[1].weight, square(1 - 0.04), 1e-4);
  }
  // Any ray leaves turned by twice the difference of the angles of Snell's law, in the plane of incidence.
  std::mt19937 random(23);
  int through = 0, mirrored = 0;
  for (int i = 0; i < 500; ++i) {
    const Vec3 n = randomUnit(random), v = randomUnit(random);
    if (dot(n, v) < 0.05) continue;
    const auto seen = object.seenAt(P0(center.raw() + radius * n), Dir0::fromUnit(v));
    const double arrives = std::acos(dot(n, v)), inside = std::asin(std::sin(arrives) / index);
    for (std::size_t k = 1; k < seen.size(); ++k) {
      const Vec3 on = -1.0 * seen[k].view.raw();
      EXPECT_NEAR(dot(on, cross(n, v)), 0, 1e-9);
      const double turned = std::acos(std::clamp(dot(on, -1.0 * v), -1.0, 1.0));
      const double parallel = square(std::tan(arrives - inside) / std::tan(arrives + inside));
      const double perpendicular = square(std::sin(arrives - inside) / std::sin(arrives + inside));
      const double reflected = 0.5 * (parallel + perpendicular);
      if (std::fabs(seen[k].weight - reflected) < 1e-9 && std::fabs(turned - (kPi - 2 * arrives)) < 1e-6) {
        ++mirrored;
      } else {
        EXPECT_NEAR(seen[k].weight, square(1 - reflected), 1e-9);
        EXPECT_NEAR(turned, 2 * (arrives - inside), 1e-6);
        ++through;
      }
    }
  }
  EXPECT_GT(through, 20);
  EXPECT_GT(mirrored, 20);
}

TEST(IndirectLight, BowlLightsItselfAsPathsTracedThroughItDo) {
  const SyntheticObject bowl(SyntheticShape::bowl, SyntheticMaterial::white, true);
  const Dir0 light = *normalize(Vector<AcquisitionSpace>(0.5, -0.2, 0.8));
  const AcquisitionMesh mesh = bowl.tessellate(96);
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(mesh.positions, mesh.triangles);
  const auto irradianceAt = [&](const P0& p) {
    const Dir0 n = bowl.normal(p);
    const double cosine = dot(n, light);
    return cosine > 0 && !scene.occluded({p + 1e-3 * n, light}, 0, INFINITY) ? cosine : 0.0;
  };
  IndirectLight indirect(bowl);
  indirect.solve(1, [&](std::size_t) {
    std::vector<Vec3> direct;
    for (const P0& p : indirect.probes()) direct.push_back(irradianceAt(p) * Vec3{1, 1, 1});
    return direct;
  });
  // By chance: the mean over paths whose directions have the density of the cosine, of albedo E at every point met. The
  // first directions are spread evenly.
  std::mt19937 random(29);
  const double albedo = 0.85;
  const int paths = 30000;
  const std::vector<Vec3> first = spherePoints(paths);
  for (const Vec3& at : {Vec3{0.1, 0.05, -0.4}, Vec3{-0.55, 0, -0.15}, Vec3{0.3, -0.66, 0.1}}) {
    const P0 start = bowl.project(P0(at));
    double sum = 0;
    for (int i = 0; i < paths; ++i) {
      P0 p = start;
      double throughput = albedo;
      for (int bounce = 0; bounce < 20; ++bounce, throughput *= albedo) {
        const Dir0 n = bowl.normal(p);
        const Vec3 off = bounce == 0 ? first[i] : randomUnit(random);
        const Dir0 d = normalize(Vector<AcquisitionSpace>(n.raw() + off)).value_or(n);
        const TriangleHit hit = scene.intersect({p + 1e-3 * n, d});
        if (!hit.hit()) break;
        p = bowl.project(p + 1e-3 * n + double{hit.distance} * d);
        if (dot(bowl.normal(p), d) >= 0) break;
        sum += throughput * irradianceAt(p);
      }
    }
    const double mean = sum / paths;
    EXPECT_GT(mean, 0.1);
    // Seeds of 400000 paths scatter by 0.25 %; over four of them the coarse mesh and its rays were off by 0.1 to 0.3 %.
    EXPECT_NEAR(indirect.at(indirect.place(start, bowl.normal(start)), 0).x / mean, 1, 0.012);
  }
}

TEST(IndirectLight, WaxIsTheMeanOfItsLightWeightedByTheProfile) {
  const SyntheticObject sphere(SyntheticShape::sphere, SyntheticMaterial::wax);
  IndirectLight indirect(sphere);
  indirect.solve(2, [&](std::size_t light) {
    std::vector<Vec3> direct;
    for (const P0& p : indirect.probes()) direct.push_back((light == 0 ? 1 : std::max(0.0, p.raw().z)) * Vec3{1, 2, 3});
    return direct;
  });
  for (const Vec3& at : {Vec3{0, 0, 1}, Vec3{1, 0, 0}, Vec3{0, 0.96, -0.28}}) {
    const IndirectLight::Place place = indirect.place(P0(at), sphere.normal(P0(at)));
    const Vec3 even = indirect.at(place, 0), from_above = indirect.at(place, 1);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(even[c], c + 1, 1e-4 * (c + 1));  // evenly lit it shows what arrives
      const double d = std::array{0.12, 0.06, 0.04}[c];
      // Rings about the point: on a sphere their area is proportional to the step of r^2, and their mean of max(z, 0)
      // a sum over the turn.
      double weighted = 0, total = 0;
      const Vec3 u = anyPerpendicular(Dir0::fromUnit(at)).raw(), v = cross(at, u);
      for (int i = 0; i < 2000; ++i) {
        const double r = 2 * (i + 0.5) / 2000, weight = std::exp(-r / d) + std::exp(-r / (3 * d));  // R(r) r dr
        const double z = 1 - r * r / 2, s = std::sqrt(1 - z * z);
        double mean = 0;
        for (int k = 0; k < 64; ++k) {
          const double a = 2 * kPi * (k + 0.5) / 64;
          mean += std::max(0.0, (z * at + s * (std::cos(a) * u + std::sin(a) * v)).z) / 64;
        }
        weighted += weight * mean, total += weight;
      }
      // Interpolated between vertices 0.07 units apart, where the light's edge bends within d.
      EXPECT_NEAR(from_above[c] / (c + 1), weighted / total, 0.01) << at.z << " channel " << c;
    }
  }
}

TEST(SyntheticCapture, WhatCannotBeCombinedIsRefused) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::glass);
  EXPECT_THROW(writeSyntheticCapture(options, folder / "cap", Reporter::silent()), Error);
  options = small(SyntheticShape::bowl, SyntheticMaterial::plastic);
  options.interreflection = true;
  EXPECT_THROW(writeSyntheticCapture(options, folder / "cap", Reporter::silent()), Error);
  writeTextFile(folder / "cap/synthetic.json", R"({"version": 1, "object": "torus", "material": "glass"})");
  EXPECT_THROW(readSyntheticObject(folder / "cap"), Error);
}

TEST(SyntheticCapture, MissingPhotographsLeaveEveryViewAndLightOne) {
  for (const SyntheticRig rig : {SyntheticRig::sphere, SyntheticRig::turntable})
    for (const double missing : {0.3, 1.0}) {
      const TemporaryFolder folder;
      SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::lambert);
      options.rig = rig;
      options.views = 20;
      options.lights = 20;
      options.size = 4;
      options.missing = missing;
      writeSyntheticCapture(options, folder / "cap", Reporter::silent());
      const Capture capture = readCapture(folder / "cap");  // refuses lights that no photograph shows
      EXPECT_EQ(capture.lights.size(), rig == SyntheticRig::turntable ? 140u : 20u);
      std::size_t photos = 0;
      for (const CaptureView& view : capture.views) {
        EXPECT_GE(view.photos.size(), 1u);
        photos += view.photos.size();
      }
      // 400 photographs, standard deviation 9; a step of the turntable has three cameras, and a light that lost two
      // keeps the third.
      if (missing == 0.3) {
        EXPECT_NEAR(static_cast<double>(photos), 280 + (rig == SyntheticRig::turntable ? 6 : 0), 40);
      }
      if (missing == 1) {
        EXPECT_LE(photos, rig == SyntheticRig::turntable ? 150u : 39u);
      }
    }
}

TEST(SyntheticCapture, FolderHoldsWhatTheOptionsAskedFor) {
  const TemporaryFolder folder;
  writeSyntheticCapture(small(SyntheticShape::torus, SyntheticMaterial::plastic), folder / "cap/", Reporter::silent());
  const Capture capture = readCapture(folder / "cap");
  ASSERT_EQ(capture.views.size(), 3u);
  ASSERT_EQ(capture.lights.size(), 3u);
  for (const CaptureView& view : capture.views) {
    EXPECT_EQ(view.photos.size(), 3u);
    EXPECT_EQ(readMask(view.mask_file).width(), 40);
    for (const Photo& photo : view.photos) EXPECT_EQ(readImage(photo.file).pixels.channels(), 3);
  }
  const SyntheticObject object = readSyntheticObject(folder / "cap");
  EXPECT_EQ(object.shape(), SyntheticShape::torus);
  EXPECT_EQ(object.material(), SyntheticMaterial::plastic);
  const AcquisitionMesh mesh = readMesh(folder / "cap/model.ply");
  EXPECT_EQ(mesh.normals.size(), mesh.positions.size());
}

// Radiance and coverage of a pixel by a sphere intersection of its own, 4 x 4 samples.
struct PixelTruth {
  Vec3 radiance;
  double coverage = 0;
};
PixelTruth spherePixel(const SyntheticObject& object, const Camera<AcquisitionSpace>& camera, const CaptureLight& light,
                       int x, int y) {
  PixelTruth truth;
  for (int k = 0; k < 16; ++k) {
    const auto ray = *camera.ray({x + (k % 4 + 0.5) / 4, y + (k / 4 + 0.5) / 4});
    const Vec3 o = ray.origin.raw(), d = ray.direction.raw();
    const double b = dot(o, d), disc = b * b - dot(o, o) + 1;
    if (disc < 0) continue;
    const Vec3 p = o + (-b - std::sqrt(disc)) * d;
    truth.coverage += 1.0 / 16;
    const double cosine = dot(p, light.directionFrom(P0(p)).raw());
    if (cosine > 0)
      truth.radiance += (cosine / (16 * kPi)) * (object.shadingPoint(P0(p)).albedo * light.irradianceAt(P0(p)));
  }
  return truth;
}

TEST(SyntheticCapture, MattSphereIsAlbedoTimesCosineOverPi) {
  for (const LightKind kind : {LightKind::directional, LightKind::point}) {
    const TemporaryFolder folder;
    SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::lambert);
    options.light_kind = kind;
    writeSyntheticCapture(options, folder / "cap", Reporter::silent());
    const SyntheticObject object = readSyntheticObject(folder / "cap");
    const Capture capture = readCapture(folder / "cap");
    for (const CaptureView& view : capture.views) {
      const Image8 mask = readMask(view.mask_file);
      for (const Photo& photo : view.photos) {
        const ImageF pixels = readImage(photo.file).pixels;
        int differing = 0;
        for (int y = 0; y < 40; ++y)
          for (int x = 0; x < 40; ++x) {
            const PixelTruth truth = spherePixel(object, view.camera, capture.lights[photo.light->value], x, y);
            // A sample within the tessellation's 2e-5 units of the silhouette may be missed.
            if (std::fabs(mask.at(x, y) / 255.0 - truth.coverage) > 0.5 / 255 + 1e-9) {
              ++differing;
              continue;
            }
            // Half precision: 2^-11 of the value; point lights reach irradiance 2.3 near the light.
            for (int c = 0; c < 3; ++c)
              EXPECT_NEAR(pixels.at(x, y, c), truth.radiance[c], 5e-4 * truth.radiance[c] + 1e-6);
          }
        EXPECT_LE(differing, 2);
      }
    }
  }
}

TEST(SyntheticCapture, ObjectFillsFourFifthsOfThePicture) {
  const TemporaryFolder folder;
  writeSyntheticCapture(small(SyntheticShape::sphere, SyntheticMaterial::lambert), folder / "cap", Reporter::silent());
  const Image8 mask = readMask(folder / "cap/masks/v001.png");
  const double sum = std::accumulate(mask.data().begin(), mask.data().end(), 0.0) / 255;
  EXPECT_NEAR(2 * std::sqrt(sum / kPi) / 40, 0.8, 0.005);  // the diameter of a disc of the same area
}

TEST(SyntheticCapture, ConcaveObjectsShadowThemselvesAsRayMarchingSays) {
  for (const SyntheticShape shape : {SyntheticShape::torus, SyntheticShape::bowl, SyntheticShape::ball_on_plate}) {
    SCOPED_TRACE(syntheticShapeNames()[static_cast<std::size_t>(shape)]);
    const TemporaryFolder folder;
    SyntheticCaptureOptions options = small(shape, SyntheticMaterial::lambert);
    options.supersampling = 1;
    writeSyntheticCapture(options, folder / "cap", Reporter::silent());
    const SyntheticObject object = readSyntheticObject(folder / "cap");
    const Capture capture = readCapture(folder / "cap");
    int shadowed = 0, wrong = 0, compared = 0;
    for (const CaptureView& view : capture.views)
      for (const Photo& photo : view.photos) {
        const ImageF pixels = readImage(photo.file).pixels;
        const Dir0 light = capture.lights[photo.light->value].direction;
        for (int y = 0; y < 40; ++y)
          for (int x = 0; x < 40; ++x) {
            const auto ray = *view.camera.ray({x + 0.5, y + 0.5});
            double t = 0;
            const auto march = [&](P0 from, const Dir0& d, double far) {  // the function of these is their distance
              for (t = 0; t < far;) {
                const double step = object.implicit(from + t * d).value;
                if (step < 1e-6) return true;
                t += step;
              }
              return false;
            };
            if (!march(ray.origin, ray.direction, 10)) continue;
            const P0 p = object.project(ray.origin + t * ray.direction);
            if (dot(object.normal(p), light) < 0.05) continue;
            const bool dark = march(p + 1e-3 * object.normal(p), light, 3);
            shadowed += dark;
            wrong += dark != (pixels.at(x, y, 0) == 0);
            ++compared;
          }
      }
    EXPECT_GT(shadowed, 50);
    EXPECT_LE(wrong, compared / 500);  // at a shadow's edge the two offsets may differ
  }
}

TEST(SyntheticCapture, SameBytesForAnyThreadCount) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::bumpy, SyntheticMaterial::velvet);
  options.noise = 0.02;
  options.exposure = 0.05;
  options.mask_error = 1;
  const std::vector<std::string> files{"images/v001/L002.exr", "masks/v002.png", "transforms.json", "model.ply"};
  std::vector<std::vector<std::byte>> first;
  for (const int threads : {1, 2}) {
    setThreadCount(threads);
    writeSyntheticCapture(options, folder / "cap", Reporter::silent());
    for (std::size_t i = 0; i < files.size(); ++i) {
      const auto bytes = readBinaryFile(folder / "cap" / files[i]);
      if (threads == 1)
        first.push_back(bytes);
      else
        EXPECT_EQ(bytes, first[i]) << files[i];
    }
  }
  setThreadCount(0);
  options.seed = 2;
  writeSyntheticCapture(options, folder / "cap", Reporter::silent());
  EXPECT_NE(readBinaryFile(folder / "cap" / files[0]), first[0]);
  EXPECT_NE(readBinaryFile(folder / "cap" / files[1]), first[1]);
  EXPECT_EQ(readBinaryFile(folder / "cap" / files[2]), first[2]);
}

TEST(SyntheticCapture, NoiseAndGainHaveTheDeviationAskedFor) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::lambert);
  options.views = 6;
  options.lights = 20;
  writeSyntheticCapture(options, folder / "clean", Reporter::silent());
  options.noise = 0.05;
  writeSyntheticCapture(options, folder / "noisy", Reporter::silent());
  options.noise = 0;
  options.exposure = 0.1;
  writeSyntheticCapture(options, folder / "gain", Reporter::silent());
  double noise = 0, gain = 0;
  int samples = 0, photos = 0;
  for (const CaptureView& view : readCapture(folder / "clean").views)
    for (const Photo& photo : view.photos) {
      const auto file = photo.file.lexically_relative(folder / "clean");
      const ImageF clean = readImage(photo.file).pixels, noisy = readImage(folder / "noisy" / file).pixels;
      const ImageF bright = readImage(folder / "gain" / file).pixels;
      double sum = 0, bright_sum = 0;
      for (std::size_t i = 0; i < clean.data().size(); ++i) {
        const double value = clean.data()[i];
        sum += value, bright_sum += bright.data()[i];
        if (value < 0.05) continue;  // far enough from zero that nothing is cut off
        // sigma^2 = noise^2 (x + 0.05 / pi) / pi, for irradiance 1
        noise += square(noisy.data()[i] - value) / (square(0.05) * (value + 0.05 / kPi) / kPi);
        ++samples;
      }
      if (sum == 0) continue;  // lit from behind
      gain += square(std::log(bright_sum / sum));
      ++photos;
    }
  // Standard error of a variance: sqrt(2 / count). 4 of them.
  EXPECT_NEAR(noise / samples, 1, 4 * std::sqrt(2.0 / samples));
  EXPECT_NEAR(gain / photos / square(0.1), 1, 4 * std::sqrt(2.0 / photos));
}

TEST(SyntheticCapture, SaturationCutsOffWhatIsBrighterAndNothingElse) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::plastic);
  writeSyntheticCapture(options, folder / "open", Reporter::silent());
  options.saturation = 0.25;
  writeSyntheticCapture(options, folder / "full", Reporter::silent());
  int cut = 0;
  for (const CaptureView& view : readCapture(folder / "open").views)
    for (const Photo& photo : view.photos) {
      const ImageF open = readImage(photo.file).pixels;
      const ImageF full = readImage(folder / "full" / photo.file.lexically_relative(folder / "open")).pixels;
      for (std::size_t i = 0; i < open.data().size(); ++i) {
        EXPECT_EQ(full.data()[i], std::min(open.data()[i], 0.25f));
        cut += open.data()[i] > 0.25f;
      }
    }
  EXPECT_GT(cut, 50);
}

TEST(SyntheticCapture, MaskErrorMovesMasksAlone) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::lambert);
  writeSyntheticCapture(options, folder / "exact", Reporter::silent());
  options.mask_error = 2;
  writeSyntheticCapture(options, folder / "off", Reporter::silent());
  EXPECT_EQ(readBinaryFile(folder / "exact/images/v000/L001.exr"), readBinaryFile(folder / "off/images/v000/L001.exr"));
  for (const CaptureView& view : readCapture(folder / "exact").views) {
    const Image8 exact = readMask(view.mask_file);
    const Image8 off = readMask(folder / "off/masks" / view.mask_file.filename());
    int differing = 0;
    for (int y = 0; y < 40; ++y)
      for (int x = 0; x < 40; ++x) {
        differing += exact.at(x, y) != off.at(x, y);
        // The silhouette is a disc of radius 16 about the centre; it moves by at most 2 + 2 pixels.
        const double r = std::hypot(x + 0.5 - 20, y + 0.5 - 20);
        if (r < 16 - 4 - 1.5) {
          EXPECT_EQ(off.at(x, y), 255);
        }
        if (r > 16 + 4 + 1.5) {
          EXPECT_EQ(off.at(x, y), 0);
        }
      }
    EXPECT_GT(differing, 10);
  }
}

TEST(SyntheticCapture, TurntableTurnsCamerasAndLightsTogether) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::box, SyntheticMaterial::lambert);
  options.rig = SyntheticRig::turntable;
  options.views = 12;
  writeSyntheticCapture(options, folder / "cap", Reporter::silent());
  const Capture capture = readCapture(folder / "cap");
  ASSERT_EQ(capture.lights.size(), 12u);  // 4 steps of 3 lights
  for (int v = 0; v < 12; ++v) {
    const Mat3 turn = rotationAbout({0, 0, 1}, -2 * kPi * (v / 3) / 4);
    const CaptureView &view = capture.views[v], &first = capture.views[v % 3];
    EXPECT_LT(length(view.camera.center().raw() - turn * first.camera.center().raw()), 1e-9);
    for (int l = 0; l < 3; ++l) {
      EXPECT_EQ(view.photos[l].light->value, static_cast<std::uint32_t>(v / 3 * 3 + l));
      EXPECT_LT(length(capture.lights[v / 3 * 3 + l].direction.raw() - turn * capture.lights[l].direction.raw()), 1e-9);
    }
  }
}

TEST(SyntheticCapture, DomeStandsAboveTheHorizonOnRings) {
  const TemporaryFolder folder;
  SyntheticCaptureOptions options = small(SyntheticShape::box, SyntheticMaterial::lambert);
  options.rig = SyntheticRig::dome;
  options.views = 30;
  options.lights = 1;
  options.size = 8;
  writeSyntheticCapture(options, folder / "cap", Reporter::silent());
  const Capture capture = readCapture(folder / "cap");
  ASSERT_EQ(capture.views.size(), 30u);
  double lowest = 90, nearest = 180;
  for (const CaptureView& a : capture.views) {
    const Vec3 da = a.camera.center().raw() / length(a.camera.center().raw());
    lowest = std::min(lowest, degrees(std::asin(da.z)));
    for (const CaptureView& b : capture.views)
      if (&a != &b)
        nearest =
            std::min(nearest, degrees(angleBetweenUnit(da, b.camera.center().raw() / length(b.camera.center().raw()))));
  }
  EXPECT_NEAR(lowest, 8, 0.01);
  EXPECT_GT(nearest, 15);  // 30 even caps over the upper half would be 26 degrees apart
}

TEST(SyntheticCapture, RefusesForeignFoldersAndLeavesNothingHalfWritten) {
  const TemporaryFolder folder;
  const SyntheticCaptureOptions options = small(SyntheticShape::sphere, SyntheticMaterial::lambert);
  writeTextFile(folder / "mine/notes.txt", "keep");
  EXPECT_THROW(writeSyntheticCapture(options, folder / "mine", Reporter::silent()), Error);
  EXPECT_EQ(readTextFile(folder / "mine/notes.txt"), "keep");
  EXPECT_THROW(readSyntheticObject(folder / "mine"), Error);

  setInterruptRequested(true);
  EXPECT_THROW(writeSyntheticCapture(options, folder / "cut", Reporter::silent()), Error);
  setInterruptRequested(false);
  SyntheticCaptureOptions wrong = options;
  wrong.views = 0;
  wrong.noise = NAN;
  EXPECT_THROW(writeSyntheticCapture(wrong, folder / "cut", Reporter::silent()), Error);
  wrong = options;
  wrong.distance = 0.5;
  EXPECT_THROW(writeSyntheticCapture(wrong, folder / "cut", Reporter::silent()), Error);
  int entries = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path())) ++entries;
  EXPECT_EQ(entries, 1);
}

TEST(SyntheticReference, CapturedViewAndLightIsThePhotograph) {
  std::vector<SyntheticObject> objects;
  for (const SyntheticMaterial material :
       {SyntheticMaterial::plastic, SyntheticMaterial::conductor, SyntheticMaterial::velvet, SyntheticMaterial::mixed})
    objects.emplace_back(SyntheticShape::torus, material);
  objects.emplace_back(SyntheticShape::bowl, SyntheticMaterial::white, true);
  objects.emplace_back(SyntheticShape::slab, SyntheticMaterial::wax);
  objects.emplace_back(SyntheticShape::ball_on_plate, SyntheticMaterial::glass);
  for (const SyntheticObject& made : objects) {
    const TemporaryFolder folder;
    SyntheticCaptureOptions options = small(made.shape(), made.material());
    options.interreflection = made.transport() == SyntheticTransport::interreflection;
    options.light_kind = LightKind::point;
    writeSyntheticCapture(options, folder / "cap", Reporter::silent());
    const SyntheticObject object = readSyntheticObject(folder / "cap");
    EXPECT_EQ(object.transport(), made.transport());
    const Capture capture = readCapture(folder / "cap");
    const CaptureView& view = capture.views[1];
    const CaptureLight& light = capture.lights[2];
    const ImageF photo = readImage(view.photos[2].file).pixels;
    ReferenceLights near_light, rest_light;
    near_light.near_lights.push_back({Point<ObjectSpace>(light.position.raw()), light.strength});
    rest_light.rest.push_back({light, 1});
    for (const ReferenceLights& lights : {near_light, rest_light}) {
      const ImageF picture = renderReference(object, kIdentity, atRest(view.camera), lights, {}, Reporter::silent());
      int differing = 0;
      for (int y = 0; y < 40; ++y)
        for (int x = 0; x < 40; ++x)
          for (int c = 0; c < 3; ++c)
            // Half precision, and hits found on two tessellations; samples at shadow edges may fall either way.
            differing += std::fabs(picture.at(x, y, c) - photo.at(x, y, c)) > 2e-3 * photo.at(x, y, c) + 2e-4;
      EXPECT_LE(differing, 40 * 40 * 3 / 200) << name(object);
    }
  }
}

TEST(SyntheticReference, EvenLightAllAroundShowsTheReflectedShare) {
  // White furnace: radiance 1 from everywhere; a matt convex object then shows its albedo.
  ReferenceLights lights;
  const int count = 1000;
  for (const Vec3& d : spherePoints(count))
    lights.distant.push_back({Direction<ObjectSpace>::fromUnit(d), (4 * kPi / count) * Vec3{1, 1, 1}});
  const SyntheticObject object(SyntheticShape::capsule, SyntheticMaterial::lambert);
  const auto camera = testCamera(16);
  const ImageF picture = renderReference(object, kIdentity, camera, lights, {.supersampling = 1}, Reporter::silent());
  int hits = 0;
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 16; ++x) {
      if (picture.at(x, y, 3) == 0) continue;
      const auto ray = *camera.ray({x + 0.5, y + 0.5});
      // From the far side of the bounding sphere, marching by the capsule's distance.
      P0 p(ray.origin.raw());
      for (int k = 0; k < 200; ++k) p = p + object.implicit(p).value * Dir0::fromUnit(ray.direction.raw());
      const Vec3 albedo = object.shadingPoint(p).albedo;
      // 1000 lights integrate the cosine to 0.3 %; at the horizon the shadow offset takes a little.
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(picture.at(x, y, c) / albedo[c], 1, 0.01);
      ++hits;
    }
  EXPECT_GT(hits, 20);
}

TEST(SyntheticReference, MovingEverythingTogetherChangesNothing) {
  const Mat3 rotation = rotationAbout(Vec3{2, -1, 2} / 3, 1.1);
  const Mat3 mirror{{Vec3{-1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}};
  const Vec3 shift{3, -1, 7};
  const double scale = 2.5;
  const SyntheticObject object(SyntheticShape::bumpy, SyntheticMaterial::conductor);
  const auto camera = testCamera(48);
  const Vec3 toward = Vec3{1, -1, 1.5} / length(Vec3{1, -1, 1.5}), lamp{-2, -2, 1};

  const auto render = [&](const Mat3& turn, const ReferenceWarp& warp, double size, const Vec3& origin) {
    ReferenceLights lights;
    lights.distant.push_back({Direction<ObjectSpace>::fromUnit(turn * toward), {1, 2, 3}});
    lights.near_lights.push_back({Point<ObjectSpace>(size * (turn * lamp) + origin), size * size * Vec3{5, 4, 3}});
    Camera<ObjectSpace> moved = camera;
    const Mat3 axes = camera.pose.rotation().raw();
    moved.pose = {Orthogonal<ObjectSpace, CameraSpace>(turn * axes),
                  Point<ObjectSpace>(size * (turn * camera.pose.origin().raw()) + origin)};
    return renderReference(object, warp, moved, lights, {}, Reporter::silent());
  };
  const ImageF rest = render(Mat3{}, kIdentity, 1, {});
  double brightest = 0;
  for (const float value : rest.data()) brightest = std::max(brightest, double{value});
  ASSERT_GT(brightest, 0.5);
  // The camera's axes are mirrored too, so that the picture is the same one. Rays in float at another place may fall to
  // the other side of a shadow's edge or the silhouette: single samples of the 16 of a pixel.
  const auto compare = [&](const ImageF& moved) {
    int differing = 0;
    for (std::size_t i = 0; i < rest.data().size(); ++i)
      differing += std::fabs(moved.data()[i] - rest.data()[i]) > 1e-4 * (1 + rest.data()[i]);
    EXPECT_LE(differing, static_cast<int>(rest.data().size() / 200));
    EXPECT_LE(largestDifference(rest, moved), brightest / 8);
  };
  compare(render(rotation, SimilarityWarp(rotation, 1, shift), 1, shift));
  compare(render(rotation, SimilarityWarp(rotation, scale, shift), scale, shift));
  compare(render(mirror, SimilarityWarp(mirror, 1, {}), 1, {}));
}

// A bend of a flat kind: the capsule's upper half leans over by a shear that grows with height.
class LeaningWarp : public ReferenceWarp {
 public:
  Point<ObjectSpace> map(const P0& p) const override {
    const Vec3& a = p.raw();
    return Point<ObjectSpace>(a.x + 0.8 * a.z * a.z, a.y, a.z);
  }
  Linear<ObjectSpace, AcquisitionSpace> jacobian(const P0& p) const override {
    return Linear<ObjectSpace, AcquisitionSpace>(Mat3{{Vec3{1, 0, 1.6 * p.raw().z}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}});
  }
  // Any rotation that takes the deformed normal to the rest one serves a matt material.
  Orthogonal<AcquisitionSpace, ObjectSpace> lookUp(const Linear<ObjectSpace, AcquisitionSpace>& jacobian,
                                                   const Dir0& n0) const override {
    const Vec3 n = inverse(jacobian.raw()).transposed() * n0.raw(), n_star = n / length(n);
    const auto frame = [](const Vec3& normal) {
      const Vec3 u = anyPerpendicular(Dir0::fromUnit(normal)).raw();
      return Mat3::fromColumns(u, cross(normal, u), normal);
    };
    return Orthogonal<AcquisitionSpace, ObjectSpace>(frame(n0.raw()) * frame(n_star).transposed());
  }
};

TEST(SyntheticReference, DeformedMattSurfaceShowsTheDeformedNormal) {
  const SyntheticObject object(SyntheticShape::capsule, SyntheticMaterial::lambert);
  const LeaningWarp warp;
  const auto camera = testCamera(64);
  const Direction<ObjectSpace> light = *normalize(Vector<ObjectSpace>(0.4, -0.3, 0.85));
  ReferenceLights lights;
  lights.distant.push_back({light, {1, 1, 1}});
  const auto picture = [&](ReferenceShadows shadows) {
    return renderReference(object, warp, camera, lights, {shadows, 1}, Reporter::silent());
  };
  const ImageF bare = picture(ReferenceShadows::none);
  int compared = 0;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) {
      if (bare.at(x, y, 3) == 0) continue;
      // The first zero of the capsule's function of the undeformed point along the ray, by small steps and bisection.
      const auto ray = *camera.ray({x + 0.5, y + 0.5});
      const auto rest = [&](double t) {
        const Vec3 p = (ray.origin + t * ray.direction).raw();
        return P0(p.x - 0.8 * p.z * p.z, p.y, p.z);
      };
      double t = 2;
      while (t < 8 && object.implicit(rest(t)).value > 0) t += 2e-3;
      double lo = t - 2e-3, hi = t;
      for (int k = 0; k < 40; ++k) (object.implicit(rest(0.5 * (lo + hi))).value > 0 ? lo : hi) = 0.5 * (lo + hi);
      const P0 p0 = rest(hi);
      const Vec3 n = inverse(warp.jacobian(p0).raw()).transposed() * object.normal(p0).raw();
      if (t >= 8 || dot(n, ray.direction.raw()) / length(n) > -0.1) continue;  // the silhouette
      const double cosine = std::max(0.0, dot(n, light.raw()) / length(n));
      // The tessellation's hit lies within 2e-5 units; over a slope of 1 / radius that is well below 1e-3.
      EXPECT_NEAR(bare.at(x, y, 0), cosine * object.shadingPoint(p0).albedo.x / kPi, 1e-3);
      ++compared;
    }
  EXPECT_GT(compared, 200);

  // At rest a convex object has no shadow of its own; leaning over, it has.
  EXPECT_EQ(largestDifference(bare, picture(ReferenceShadows::captured)), 0);
  EXPECT_GT(largestDifference(bare, picture(ReferenceShadows::deformed)), 0.02);
}

TEST(SyntheticReference, PointsThatTheWarpSendsNowhereAreHoles) {
  class HalfGone : public SimilarityWarp {
   public:
    HalfGone() : SimilarityWarp(Mat3{}, 1, {}) {}
    Point<ObjectSpace> map(const P0& p) const override {
      return p.raw().z > 0 ? Point<ObjectSpace>(NAN, 0, 0) : SimilarityWarp::map(p);
    }
  };
  ReferenceLights lights;
  lights.distant.push_back({Direction<ObjectSpace>(), {1, 1, 1}});
  const ImageF picture = renderReference(SyntheticObject(SyntheticShape::sphere, SyntheticMaterial::plastic),
                                         HalfGone(), testCamera(24), lights, {}, Reporter::silent());
  for (const float value : picture.data()) EXPECT_TRUE(std::isfinite(value));
  EXPECT_EQ(picture.at(12, 3, 3), 0);
  EXPECT_GT(picture.at(12, 16, 3), 0);
}

}  // namespace
}  // namespace srf
