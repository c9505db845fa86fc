#include "render/light_weights.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"

namespace srf {
namespace {

/// The key of a frame's only orientation; no corner of the grid has it.
constexpr std::uint64_t kOnlyOrientation = ~std::uint64_t{0};

constexpr std::size_t kChunkLines = 1024;  // of shared vectors that are allocated together

}  // namespace

const float* LightGather::vector(const LightWeights& w, int pad, float* scratch_vector) const {
  if (w.entries == 0) {
    if (w.own != LightWeights::kNone && w.share == std::array<float, 4>{}) return own.data() + w.own;
    if (w.own == LightWeights::kNone && w.share == std::array<float, 4>{1}) return vectors[w.shared[0]];
  }
  const int count = 3 * pad;
  if (w.own != LightWeights::kNone)
    std::copy_n(own.data() + w.own, count, scratch_vector);
  else
    std::fill_n(scratch_vector, count, 0.f);
  if (w.share != std::array<float, 4>{}) {
    // An unused one has share 0; any vector may stand in its place.
    const std::size_t used =
        std::find_if(w.share.begin(), w.share.end(), [](float f) { return f > 0; }) - w.share.begin();
    std::array<const float*, 4> blended;
    for (int i = 0; i < 4; ++i) blended[i] = vectors[w.shared[w.share[i] > 0 ? i : used]];
    addBlend(scratch_vector, w.share, blended, count);
  }
  for (std::uint32_t e = w.first_entry; e < w.first_entry + w.entries; ++e)
    for (int c = 0; c < 3; ++c) scratch_vector[c * pad + entries[e].light] += entries[e].weight[c];
  return scratch_vector;
}

void LightGather::settle(LightWeights& w, int lights) {
  w.entries = static_cast<std::uint32_t>(entries.size()) - w.first_entry;
  if (w.entries > fewEntries(lights)) {
    const int pad = lightPad(lights);
    w.own = static_cast<std::uint32_t>(own.size());
    own.resize(own.size() + 3 * static_cast<std::size_t>(pad), 0.f);
    for (std::size_t e = w.first_entry; e < entries.size(); ++e)
      for (int c = 0; c < 3; ++c) own[w.own + c * pad + entries[e].light] += entries[e].weight[c];
    entries.resize(w.first_entry);
    w.entries = 0;
  }
}

std::uint32_t LightGather::append(LightWeights w, int lights) {
  settle(w, lights);
  weights.push_back(w);
  return static_cast<std::uint32_t>(weights.size() - 1);
}

void LightGather::clear() {
  weights.clear(), entries.clear(), own.clear();
  wanted.clear(), vectors.clear();
}

std::size_t LightGather::bytes() const {
  return weights.capacity() * sizeof(LightWeights) + entries.capacity() * sizeof(LightEntry) +
         own.capacity() * sizeof(float) + wanted.bytes() + vectors.capacity() * sizeof(float*);
}

FrameLighting::FrameLighting(const FrameLights& lights, std::span<const AcquiredLights> lists, const Options& options)
    : lights_(lights), lists_(lists), options_(options) {
  if (options_.sharing > 0) grid_.emplace(options_.sharing);
  for (const AcquiredLights& list : lists_) {
    bool serves = list.relightable() || (lights.distant.empty() && lights.near_lights.empty());
    for (const RestLight& rest : lights.rest) serves = serves && list.find(rest.light);
    serves_.push_back(serves);
  }
}

bool FrameLighting::shares(std::uint32_t list) const {
  return lists_[list].distant() && !lights_.distant.empty() &&
         (options_.only_orientation || (grid_ && lights_.distant.size() >= kFewestShared));
}

bool FrameLighting::sharesLike(const std::vector<DistantLight>& distant,
                               const std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>>& only_orientation) const {
  const auto same = [](const DistantLight& a, const DistantLight& b) {
    return a.direction == b.direction && a.irradiance == b.irradiance;
  };
  const auto matrix = [](const auto& orientation) { return orientation ? orientation->raw() : Mat3{}; };
  return only_orientation.has_value() == options_.only_orientation.has_value() &&
         matrix(only_orientation) == matrix(options_.only_orientation) &&
         std::equal(distant.begin(), distant.end(), lights_.distant.begin(), lights_.distant.end(), same);
}

template <class Add>
void FrameLighting::standIn(const AcquiredLights& list, const Direction<AcquisitionSpace>& direction,
                            const Vec3& irradiance, const Point<AcquisitionSpace>& p, std::vector<Penalised>& scratch,
                            std::vector<Weighted>& nearest, const Add& add) const {
  list.nearest(direction, p, scratch, nearest);
  for (const Weighted& light : nearest)
    add(light.source, light.weight * (irradiance * list.inverseIrradiance(light.source, p)));
}

void FrameLighting::standIn(const AcquiredLights& list, const Direction<AcquisitionSpace>& direction,
                            const Vec3& irradiance, const Point<AcquisitionSpace>& p, LightGather& out) const {
  standIn(list, direction, irradiance, p, out.scratch, out.nearest, [&](std::uint32_t light, const Vec3& weight) {
    out.entries.push_back(
        {light, {static_cast<float>(weight.x), static_cast<float>(weight.y), static_cast<float>(weight.z)}});
  });
}

OrientationGrid::Blend FrameLighting::sharedCorners(
    const Orthogonal<AcquisitionSpace, ObjectSpace>& acquisition_from_object) const {
  if (options_.only_orientation) return {{kOnlyOrientation}, {1}};
  return grid_->blend(acquisition_from_object);
}

void FrameLighting::sharedCorners(const std::function<const Orthogonal<AcquisitionSpace, ObjectSpace>&(std::size_t)>& l,
                                  std::span<OrientationGrid::Blend> blends) const {
  if (options_.only_orientation) {
    std::fill(blends.begin(), blends.end(), OrientationGrid::Blend{{kOnlyOrientation}, {1}});
    return;
  }
  struct Memory {
    std::vector<std::int32_t> cell;
    std::vector<float> fraction, matrix;
  };
  thread_local Memory memory;
  const std::size_t stride = paddedLanes(blends.size());
  memory.cell.resize(4 * stride);
  memory.fraction.resize(3 * stride);
  memory.matrix.resize(9 * stride);
  std::int32_t* const cell = memory.cell.data();
  float *const fraction = memory.fraction.data(), *const matrix = memory.matrix.data();
  for (std::size_t i = 0; i < blends.size(); ++i) {
    const Mat3& m = l(i).raw();
    for (int k = 0; k < 9; ++k) matrix[k * stride + i] = static_cast<float>(m.row[k / 3][k % 3]);
  }
  OrientationLanes orientations{};
  for (int k = 0; k < 9; ++k) orientations.m[k] = matrix + k * stride;
  const OrientationCells where{cell,
                               {cell + stride, cell + 2 * stride, cell + 3 * stride},
                               {fraction, fraction + stride, fraction + 2 * stride}};
  orientationCells(orientations, blends.size(), grid_->halfCells(), where);
  OrientationGrid::Place last{-1, {}, {}};
  int last_tetrahedron = -1;
  for (std::size_t i = 0; i < blends.size(); ++i) {
    const OrientationGrid::Place place{where.code[i],
                                       {where.cell[0][i], where.cell[1][i], where.cell[2][i]},
                                       {where.fraction[0][i], where.fraction[1][i], where.fraction[2][i]}};
    const int tetrahedron = OrientationGrid::tetrahedron(place);
    if (place.code == last.code && place.cell == last.cell && tetrahedron == last_tetrahedron)
      blends[i] = {blends[i - 1].corner, OrientationGrid::shares(place)};
    else
      blends[i] = grid_->blend(place);
    last = place, last_tetrahedron = tetrahedron;
  }
}

void FrameLighting::noteShared(std::uint32_t list, const LitPoint& point, LightGather& out, LightWeights& w) const {
  const OrientationGrid::Blend blend = sharedCorners(point.acquisition_from_object);
  // Neighbouring hits mostly want the same vectors: ask the last ones before the table.
  const LightWeights* last = out.weights.empty() ? nullptr : &out.weights.back();
  for (int i = 0; i < 4; ++i) {
    if (!(blend.share[i] > 0)) continue;
    const SharedKey key{list, blend.corner[i]};
    w.share[i] = blend.share[i];
    bool found = false;
    for (int j = 0; last && j < 4 && !found; ++j)
      if (last->share[j] > 0 && out.wanted[last->shared[j]] == key) {
        w.shared[i] = last->shared[j];
        found = true;
      }
    if (!found) w.shared[i] = out.wanted.numberOf(key);
  }
}

std::pair<Direction<AcquisitionSpace>, Vec3> FrameLighting::nearLightAt(const NearLight& light,
                                                                        const LitPoint& point) const {
  const Vector<ObjectSpace> to_light = light.position - point.p_star;
  const double d = std::max(length(to_light), options_.min_distance);
  const auto towards = normalize(to_light);
  const Direction<ObjectSpace> direction = towards ? *towards : point.normal();
  return {point.acquisition_from_object * direction, light.intensity / (d * d)};  // Eq. 11: A(|p* - p_l|) I_l
}

std::uint32_t FrameLighting::gather(std::uint32_t list_index, const LitPoint& point, LightGather& out) const {
  const AcquiredLights& list = lists_[list_index];
  LightWeights w;
  w.first_entry = static_cast<std::uint32_t>(out.entries.size());
  if (shares(list_index))
    noteShared(list_index, point, out, w);
  else
    addDistant(list, point, out);
  for (const NearLight& light : lights_.near_lights) addNear(list, light, point, out);
  addRest(list, out);
  return out.append(w, list.count());
}

void FrameLighting::addDistant(const AcquiredLights& list, const LitPoint& point, LightGather& out) const {
  for (const DistantLight& light : lights_.distant)
    standIn(list, point.acquisition_from_object * light.direction, light.irradiance, point.p, out);
}

void FrameLighting::addNear(const AcquiredLights& list, const NearLight& light, const LitPoint& point,
                            LightGather& out) const {
  const auto [direction, irradiance] = nearLightAt(light, point);
  standIn(list, direction, irradiance, point.p, out);
}

void FrameLighting::addRest(const AcquiredLights& list, LightGather& out) const {
  for (const RestLight& light : lights_.rest) {
    const auto scale = static_cast<float>(light.scale);
    if (const auto at = list.find(light.light)) out.entries.push_back({*at, {scale, scale, scale}});
  }
}

void FrameLighting::gather(std::span<const LitPoint> points, std::span<const Wanted> wanted, LightGather& out) const {
  for (std::size_t begin = 0, end = 0; begin < wanted.size(); begin = end) {
    const std::uint32_t list = wanted[begin].list;
    while (end < wanted.size() && wanted[end].list == list) ++end;
    // All or none by the kernels, whatever other lights there are: so pictures stay linear in the lights.
    if (options_.sharing > 0 && lists_[list].cells()) {
      gatherMany(list, points, wanted.subspan(begin, end - begin), out);
      continue;
    }
    for (std::size_t i = begin; i < end; ++i) gather(list, points[wanted[i].point], out);
  }
}

void FrameLighting::gatherMany(std::uint32_t list_index, std::span<const LitPoint> points,
                               std::span<const Wanted> wanted, LightGather& out) const {
  const AcquiredLights& list = lists_[list_index];
  const LightCells cells = *list.cells();
  const std::size_t count = wanted.size(), stride = paddedLanes(count), lights = lights_.near_lights.size();
  const int k = list.k();
  struct Memory {
    std::vector<double> lit;
    std::vector<float> lanes, falloff, weight;
    std::vector<std::int32_t> cell;
    std::vector<std::uint32_t> light;
    std::vector<Rgb> irradiance;
    std::vector<OrientationGrid::Blend> blends;
  };
  thread_local Memory memory;
  memory.lit.resize(12 * stride);
  memory.lanes.resize(3 * stride);
  memory.falloff.resize(stride);
  memory.cell.resize(stride);
  float* const lane = memory.lanes.data();
  for (std::size_t i = 0; i < count; ++i) {
    const LitPoint& point = points[wanted[i].point];
    const Vec3& p_star = point.p_star.raw();
    const Mat3& l = point.acquisition_from_object.raw();
    double* const to = memory.lit.data() + i;
    for (int k = 0; k < 3; ++k) to[k * stride] = p_star[k];
    for (int k = 0; k < 9; ++k) to[(3 + k) * stride] = l.row[k / 3][k % 3];
  }
  LitLanes lit;
  for (int k = 0; k < 3; ++k) lit.p_star[k] = memory.lit.data() + k * stride;
  for (int k = 0; k < 9; ++k) lit.l[k] = memory.lit.data() + (3 + k) * stride;

  memory.blends.resize(count);
  if (shares(list_index))
    sharedCorners(
        [&](std::size_t i) -> const auto& { return points[wanted[i].point].acquisition_from_object; }, memory.blends);
  const std::size_t first = out.weights.size();
  out.weights.resize(first + count);
  std::array<std::uint32_t, 4> ids{};
  for (std::size_t i = 0; shares(list_index) && i < count; ++i) {
    LightWeights& w = out.weights[first + i];
    const OrientationGrid::Blend& blend = memory.blends[i];
    if (i == 0 || blend.corner != memory.blends[i - 1].corner) ids.fill(LightWeights::kNone);
    w.share = blend.share;
    for (int c = 0; c < 4; ++c) {
      if (!(blend.share[c] > 0)) continue;
      if (ids[c] == LightWeights::kNone) ids[c] = out.wanted.numberOf({list_index, blend.corner[c]});
      w.shared[c] = ids[c];
    }
  }

  memory.weight.resize(lights * k * stride);
  memory.light.resize(lights * k * stride);
  memory.irradiance.resize(lights * stride);
  for (std::size_t l = 0; l < lights; ++l) {
    float *const x = lane, *const y = lane + stride, *const z = lane + 2 * stride;
    const NearLight& light = lights_.near_lights[l];
    const auto red = static_cast<float>(light.intensity.x), green = static_cast<float>(light.intensity.y),
               blue = static_cast<float>(light.intensity.z);
    Rgb* const irradiance = &memory.irradiance[l * stride];
    const bool ordinary =
        towardsLight(lit, light.position.raw(), options_.min_distance, count, x, y, z, memory.falloff.data());
    for (std::size_t i = 0; i < count; ++i) {
      const float falloff = memory.falloff[i];
      irradiance[i] = {red * falloff, green * falloff, blue * falloff};
    }
    for (std::size_t i = 0; i < count && !ordinary; ++i) {
      const LitPoint& point = points[wanted[i].point];
      const Vec3 to_light = (light.position - point.p_star).raw();
      const double squared = dot(to_light, to_light);
      if (squared > kOrdinarySquares[0] && squared < kOrdinarySquares[1]) continue;
      const auto [direction, e] = nearLightAt(light, point);
      const Vec3& d = direction.raw();
      x[i] = static_cast<float>(d.x), y[i] = static_cast<float>(d.y), z[i] = static_cast<float>(d.z);
      irradiance[i] = {static_cast<float>(e.x), static_cast<float>(e.y), static_cast<float>(e.z)};
    }
    for (std::size_t i = count; i < stride; ++i) x[i] = y[i] = 0, z[i] = 1;
    lightCells(x, y, z, count, cells.resolution, memory.cell.data());
    nearestWeights(cells, x, y, z, memory.cell.data(), count, k, stride, &memory.weight[l * k * stride],
                   &memory.light[l * k * stride]);
  }
  const auto& inverse = list.inverseIrradiances();
  const std::size_t exact = shares(list_index) ? 0 : lights_.distant.size();
  out.entries.reserve(out.entries.size() + count * ((exact + lights) * k + lights_.rest.size()));
  for (std::size_t i = 0; i < count; ++i) {
    LightWeights& w = out.weights[first + i];
    w.first_entry = static_cast<std::uint32_t>(out.entries.size());
    const LitPoint& point = points[wanted[i].point];
    if (exact > 0) addDistant(list, point, out);
    for (std::size_t l = 0; l < lights; ++l) {
      const float* weight = &memory.weight[l * k * stride + i];
      const std::uint32_t* light = &memory.light[l * k * stride + i];
      if (!(*weight > 0)) {  // all tie
        addNear(list, lights_.near_lights[l], point, out);
        continue;
      }
      const Rgb& e = memory.irradiance[l * stride + i];
      for (int j = 0; j < k; ++j) {
        const float share = weight[j * stride];
        if (!(share > 0)) break;  // by falling weight
        const std::uint32_t of = light[j * stride];
        const std::array<float, 3>& per = inverse[of];
        out.entries.push_back({of, {share * (e[0] * per[0]), share * (e[1] * per[1]), share * (e[2] * per[2])}});
      }
    }
    addRest(list, out);
    out.settle(w, list.count());
  }
}

void FrameLighting::computeShared(const SharedKey& key, float* vector, std::uint32_t* nearest_of) const {
  const AcquiredLights& list = lists_[key.list];
  const int pad = lightPad(list.count());
  std::fill_n(vector, 3 * pad, 0.f);
  const Orthogonal<AcquisitionSpace, ObjectSpace> acquisition_from_object =
      key.corner == kOnlyOrientation ? *options_.only_orientation : grid_->orientation(key.corner);
  if (const auto cells = list.cells(); cells && options_.sharing > 0) {
    const std::size_t count = lights_.distant.size(), stride = paddedLanes(count), k = list.k();
    thread_local std::vector<float> lane, weight;
    thread_local std::vector<std::int32_t> cell;
    thread_local std::vector<std::uint32_t> of;
    lane.resize(3 * stride), cell.resize(stride), weight.resize(k * stride), of.resize(k * stride);
    float *const x = lane.data(), *const y = x + stride, *const z = y + stride;
    for (std::size_t i = 0; i < stride; ++i) {
      const Vec3 d = (acquisition_from_object * lights_.distant[std::min(i, count - 1)].direction).raw();
      x[i] = static_cast<float>(d.x), y[i] = static_cast<float>(d.y), z[i] = static_cast<float>(d.z);
    }
    lightCells(x, y, z, count, cells->resolution, cell.data());
    nearestWeights(*cells, x, y, z, cell.data(), count, list.k(), stride, weight.data(), of.data());
    const auto& inverse = list.inverseIrradiances();
    bool all_told = true;
    for (std::size_t i = 0; i < count; ++i) all_told &= weight[i] > 0;  // else the k + 1 nearest tie
    for (std::size_t i = 0; all_told && i < count; ++i) {
      const Vec3& irradiance = lights_.distant[i].irradiance;
      for (std::size_t j = 0; j < k; ++j) {
        const std::uint32_t captured = of[j * stride + i];
        for (int c = 0; c < 3; ++c)
          vector[c * pad + captured] +=
              weight[j * stride + i] * (static_cast<float>(irradiance[c]) * inverse[captured][c]);
      }
      if (nearest_of) nearest_of[i] = of[i];
    }
    if (all_told) return;
  }
  std::vector<Penalised> scratch;
  std::vector<Weighted> nearest;
  for (const DistantLight& light : lights_.distant) {
    standIn(list, acquisition_from_object * light.direction, light.irradiance, Point<AcquisitionSpace>(), scratch,
            nearest, [&](std::uint32_t i, const Vec3& weight) {
              for (int c = 0; c < 3; ++c) vector[c * pad + i] += static_cast<float>(weight[c]);
            });
    if (nearest_of) *nearest_of++ = nearest.front().source;  // by falling weight
  }
}

void SharedLightVectors::prepare(const FrameLighting& lighting) {
  if (lighting.sharesLike(distant_, only_orientation_)) return;
  keys_.clear(), vectors_.clear();
  filled_ = chunk_ = used_ = 0;
  distant_ = lighting.lights().distant;
  only_orientation_ = lighting.options().only_orientation;
}

void SharedLightVectors::clear() {
  keys_ = SharedKeys(), vectors_ = std::vector<float*>();
  chunks_.clear();
  filled_ = chunk_ = used_ = 0;
  bytes_ = 0;
}

float* SharedLightVectors::room(std::size_t floats) {
  const std::size_t lines = (floats + std::size(Line().value) - 1) / std::size(Line().value);
  while (chunk_ < chunks_.size() && used_ + lines > chunks_[chunk_].lines) ++chunk_, used_ = 0;
  if (chunk_ == chunks_.size()) {
    const std::size_t size = std::max(kChunkLines, lines);
    chunks_.push_back({size, std::make_unique_for_overwrite<Line[]>(size)});
    bytes_ += size * sizeof(Line);
  }
  float* const at = chunks_[chunk_].memory[used_].value;
  used_ += lines;
  return at;
}

void SharedLightVectors::want(LightGather& gather, const FrameLighting& lighting) {
  gather.vectors.clear();
  gather.vectors.reserve(gather.wanted.size());
  const std::lock_guard lock(wanting_);
  for (std::size_t i = 0; i < gather.wanted.size(); ++i) {
    const SharedKey& key = gather.wanted[i];
    const std::uint32_t number = keys_.numberOf(key);
    if (number == vectors_.size())
      vectors_.push_back(room(3 * static_cast<std::size_t>(lightPad(lighting.lists()[key.list].count()))));
    gather.vectors.push_back(vectors_[number]);
  }
}

void SharedLightVectors::compute(const FrameLighting& lighting) {
  const std::size_t first = filled_;
  parallelFor(keys_.size() - first, 4, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = first + begin; i < first + end; ++i) lighting.computeShared(keys_[i], vectors_[i]);
  });
  computed_ += keys_.size() - first;
  filled_ = keys_.size();
}

}  // namespace srf
