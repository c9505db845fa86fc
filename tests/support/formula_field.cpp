#include "tests/support/formula_field.h"

#include <map>

#include "base/image_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "field/reflectance_store.h"

namespace srf::test {

Vec3 fibonacci(int i, int n) {
  const double z = 1 - (2.0 * i + 1) / n, r = std::sqrt(1 - z * z), phi = kPi * (1 + std::sqrt(5.0)) * (i + 0.5);
  return {r * std::cos(phi), r * std::sin(phi), z};
}

AcquisitionMesh unitSphere(int subdivision) {
  AcquisitionMesh mesh;
  for (const Vec3& p : {Vec3{1, 0, 0}, Vec3{-1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, -1, 0}, Vec3{0, 0, 1}, Vec3{0, 0, -1}})
    mesh.positions.emplace_back(p);
  mesh.triangles = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int level = 0; level < subdivision; ++level) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middle;
    const auto split = [&](std::uint32_t a, std::uint32_t b) {
      const auto [it, fresh] = middle.try_emplace(std::minmax(a, b), mesh.positions.size());
      if (fresh) {
        const Vec3 m = mesh.positions[a].raw() + mesh.positions[b].raw();
        mesh.positions.emplace_back(m / length(m));
      }
      return it->second;
    };
    std::vector<Triangle> finer;
    for (const Triangle& t : mesh.triangles) {
      const std::uint32_t a = split(t[0], t[1]), b = split(t[1], t[2]), c = split(t[2], t[0]);
      finer.insert(finer.end(), {{t[0], a, c}, {t[1], b, a}, {t[2], c, b}, {a, b, c}});
    }
    mesh.triangles = std::move(finer);
  }
  for (const auto& p : mesh.positions) mesh.normals.push_back(Direction<AcquisitionSpace>::fromUnit(p.raw()));
  return mesh;
}

FormulaField makeSphereField(const std::filesystem::path& srf_folder, const FormulaFieldOptions& options,
                             const ReflectanceFormula& reflectance) {
  FormulaField field{srf_folder, {}, {}};
  SrfManifest& manifest = field.manifest;
  manifest.source = "formula";
  std::filesystem::create_directories(srf_folder / "views");
  for (int j = 0; j < options.lights; ++j) {
    const Vec3 d = fibonacci(j, options.lights);
    CaptureLight light;
    light.name = "L" + std::to_string(j);
    light.direction = Direction<AcquisitionSpace>::fromUnit(d);
    if (options.near_lights) {
      light.kind = LightKind::point;
      light.position = Point<AcquisitionSpace>(options.middle + 3 * options.radius * d);
      light.strength = {9, 9, 9};
    }
    manifest.lights.push_back(light);
  }
  manifest.views.resize(options.views);
  const auto make_view = [&](int i) {
    StoredView& view = manifest.views[i];
    view.name = "v" + std::to_string(i);
    view.camera.lens = pinholeFromFov(options.size, options.size, 33);
    const Vec3 eye = options.view_distance * fibonacci(i, options.views);
    const Vec3 up = std::fabs(eye.z) < 0.95 * options.view_distance ? Vec3{0, 0, 1} : Vec3{1, 0, 0};
    view.camera.pose = *lookAt(Point<AcquisitionSpace>(options.middle + options.radius * eye),
                               Point<AcquisitionSpace>(options.middle), Vector<AcquisitionSpace>(up));
    for (int j = 0; j < options.lights; ++j) view.lights.push_back(LightId{static_cast<std::uint32_t>(j)});

    StoreGeometry geometry;
    geometry.image_width = geometry.image_height = options.size;
    geometry.tiles_x = geometry.tiles_y = (options.size + kTile - 1) / kTile;
    geometry.light_count = options.lights;
    if (options.levels) geometry.levels = geometry.mostLevels();
    Image8 coverage(geometry.cropWidth(), geometry.cropHeight(), 1);
    std::vector<std::vector<std::uint16_t>> tiles(geometry.tileCount(),
                                                  std::vector<std::uint16_t>(geometry.blockHalves(), 0));
    for (int y = 0; y < options.size; ++y)
      for (int x = 0; x < options.size; ++x) {
        std::vector<Vec3> sum(options.lights);
        const int n = options.samples;
        bool met = true;
        for (int k = 0; k < n * n && met; ++k) {
          const auto ray = view.camera.ray({x + (k % n + 0.5) / n, y + (k / n + 0.5) / n});
          const Vec3 o = eye, d = ray->direction.raw();  // in radii about the middle
          const double b = dot(o, d), root = b * b - (dot(o, o) - 1);
          met = root > 0;
          if (!met) break;
          const Vec3 p = o + (-b - std::sqrt(root)) * d;
          const Point<AcquisitionSpace> point(options.middle + options.radius * p);
          for (int j = 0; j < options.lights; ++j) {
            const CaptureLight& light = manifest.lights[j];
            sum[j] += reflectance(p, light.directionFrom(point).raw(), -d) * light.irradianceAt(point);
          }
        }
        if (!met) continue;
        coverage.at(x, y) = 255;
        auto& tile = tiles[static_cast<std::size_t>(y / kTile) * geometry.tiles_x + x / kTile];
        std::uint16_t* texel = tile.data() + ((y % kTile) * kTile + x % kTile) * geometry.texelHalves();
        for (int j = 0; j < options.lights; ++j)
          for (int c = 0; c < 3; ++c)
            texel[c * geometry.lightPad() + j] = halfFromFloat(static_cast<float>(sum[j][c] / (n * n)));
      }
    view.file = "views/" + view.name + ".blk";
    ReflectanceStoreWriter writer(srf_folder / view.file, geometry, coverage, options.coding);
    for (int t = 0; t < geometry.tileCount(); ++t) {
      bool covered = false;
      for (int i = 0; i < kTile * kTile; ++i)
        covered = covered ||
                  coverage.at(t % geometry.tiles_x * kTile + i % kTile, t / geometry.tiles_x * kTile + i / kTile) > 0;
      if (covered) writer.writeTile(t % geometry.tiles_x, t / geometry.tiles_x, tiles[t]);
    }
    view.hash = writer.commit();
  };
  const auto views = static_cast<std::size_t>(options.views);
  parallelFor(views, options.parallel ? 1 : views, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) make_view(static_cast<int>(i));
  });
  writeManifest(srf_folder, manifest);
  AcquisitionMesh sphere = unitSphere(options.subdivision);
  for (auto& p : sphere.positions) p = Point<AcquisitionSpace>(options.middle + options.radius * p.raw());
  field.model = buildModel(sphere, "sphere", 1e-6 * options.radius, manifest, options.model, Reporter::silent());
  return field;
}

}  // namespace srf::test
