#include "acquire/synthetic_reference.h"

#include <cmath>
#include <optional>
#include <random>
#include <span>

#include "acquire/synthetic_indirect.h"
#include "base/numeric.h"
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
  int x = 0;
  double weight = 1;
  ShadingPoint point;
  Direction<AcquisitionSpace> view;
  Orthogonal<AcquisitionSpace, ObjectSpace> acquisition_from_object;  // L
  Point<ObjectSpace> p_star;
  Direction<ObjectSpace> n_star;
  IndirectLight::Place place{};
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
                 const ReferenceOptions& options)
      : object_(object),
        warp_(warp),
        lights_(lights),
        options_(options),
        shadows_(options.shadows),
        mesh_(object.tessellate(kCells)) {
    std::vector<Point<ObjectSpace>> moved(mesh_.positions.size());
    parallelFor(moved.size(), 4096, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) moved[i] = warp.map(mesh_.positions[i]);
    });
    Box<ObjectSpace> box;
    for (const auto& p : moved)
      if (isFinite(p)) box.extend(p);
    offset_ = kShadowOffset * box.diameter();
    deformed_ = RayScene<ObjectSpace>::ofTriangles(moved, mesh_.triangles);
    const std::vector<Triangle> casters = object.casters(mesh_);
    if (casters.size() < mesh_.triangles.size()) deformed_casters_ = RayScene<ObjectSpace>::ofTriangles(moved, casters);
    // A convex object casts no shadow on itself at rest.
    if (shadows_ != ReferenceShadows::none && !object.convex())
      rest_casters_ = RayScene<AcquisitionSpace>::ofTriangles(mesh_.positions, casters);
    rest_offset_ = kShadowOffset * mesh_.bounds().diameter();
    solveIndirect();
  }

  void renderRow(const Camera<ObjectSpace>& camera, int y, float* rgba) const {
    const int n = options_.supersampling;
    std::vector<double> sum(4 * static_cast<std::size_t>(camera.lens.width), 0.0);
    const std::vector<Sample> samples = meetRow(camera, n, y, sum);
    const auto add = [&](const Sample& s, const Vec3& radiance) {
      for (int c = 0; c < 3; ++c) sum[4 * s.x + c] += s.weight * radiance[c];
    };
    for (const bool rest : {false, true})
      illuminate(samples, rest, [&](std::size_t i, const Incident& in, const Vec3& irradiance) {
        add(samples[i], brdf(samples[i].point, in.light, samples[i].view) * irradiance);
      });
    for (const IndirectLight& indirect : indirect_)
      for (const Sample& s : samples) add(s, (1 / kPi) * (s.point.albedo * indirect.at(s.place, 0)));
    for (std::size_t i = 0; i < sum.size(); ++i) rgba[i] = static_cast<float>(sum[i] / (n * n));
  }

 private:
  // The samples of a row of pixels that meet the surface, those of a pixel together; counts them in the row's alpha.
  std::vector<Sample> meetRow(const Camera<ObjectSpace>& camera, int n, int y, std::vector<double>& rgba) const {
    std::vector<Ray<ObjectSpace>> rays;
    std::vector<int> column;
    std::mt19937_64 random(y);  // of the row: the same for any thread count
    for (int x = 0; x < camera.lens.width; ++x)
      for (int k = 0; k < n * n; ++k)
        if (const auto ray = camera.ray({x + (k % n + 0.5) / n, y + (k / n + 0.5) / n})) {
          rays.push_back(options_.lens ? throughLens(*ray, camera, random) : *ray);
          column.push_back(x);
        }
    std::vector<TriangleHit> hits(rays.size());
    deformed_->intersect(rays, hits);
    std::vector<Sample> samples;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      if (options_.ground && meetsGround(rays[i], hits[i], &rgba[4 * column[i]])) continue;
      if (!hits[i].hit()) continue;
      rgba[4 * column[i] + 3] += 1;
      addSamples(hits[i], camera, rays[i].origin, column[i], samples);
    }
    return samples;
  }

  // From a point of the lens drawn at random to where the ray through its centre meets the plane in focus.
  Ray<ObjectSpace> throughLens(const Ray<ObjectSpace>& ray, const Camera<ObjectSpace>& camera,
                               std::mt19937_64& random) const {
    std::uniform_real_distribution<double> across(-1, 1);
    double x, y;
    do x = across(random), y = across(random);
    while (x * x + y * y > 1);
    const double ahead = dot(ray.direction, camera.forward());
    if (!(ahead > 1e-6)) return ray;
    const double r = options_.lens->aperture;
    const auto origin = ray.origin + camera.pose.rotation() * Vector<CameraSpace>(r * x, r * y, 0);
    const auto in_focus = ray.origin + (options_.lens->focus / ahead) * ray.direction;
    return {origin, normalize(in_focus - origin).value_or(ray.direction)};
  }

  // Adds the ground to a pixel where the ray comes upon it first.
  bool meetsGround(const Ray<ObjectSpace>& ray, const TriangleHit& hit, double* rgba) const {
    const ReferenceGround& ground = *options_.ground;
    const double t = (ground.height - ray.origin.raw().z) / ray.direction.raw().z;
    if (!(ray.direction.raw().z < 0 && t > 0) || (hit.hit() && hit.distance < t)) return false;
    const auto p = ray.origin + t * ray.direction;
    const Point<ObjectSpace> from(p.raw().x, p.raw().y, ground.height + 1e-3 * offset_);
    Vec3 open, lit;
    std::vector<Ray<ObjectSpace>> rays;
    std::vector<double> far;
    std::vector<Vec3> irradiance;
    const auto ask = [&](const Direction<ObjectSpace>& to, double distance, const Vec3& normal_irradiance) {
      if (!(to.raw().z > 0)) return;
      rays.push_back({from, to});
      far.push_back(distance);
      irradiance.push_back(to.raw().z * normal_irradiance);
    };
    for (const auto& light : lights_.distant) ask(light.direction, INFINITY, light.irradiance);
    for (const auto& light : lights_.near_lights) {
      const double d = distance(light.position, from);
      if (const auto to = normalize(light.position - from)) ask(*to, d, light.intensity / (d * d));
    }
    std::vector<std::uint8_t> blocked(rays.size());
    (deformed_casters_ ? *deformed_casters_ : *deformed_).occluded(rays, far, 0, blocked);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      open += irradiance[i];
      if (!blocked[i]) lit += irradiance[i];
    }
    const Vec3 luminance{0.2126, 0.7152, 0.0722};
    if (ground.shadow_only) {
      rgba[3] += dot(luminance, open) > 0 ? 1 - dot(luminance, lit) / dot(luminance, open) : 0;
    } else {
      for (int c = 0; c < 3; ++c) rgba[c] += ground.albedo[c] / kPi * lit[c];
      rgba[3] += 1;
    }
    return true;
  }

  // What is seen at a hit; nothing where the inside is seen, or where Psi collapses the surface. Through glass the
  // object is seen as at rest from the direction that L gives, and each point of it lit where Psi has put it.
  void addSamples(const TriangleHit& hit, const Camera<ObjectSpace>& camera, const Point<ObjectSpace>& eye, int x,
                  std::vector<Sample>& samples) const {
    const Triangle& t = mesh_.triangles[hit.triangle];
    const Point<AcquisitionSpace>&a = mesh_.positions[t[0]], &b = mesh_.positions[t[1]], &c = mesh_.positions[t[2]];
    const auto p0 = object_.project(a + double{hit.b1} * (b - a) + double{hit.b2} * (c - a));
    const auto first = surfaceAt(object_.shadingPoint(p0));
    if (!first) return;
    const auto seen_along = camera.viewDirection(first->p_star);
    const auto v_star = options_.lens ? normalize(eye - first->p_star).value_or(seen_along) : seen_along;
    if (dot(first->n_star, v_star) < kInside) return;
    for (const auto& [point, view, weight] : object_.seenAt(p0, first->acquisition_from_object * v_star)) {
      auto sample = point.p == p0 ? first : surfaceAt(point);
      if (!sample) continue;
      sample->x = x, sample->weight = weight, sample->view = view;
      if (!indirect_.empty()) sample->place = indirect_[0].place(point.p, point.normal);
      samples.push_back(*sample);
    }
  }

  // Nothing where Psi collapses the surface.
  std::optional<Sample> surfaceAt(const ShadingPoint& point) const {
    const auto jacobian = warp_.jacobian(point.p);
    const Mat3& j = jacobian.raw();
    const double det = determinant(jacobian);
    // The cofactor matrix carries normals; where Psi mirrors it turns them inwards.
    const Vec3 &r0 = j.row[0], &r1 = j.row[1], &r2 = j.row[2];
    const Mat3 cofactor{{cross(r1, r2), cross(r2, r0), cross(r0, r1)}};
    const auto n_star = normalize(Vector<ObjectSpace>((det < 0 ? -1.0 : 1.0) * (cofactor * point.normal.raw())));
    if (!n_star) return std::nullopt;
    const Point<ObjectSpace> p_star = warp_.map(point.p);
    if (!isFinite(p_star)) return std::nullopt;
    return Sample{0, 1, point, point.normal, warp_.lookUp(jacobian, point.normal), p_star, *n_star};
  }

  // What the object itself passes on of the scene's lights and of the captured ones. Reflected light travels between
  // the places that the shadows are cast in; without cast shadows there is none.
  void solveIndirect() {
    const SyntheticTransport transport = object_.transport();
    if (transport == SyntheticTransport::direct) return;
    if (transport == SyntheticTransport::interreflection && shadows_ == ReferenceShadows::none) return;
    IndirectLight::Pose pose;
    if (shadows_ == ReferenceShadows::deformed)
      pose = [&](const auto& p) { return Point<IndirectLight::TravelSpace>(warp_.map(p).raw()); };
    for (const bool rest : {false, true}) {
      if (rest ? lights_.rest.empty() : lights_.distant.empty() && lights_.near_lights.empty()) continue;
      IndirectLight& indirect = indirect_.emplace_back(object_, rest ? IndirectLight::Pose() : pose);
      std::vector<Sample> probes;
      std::vector<std::size_t> of_probe;
      for (std::size_t i = 0; i < indirect.probes().size(); ++i)
        if (const auto sample = surfaceAt(object_.shadingPoint(indirect.probes()[i]))) {
          probes.push_back(*sample);
          of_probe.push_back(i);
        }
      indirect.solve(1, [&](std::size_t) {
        std::vector<Vec3> sum(indirect.probes().size());
        illuminate(probes, rest,
                   [&](std::size_t i, const Incident&, const Vec3& irradiance) { sum[of_probe[i]] += irradiance; });
        return sum;
      });
    }
  }

  // Calls use(sample, what arrives, irradiance on the surface there) for each light of the scene, or each captured one,
  // and each sample that it reaches.
  template <class Use>
  void illuminate(const std::vector<Sample>& samples, bool rest, const Use& use) const {
    if (rest) {
      for (const auto& [light, scale] : lights_.rest)
        reach(samples, true, use, [&, scale = scale](const Sample& s) {
          const auto to = light.directionFrom(s.point.p);
          const double d = light.kind == LightKind::point ? distance(light.position, s.point.p) : INFINITY;
          return Incident{to, s.acquisition_from_object.inverse() * to, INFINITY, d,
                          scale * light.irradianceAt(s.point.p)};
        });
      return;
    }
    for (const auto& light : lights_.distant)
      reach(samples, false, use, [&](const Sample& s) {
        return Incident{s.acquisition_from_object * light.direction, light.direction, INFINITY, INFINITY,
                        light.irradiance};
      });
    for (const auto& light : lights_.near_lights)
      reach(samples, false, use, [&](const Sample& s) {
        const double d = distance(light.position, s.p_star);
        const auto to = normalize(light.position - s.p_star).value_or(s.n_star);
        return Incident{s.acquisition_from_object * to, to, d, INFINITY, d > 0 ? light.intensity / (d * d) : Vec3{}};
      });
  }

  template <class Use, class IncidentAt>
  void reach(const std::vector<Sample>& samples, bool fixed_to_rest, const Use& use,
             const IncidentAt& incident_at) const {
    std::vector<std::size_t> lit;
    std::vector<Incident> incident;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const Incident in = incident_at(samples[i]);
      if (!(dot(samples[i].point.normal, in.light) > 0)) continue;
      lit.push_back(i);
      incident.push_back(in);
    }
    const std::vector<std::uint8_t> blocked = shadow(samples, lit, incident, fixed_to_rest);
    for (std::size_t k = 0; k < lit.size(); ++k)
      if (!blocked[k])
        use(lit[k], incident[k], dot(samples[lit[k]].point.normal, incident[k].light) * incident[k].irradiance);
  }

  std::vector<std::uint8_t> shadow(const std::vector<Sample>& samples, const std::vector<std::size_t>& lit,
                                   const std::vector<Incident>& incident, bool fixed_to_rest) const {
    std::vector<std::uint8_t> blocked(lit.size(), 0);
    if (shadows_ == ReferenceShadows::none) return blocked;
    std::vector<double> far(lit.size());
    if (fixed_to_rest || shadows_ == ReferenceShadows::captured) {
      if (!rest_casters_) return blocked;
      std::vector<Ray<AcquisitionSpace>> rays(lit.size());
      for (std::size_t i = 0; i < lit.size(); ++i) {
        const Sample& s = samples[lit[i]];
        rays[i] = {s.point.p + rest_offset_ * s.point.normal, incident[i].light};
        far[i] = incident[i].rest_distance;
      }
      rest_casters_->occluded(rays, far, 0, blocked);
    } else {
      std::vector<Ray<ObjectSpace>> rays(lit.size());
      for (std::size_t i = 0; i < lit.size(); ++i) {
        const Sample& s = samples[lit[i]];
        rays[i] = {s.p_star + offset_ * s.n_star, incident[i].light_star};
        far[i] = incident[i].distance;
      }
      (deformed_casters_ ? *deformed_casters_ : *deformed_).occluded(rays, far, 0, blocked);
    }
    return blocked;
  }

  const SyntheticObject& object_;
  const ReferenceWarp& warp_;
  const ReferenceLights& lights_;
  const ReferenceOptions& options_;
  ReferenceShadows shadows_;
  AcquisitionMesh mesh_;
  std::optional<RayScene<ObjectSpace>> deformed_, deformed_casters_;
  std::optional<RayScene<AcquisitionSpace>> rest_casters_;
  std::vector<IndirectLight> indirect_;  // of the scene's lights, of the captured ones; where there are both or either
  double offset_ = 0, rest_offset_ = 0;
};

}  // namespace

const std::vector<std::string>& referenceShadowNames() {
  static const std::vector<std::string> names{"none", "captured", "deformed"};
  return names;
}

ImageF renderReference(const SyntheticObject& object, const ReferenceWarp& warp, const Camera<ObjectSpace>& camera,
                       const ReferenceLights& lights, const ReferenceOptions& options, Reporter& reporter) {
  const ReferenceScene scene(object, warp, lights, options);
  ImageF picture(camera.lens.width, camera.lens.height, 4);
  Reporter::Stage stage(reporter, "reference", picture.height());
  parallelFor(picture.height(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      scene.renderRow(camera, static_cast<int>(y), picture.row(static_cast<int>(y)));
      stage.advance();
    }
  });
  return picture;
}

}  // namespace srf
