#include "base/ray_scene.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "base/check.h"
#include "base/error.h"

namespace srf::detail {
namespace {

// The surface area of the boxes may grow by this factor under refitting before the tree is rebuilt: a rebuild costs
// about as much as the slower traversal of such a tree.
constexpr double kRefitDecay = 1.5;
// Splats whose plane is seen more edge-on than this (sine of the angle) have no usable intersection.
constexpr float kEdgeOn = 1e-7f;

RTCDevice device() {
  static RTCDevice device = [] {
    RTCDevice d = rtcNewDevice("start_threads=0");
    if (!d) throw Error(ErrorKind::failed, "Embree could not be started");
    rtcSetDeviceErrorFunction(
        d, [](void*, RTCError, const char* text) { std::fprintf(stderr, "embree: %s\n", text); }, nullptr);
    return d;
  }();
  return device;
}

double summedBoxArea(const std::vector<float>& xyz, const std::vector<Triangle>& triangles) {
  double sum = 0;
  for (const Triangle& t : triangles) {
    double size[3];
    for (int k = 0; k < 3; ++k) {
      const float a = xyz[3 * t[0] + k], b = xyz[3 * t[1] + k], c = xyz[3 * t[2] + k];
      size[k] = std::max({a, b, c}) - std::min({a, b, c});
    }
    sum += size[0] * size[1] + size[1] * size[2] + size[2] * size[0];
  }
  return sum;
}

// What a gathering ray carries through the traversal.
struct GatherContext {
  RTCIntersectContext embree;
  std::vector<SplatHit>* hits = nullptr;
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
  }
  EmbreeScene(const EmbreeScene&) = delete;
  EmbreeScene& operator=(const EmbreeScene&) = delete;

  RTCScene scene() const { return scene_; }

  void setTriangles(std::span<const float> xyz, std::span<const Triangle> triangles) {
    positions_.assign(xyz.begin(), xyz.end());
    triangles_.assign(triangles.begin(), triangles.end());
    positions_.resize(positions_.size() + 4, 0.f);  // Embree reads 16 bytes at the last vertex
    geometry_ = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions_.data(), 0, 12,
                               xyz.size() / 3);
    rtcSetSharedGeometryBuffer(geometry_, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, triangles_.data(), 0,
                               sizeof(Triangle), triangles_.size());
    attach(RTC_BUILD_QUALITY_MEDIUM);
    built_area_ = summedBoxArea(positions_, triangles_);
  }

  void moveTriangles(std::span<const float> xyz) {
    SRF_CHECK(xyz.size() + 4 == positions_.size());
    std::copy(xyz.begin(), xyz.end(), positions_.begin());
    rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
    const double area = summedBoxArea(positions_, triangles_);
    const bool rebuild = !(area < kRefitDecay * built_area_);
    rtcSetGeometryBuildQuality(geometry_, rebuild ? RTC_BUILD_QUALITY_LOW : RTC_BUILD_QUALITY_REFIT);
    rtcCommitGeometry(geometry_);
    rtcCommitScene(scene_);
    if (rebuild) built_area_ = area;
  }

  void setSplats(std::span<const RawSplat> splats, float cutoff) {
    splats_.assign(splats.begin(), splats.end());
    cutoff_ = cutoff;
    geometry_ = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry_, static_cast<unsigned>(splats_.size()));
    rtcSetGeometryUserData(geometry_, this);
    rtcSetGeometryBoundsFunction(geometry_, splatBounds, nullptr);
    rtcSetGeometryIntersectFunction(geometry_, intersectSplat);
    rtcSetGeometryOccludedFunction(geometry_, occludedSplat);
    attach(RTC_BUILD_QUALITY_MEDIUM);
  }

  void moveSplats(std::span<const RawSplat> splats) {
    SRF_CHECK(splats.size() == splats_.size());
    std::copy(splats.begin(), splats.end(), splats_.begin());
    rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_LOW);
    rtcCommitGeometry(geometry_);
    rtcCommitScene(scene_);
  }

 private:
  void attach(RTCBuildQuality quality) {
    rtcSetGeometryBuildQuality(geometry_, quality);
    rtcSetGeometryMask(geometry_, 0xffffffffu);
    rtcCommitGeometry(geometry_);
    rtcAttachGeometry(scene_, geometry_);
    rtcReleaseGeometry(geometry_);  // the scene holds it from here on
    rtcCommitScene(scene_);
  }

  static void splatBounds(const RTCBoundsFunctionArguments* args) {
    const auto& self = *static_cast<const EmbreeScene*>(args->geometryUserPtr);
    const RawSplat& s = self.splats_[args->primID];
    float low[3], high[3];
    bool finite = true;
    for (int k = 0; k < 3; ++k) {
      // Half extent of the ellipse, padded by the rounding of the centre.
      const float half = self.cutoff_ * std::sqrt(s.u[k] * s.u[k] + s.v[k] * s.v[k]);
      const float pad = 4e-7f * (std::fabs(s.center[k]) + half);
      low[k] = s.center[k] - half - pad;
      high[k] = s.center[k] + half + pad;
      finite &= std::isfinite(low[k]) && std::isfinite(high[k]);
    }
    if (!finite)  // an empty box: the primitive is never met
      for (int k = 0; k < 3; ++k) low[k] = INFINITY, high[k] = -INFINITY;
    *args->bounds_o = {low[0], low[1], low[2], 0, high[0], high[1], high[2], 0};
  }

  // Ray-plane hit in the splat's own coordinates (theory of ray-cast surfels: perspective-exact without a projection).
  bool meet(std::uint32_t index, const float o[3], const float d[3], float near_t, float far_t, SplatHit& hit) const {
    const RawSplat& s = splats_[index];
    const float n[3] = {s.u[1] * s.v[2] - s.u[2] * s.v[1], s.u[2] * s.v[0] - s.u[0] * s.v[2],
                        s.u[0] * s.v[1] - s.u[1] * s.v[0]};
    const float nn = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    const float denom = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
    const float dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    if (!(denom * denom > kEdgeOn * kEdgeOn * nn * dd)) return false;
    const float to[3] = {s.center[0] - o[0], s.center[1] - o[1], s.center[2] - o[2]};
    const float t = (n[0] * to[0] + n[1] * to[1] + n[2] * to[2]) / denom;
    if (!(t >= near_t && t <= far_t)) return false;
    const float x[3] = {t * d[0] - to[0], t * d[1] - to[1], t * d[2] - to[2]};
    // a = ((x cross v) . n) / n.n, b = ((u cross x) . n) / n.n
    const float a = ((x[1] * s.v[2] - x[2] * s.v[1]) * n[0] + (x[2] * s.v[0] - x[0] * s.v[2]) * n[1] +
                     (x[0] * s.v[1] - x[1] * s.v[0]) * n[2]) /
                    nn;
    const float b = ((s.u[1] * x[2] - s.u[2] * x[1]) * n[0] + (s.u[2] * x[0] - s.u[0] * x[2]) * n[1] +
                     (s.u[0] * x[1] - s.u[1] * x[0]) * n[2]) /
                    nn;
    if (!(a * a + b * b <= cutoff_ * cutoff_)) return false;
    hit = {index, a, b, t};
    return true;
  }

  // Records every splat near the front and pulls the ray's far end to the nearest one plus the window, without
  // reporting a hit: traversal then visits exactly the splats that may still be blended.
  static void intersectSplat(const RTCIntersectFunctionNArguments* args) {
    if (!args->valid[0]) return;
    SRF_DCHECK(args->N == 1);
    const auto& self = *static_cast<const EmbreeScene*>(args->geometryUserPtr);
    auto& context = *reinterpret_cast<GatherContext*>(args->context);
    RTCRayHitN* rayhit = args->rayhit;
    RTCRayN* ray = RTCRayHitN_RayN(rayhit, 1);
    const float o[3] = {RTCRayN_org_x(ray, 1, 0), RTCRayN_org_y(ray, 1, 0), RTCRayN_org_z(ray, 1, 0)};
    const float d[3] = {RTCRayN_dir_x(ray, 1, 0), RTCRayN_dir_y(ray, 1, 0), RTCRayN_dir_z(ray, 1, 0)};
    SplatHit hit;
    if (!self.meet(args->primID, o, d, RTCRayN_tnear(ray, 1, 0), RTCRayN_tfar(ray, 1, 0), hit)) return;
    context.hits->push_back(hit);
    RTCRayN_tfar(ray, 1, 0) = std::min(RTCRayN_tfar(ray, 1, 0), hit.distance + context.window);
  }

  static void occludedSplat(const RTCOccludedFunctionNArguments* args) {
    const auto& self = *static_cast<const EmbreeScene*>(args->geometryUserPtr);
    for (unsigned i = 0; i < args->N; ++i) {
      if (!args->valid[i]) continue;
      RTCRayN* ray = args->ray;
      const unsigned n = args->N;
      const float o[3] = {RTCRayN_org_x(ray, n, i), RTCRayN_org_y(ray, n, i), RTCRayN_org_z(ray, n, i)};
      const float d[3] = {RTCRayN_dir_x(ray, n, i), RTCRayN_dir_y(ray, n, i), RTCRayN_dir_z(ray, n, i)};
      SplatHit hit;
      if (self.meet(args->primID, o, d, RTCRayN_tnear(ray, n, i), RTCRayN_tfar(ray, n, i), hit))
        RTCRayN_tfar(ray, n, i) = -INFINITY;
    }
  }

  RTCScene scene_ = nullptr;
  RTCGeometry geometry_ = nullptr;
  std::vector<float> positions_;
  std::vector<Triangle> triangles_;
  std::vector<RawSplat> splats_;
  float cutoff_ = 1;
  double built_area_ = 0;
};

RayBackend::RayBackend() = default;
RayBackend::~RayBackend() = default;
RayBackend::RayBackend(RayBackend&&) noexcept = default;
RayBackend& RayBackend::operator=(RayBackend&&) noexcept = default;

void RayBackend::setTriangles(std::span<const float> positions_xyz, std::span<const Triangle> triangles) {
  for (const Triangle& t : triangles)
    for (const std::uint32_t corner : t) SRF_CHECK(corner < positions_xyz.size() / 3);
  scene_ = std::make_unique<EmbreeScene>();
  scene_->setTriangles(positions_xyz, triangles);
}
void RayBackend::moveTriangles(std::span<const float> positions_xyz) {
  scene_->moveTriangles(positions_xyz);
}
void RayBackend::setSplats(std::span<const RawSplat> splats, float cutoff) {
  scene_ = std::make_unique<EmbreeScene>();
  scene_->setSplats(splats, cutoff);
}
void RayBackend::moveSplats(std::span<const RawSplat> splats) {
  scene_->moveSplats(splats);
}

namespace {
constexpr std::size_t kPacket = 16;

// Fills a packet from up to 16 rays; the rest is marked invalid.
void loadPacket(std::span<const RawRay> rays, RTCRay16& packet, int* valid) {
  for (std::size_t i = 0; i < kPacket; ++i) {
    const RawRay& r = rays[std::min(i, rays.size() - 1)];
    valid[i] = i < rays.size() ? -1 : 0;
    packet.org_x[i] = r.origin[0], packet.org_y[i] = r.origin[1], packet.org_z[i] = r.origin[2];
    packet.dir_x[i] = r.direction[0], packet.dir_y[i] = r.direction[1], packet.dir_z[i] = r.direction[2];
    packet.tnear[i] = r.near_distance, packet.tfar[i] = r.far_distance;
    packet.time[i] = 0, packet.mask[i] = 0xffffffffu, packet.id[i] = 0, packet.flags[i] = 0;
  }
}
}  // namespace

void RayBackend::intersect(std::span<const RawRay> rays, std::span<TriangleHit> hits) const {
  SRF_CHECK(rays.size() == hits.size());
  for (std::size_t begin = 0; begin < rays.size(); begin += kPacket) {
    const std::size_t count = std::min(kPacket, rays.size() - begin);
    alignas(64) RTCRayHit16 packet;
    alignas(64) int valid[kPacket];
    loadPacket(rays.subspan(begin, count), packet.ray, valid);
    std::fill(std::begin(packet.hit.geomID), std::end(packet.hit.geomID), RTC_INVALID_GEOMETRY_ID);
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcIntersect16(valid, scene_->scene(), &context, &packet);
    for (std::size_t i = 0; i < count; ++i) {
      TriangleHit& hit = hits[begin + i];
      hit = {};
      if (packet.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
      hit = {packet.hit.primID[i], packet.hit.u[i], packet.hit.v[i], packet.ray.tfar[i]};
    }
  }
}

void RayBackend::occluded(std::span<const RawRay> rays, std::span<std::uint8_t> blocked) const {
  SRF_CHECK(rays.size() == blocked.size());
  for (std::size_t begin = 0; begin < rays.size(); begin += kPacket) {
    const std::size_t count = std::min(kPacket, rays.size() - begin);
    alignas(64) RTCRay16 packet;
    alignas(64) int valid[kPacket];
    loadPacket(rays.subspan(begin, count), packet, valid);
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded16(valid, scene_->scene(), &context, &packet);
    for (std::size_t i = 0; i < count; ++i) blocked[begin + i] = packet.tfar[i] < 0;
  }
}

void RayBackend::gatherSplats(const RawRay& ray, float depth_window, std::vector<SplatHit>& hits) const {
  hits.clear();
  GatherContext context;
  rtcInitIntersectContext(&context.embree);
  context.hits = &hits;
  context.window = depth_window;
  RTCRayHit query{};
  std::memcpy(&query.ray.org_x, ray.origin, sizeof ray.origin);
  std::memcpy(&query.ray.dir_x, ray.direction, sizeof ray.direction);
  query.ray.tnear = ray.near_distance;
  query.ray.tfar = ray.far_distance;
  query.ray.mask = 0xffffffffu;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(scene_->scene(), &context.embree, &query);
  std::sort(hits.begin(), hits.end(), [](const SplatHit& x, const SplatHit& y) {
    return x.distance != y.distance ? x.distance < y.distance : x.splat < y.splat;
  });
  while (!hits.empty() && hits.back().distance > hits.front().distance + depth_window) hits.pop_back();
}

}  // namespace srf::detail
