#include "base/ray_scene.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <optional>

#include "base/check.h"
#include "base/error.h"

namespace srf::detail {
namespace {

// The surface area of the boxes may grow by this factor under refitting before the tree is rebuilt: a rebuild costs
// about as much as the slower traversal of such a tree.
constexpr double kRefitDecay = 1.5;
constexpr std::size_t kAreaSample = 1 << 14;  // primitives whose boxes tell the area
// Splats whose plane is seen more edge-on than this (sine of the angle) have no usable intersection.
constexpr float kEdgeOn = 1e-7f;
constexpr std::size_t kPacket = 16;
// A ray that is looked at again is probed with rays this far beside it, in radii of the scene: floats about the scene
// are off by some 1e-7 of it.
constexpr double kBeside = 4e-6;
// Batches of fewer hits do not tell which way the surface faces.
constexpr std::size_t kFewHits = 64;

RTCDevice device() {
  static RTCDevice device = [] {
    // The cache is for subdivision surfaces, of which there are none; it would take 128 MiB of what the program may
    // hold.
    RTCDevice d = rtcNewDevice("start_threads=0,tessellation_cache_size=0");
    if (!d) throw Error(ErrorKind::failed, "Embree could not be started");
    rtcSetDeviceErrorFunction(
        d, [](void*, RTCError, const char* text) { std::fprintf(stderr, "embree: %s\n", text); }, nullptr);
    return d;
  }();
  return device;
}

/// What the test of a ray against a splat needs, a cache line: x lies on the splat where n . x = n . center, and there
/// a = dual_u . (x - center), b = dual_v . (x - center).
struct Splat {
  float center[3], half[3];  // half extents of the box of the ellipse a^2 + b^2 <= 1
  float n[3];                // unit, or zero where the splat is never met
  float dual_u[3], dual_v[3];
  float longest;  // half axis
};
static_assert(sizeof(Splat) == 64);

Splat prepared(const RawSplat& raw) {
  const auto vec = [](const float* p) { return Vec3{p[0], p[1], p[2]}; };
  const auto put = [](const Vec3& from, float* to) {
    for (int k = 0; k < 3; ++k) to[k] = static_cast<float>(from[k]);
  };
  const Vec3 u = vec(raw.u), v = vec(raw.v), n = cross(u, v);
  Splat splat{};
  std::copy_n(raw.center, 3, splat.center);
  put({std::hypot(u.x, v.x), std::hypot(u.y, v.y), std::hypot(u.z, v.z)}, splat.half);
  const double nn = dot(n, n);
  if (!(nn > 0) || !std::isfinite(nn)) return splat;
  put(n / std::sqrt(nn), splat.n);
  put(cross(v, n) / nn, splat.dual_u);
  put(cross(n, u) / nn, splat.dual_v);
  splat.longest = static_cast<float>(std::sqrt(std::max(dot(u, u), dot(v, v))));
  return splat;
}

// What a gathering packet carries through the traversal.
struct GatherContext {
  RTCIntersectContext embree;
  std::array<std::vector<SplatHit>, kPacket> hits;
  float end[kPacket];  // of each ray's window
  float window = 0;
};

}  // namespace

class EmbreeScene {
 public:
  ~EmbreeScene() {
    if (scene_) rtcReleaseScene(scene_);
  }
  EmbreeScene() : scene_(rtcNewScene(device())) {
    rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_DYNAMIC));
    // One tree a geometry, which can be refitted; with a better scene Embree builds everything anew at every commit.
    rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_LOW);
  }
  EmbreeScene(const EmbreeScene&) = delete;
  EmbreeScene& operator=(const EmbreeScene&) = delete;

  RTCScene scene() const { return scene_; }
  double reach() const { return reach_; }

  float* positions(std::size_t vertices) {
    positions_.resize(3 * vertices + 4);  // Embree reads 16 bytes at the last vertex
    return positions_.data();
  }
  void setTriangles(std::span<const Triangle> triangles, bool all_finite) {
    all_finite_ = all_finite;
    const std::size_t vertices = (positions_.size() - 4) / 3;
    for (const Triangle& t : triangles)
      for (const std::uint32_t corner : t) SRF_CHECK(corner < vertices);
    triangles_.assign(triangles.begin(), triangles.end());
    build();
  }
  void moveTriangles(bool all_finite) {
    rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
    // Embree leaves triangles that are not finite out of the tree, and refitting would not bring them back.
    const bool complete = all_finite && all_finite_;
    all_finite_ = all_finite;
    complete ? refit() : build();
  }

  RawSplat* splats(std::size_t count) {
    raw_splats_.resize(count);
    return raw_splats_.data();
  }
  void setSplats(float cutoff) {
    cutoff_ = cutoff;
    prepareSplats();
    build();
  }
  void moveSplats() {
    const bool same_number = splats_.size() == raw_splats_.size();
    prepareSplats();
    same_number ? refit() : build();
  }

  /// Whether the ray comes near what there is.
  bool meetsBox(const RawRay& ray) const {
    double near_t = ray.near_distance, far_t = ray.far_distance;
    const double pad = kBeside * reach_;
    for (int k = 0; k < 3; ++k) {
      const double o = ray.origin[k], d = ray.direction[k], low = box_low_[k] - pad, high = box_high_[k] + pad;
      if (std::fabs(d) < 1e-30) {
        if (!(o >= low && o <= high)) return false;
        continue;
      }
      const double a = (low - o) / d, b = (high - o) / d;
      near_t = std::max(near_t, std::min(a, b));
      far_t = std::min(far_t, std::max(a, b));
    }
    return near_t <= far_t;
  }

  struct Crossing {
    double distance, b1, b2;
    double outside;  ///< how far beside the triangle the ray runs, units; 0: through it
  };
  /// The ray against one triangle in double, edge functions in the plane across the ray (Woop, Benthin, Wald 2013):
  /// they are differences of the corners' own coordinates there, so that neighbours agree on corners and edges.
  std::optional<Crossing> cross(const RawRay& ray, std::uint32_t triangle) const {
    int kz = 0;
    for (int k = 1; k < 3; ++k)
      if (std::fabs(ray.direction[k]) > std::fabs(ray.direction[kz])) kz = k;
    const int kx = (kz + 1) % 3, ky = (kz + 2) % 3;
    const double sz = 1 / ray.direction[kz], sx = ray.direction[kx] * sz, sy = ray.direction[ky] * sz;
    double x[3], y[3], z[3];
    for (int c = 0; c < 3; ++c) {
      const float* p = &positions_[3 * std::size_t{triangles_[triangle][c]}];
      const Vec3 q = Vec3{p[0], p[1], p[2]} - ray.origin;
      x[c] = q[kx] - sx * q[kz], y[c] = q[ky] - sy * q[kz], z[c] = sz * q[kz];
    }
    double weight[3], sum = 0, distance = 0;
    for (int c = 0; c < 3; ++c) {
      const int a = (c + 1) % 3, b = (c + 2) % 3;
      weight[c] = differenceOfProducts(x[b], y[a], y[b], x[a]);
      sum += weight[c];
    }
    if (sum == 0) return std::nullopt;
    Crossing crossing{0, 0, 0, 0};
    for (int c = 0; c < 3; ++c) {
      const int a = (c + 1) % 3, b = (c + 2) % 3;
      const double edge = std::hypot(x[b] - x[a], y[b] - y[a]);
      crossing.outside = std::max(crossing.outside, -std::copysign(1.0, sum) * weight[c] / edge);
      weight[c] = std::max(0.0, weight[c] / sum);
    }
    sum = weight[0] + weight[1] + weight[2];  // clamped to the triangle, where the ray runs beside it
    for (int c = 0; c < 3; ++c) distance += weight[c] / sum * z[c];
    if (!(distance >= ray.near_distance && distance <= ray.far_distance)) return std::nullopt;
    crossing.distance = distance, crossing.b1 = weight[1] / sum, crossing.b2 = weight[2] / sum;
    return crossing;
  }

 private:
  RTCGeometry newGeometry() {
    if (!splats_.empty()) {
      RTCGeometry splats = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_USER);
      rtcSetGeometryUserPrimitiveCount(splats, static_cast<unsigned>(splats_.size()));
      rtcSetGeometryUserData(splats, this);
      rtcSetGeometryBoundsFunction(splats, splatBounds, nullptr);
      rtcSetGeometryIntersectFunction(splats, intersectSplat);
      rtcSetGeometryOccludedFunction(splats, occludedSplat);
      return splats;
    }
    RTCGeometry triangles = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(triangles, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions_.data(), 0, 12,
                               positions_.size() / 3);
    rtcSetSharedGeometryBuffer(triangles, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, triangles_.data(), 0,
                               sizeof(Triangle), triangles_.size());
    return triangles;
  }
  void build() {
    if (geometry_) rtcDetachGeometry(scene_, 0);
    geometry_ = newGeometry();
    rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_REFIT);  // the first build is a full one all the same
    rtcSetGeometryMask(geometry_, 0xffffffffu);
    rtcCommitGeometry(geometry_);
    rtcAttachGeometryByID(scene_, geometry_, 0);
    rtcReleaseGeometry(geometry_);  // the scene holds it from here on
    commit();
    built_area_ = summedBoxArea();
  }
  void refit() {
    if (!(summedBoxArea() < kRefitDecay * built_area_)) return build();
    rtcCommitGeometry(geometry_);
    commit();
  }
  void commit() {
    rtcCommitScene(scene_);
    RTCBounds bounds;
    rtcGetSceneBounds(scene_, &bounds);
    box_low_ = {bounds.lower_x, bounds.lower_y, bounds.lower_z};
    box_high_ = {bounds.upper_x, bounds.upper_y, bounds.upper_z};
    const bool empty = !(box_low_.x <= box_high_.x && box_low_.y <= box_high_.y && box_low_.z <= box_high_.z);
    if (empty) box_low_ = box_high_ = {};
    reach_ = 0;
    for (int corner = 0; corner < 8; ++corner)
      reach_ = std::max(reach_, length({(corner & 1 ? box_low_ : box_high_).x, (corner & 2 ? box_low_ : box_high_).y,
                                        (corner & 4 ? box_low_ : box_high_).z}));
  }
  // Of a sample of the boxes, in a fixed order.
  double summedBoxArea() const {
    double sum = 0;
    const auto add = [&sum](const double size[3]) { sum += size[0] * size[1] + size[1] * size[2] + size[2] * size[0]; };
    double size[3];
    for (std::size_t i = 0; i < triangles_.size(); i += triangles_.size() / kAreaSample + 1) {
      for (int k = 0; k < 3; ++k) {
        const Triangle& t = triangles_[i];
        const float a = positions_[3 * std::size_t{t[0]} + k], b = positions_[3 * std::size_t{t[1]} + k],
                    c = positions_[3 * std::size_t{t[2]} + k];
        size[k] = std::max({a, b, c}) - std::min({a, b, c});
      }
      add(size);
    }
    for (std::size_t i = 0; i < splats_.size(); i += splats_.size() / kAreaSample + 1) {
      for (int k = 0; k < 3; ++k) size[k] = splats_[i].half[k];
      add(size);
    }
    return sum;
  }

  void prepareSplats() {
    splats_.resize(raw_splats_.size());
    parallelFor(splats_.size(), 1 << 13, [this](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) splats_[i] = prepared(raw_splats_[i]);
    });
  }
  static void splatBounds(const RTCBoundsFunctionArguments* args) {
    const auto& self = *static_cast<const EmbreeScene*>(args->geometryUserPtr);
    const Splat& s = self.splats_[args->primID];
    float low[3], high[3];
    bool finite = true;
    for (int k = 0; k < 3; ++k) {
      const float half = self.cutoff_ * s.half[k];
      const float pad = 4e-7f * (std::fabs(s.center[k]) + half);  // for the rounding of the centre
      low[k] = s.center[k] - half - pad;
      high[k] = s.center[k] + half + pad;
      finite &= std::isfinite(low[k]) && std::isfinite(high[k]);
    }
    if (!finite)  // a point at the centre, where it is never met: an empty box would be left out of all refits to come
      for (int k = 0; k < 3; ++k) low[k] = high[k] = 0;
    *args->bounds_o = {low[0], low[1], low[2], 0, high[0], high[1], high[2], 0};
  }

  // One splat against the rays of a packet: hits in the splat's own coordinates (perspective-exact without a
  // projection). Returns by hit[i] where ray i meets it. Plain loops over the packet, which compilers make wide.
  void meet(std::uint32_t index, RTCRayN* ray, unsigned count, float* t, float* a, float* b, int* hit) const {
    const Splat s = splats_[index];
    const float *ox = &RTCRayN_org_x(ray, count, 0), *oy = &RTCRayN_org_y(ray, count, 0),
                *oz = &RTCRayN_org_z(ray, count, 0), *dx = &RTCRayN_dir_x(ray, count, 0),
                *dy = &RTCRayN_dir_y(ray, count, 0), *dz = &RTCRayN_dir_z(ray, count, 0),
                *near_t = &RTCRayN_tnear(ray, count, 0), *far_t = &RTCRayN_tfar(ray, count, 0);
    const float most = cutoff_ * cutoff_;
    for (unsigned i = 0; i < count; ++i) {
      const float denom = s.n[0] * dx[i] + s.n[1] * dy[i] + s.n[2] * dz[i];
      const float tx = s.center[0] - ox[i], ty = s.center[1] - oy[i], tz = s.center[2] - oz[i];
      t[i] = (s.n[0] * tx + s.n[1] * ty + s.n[2] * tz) / denom;
      const float x = t[i] * dx[i] - tx, y = t[i] * dy[i] - ty, z = t[i] * dz[i] - tz;
      a[i] = s.dual_u[0] * x + s.dual_u[1] * y + s.dual_u[2] * z;
      b[i] = s.dual_v[0] * x + s.dual_v[1] * y + s.dual_v[2] * z;
      hit[i] =
          (std::fabs(denom) > kEdgeOn) & (t[i] >= near_t[i]) & (t[i] <= far_t[i]) & (a[i] * a[i] + b[i] * b[i] <= most);
    }
  }

  // Records every splat near the front and pulls the ray's far end to the end of the window, without reporting a hit:
  // traversal then visits exactly the splats that may still be blended.
  static void intersectSplat(const RTCIntersectFunctionNArguments* args) {
    const auto& self = *static_cast<const EmbreeScene*>(args->geometryUserPtr);
    auto& context = *reinterpret_cast<GatherContext*>(args->context);
    const unsigned count = args->N;
    SRF_DCHECK(count <= kPacket);
    RTCRayN* ray = RTCRayHitN_RayN(args->rayhit, count);
    alignas(64) float t[kPacket], a[kPacket], b[kPacket];
    alignas(64) int hit[kPacket];
    self.meet(args->primID, ray, count, t, a, b, hit);
    const float behind = context.window * self.splats_[args->primID].longest;
    for (unsigned i = 0; i < count; ++i) {
      if (!hit[i] || !args->valid[i]) continue;
      const unsigned lane = RTCRayN_id(ray, count, i);
      context.hits[lane].push_back({args->primID, a[i], b[i], t[i]});
      context.end[lane] = std::min(context.end[lane], t[i] + behind);
      RTCRayN_tfar(ray, count, i) = std::min(RTCRayN_tfar(ray, count, i), t[i] + behind);
    }
  }

  static void occludedSplat(const RTCOccludedFunctionNArguments* args) {
    const auto& self = *static_cast<const EmbreeScene*>(args->geometryUserPtr);
    alignas(64) float t[kPacket], a[kPacket], b[kPacket];
    alignas(64) int hit[kPacket];
    self.meet(args->primID, args->ray, args->N, t, a, b, hit);
    for (unsigned i = 0; i < args->N; ++i)
      if (hit[i] && args->valid[i]) RTCRayN_tfar(args->ray, args->N, i) = -INFINITY;
  }

  RTCScene scene_ = nullptr;
  RTCGeometry geometry_ = nullptr;
  std::vector<float> positions_;
  std::vector<Triangle> triangles_;
  std::vector<RawSplat> raw_splats_;
  std::vector<Splat> splats_;
  float cutoff_ = 1;
  bool all_finite_ = true;  ///< vertices at the latest build
  double built_area_ = 0;
  Vec3 box_low_, box_high_;
  double reach_ = 0;  ///< of the box from the centre
};

RayBackend::RayBackend() : scene_(std::make_unique<EmbreeScene>()) {}
RayBackend::~RayBackend() = default;
RayBackend::RayBackend(RayBackend&&) noexcept = default;
RayBackend& RayBackend::operator=(RayBackend&&) noexcept = default;

float* RayBackend::positions(std::size_t vertices) {
  return scene_->positions(vertices);
}
void RayBackend::setTriangles(std::span<const Triangle> triangles, bool all_finite) {
  scene_->setTriangles(triangles, all_finite);
}
void RayBackend::moveTriangles(bool all_finite) {
  scene_->moveTriangles(all_finite);
}
RawSplat* RayBackend::splats(std::size_t count) {
  return scene_->splats(count);
}
void RayBackend::setSplats(float cutoff) {
  scene_->setSplats(cutoff);
}
void RayBackend::moveSplats() {
  scene_->moveSplats();
}

namespace {

/// Up to 16 rays as Embree takes them. Each starts close to the scene, however far away its origin lies: the floats
/// then are off by parts of the scene.
struct Packet {
  alignas(64) RTCRayHit16 rays;
  alignas(64) int valid[kPacket];
  double start[kPacket];

  Packet() {
    RTCRay16& ray = rays.ray;
    for (std::size_t i = 0; i < kPacket; ++i) {
      ray.time[i] = 0, ray.mask[i] = 0xffffffffu, ray.id[i] = static_cast<unsigned>(i), ray.flags[i] = 0;
      rays.hit.Ng_x[i] = rays.hit.Ng_y[i] = rays.hit.Ng_z[i] = 0;
    }
  }
  void take(std::span<const RawRay> from, double reach) {
    Sides sides;
    for (std::size_t i = 0; i < kPacket; ++i) {
      const RawRay& r = from[std::min(i, from.size() - 1)];
      for (int k = 0; k < 3; ++k) sides.origin[k][i] = r.origin[k], sides.direction[k][i] = r.direction[k];
      sides.near_distance[i] = r.near_distance, sides.far_distance[i] = r.far_distance;
    }
    put(sides, from.size(), reach);
  }
  /// `count` of the rays, from `first` on.
  void take(const RaysInSpace& from, std::size_t first, std::size_t count, double reach) {
    Sides sides;
    for (std::size_t i = 0; i < kPacket; ++i) {
      const double* const numbers = from.numbers + 6 * (first + std::min(i, count - 1));
      for (int k = 0; k < 3; ++k) sides.origin[k][i] = numbers[k], sides.direction[k][i] = numbers[3 + k];
    }
    for (std::size_t i = 0; i < kPacket; ++i) {
      for (int k = 0; k < 3; ++k) sides.origin[k][i] -= from.center[k];
      sides.near_distance[i] = from.near_distance, sides.far_distance[i] = from.far_distance;
    }
    put(sides, count, reach);
  }

 private:
  /// Rays side by side: then the rest is done for several at once.
  struct Sides {
    double origin[3][kPacket], direction[3][kPacket], near_distance[kPacket], far_distance[kPacket];
  };

  /// Not inlined: there compilers lose sight of what makes the loops wide.
  [[gnu::noinline]] void put(const Sides& sides, std::size_t count, double reach) {
    const auto &o = sides.origin, &d = sides.direction;
    RTCRay16& ray = rays.ray;
    for (std::size_t i = 0; i < kPacket; ++i) {
      const double along = o[0][i] * d[0][i] + o[1][i] * d[1][i] + o[2][i] * d[2][i];
      const double before = -along - 1.01 * reach;
      start[i] = before > 0 ? before : 0;
      ray.org_x[i] = static_cast<float>(o[0][i] + start[i] * d[0][i]);
      ray.org_y[i] = static_cast<float>(o[1][i] + start[i] * d[1][i]);
      ray.org_z[i] = static_cast<float>(o[2][i] + start[i] * d[2][i]);
      ray.dir_x[i] = static_cast<float>(d[0][i]), ray.dir_y[i] = static_cast<float>(d[1][i]);
      ray.dir_z[i] = static_cast<float>(d[2][i]);
      const double near = sides.near_distance[i] - start[i];
      ray.tnear[i] = near > 0 ? static_cast<float>(near) : 0.f;
      ray.tfar[i] = static_cast<float>(sides.far_distance[i] - start[i]);
    }
    for (std::size_t i = 0; i < kPacket; ++i) {
      valid[i] = i < count ? -1 : 0;
      rays.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
    }
  }
};

/// What a packet met, bits by ray.
struct PacketHits {
  unsigned met, from_behind;
};

PacketHits trace(const EmbreeScene& scene, Packet& packet, std::span<TriangleHit> hits) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcIntersect16(packet.valid, scene.scene(), &context, &packet.rays);
  const RTCRay16& ray = packet.rays.ray;
  const RTCHit16& hit = packet.rays.hit;
  float distance[kPacket];
  int met[kPacket], behind[kPacket];
  for (std::size_t i = 0; i < kPacket; ++i) {
    distance[i] = static_cast<float>(packet.start[i] + ray.tfar[i]);
    const float facing = hit.Ng_x[i] * ray.dir_x[i] + hit.Ng_y[i] * ray.dir_y[i] + hit.Ng_z[i] * ray.dir_z[i];
    met[i] = hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
    behind[i] = facing > 0;
  }
  PacketHits result{0, 0};
  for (std::size_t i = 0; i < hits.size(); ++i) {
    result.met |= static_cast<unsigned>(met[i]) << i;
    result.from_behind |= static_cast<unsigned>(met[i] & behind[i]) << i;
    hits[i] = met[i] ? TriangleHit{hit.primID[i], hit.u[i], hit.v[i], distance[i]} : TriangleHit{};
  }
  return result;
}

/// A ray kBeside away from it, or a little less: along the axis that it runs least along.
RawRay beside(const RawRay& ray, double reach) {
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (std::fabs(ray.direction[k]) < std::fabs(ray.direction[axis])) axis = k;
  RawRay moved = ray;
  moved.origin[axis] += kBeside * reach;
  return moved;
}

/// kPacket rays around it, on a circle of radius kBeside.
void besides(const RawRay& ray, double reach, RawRay* moved) {
  struct Place {
    double cosine, sine;
  };
  static const std::array<Place, kPacket> circle = [] {
    std::array<Place, kPacket> places;
    for (std::size_t part = 0; part < kPacket; ++part) {
      const double angle = 6.283185307179586 * (static_cast<double>(part) + 0.25) / kPacket;
      places[part] = {std::cos(angle), std::sin(angle)};
    }
    return places;
  }();
  const Vec3& d = ray.direction;
  const Vec3 across = cross(d, std::fabs(d.x) < 0.5 ? Vec3{1, 0, 0} : Vec3{0, 1, 0});
  const Vec3 e = across / length(across), f = cross(d, e);
  for (std::size_t part = 0; part < kPacket; ++part) {
    moved[part] = ray;
    moved[part].origin += (kBeside * reach * circle[part].cosine) * e + (kBeside * reach * circle[part].sine) * f;
  }
}

// Embree decides by the signs of three edge functions, each rounded for itself. At a vertex the signs of all edges may
// come out so that the ray passes outside every triangle of the fan: some 0.2 % of the rays aimed at one do. A ray that
// has slipped through a closed part either meets nothing more or meets the part from its other side, so those rays are
// looked at again: with a ray close beside it, which cannot but meet the part unless its outline runs between them, and
// where that meets something nearer, with rays all around and in double.
void lookAgain(const EmbreeScene& scene, const RaysInSpace& rays, std::span<const std::uint32_t> doubtful,
               std::span<TriangleHit> hits) {
  const auto nearer = [](const TriangleHit& probe, const TriangleHit& hit) {
    return probe.hit() && probe.triangle != hit.triangle && !(hit.hit() && probe.distance >= hit.distance);
  };
  RawRay moved[kPacket];
  TriangleHit probes[kPacket], ring[kPacket];
  Packet packet;
  for (std::size_t begin = 0; begin < doubtful.size(); begin += kPacket) {
    const std::size_t count = std::min(kPacket, doubtful.size() - begin);
    for (std::size_t i = 0; i < count; ++i) moved[i] = beside(rays[doubtful[begin + i]], scene.reach());
    packet.take({moved, count}, scene.reach());
    trace(scene, packet, {probes, count});
    for (std::size_t i = 0; i < count; ++i) {
      TriangleHit& hit = hits[doubtful[begin + i]];
      if (!nearer(probes[i], hit)) continue;
      const RawRay ray = rays[doubtful[begin + i]];
      besides(ray, scene.reach(), moved);
      packet.take(moved, scene.reach());
      trace(scene, packet, ring);
      // Surrounded on all sides by something nearer, it cannot but meet it: then the triangle it comes closest to.
      const bool surrounded = std::all_of(ring, ring + kPacket, [&](const auto& probe) { return nearer(probe, hit); });
      std::optional<EmbreeScene::Crossing> best;
      std::uint32_t triangle = kNoHit;
      for (const TriangleHit& probe : ring) {
        if (!nearer(probe, hit)) continue;
        const auto crossing = scene.cross(ray, probe.triangle);
        if (!crossing || (crossing->outside > 0 && !surrounded)) continue;
        const bool better = !best || crossing->outside < best->outside ||
                            (crossing->outside == best->outside && crossing->distance < best->distance);
        if (better) best = crossing, triangle = probe.triangle;
      }
      if (best)
        hit = {triangle, static_cast<float>(best->b1), static_cast<float>(best->b2),
               static_cast<float>(best->distance)};
    }
  }
}

}  // namespace

void RayBackend::intersect(const RaysInSpace& rays, std::span<TriangleHit> hits) const {
  SRF_CHECK(rays.count == hits.size());
  thread_local std::vector<std::uint32_t> doubtful;
  thread_local std::vector<PacketHits> packets;
  doubtful.clear(), packets.clear();
  std::size_t met = 0, from_behind = 0;
  const auto doubt = [](unsigned bits, std::size_t begin) {
    for (; bits; bits &= bits - 1) doubtful.push_back(static_cast<std::uint32_t>(begin + std::countr_zero(bits)));
  };
  Packet packet;
  for (std::size_t begin = 0; begin < rays.count; begin += kPacket) {
    const std::size_t count = std::min(kPacket, rays.count - begin);
    packet.take(rays, begin, count, scene_->reach());
    const PacketHits of = packets.emplace_back(trace(*scene_, packet, hits.subspan(begin, count)));
    met += std::popcount(of.met), from_behind += std::popcount(of.from_behind);
    for (unsigned missed = ~of.met & ((1u << count) - 1); missed; missed &= missed - 1) {
      const std::size_t i = begin + static_cast<std::size_t>(std::countr_zero(missed));
      if (scene_->meetsBox(rays[i])) doubtful.push_back(static_cast<std::uint32_t>(i));
    }
  }
  // Rays of one batch mostly start outside, or mostly inside; and a mirror turns every triangle. So it is the rarer
  // side that is doubtful.
  const bool few = hits.size() < kFewHits;
  const std::size_t from_front = met - from_behind;
  const bool doubt_front = few || from_front < from_behind, doubt_behind = few || from_behind < from_front;
  if ((doubt_front && from_front > 0) || (doubt_behind && from_behind > 0))
    for (std::size_t p = 0; p < packets.size(); ++p)
      doubt((doubt_front ? packets[p].met & ~packets[p].from_behind : 0) | (doubt_behind ? packets[p].from_behind : 0),
            p * kPacket);
  lookAgain(*scene_, rays, doubtful, hits);
}

void RayBackend::occluded(std::span<const RawRay> rays, bool side_by_side, std::span<std::uint8_t> blocked) const {
  SRF_CHECK(rays.size() == blocked.size());
  Packet packet;
  for (std::size_t begin = 0; begin < rays.size(); begin += kPacket) {
    const std::size_t count = std::min(kPacket, rays.size() - begin);
    packet.take(rays.subspan(begin, count), scene_->reach());
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    if (side_by_side) context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcOccluded16(packet.valid, scene_->scene(), &context, &packet.rays.ray);
    for (std::size_t i = 0; i < count; ++i) blocked[begin + i] = packet.rays.ray.tfar[i] == -INFINITY;
  }
}

void RayBackend::gatherSplats(std::span<const RawRay> rays, float depth_window, SplatLists& lists) const {
  lists.hits.clear();
  lists.first.assign(1, 0);
  GatherContext context;
  rtcInitIntersectContext(&context.embree);
  context.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  context.window = depth_window;
  Packet packet;
  for (std::size_t begin = 0; begin < rays.size(); begin += kPacket) {
    const std::size_t count = std::min(kPacket, rays.size() - begin);
    packet.take(rays.subspan(begin, count), scene_->reach());
    std::fill(std::begin(context.end), std::end(context.end), INFINITY);
    for (auto& lane : context.hits) lane.clear();
    rtcIntersect16(packet.valid, scene_->scene(), &context.embree, &packet.rays);
    for (std::size_t i = 0; i < count; ++i) {
      std::vector<SplatHit>& met = context.hits[i];
      std::erase_if(met, [end = context.end[i]](const SplatHit& hit) { return hit.distance > end; });
      std::sort(met.begin(), met.end(), [](const SplatHit& x, const SplatHit& y) {
        return x.distance != y.distance ? x.distance < y.distance : x.splat < y.splat;
      });
      for (SplatHit& hit : met) {
        hit.distance = static_cast<float>(packet.start[i] + hit.distance);
        lists.hits.push_back(hit);
      }
      lists.first.push_back(static_cast<std::uint32_t>(lists.hits.size()));
    }
  }
}

}  // namespace srf::detail
