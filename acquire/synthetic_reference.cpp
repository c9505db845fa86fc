#include "acquire/synthetic_reference.h"

#include <cmath>
#include <optional>
#include <span>

#include "base/parallel.h"
#include "base/ray_scene.h"

namespace srf {
namespace {

constexpr int kCells = 160;               // 307k triangles
constexpr double kShadowOffset = 2.5e-4;  // of the diameter: beyond the tessellation's error, far below a pixel
// n.v below this is the inside of the surface, seen through a fold: black, as no photograph shows it. Down to here it
// is the error of a point found on the tessellation at a silhouette.
constexpr double kInside = -0.02;

// Where a sample of the picture meets the deformed surface.
struct Sample {
  int x;
  ShadingPoint point;
  Direction<AcquisitionSpace> view;
  Orthogonal<AcquisitionSpace, ObjectSpace> acquisition_from_object;  // L
  Point<ObjectSpace> p_star;
  Direction<ObjectSpace> n_star;
};

// What arrives at a sample from one light.
struct Incident {
  Direction<AcquisitionSpace> light;
  Direction<ObjectSpace> light_star;
  double distance;       // to the light in the deformed scene
  double rest_distance;  // to a light of the capture
  Vec3 irradiance;
};

class ReferenceScene {
 public:
  ReferenceScene(const SyntheticObject& object, const ReferenceWarp& warp, const ReferenceLights& lights,
                 ReferenceShadows shadows)
      : object_(object), warp_(warp), lights_(lights), shadows_(shadows), mesh_(object.tessellate(kCells)) {
    std::vector<Point<ObjectSpace>> moved(mesh_.positions.size());
    parallelFor(moved.size(), 4096, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) moved[i] = warp.map(mesh_.positions[i]);
    });
    Box<ObjectSpace> box;
    for (const auto& p : moved)
      if (isFinite(p)) box.extend(p);
    offset_ = kShadowOffset * box.diameter();
    deformed_ = RayScene<ObjectSpace>::ofTriangles(moved, mesh_.triangles);
    // A convex object casts no shadow on itself at rest.
    if (shadows != ReferenceShadows::none && !object.convex())
      rest_ = RayScene<AcquisitionSpace>::ofTriangles(mesh_.positions, mesh_.triangles);
    rest_offset_ = kShadowOffset * mesh_.bounds().diameter();
  }

  void renderRow(const Camera<ObjectSpace>& camera, int n, int y, float* rgba) const {
    std::vector<double> sum(4 * static_cast<std::size_t>(camera.lens.width), 0.0);
    const std::vector<Sample> samples = meetRow(camera, n, y, sum);
    for (const auto& light : lights_.distant)
      add(samples, sum, false, [&](const Sample& s) {
        return Incident{s.acquisition_from_object * light.direction, light.direction, INFINITY, INFINITY,
                        light.irradiance};
      });
    for (const auto& light : lights_.near_lights)
      add(samples, sum, false, [&](const Sample& s) {
        const double d = distance(light.position, s.p_star);
        const auto to = normalize(light.position - s.p_star).value_or(s.n_star);
        return Incident{s.acquisition_from_object * to, to, d, INFINITY, d > 0 ? light.intensity / (d * d) : Vec3{}};
      });
    for (const auto& [light, scale] : lights_.rest)
      add(samples, sum, true, [&, scale = scale](const Sample& s) {
        const auto to = light.directionFrom(s.point.p);
        const double d = light.kind == LightKind::point ? distance(light.position, s.point.p) : INFINITY;
        return Incident{to, s.acquisition_from_object.inverse() * to, INFINITY, d,
                        scale * light.irradianceAt(s.point.p)};
      });
    for (std::size_t i = 0; i < sum.size(); ++i) rgba[i] = static_cast<float>(sum[i] / (n * n));
  }

 private:
  // The samples of a row of pixels that meet the surface, those of a pixel together; counts them in the row's alpha.
  std::vector<Sample> meetRow(const Camera<ObjectSpace>& camera, int n, int y, std::vector<double>& rgba) const {
    std::vector<Ray<ObjectSpace>> rays;
    std::vector<int> column;
    for (int x = 0; x < camera.lens.width; ++x)
      for (int k = 0; k < n * n; ++k)
        if (const auto ray = camera.ray({x + (k % n + 0.5) / n, y + (k / n + 0.5) / n})) {
          rays.push_back(*ray);
          column.push_back(x);
        }
    std::vector<TriangleHit> hits(rays.size());
    deformed_->intersect(rays, hits);
    std::vector<Sample> samples;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      if (!hits[i].hit()) continue;
      rgba[4 * column[i] + 3] += 1;
      if (auto sample = sampleAt(hits[i], camera)) {
        sample->x = column[i];
        samples.push_back(*sample);
      }
    }
    return samples;
  }

  // Nothing where the inside is seen, or where Psi collapses the surface.
  std::optional<Sample> sampleAt(const TriangleHit& hit, const Camera<ObjectSpace>& camera) const {
    const Triangle& t = mesh_.triangles[hit.triangle];
    const Point<AcquisitionSpace>&a = mesh_.positions[t[0]], &b = mesh_.positions[t[1]], &c = mesh_.positions[t[2]];
    const auto p0 = object_.project(a + double{hit.b1} * (b - a) + double{hit.b2} * (c - a));
    const ShadingPoint point = object_.shadingPoint(p0);
    const auto jacobian = warp_.jacobian(p0);
    const Mat3& j = jacobian.raw();
    const double det = determinant(jacobian);
    // The cofactor matrix carries normals; where Psi mirrors it turns them inwards.
    const Vec3 &r0 = j.row[0], &r1 = j.row[1], &r2 = j.row[2];
    const Mat3 cofactor{{cross(r1, r2), cross(r2, r0), cross(r0, r1)}};
    const auto n_star = normalize(Vector<ObjectSpace>((det < 0 ? -1.0 : 1.0) * (cofactor * point.normal.raw())));
    if (!n_star) return std::nullopt;
    const Point<ObjectSpace> p_star = warp_.map(p0);
    if (!isFinite(p_star)) return std::nullopt;
    const auto v_star = camera.viewDirection(p_star);
    if (dot(*n_star, v_star) < kInside) return std::nullopt;
    const auto look_up = warp_.lookUp(jacobian, point.normal);
    return Sample{0, point, look_up * v_star, look_up, p_star, *n_star};
  }

  template <class IncidentAt>
  void add(const std::vector<Sample>& samples, std::vector<double>& rgba, bool fixed_to_rest,
           const IncidentAt& incident_at) const {
    std::vector<const Sample*> lit;
    std::vector<Incident> incident;
    for (const Sample& s : samples) {
      const Incident in = incident_at(s);
      if (!(dot(s.point.normal, in.light) > 0)) continue;
      lit.push_back(&s);
      incident.push_back(in);
    }
    const std::vector<std::uint8_t> blocked = shadow(lit, incident, fixed_to_rest);
    for (std::size_t i = 0; i < lit.size(); ++i) {
      if (blocked[i]) continue;
      const Sample& s = *lit[i];
      const Incident& in = incident[i];
      const Vec3 radiance = dot(s.point.normal, in.light) * (brdf(s.point, in.light, s.view) * in.irradiance);
      for (int c = 0; c < 3; ++c) rgba[4 * s.x + c] += radiance[c];
    }
  }

  std::vector<std::uint8_t> shadow(const std::vector<const Sample*>& lit, const std::vector<Incident>& incident,
                                   bool fixed_to_rest) const {
    std::vector<std::uint8_t> blocked(lit.size(), 0);
    if (shadows_ == ReferenceShadows::none) return blocked;
    std::vector<double> far(lit.size());
    if (fixed_to_rest || shadows_ == ReferenceShadows::captured) {
      if (!rest_) return blocked;
      std::vector<Ray<AcquisitionSpace>> rays(lit.size());
      for (std::size_t i = 0; i < lit.size(); ++i) {
        rays[i] = {lit[i]->point.p + rest_offset_ * lit[i]->point.normal, incident[i].light};
        far[i] = incident[i].rest_distance;
      }
      rest_->occluded(rays, far, 0, blocked);
    } else {
      std::vector<Ray<ObjectSpace>> rays(lit.size());
      for (std::size_t i = 0; i < lit.size(); ++i) {
        rays[i] = {lit[i]->p_star + offset_ * lit[i]->n_star, incident[i].light_star};
        far[i] = incident[i].distance;
      }
      deformed_->occluded(rays, far, 0, blocked);
    }
    return blocked;
  }

  const SyntheticObject& object_;
  const ReferenceWarp& warp_;
  const ReferenceLights& lights_;
  ReferenceShadows shadows_;
  AcquisitionMesh mesh_;
  std::optional<RayScene<ObjectSpace>> deformed_;
  std::optional<RayScene<AcquisitionSpace>> rest_;
  double offset_ = 0, rest_offset_ = 0;
};

}  // namespace

const std::vector<std::string>& referenceShadowNames() {
  static const std::vector<std::string> names{"none", "captured", "deformed"};
  return names;
}

ImageF renderReference(const SyntheticObject& object, const ReferenceWarp& warp, const Camera<ObjectSpace>& camera,
                       const ReferenceLights& lights, const ReferenceOptions& options, Reporter& reporter) {
  const ReferenceScene scene(object, warp, lights, options.shadows);
  ImageF picture(camera.lens.width, camera.lens.height, 4);
  Reporter::Stage stage(reporter, "reference", picture.height());
  parallelFor(picture.height(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      scene.renderRow(camera, options.supersampling, static_cast<int>(y), picture.row(static_cast<int>(y)));
      stage.advance();
    }
  });
  return picture;
}

}  // namespace srf
