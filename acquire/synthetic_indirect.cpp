#include "acquire/synthetic_indirect.h"

#include <algorithm>
#include <cmath>

#include "base/numeric.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr int kCells = 24;   // 6912 triangles, 3458 vertices
constexpr int kProbes = 4;   // a triangle: the middles of its four quarters
constexpr int kRays = 1000;  // a vertex
constexpr double kGoldenAngle = 2.39996322972865332;
constexpr int kBounces = 8;                // the white bowl's hollow keeps 0.43 of each: 0.1 % is left out
constexpr double kOffset = 1e-3;           // units: of rays from a vertex, beyond the tessellation's error
constexpr double kProbeHeight = 0.02;      // units above the surface, whence the coarse mesh is looked for
constexpr std::size_t kLightsAtOnce = 64;  // bounds the memory: 19 kB a light and thousand triangles
constexpr Vec3 kScatter{0.12, 0.06, 0.04};
constexpr int kDeepest = 5;  // times that a triangle near a vertex is quartered

struct Corners {
  Vec3 a, b, c;
  Vec3 middle() const { return (a + b + c) / 3; }
  double area() const { return 0.5 * length(cross(b - a, c - a)); }
  double size() const { return std::sqrt(std::max({dot(b - a, b - a), dot(c - b, c - b), dot(a - c, a - c)})); }
  std::array<Corners, 4> quarters() const {
    const Vec3 ab = 0.5 * (a + b), bc = 0.5 * (b + c), ca = 0.5 * (c + a);
    return {Corners{a, ab, ca}, Corners{ab, b, bc}, Corners{ca, bc, c}, Corners{bc, ca, ab}};
  }
};

// Integral of R(|p - q|) over a triangle, per channel: its middle times its area, quartered where it is near.
Vec3 profileOver(const Vec3& p, const Corners& triangle, int depth) {
  const Vec3 middle = triangle.middle();
  const double r = length(p - middle);
  if (depth < kDeepest && r < 2 * triangle.size()) {
    Vec3 sum;
    for (const Corners& quarter : triangle.quarters()) sum += profileOver(p, quarter, depth + 1);
    return sum;
  }
  Vec3 value;
  for (int c = 0; c < 3; ++c) {
    const double far = std::exp(-r / (3 * kScatter[c]));
    value[c] = (far * far * far + far) / r;
  }
  return triangle.area() * value;
}

// The k-th of kRays directions about z whose density is the cosine: an even spiral over the disc, lifted to the
// hemisphere above it.
Vec3 cosineDirection(int k, double turn) {
  const double square_r = (k + 0.5) / kRays, r = std::sqrt(square_r), angle = kGoldenAngle * k + turn;
  return {r * std::cos(angle), r * std::sin(angle), std::sqrt(1 - square_r)};
}

}  // namespace

IndirectLight::IndirectLight(const SyntheticObject& object, const Pose& pose)
    : transport_(object.transport()), mesh_(object.tessellate(kCells)) {
  for (const Triangle& t : mesh_.triangles) {
    const Corners corners{mesh_.positions[t[0]].raw(), mesh_.positions[t[1]].raw(), mesh_.positions[t[2]].raw()};
    for (const Corners& quarter : corners.quarters())
      probes_.push_back(object.project(Point<AcquisitionSpace>(quarter.middle())));
    albedo_.push_back(object.shadingPoint(object.project(Point<AcquisitionSpace>(corners.middle()))).albedo);
  }
  rest_ = RayScene<AcquisitionSpace>::ofTriangles(mesh_.positions, mesh_.triangles);
  if (transport_ == SyntheticTransport::interreflection) prepareBounces(pose);
}

void IndirectLight::prepareBounces(const Pose& pose) {
  std::vector<Point<TravelSpace>> at;
  for (const auto& p : mesh_.positions) at.push_back(pose ? pose(p) : Point<TravelSpace>(p.raw()));
  const auto scene = RayScene<TravelSpace>::ofTriangles(at, mesh_.triangles);
  std::vector<Vec3> across(mesh_.triangles.size()), normal(at.size());
  for (std::size_t t = 0; t < across.size(); ++t) {
    const auto& [a, b, c] = mesh_.triangles[t];
    across[t] = cross((at[b] - at[a]).raw(), (at[c] - at[a]).raw());
    for (const std::uint32_t v : {a, b, c}) normal[v] += across[t];
  }
  // A mirrored pose turns the triangles inside out.
  double volume = 0;
  for (std::size_t t = 0; t < across.size(); ++t) volume += dot(across[t], at[mesh_.triangles[t][0]].raw());
  const double out = volume < 0 ? -1 : 1;

  seen_.resize(at.size() * kRays);
  parallelFor(at.size(), 64, [&](std::size_t begin, std::size_t end) {
    std::vector<Ray<TravelSpace>> rays(kRays);
    std::vector<TriangleHit> hits(kRays);
    for (std::size_t v = begin; v < end; ++v) {
      const auto n = normalize(Vector<TravelSpace>(out * normal[v])).value_or(Direction<TravelSpace>());
      const Vec3 x = anyPerpendicular(n).raw(), y = cross(n.raw(), x);
      const double turn = static_cast<double>(v);  // neighbours' patterns differ
      for (int k = 0; k < kRays; ++k) {
        const Vec3 d = cosineDirection(k, turn);
        rays[k] = {at[v] + kOffset * n, Direction<TravelSpace>::fromUnit(d.x * x + d.y * y + d.z * n.raw())};
      }
      scene.intersect(rays, hits);
      for (int k = 0; k < kRays; ++k) {
        const std::uint32_t t = hits[k].triangle;
        const bool faces = t != kNoHit && out * dot(across[t], rays[k].direction.raw()) < 0;
        seen_[v * kRays + k] = faces ? t : kNoHit;
      }
    }
  });
}

void IndirectLight::solve(std::size_t lights, const DirectAt& direct_at) {
  values_.resize(lights * mesh_.positions.size() * 3);
  for (std::size_t first = 0; first < lights; first += kLightsAtOnce)
    solveBatch(first, std::min(kLightsAtOnce, lights - first), direct_at);
}

void IndirectLight::solveBatch(std::size_t first, std::size_t count, const DirectAt& direct_at) {
  // Columns: all lights of red, of green, of blue.
  const std::size_t columns = 3 * count, triangles = mesh_.triangles.size(), vertices = mesh_.positions.size();
  std::vector<float> of_triangles(triangles * columns), of_vertices(vertices * columns);
  parallelFor(count, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t l = begin; l < end; ++l) {
      const std::vector<Vec3> direct = direct_at(first + l);
      for (std::size_t t = 0; t < triangles; ++t) {
        Vec3 sum;
        for (int k = 0; k < kProbes; ++k) sum += direct[kProbes * t + k];
        for (int c = 0; c < 3; ++c) of_triangles[t * columns + c * count + l] = static_cast<float>(sum[c] / kProbes);
      }
    }
  });
  if (transport_ == SyntheticTransport::interreflection)
    bounce(of_triangles, columns, of_vertices);
  else
    scatter(of_triangles, columns, of_vertices);
  for (std::size_t l = 0; l < count; ++l)
    for (std::size_t v = 0; v < vertices; ++v)
      for (int c = 0; c < 3; ++c)
        values_[((first + l) * vertices + v) * 3 + c] = of_vertices[v * columns + c * count + l];
}

// Irradiance by way of ever more bounces: at a vertex the mean of what its rays, whose density is the cosine, meet.
void IndirectLight::bounce(const std::vector<float>& of_triangles, std::size_t columns,
                           std::vector<float>& of_vertices) const {
  const std::size_t count = columns / 3;
  std::vector<float> radiosity(of_triangles.size());
  for (int n = 0; n < kBounces; ++n) {
    parallelFor(mesh_.triangles.size(), 256, [&](std::size_t begin, std::size_t end) {
      for (std::size_t t = begin; t < end; ++t) {
        const Triangle& corners = mesh_.triangles[t];
        for (std::size_t i = 0; i < columns; ++i) {
          float indirect = 0;
          for (const std::uint32_t v : corners) indirect += of_vertices[v * columns + i];
          radiosity[t * columns + i] = static_cast<float>(albedo_[t][static_cast<int>(i / count)]) *
                                       (of_triangles[t * columns + i] + indirect / 3);
        }
      }
    });
    parallelFor(mesh_.positions.size(), 64, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v) {
        float* sum = &of_vertices[v * columns];
        std::fill(sum, sum + columns, 0.f);
        for (int k = 0; k < kRays; ++k) {
          const std::uint32_t t = seen_[v * kRays + k];
          if (t == kNoHit) continue;
          const float* from = &radiosity[t * columns];
          for (std::size_t i = 0; i < columns; ++i) sum[i] += from[i];
        }
        for (std::size_t i = 0; i < columns; ++i) sum[i] *= 1.f / kRays;
      }
    });
  }
}

// The mean of the irradiance over the surface, weighted by the profile.
void IndirectLight::scatter(const std::vector<float>& of_triangles, std::size_t columns,
                            std::vector<float>& of_vertices) const {
  const std::size_t count = columns / 3;
  parallelFor(mesh_.positions.size(), 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      float* sum = &of_vertices[v * columns];
      std::fill(sum, sum + columns, 0.f);
      Vec3 total;
      for (std::size_t t = 0; t < mesh_.triangles.size(); ++t) {
        const auto& [a, b, c] = mesh_.triangles[t];
        const Corners corners{mesh_.positions[a].raw(), mesh_.positions[b].raw(), mesh_.positions[c].raw()};
        const Vec3 weight = profileOver(mesh_.positions[v].raw(), corners, 0);
        total += weight;
        for (int channel = 0; channel < 3; ++channel) {
          const float w = static_cast<float>(weight[channel]);
          const float* from = &of_triangles[t * columns + channel * count];
          float* to = sum + channel * count;
          for (std::size_t l = 0; l < count; ++l) to[l] += w * from[l];
        }
      }
      for (std::size_t i = 0; i < columns; ++i) sum[i] /= static_cast<float>(total[static_cast<int>(i / count)]);
    }
  });
}

IndirectLight::Place IndirectLight::place(const Point<AcquisitionSpace>& p,
                                          const Direction<AcquisitionSpace>& normal) const {
  const TriangleHit hit = rest_->intersect({p + kProbeHeight * normal, -normal});
  if (!hit.hit()) return {};  // weights of 0
  return {mesh_.triangles[hit.triangle], {1 - hit.b1 - hit.b2, hit.b1, hit.b2}};
}

Vec3 IndirectLight::at(const Place& place, std::size_t light) const {
  Vec3 value;
  for (int k = 0; k < 3; ++k) {
    const float* of_vertex = &values_[(light * mesh_.positions.size() + place.vertex[k]) * 3];
    for (int c = 0; c < 3; ++c) value[c] += double{place.weight[k]} * of_vertex[c];
  }
  return value;
}

}  // namespace srf
