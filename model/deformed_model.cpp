#include "model/deformed_model.h"

#include <algorithm>
#include <climits>
#include <cmath>
#include <limits>

#include "base/check.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "base/quantile.h"
#include "model/frame_kernels.h"

namespace srf {
namespace {

constexpr std::size_t kGrain = 2048;  // points a task
constexpr std::size_t kBatch = 256;   // rays traced at once
// Coordinates beyond this would overflow the ray scene's floats once squared: such points are nowhere.
constexpr double kFarthest = 1e18;

// A splat is the ellipse {p* + a u + b v : a^2 + b^2 <= 1} of its tangents times its rest radius (M9). Its Gaussian
// weight falls to 0 at that rim, which lies at kRimSigmas standard deviations (EWA-style; theory 5).
constexpr double kSplatCutoff = 1;
constexpr double kRimSigmas = 2;
// A splat met at its very rim with no other near is still surface.
constexpr double kLeastSplatWeight = 1e-6;
// Splats blend with the first one met when they are this near behind it, in its half axes, and when their normals
// agree.
constexpr double kDepthWindow = 1.5;
constexpr double kNormalCosine = 0.5;
// A surfel is split where Psi differs at its rim from its first order by more than this part of its shorter half axis:
// the tangents of neighbours then differ by some 20 % (theory 5), and flat ellipses begin to part.
constexpr double kMostBend = 0.125;
constexpr int kMostSplits = 3;  // times; at a crease of Psi no size is small enough
// Seven discs of half the radius cover a disc, the outer six at this part of its radius; a little larger, they overlap.
constexpr double kPartRadius = 0.55, kPartDistance = 0.8660254037844386;
// Distance of neighbouring surfels in radii (surface_sampling.cpp).
constexpr double kSurfelSpacing = 0.8;
constexpr std::size_t kSpacingSample = 1 << 12;  // splats that tell it, points that tell how far all are stretched
// Shadow rays start so far off the surface: of the object's diameter, of what rims stand out.
constexpr double kShadowOffset = 5e-4, kRims = 2;
// In-plane phases further apart than 8 degrees are turned together before they are blended: apart they blend unevenly,
// which tilts the plane, and opposed ones cancel. The direction field of a model keeps nearly all of them nearer.
constexpr double kPhaseCosine = 0.99;
// Squared sine between blended rest tangents below which they are no frame: points of opposite normals were blended.
constexpr double kNoFrame = 1e-8;

double splatWeight(float a, float b) {
  const double falloff = -0.5 * kRimSigmas * kRimSigmas;
  static const double rim = std::exp(falloff * kSplatCutoff * kSplatCutoff);
  return std::exp(falloff * (double{a} * a + double{b} * b)) - rim + kLeastSplatWeight;
}

Vec3 unitOr(const Vec3& a, const Vec3& otherwise) {
  const double squared = dot(a, a);
  return squared > 0 ? a / std::sqrt(squared) : otherwise;
}

// Whether deformedFrame would say so; most tangents are far from it.
bool collapsed(const Tangents<ObjectSpace>& tangents) {
  const Vec3 &u = tangents.u.raw(), &v = tangents.v.raw(), n = cross(u, v);
  const double uu = dot(u, u), vv = dot(v, v);
  const bool ordinary = uu > 1e-100 && uu < 1e100 && vv > 1e-100 && vv < 1e100 && dot(n, n) > 1e-20 * uu * vv;
  return !ordinary && deformedFrame(tangents, FrameMode::bisector).collapsed;
}

// How far the rims of discs stand out of the flat triangles that they lie on, by the normals blended from the corners':
// of all but one in a hundred.
double discRise(const DeformableModel& model, std::span<const Orthogonal<AcquisitionSpace, TangentSpace>> frames) {
  if (model.kind == ModelKind::mesh || model.size() == 0) return 0;
  std::vector<double> rise;
  for (std::size_t i = 0; i < model.size(); ++i) {
    const auto& [a, b, c] = model.rest_mesh.triangles[model.anchor_triangle[i]];
    const auto& corners = model.rest_mesh.positions;
    const auto face = normalize(cross(corners[b] - corners[a], corners[c] - corners[a]));
    if (face) rise.push_back(model.radius[i] * length(cross(face->raw(), frames[i].raw().column(2))));
  }
  return rise.empty() ? 0 : quantile(rise, 0.99);
}

}  // namespace

DeformedModel::DeformedModel(const DeformableModel& model)
    : model_(model), rest_frame_(model.size()), p_star_(model.size()), tangents_(model.size()) {
  parallelFor(model.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) rest_frame_[i] = rotationFromRodrigues(model.r0[i]);
  });
  rest_offset_ = std::max(
      {kShadowOffset * model.bounds().diameter(), model.positional_error, kRims * discRise(model, rest_frame_)});
  deform(Deformation());
}

void DeformedModel::deform(const Deformation& psi, const MovedVertices* moved) {
  carry(psi, moved);
  updateScene();
}

void DeformedModel::carry(const Deformation& psi, const MovedVertices* moved) {
  statistics_ = {};
  const AcquisitionMesh rest = moved ? model_.restMesh() : AcquisitionMesh();
  MeshMotion motion;
  if (moved) {
    if (!parts_) parts_ = meshParts(rest);
    motion = meshMotion(rest, *parts_, *moved);
  }
  struct Carried {
    Point<ObjectSpace> p_star;
    Tangents<ObjectSpace> tangents;
  };
  // Makes slot k of a batch point i of the model, or what lies beside it at rest, with its rest tangents: after a skin
  // or a mesh sequence, before the maps of space.
  const auto put = [&](std::size_t i, const Vec3& beside, CarriedPoints& batch, std::size_t k) {
    Vec3 from = model_.p0[i].raw() + beside;
    const Mat3& frame = rest_frame_[i].raw();
    Vec3 u = frame.column(0), v = frame.column(1);
    int handedness = 1;
    if (moved && model_.kind == ModelKind::mesh) {
      from = moved->positions[i].raw();
      u = motion.gradient[i].raw() * u;
      v = motion.gradient[i].raw() * v;
      handedness = motion.handedness[i];
    } else if (moved) {
      const Triangle& corners = rest.triangles[model_.anchor_triangle[i]];
      const auto [b1, b2] = model_.anchor_weights[i];
      const double weights[3] = {1.0 - b1 - b2, b1, b2};
      const Vec3 &a = moved->positions[corners[0]].raw(), &b = moved->positions[corners[1]].raw(),
                 &c = moved->positions[corners[2]].raw();
      Mat3 gradient = 0.0 * Mat3{};
      for (int n = 0; n < 3; ++n) gradient = gradient + weights[n] * motion.gradient[corners[n]].raw();
      from = a + (weights[1] * (b - a) + weights[2] * (c - a)) + gradient * beside;
      u = gradient * u;
      v = gradient * v;
      handedness = motion.handedness[corners[0]];
    }
    CarriedPoints::put(from, batch.p, k);
    CarriedPoints::put(u, batch.vector[0], k);
    CarriedPoints::put(v, batch.vector[1], k);
    batch.handedness[k] = handedness;
  };
  // M8: tangents by the analytic Jacobian (its check is Eq. 6).
  const auto carryBatch = [&](CarriedPoints& batch, std::size_t count) {
    batch.count = count;
    batch.vectors = 2;
    psi.carry(batch);
  };
  const auto get = [](const CarriedPoints& batch, std::size_t k) {
    return Carried{Point<ObjectSpace>(CarriedPoints::get(batch.p, k)),
                   {Vector<ObjectSpace>(CarriedPoints::get(batch.vector[0], k)),
                    Vector<ObjectSpace>(CarriedPoints::get(batch.vector[1], k)), batch.handedness[k] < 0 ? -1 : 1}};
  };
  // Adds the splats that stand for the disc of `radius` about `beside`; true: there are several.
  const bool bends = !psi.affine();
  const auto addSplats = [&](std::size_t i, const Vec3& beside, double radius, const Carried& at, int splits,
                             std::vector<Splat>& out, const auto& self) -> bool {
    const Tangents<ObjectSpace>& tangents = at.tangents;
    const Vec3 u = radius * rest_frame_[i].raw().column(0), v = radius * rest_frame_[i].raw().column(1);
    bool split = false;
    CarriedPoints batch;
    if (bends && splits > 0) {
      const double most = kMostBend * radius * std::min(length(tangents.u), length(tangents.v));
      const double half = std::sqrt(0.5);
      static constexpr std::size_t kRim = 4;
      const double rim[kRim][2] = {{1, 0}, {0, 1}, {half, half}, {half, -half}};
      for (std::size_t k = 0; k < kRim; ++k) put(i, beside + (rim[k][0] * u + rim[k][1] * v), batch, k);
      carryBatch(batch, kRim);
      for (std::size_t k = 0; k < kRim; ++k) {
        const Vector<ObjectSpace> flat = (radius * rim[k][0]) * tangents.u + (radius * rim[k][1]) * tangents.v;
        const double bend = length((get(batch, k).p_star - at.p_star) - flat);
        split |= bend > most && bend < kFarthest;
      }
    }
    if (!split) {
      const Vec3 normal = tangents.handedness * cross(tangents.u, tangents.v).raw();
      out.push_back({static_cast<std::uint32_t>(i), radius, model_.p0[i] + Vector<AcquisitionSpace>(beside), at.p_star,
                     tangents, unitOr(normal, {})});
      return false;
    }
    self(i, beside, kPartRadius * radius, at, splits - 1, out, self);
    Vec3 part[6];
    for (std::size_t k = 0; k < 6; ++k) {
      const double angle = static_cast<double>(k) * kPi / 3;
      part[k] = beside + (kPartDistance * std::cos(angle)) * u + (kPartDistance * std::sin(angle)) * v;
      put(i, part[k], batch, k);
    }
    carryBatch(batch, 6);
    for (std::size_t k = 0; k < 6; ++k) self(i, part[k], kPartRadius * radius, get(batch, k), splits - 1, out, self);
    return true;
  };

  // Each chunk counts for itself: the sum does not depend on the threads.
  struct Chunk {
    DeformedStatistics count;
    std::vector<Splat> splats;
  };
  std::vector<Chunk> chunks((model_.size() + kGrain - 1) / kGrain);
  parallelFor(model_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    Chunk& chunk = chunks[begin / kGrain];
    DeformedStatistics& count = chunk.count;
    CarriedPoints batch;
    for (std::size_t first = begin; first < end; first += CarriedPoints::kMost) {
      const std::size_t size = std::min(CarriedPoints::kMost, end - first);
      for (std::size_t k = 0; k < size; ++k) put(first + k, {}, batch, k);
      carryBatch(batch, size);
      for (std::size_t k = 0; k < size; ++k) {
        const std::size_t i = first + k;
        const Carried at = get(batch, k);
        p_star_[i] = at.p_star;
        tangents_[i] = at.tangents;
        const Vec3& p = at.p_star.raw();
        if (!(std::fabs(p.x) < kFarthest && std::fabs(p.y) < kFarthest && std::fabs(p.z) < kFarthest)) {
          constexpr double kNowhere = std::numeric_limits<double>::quiet_NaN();
          p_star_[i] = Point<ObjectSpace>(kNowhere, kNowhere, kNowhere);
          ++count.not_finite;
          continue;
        }
        count.mirrored += at.tangents.handedness < 0;
        count.collapsed += collapsed(at.tangents);
        if (model_.kind == ModelKind::surfels)
          count.split += addSplats(i, {}, model_.radius[i], at, kMostSplits, chunk.splats, addSplats);
      }
    }
  });
  splats_.clear();
  for (const Chunk& chunk : chunks) {
    statistics_.not_finite += chunk.count.not_finite;
    statistics_.mirrored += chunk.count.mirrored;
    statistics_.collapsed += chunk.count.collapsed;
    statistics_.split += chunk.count.split;
    splats_.insert(splats_.end(), chunk.splats.begin(), chunk.splats.end());
  }
  statistics_.unsure_handedness = motion.unsure;
}

void DeformedModel::updateScene() {
  if (model_.kind == ModelKind::mesh) {
    if (scene_) {
      scene_->moveTriangles(p_star_);
    } else {
      scene_ = RayScene<ObjectSpace>::ofTriangles(p_star_, model_.triangles);
    }
    return;
  }
  std::vector<Point<ObjectSpace>> centers(splats_.size());
  std::vector<Vector<ObjectSpace>> u(splats_.size()), v(splats_.size());
  parallelFor(splats_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Splat& splat = splats_[i];
      centers[i] = splat.p_star;
      u[i] = splat.radius * splat.tangents.u;
      v[i] = splat.radius * splat.tangents.v;
    }
  });
  if (scene_) {
    scene_->moveSplats(centers, u, v);
  } else {
    scene_ = RayScene<ObjectSpace>::ofSplats(centers, u, v, kSplatCutoff);
  }
}

Box<ObjectSpace> DeformedModel::bounds() const {
  Box<ObjectSpace> box;
  if (model_.kind == ModelKind::mesh) {
    for (const auto& p : p_star_)
      if (isFinite(p)) box.extend(p);
    return box;
  }
  for (const Splat& splat : splats_) {
    if (!isFinite(splat.p_star)) continue;
    box.extend(splat.p_star);
    const Vec3 &u = splat.tangents.u.raw(), &v = splat.tangents.v.raw();
    const Vector<ObjectSpace> half =
        splat.radius * Vector<ObjectSpace>(std::hypot(u.x, v.x), std::hypot(u.y, v.y), std::hypot(u.z, v.z));
    if (!isFinite(half)) continue;
    box.extend(splat.p_star - half);
    box.extend(splat.p_star + half);
  }
  return box;
}

double DeformedModel::shadowOffset() const {
  std::vector<double> growth;
  for (std::size_t i = 0; i < tangents_.size(); i += tangents_.size() / kSpacingSample + 1) {
    const double area = length(cross(tangents_[i].u, tangents_[i].v));  // 1 at rest
    if (std::isfinite(area)) growth.push_back(std::sqrt(area));
  }
  return growth.empty() ? rest_offset_ : rest_offset_ * median(std::move(growth));
}

int DeformedModel::raysAcross(const Camera<ObjectSpace>& camera) const {
  std::vector<double> across;  // pixels in radii
  for (std::size_t i = 0; i < splats_.size(); i += splats_.size() / kSpacingSample + 1) {
    const Splat& splat = splats_[i];
    const double depth = camera.depthOf(splat.p_star);
    const double radius = splat.radius * std::sqrt(length(cross(splat.tangents.u, splat.tangents.v)));
    const bool faces = dot(splat.outward, camera.viewDirection(splat.p_star).raw()) > 0;
    if (!faces || !(radius > 0) || !(depth > 0 || camera.lens.isOrthographic())) continue;
    across.push_back(camera.pixelFootprint(depth) / radius);
  }
  if (across.empty()) return 1;
  const auto middle = across.begin() + static_cast<std::ptrdiff_t>(across.size() / 2);
  std::nth_element(across.begin(), middle, across.end());
  return *middle <= 1 ? 1 : static_cast<int>(std::min(std::ceil(*middle / kSurfelSpacing), double{INT_MAX}));
}

void DeformedModel::intersect(std::span<const Ray<ObjectSpace>> rays, std::span<SurfaceHit> hits) const {
  SRF_CHECK(rays.size() == hits.size());
  RaysMet met;
  for (std::size_t begin = 0; begin < rays.size(); begin += kBatch) {
    const std::size_t count = std::min(kBatch, rays.size() - begin);
    trace(rays.subspan(begin, count), met);
    blend(rays.subspan(begin, count), met, hits.subspan(begin, count));
  }
}

void DeformedModel::trace(std::span<const Ray<ObjectSpace>> rays, RaysMet& met) const {
  if (model_.kind == ModelKind::surfels) {
    scene_->gatherSplats(rays, kDepthWindow, met.splats);
    return;
  }
  met.triangles.resize(rays.size());
  for (std::size_t begin = 0; begin < rays.size(); begin += kBatch) {
    const std::size_t count = std::min(kBatch, rays.size() - begin);
    scene_->intersect(rays.subspan(begin, count), std::span(met.triangles).subspan(begin, count));
  }
}

void DeformedModel::blend(std::span<const Ray<ObjectSpace>> rays, const RaysMet& met,
                          std::span<SurfaceHit> hits) const {
  if (model_.kind == ModelKind::mesh) {
    blendTriangles(rays, met.triangles, hits);
  } else {
    blendSplats(rays, met.splats, hits);
  }
}

void DeformedModel::blendTriangles(std::span<const Ray<ObjectSpace>> rays, std::span<const TriangleHit> met,
                                   std::span<SurfaceHit> hits) const {
  thread_local BlendedFrames frames;  // for its memory
  std::size_t of[kFrameLanes];        // hits in it
  std::uint32_t reference[kFrameLanes];
  frames.count = 0;
  const auto blend = [&] {
    srf::blendFrames(frames, kPhaseCosine, kNoFrame);
    for (std::size_t i = 0; i < frames.count; ++i) {
      SurfaceHit& hit = hits[of[i]];
      if (!frames.holds[i]) {
        hit.acquisition_from_tangent = rest_frame_[reference[i]];
        hit.tangents = tangents_[reference[i]];
        continue;
      }
      const auto get = [i](const FrameVector& from) { return Vec3{from[0][i], from[1][i], from[2][i]}; };
      hit.acquisition_from_tangent = Orthogonal<AcquisitionSpace, TangentSpace>(
          Mat3::fromColumns(get(frames.r_u), get(frames.r_v), get(frames.r_n)));
      hit.tangents.u = Vector<ObjectSpace>(get(frames.t_u));
      hit.tangents.v = Vector<ObjectSpace>(get(frames.t_v));
    }
    frames.count = 0;
  };
  for (std::size_t k = 0; k < rays.size(); ++k) {
    SurfaceHit& hit = hits[k];
    hit.count = 0;
    if (!met[k].hit()) continue;
    const Triangle& corners = model_.triangles[met[k].triangle];
    const double b1 = met[k].b1, b2 = met[k].b2, b0 = std::max(0.0, 1 - b1 - b2);
    hit.p0 = pointOfTriangle(model_.p0, corners, b1, b2);
    hit.p_star = pointOfTriangle(p_star_, corners, b1, b2);
    hit.distance = dot(hit.p_star - rays[k].origin, rays[k].direction);
    hit.count = 3;
    const double weights[3] = {b0, b1, b2};
    for (int i = 0; i < 3; ++i) hit.point[i] = corners[i], hit.weight[i] = static_cast<float>(weights[i]);
    // By falling weight, ties as they come; without branches, which nothing foretells.
    for (const int i : {0, 1, 0}) {
      const bool swaps = hit.weight[i] < hit.weight[i + 1];
      const float first = hit.weight[swaps ? i + 1 : i], second = hit.weight[swaps ? i : i + 1];
      const std::uint32_t of_first = hit.point[swaps ? i + 1 : i], of_second = hit.point[swaps ? i : i + 1];
      hit.weight[i] = first, hit.weight[i + 1] = second;
      hit.point[i] = of_first, hit.point[i + 1] = of_second;
    }
    const std::size_t lane = frames.count++;
    of[lane] = k, reference[lane] = corners[0];
    double handedness = 0;
    for (int i = 0; i < 3; ++i) {
      const Mat3& frame = rest_frame_[hit.point[i]].raw();
      const Tangents<ObjectSpace>& carried = tangents_[hit.point[i]];
      const Vec3 &u = carried.u.raw(), &v = carried.v.raw();
      frames.weight[i][lane] = hit.weight[i];
      for (int axis = 0; axis < 3; ++axis) {
        frames.rest_u[i][axis][lane] = frame.row[axis].x;
        frames.rest_v[i][axis][lane] = frame.row[axis].y;
        frames.u[i][axis][lane] = u[axis];
        frames.v[i][axis][lane] = v[axis];
      }
      handedness += static_cast<double>(hit.weight[i]) * carried.handedness;
    }
    for (int axis = 0; axis < 3; ++axis) frames.reference[axis][lane] = rest_frame_[corners[0]].raw().row[axis].x;
    hit.tangents.handedness = handedness < 0 ? -1 : 1;
    if (frames.count == kFrameLanes) blend();
  }
  blend();
}

void DeformedModel::blendSplats(std::span<const Ray<ObjectSpace>> rays, const SplatLists& gathered,
                                std::span<SurfaceHit> hits) const {
  struct Met {
    SplatHit splat;
    double weight;
  };
  std::vector<Met> met;
  for (std::size_t k = 0; k < rays.size(); ++k) {
    SurfaceHit& hit = hits[k];
    hit.count = 0;
    const std::span<const SplatHit> near = gathered.of(k);
    if (near.empty()) continue;
    const Splat& first = splats_[near.front().splat];
    met.clear();
    for (const SplatHit& splat : near)
      if (&splats_[splat.splat] == &first || dot(splats_[splat.splat].outward, first.outward) > kNormalCosine)
        met.push_back({splat, splatWeight(splat.a, splat.b)});
    std::sort(met.begin(), met.end(), [](const Met& x, const Met& y) {
      return x.weight != y.weight ? x.weight > y.weight : x.splat.splat < y.splat.splat;
    });
    hit.count = static_cast<int>(std::min<std::size_t>(met.size(), SurfaceHit::kMostPoints));
    double total = 0;
    for (int i = 0; i < hit.count; ++i) total += met[i].weight;
    // Inside a splat, position and rest position are those of its plane: Psi inverted to first order.
    const Splat& anchor = splats_[met.front().splat.splat];
    const Tangents<ObjectSpace>* carried[SurfaceHit::kMostPoints];
    Vector<AcquisitionSpace> p0_from_anchor;
    Vector<ObjectSpace> p_star_from_anchor;
    for (int i = 0; i < hit.count; ++i) {
      const Splat& splat = splats_[met[i].splat.splat];
      const double weight = met[i].weight / total, a = splat.radius * met[i].splat.a, b = splat.radius * met[i].splat.b;
      const Mat3& frame = rest_frame_[splat.point].raw();
      p0_from_anchor +=
          weight * ((splat.p0 - anchor.p0) + Vector<AcquisitionSpace>(a * frame.column(0) + b * frame.column(1)));
      p_star_from_anchor += weight * ((splat.p_star - anchor.p_star) + (a * splat.tangents.u + b * splat.tangents.v));
      hit.point[i] = splat.point;
      hit.weight[i] = static_cast<float>(weight);
      carried[i] = &splat.tangents;
    }
    hit.p0 = anchor.p0 + p0_from_anchor;
    hit.p_star = anchor.p_star + p_star_from_anchor;
    hit.distance = dot(hit.p_star - rays[k].origin, rays[k].direction);
    blendFrames(hit, carried, first.point, first.tangents);
  }
}

void DeformedModel::blendFrames(SurfaceHit& hit, const Tangents<ObjectSpace>* const* carried_by_point,
                                std::uint32_t reference, const Tangents<ObjectSpace>& reference_carried) const {
  const Vec3 reference_u = rest_frame_[reference].raw().column(0);
  Vec3 u0, v0, u, v;
  double handedness = 0;
  for (int i = 0; i < hit.count; ++i) {
    const Mat3& frame = rest_frame_[hit.point[i]].raw();
    const Tangents<ObjectSpace>& carried = *carried_by_point[i];
    const Vec3 own_u = frame.column(0), own_v = frame.column(1);
    const double weight = hit.weight[i];
    handedness += weight * carried.handedness;
    // The angle in this point's plane from its own phase to the reference's.
    const double x = dot(reference_u, own_u), y = dot(reference_u, own_v), squared = x * x + y * y;
    double c = 1, s = 0;
    if (squared > 1e-6 && !(x > 0 && x * x > kPhaseCosine * kPhaseCosine * squared)) {
      c = x / std::sqrt(squared);
      s = y / std::sqrt(squared);
    }
    u0 += (weight * c) * own_u + (weight * s) * own_v;
    v0 += (weight * c) * own_v - (weight * s) * own_u;
    u += (weight * c) * carried.u.raw() + (weight * s) * carried.v.raw();
    v += (weight * c) * carried.v.raw() - (weight * s) * carried.u.raw();
  }
  hit.tangents.handedness = handedness < 0 ? -1 : 1;
  const Vec3 n = cross(u0, v0);
  const double squared = dot(n, n);
  if (!(squared > kNoFrame)) {
    hit.acquisition_from_tangent = rest_frame_[reference];
    hit.tangents = reference_carried;
    return;
  }
  // R0 is the orthonormal pair nearest to the blended rest tangents, (u0-bar v0-bar) = (u0 v0) M; the carried tangents
  // of that pair are (u v) M. So an undeformed point gives L = identity, whatever was blended.
  const Vec3 n_bar = n / std::sqrt(squared);
  const Vec3 sum = u0 + cross(v0, n_bar);
  const Vec3 u_bar = sum / std::sqrt(dot(sum, sum)), v_bar = cross(n_bar, u_bar);
  const double uu = dot(u0, u_bar), uv = dot(u0, v_bar), vu = dot(v0, u_bar), vv = dot(v0, v_bar);
  const double scale = 1 / (uu * vv - uv * vu);
  hit.acquisition_from_tangent = Orthogonal<AcquisitionSpace, TangentSpace>(Mat3::fromColumns(u_bar, v_bar, n_bar));
  hit.tangents.u = Vector<ObjectSpace>((scale * vv) * u - (scale * uv) * v);
  hit.tangents.v = Vector<ObjectSpace>((scale * uu) * v - (scale * vu) * u);
}

}  // namespace srf
