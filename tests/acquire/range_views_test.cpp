// Laser range data (claim 6): noisy range views with outliers to one surface.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "acquire/shape_import.h"
#include "acquire/surface_distance.h"
#include "acquire/synthetic_capture.h"
#include "base/error.h"
#include "base/mesh_io.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

TEST(RangeViews, NoisyViewsWithOutliersGiveTheSurfaceWithinThreeSigma) {
  constexpr double kNoise = 0.01;
  for (const SyntheticShape shape : {SyntheticShape::bumpy, SyntheticShape::torus}) {
    SCOPED_TRACE(syntheticShapeNames()[static_cast<std::size_t>(shape)]);
    const test::TemporaryFolder folder;
    SyntheticCaptureOptions options;
    options.shape = shape;
    options.views = options.lights = 1;
    options.size = 56;
    options.supersampling = 1;
    options.range_views = 8;
    options.range_noise = kNoise;
    options.range_outliers = 0.05;
    writeSyntheticCapture(options, folder / "capture", Reporter::silent());
    Reporter reporter(ProgressMode::none, LogLevel::error);
    const ImportedShape surface = importShape(folder / "capture" / "ranges", reporter);
    EXPECT_GT(reporter.counters()["shape.points_dropped"], 0u);
    const MeshTopology topology = meshTopology(surface.mesh);
    EXPECT_TRUE(topology.closed && topology.manifold && topology.oriented);
    EXPECT_EQ(topology.components, 1);
    EXPECT_EQ(topology.euler_characteristic, shape == SyntheticShape::torus ? 0 : 2);
    EXPECT_GT(meshVolume(surface.mesh), 0);
    const AcquisitionMesh truth = readMesh(folder / "capture" / "model.ply");
    for (auto off :
         {distancesTo(truth, pointsOn(surface.mesh, 20000)), distancesTo(surface.mesh, pointsOn(truth, 20000))}) {
      std::sort(off.begin(), off.end());
      EXPECT_LT(off[off.size() * 95 / 100], 3 * kNoise);
      RecordProperty("p95_in_sigma", std::to_string(off[off.size() * 95 / 100] / kNoise));
    }
  }
}

TEST(RangeViews, TheSameViewsGiveTheSameBits) {
  const test::TemporaryFolder folder;
  SyntheticCaptureOptions options;
  options.views = options.lights = 1;
  options.size = 40;
  options.supersampling = 1;
  options.range_views = 6;
  options.range_noise = 0.01;
  options.range_outliers = 0.05;
  writeSyntheticCapture(options, folder / "capture", Reporter::silent());
  // With the sensors' places, and as one cloud whose normals neighbours settle.
  AcquisitionMesh cloud;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "capture" / "ranges")) {
    const auto points = readRangeView(entry.path()).points.positions;
    cloud.positions.insert(cloud.positions.end(), points.begin(), points.end());
  }
  std::vector<AcquisitionMesh> first;
  for (unsigned seed = 0; seed < 5; ++seed)
    for (const bool views : {true, false}) {
      test::scatterHeap(seed);
      const AcquisitionMesh mesh = (views ? importShape(folder / "capture" / "ranges", Reporter::silent())
                                          : importShape(cloud, "cloud", Reporter::silent()))
                                       .mesh;
      if (seed == 0) {
        first.push_back(mesh);
        continue;
      }
      const AcquisitionMesh& before = first[views ? 0 : 1];
      EXPECT_TRUE(mesh.positions == before.positions) << seed << views;
      EXPECT_TRUE(mesh.triangles == before.triangles) << seed << views;
      EXPECT_TRUE(mesh.normals == before.normals) << seed << views;
    }
}

TEST(RangeViews, TheSensorsPlaceSurvivesTheFile) {
  const test::TemporaryFolder folder;
  RangeView view;
  view.sensor = Point<AcquisitionSpace>(1, -2, 3e6);
  for (int i = 0; i < 5; ++i) view.points.positions.emplace_back(i, 0.1 * i, -i);
  writeRangeView(folder / "a.ply", view);
  const RangeView back = readRangeView(folder / "a.ply");
  ASSERT_TRUE(back.sensor);
  EXPECT_EQ(*back.sensor, *view.sensor);
  EXPECT_EQ(back.points.positions, view.points.positions);
  EXPECT_EQ(readMesh(folder / "a.ply").positions, view.points.positions);
  view.sensor.reset();
  writeRangeView(folder / "b.ply", view);
  EXPECT_FALSE(readRangeView(folder / "b.ply").sensor);

  const test::TemporaryFolder empty;
  EXPECT_THROW(importShape(empty.path(), Reporter::silent()), Error);
  AcquisitionMesh triangle;
  triangle.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  triangle.triangles = {{0, 1, 2}};
  writePly(empty / "a.ply", triangle);
  writeRangeView(empty / "b.ply", view);
  EXPECT_THROW(importShape(empty.path(), Reporter::silent()), Error);
}

}  // namespace
}  // namespace srf
