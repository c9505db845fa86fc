// Where a frame's time goes, stage by stage, each beside the limit of this machine measured in the same run: tracing
// against a bare Embree loop over the same rays, the product with the stack against a bare kernel that streams as many
// halves, memory by a plain read. Prints rows of Markdown.
#include <embree3/rtcore.h>
#include <immintrin.h>

#include <cstdio>
#include <memory>
#include <numeric>
#include <random>

#include "apps/program.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "bench/timing.h"
#include "model/frame_kernels.h"
#include "render/animation.h"
#include "render/guided_kernels.h"
#include "render/scene.h"
#include "render/view_kernels.h"

namespace srf {
namespace {

// Embree with nothing around it: float rays made beforehand, packets of 16, rows of the picture shared among threads.
class BareEmbree {
 public:
  BareEmbree(const std::vector<Point<ObjectSpace>>& positions, const std::vector<Triangle>& triangles,
             const Camera<ObjectSpace>& camera)
      : device_(rtcNewDevice(nullptr)), scene_(rtcNewScene(device_)), moving_(rtcNewScene(device_)) {
    RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* xyz = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, positions.size()));
    auto* const first = xyz;
    for (const auto& p : positions)
      for (int k = 0; k < 3; ++k) *xyz++ = static_cast<float>(p.raw()[k]);
    auto* index = static_cast<Triangle*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, triangles.size()));
    std::copy(triangles.begin(), triangles.end(), index);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_, geometry);
    rtcReleaseGeometry(geometry);
    rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
    rtcCommitScene(scene_);
    xyz_.assign(first, first + 3 * positions.size() + 1);
    geometry_ = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, xyz_.data(), 0, 12,
                               positions.size());
    std::copy(triangles.begin(), triangles.end(),
              static_cast<Triangle*>(rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12,
                                                             triangles.size())));
    rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_REFIT);
    rtcCommitGeometry(geometry_);
    rtcAttachGeometry(moving_, geometry_);
    rtcSetSceneFlags(moving_, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_DYNAMIC));
    rtcSetSceneBuildQuality(moving_, RTC_BUILD_QUALITY_LOW);
    rtcCommitScene(moving_);
    const int width = camera.lens.width, height = camera.lens.height;
    for (int y = 0; y < height; y += 4)  // packets of 4 x 4 pixels
      for (int x = 0; x < width; x += 4) {
        RTCRay16 packet{};
        for (int i = 0; i < 16; ++i) {
          const auto ray = camera.ray({std::min(x + i % 4, width - 1) + 0.5, std::min(y + i / 4, height - 1) + 0.5});
          packet.org_x[i] = ray->origin.raw().x, packet.org_y[i] = ray->origin.raw().y;
          packet.org_z[i] = ray->origin.raw().z, packet.dir_x[i] = ray->direction.raw().x;
          packet.dir_y[i] = ray->direction.raw().y, packet.dir_z[i] = ray->direction.raw().z;
          packet.tfar[i] = INFINITY, packet.mask[i] = 0xffffffffu;
        }
        packets_.push_back(packet);
      }
  }
  ~BareEmbree() {
    rtcReleaseGeometry(geometry_);
    rtcReleaseScene(moving_);
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  BareEmbree(const BareEmbree&) = delete;
  BareEmbree& operator=(const BareEmbree&) = delete;

  /// New positions for the vertices, and the refit.
  void refit(const std::vector<Point<ObjectSpace>>& positions) {
    parallelFor(positions.size(), 8192, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const Vec3& p = positions[i].raw();
        const Vec3 moved{0.8 * p.x - 0.6 * p.y, 0.6 * p.x + 0.8 * p.y, p.z};
        for (int k = 0; k < 3; ++k) xyz_[3 * i + k] = static_cast<float>(moved[k]);
      }
    });
    rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(geometry_);
    rtcCommitScene(moving_);
  }

  void trace() const {
    parallelFor(packets_.size(), 256, [&](std::size_t begin, std::size_t end) {
      alignas(64) int valid[16];
      std::fill(std::begin(valid), std::end(valid), -1);
      for (std::size_t p = begin; p < end; ++p) {
        alignas(64) RTCRayHit16 hit;
        hit.ray = packets_[p];
        std::fill(std::begin(hit.hit.geomID), std::end(hit.hit.geomID), RTC_INVALID_GEOMETRY_ID);
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        rtcIntersect16(valid, scene_, &context, &hit);
      }
    });
  }

 private:
  RTCDevice device_;
  RTCScene scene_, moving_;  ///< as it stands; that of refit()
  RTCGeometry geometry_;
  std::vector<float> xyz_;
  std::vector<RTCRay16> packets_;
};

// Occlusion rays from the model's points, in the order of the points, to directions all over the sphere.
class BareShadows {
 public:
  BareShadows(const DeformedModel& deformed, std::size_t rays) : deformed_(deformed), blocked_(rays) {
    const auto& points = deformed.positions();
    const double golden = kPi * (3 - std::sqrt(5.0)), offset = 1e-3 * deformed.bounds().diameter();
    for (std::size_t i = 0; i < rays; ++i) {
      // 32 rays from a point to lights of one hemisphere, as a hit casts them.
      const std::size_t point = i / 32 * 32 * 7919 % points.size(), light = i % 32;
      const Direction<ObjectSpace> n = *normalize(points[point] - Point<ObjectSpace>(Vec3{1e-9, 0, 0}));
      const double z = 1 - (light + 0.5) / 32, r = std::sqrt(1 - z * z);
      const Direction<ObjectSpace> u = anyPerpendicular(n);
      const Vec3 d =
          z * n.raw() + r * std::cos(golden * light) * u.raw() + r * std::sin(golden * light) * cross(n, u).raw();
      rays_.push_back({points[point] + offset * n, Direction<ObjectSpace>::fromUnit(d)});
    }
  }
  void trace() const {
    parallelFor(rays_.size(), 8192, [&](std::size_t begin, std::size_t end) {
      const std::vector<double> far(end - begin, std::numeric_limits<double>::infinity());
      deformed_.rays().occluded(std::span(rays_).subspan(begin, end - begin), far, 0,
                                std::span(blocked_).subspan(begin, end - begin));
    });
  }

 private:
  const DeformedModel& deformed_;
  std::vector<Ray<ObjectSpace>> rays_;
  mutable std::vector<std::uint8_t> blocked_;
};

// Sums of the model over so many pairs of a light and a view, 64 lights of one view at a time.
void bareModelValues(std::size_t count) {
  parallelFor((count + 63) / 64, 256, [&](std::size_t begin, std::size_t end) {
    const std::vector<float> lane(64, 0.577f);
    const std::array<float, 3> view{0.6f, 0, 0.8f};
    PointReflectance point;
    [[maybe_unused]] volatile float sink = 0;
    for (std::size_t i = begin; i < end; ++i) {
      point.alpha_x = 0.1f + 1e-6f * static_cast<float>(i % 1000);
      ModelOfPoint model = modelOfPoint(point);
      const ModelView of = addView(model, point, view, 1);
      sink = modelSums(model, &of, 1, {lane.data(), lane.data(), lane.data()}, {lane.data(), lane.data(), lane.data()},
                       64)[0];
    }
  });
}

// The kernels of view selection over hits on a sphere: `pairs` places of views, and bounds of `views` views a hit,
// every other one of which sees it.
class BareViews {
 public:
  BareViews(const Camera<AcquisitionSpace>& camera, std::size_t hits, std::size_t pairs, std::size_t views)
      : camera_(camera), hits_(hits), pairs_(pairs), views_(views) {
    for (std::size_t v = 0; v < views; ++v) {
      const double z = 1 - (v + 0.5) * 2 / views, r = std::sqrt(1 - z * z), angle = 2.4 * static_cast<double>(v);
      centers_[0].push_back(static_cast<float>(3 * r * std::cos(angle)));
      centers_[1].push_back(static_cast<float>(3 * r * std::sin(angle)));
      centers_[2].push_back(static_cast<float>(3 * z));
      numbers_.push_back(static_cast<std::uint32_t>(v));
    }
    seen_.assign((views / 32 + 1) * kAtOnce, ~0u);
    for (std::size_t i = 0; i < kAtOnce; ++i) {
      const double z = 1 - (i + 0.5) * 2 / kAtOnce, r = std::sqrt(1 - z * z), angle = 2.4 * static_cast<double>(i);
      const double xyz[3] = {r * std::cos(angle), r * std::sin(angle), z};
      for (int k = 0; k < 9; ++k) lanes_[k].push_back(xyz[k % 3]);
      lanes_[9].push_back(3);
      for (int k = 0; k < 3; ++k) near_[k].push_back(static_cast<float>(xyz[k]));
      near_[3].push_back(0.3f);
    }
  }
  void run() const {
    parallelFor((hits_ + kAtOnce - 1) / kAtOnce, 8, [&](std::size_t begin, std::size_t end) {
      const int wanted = std::min<int>(static_cast<int>(pairs_ / hits_), kMostNearViews);
      std::vector<float> bound(views_ * kAtOnce), rest(kAtOnce);
      std::vector<std::int32_t> nearest(wanted * kAtOnce);
      const auto& n = near_;
      for (std::size_t b = begin; b < end; ++b)
        nearestViews(
            {centers_[0].data(), centers_[1].data(), centers_[2].data(), numbers_.data(), views_},
            {n[0].data(), n[1].data(), n[2].data(), n[0].data(), n[1].data(), n[2].data(), n[3].data(), seen_.data()},
            kAtOnce, kAtOnce, wanted, bound.data(), nearest.data(), rest.data());
    });
    parallelFor((pairs_ + kAtOnce - 1) / kAtOnce, 8, [&](std::size_t begin, std::size_t end) {
      std::array<std::vector<double>, 6> out;
      for (auto& lane : out) lane.resize(kAtOnce);
      std::array<std::vector<std::int32_t>, 3> texels;
      for (auto& lane : texels) lane.resize(kAtOnce);
      std::vector<float> taps(4 * kAtOnce);
      const PlacedView view(camera_);
      const WholeTexels whole;
      const std::vector<std::int32_t> of(kAtOnce, 0);
      const std::vector<double> one(kAtOnce, 1.0);
      const auto& l = lanes_;
      const HitLanes in{l[0].data(), l[1].data(), l[2].data(), l[3].data(), l[4].data(),  l[5].data(), l[6].data(),
                        l[7].data(), l[8].data(), l[9].data(), one.data(),  seen_.data(), kAtOnce};
      for (std::size_t b = begin; b < end; ++b)
        placeViews(&view, whole, of.data(), 0.05, 4, in, kAtOnce,
                   {out[0].data(), out[1].data(), out[2].data(), out[3].data(), out[4].data(), out[5].data(),
                    texels[0].data(), texels[1].data(), texels[2].data(), taps.data()});
    });
  }

 private:
  static constexpr std::size_t kAtOnce = 256;
  Camera<AcquisitionSpace> camera_;
  std::size_t hits_, pairs_, views_;
  std::array<std::vector<float>, 3> centers_;
  std::array<std::vector<float>, 4> near_;
  std::vector<std::uint32_t> numbers_, seen_;
  std::array<std::vector<double>, 10> lanes_;
};

// Blends the frames of so many hits, whose points' tangents lie in place.
void bareFrames(std::size_t hits) {
  parallelFor((hits + kFrameLanes - 1) / kFrameLanes, 64, [](std::size_t begin, std::size_t end) {
    const auto frames = std::make_unique<BlendedFrames>();
    const auto fill = [](FrameVector& to, const Vec3& value) {
      for (int axis = 0; axis < 3; ++axis) std::fill_n(to[axis], kFrameLanes, value[axis]);
    };
    frames->count = kFrameLanes;
    for (int i = 0; i < 3; ++i) {
      std::fill_n(frames->weight[i], kFrameLanes, 1.0 / 3);
      fill(frames->rest_u[i], {1, 0, 0}), fill(frames->rest_v[i], {0, 1, 0});
      fill(frames->u[i], {0.8, 0.6, 0}), fill(frames->v[i], {-0.6, 0.8, 0.1});
    }
    fill(frames->reference, {1, 0, 0});
    for (std::size_t i = begin; i < end; ++i) blendFrames(*frames, 0.99, 1e-8);
  });
}

// Blends four vectors of light weights a hit.
void bareBlend(std::size_t hits, std::size_t lights) {
  parallelFor(hits, 4096, [&](std::size_t begin, std::size_t end) {
    const int count = static_cast<int>(3 * lights);
    std::vector<float> vectors(static_cast<std::size_t>(count) * 8, 0.01f), sum(count);
    const std::array<float, 4> share{0.4f, 0.3f, 0.2f, 0.1f};
    for (std::size_t h = begin; h < end; ++h) {
      std::fill(sum.begin(), sum.end(), 0.f);
      std::array<const float*, 4> of;
      for (std::size_t i = 0; i < 4; ++i) of[i] = vectors.data() + (h + i) % 8 * count;
      addBlend(sum.data(), share, of, count);
    }
  });
}

// The kernels that make the residual's light weights of guided hits, over arrays at hand: shares of visibility bits,
// which captured lights face, how much of the frame's lights is shown, the blend of four shared vectors, what counts of
// it all, and the captured lights nearest to point lights.
class BareResidualWeights {
 public:
  BareResidualWeights(const AcquiredLights& list, const FrameLights& lights, std::size_t hits)
      : list_(list),
        distant_(lights.distant.size()),
        near_(lights.near_lights.size()),
        pad_(paddedLanes(static_cast<std::size_t>(list.count()))),
        known_(pad_, 0),
        energy_(paddedLanes(distant_), 0),
        about_(paddedLanes(distant_), 0),
        own_((hits + kHits - 1) / kHits * kHits * 3 * pad_, 0) {
    std::mt19937 random(1);
    std::uniform_real_distribution<float> uniform(0, 1);
    for (int c = 0; c < 3; ++c) {
      captured_[c].assign(pad_, c == 2 ? 1.f : 0.f);
      irradiance_[c].assign(pad_, 0);
      direction_[c].assign(paddedLanes(distant_), c == 2 ? 1.f : 0.f);
      for (auto& answer : answer_[c] = std::vector<float>(kHits * paddedLanes(distant_))) answer = uniform(random);
    }
    for (const std::uint32_t i : list.usable()) {
      known_[i] = 1;
      for (int c = 0; c < 3; ++c) {
        captured_[c][i] = static_cast<float>(list.directionOf(i, {}).raw()[c]);
        irradiance_[c][i] = 1;
      }
    }
    std::vector<Penalised> order;
    std::vector<Weighted> nearest;
    for (std::size_t k = 0; k < distant_; ++k) {
      const Vec3& d = lights.distant[k].direction.raw();
      for (int c = 0; c < 3; ++c) direction_[c][k] = static_cast<float>(d[c]);
      energy_[k] = static_cast<float>(maxComponent(lights.distant[k].irradiance));
      list.nearest(Direction<AcquisitionSpace>::fromUnit(d), {}, order, nearest);
      about_[k] = nearest[0].source;
    }
    // Three points of a hit that see much the same lights.
    for (std::size_t i = 0; i < kHits; ++i) {
      std::uint64_t common = random();
      for (std::size_t p = 0; p < 3; ++p)
        for (std::size_t w = 0; w < pad_ / 64 + 1; ++w)
          rows_[i][p].push_back((common = common * 6364136223846793005u + 1) | (random() & random() & random()));
      const double z = 1 - (static_cast<double>(i) + 0.5) * 2 / kHits, r = std::sqrt(1 - z * z),
                   angle = 2.4 * static_cast<double>(i);
      normal_[i] = {static_cast<float>(r * std::cos(angle)), static_cast<float>(r * std::sin(angle)),
                    static_cast<float>(z)};
      sight_[i].assign(paddedLanes(distant_), kNotAsked);
      for (std::size_t k = 0; k < distant_; k += 32) sight_[i][k] = static_cast<std::int8_t>(random() % 2);
    }
  }
  void run() {
    const auto lanes = [](const auto& of, std::size_t from = 0) {
      return std::array<const float*, 3>{of[0].data() + from, of[1].data() + from, of[2].data() + from};
    };
    const auto directions = [](const auto& of) { return DirectionLanes{of[0].data(), of[1].data(), of[2].data()}; };
    const CapturedLanes captured{directions(captured_), known_.data(), lanes(irradiance_), lanes(irradiance_)};
    parallelFor(own_.size() / (kHits * 3 * pad_), 16, [&](std::size_t begin, std::size_t end) {
      std::vector<float> lit(pad_), usable(pad_), facing(pad_), gate(pad_, 1), shown(3 * pad_), energy(4 * pad_),
          vectors(3 * pad_ * 8, 0.01f), blended(3 * pad_);
      std::array<std::vector<float>, 3> used_direction, used_model;
      for (int c = 0; c < 3; ++c) used_direction[c].resize(pad_), used_model[c].resize(pad_);
      const std::array<float, 3> share{0.5f, 0.3f, 0.2f};
      const std::optional<LightCells> cells = list_.cells();
      std::vector<std::int32_t> cell(kHits);
      std::vector<float> weight(kHits * static_cast<std::size_t>(list_.k()));
      std::vector<std::uint32_t> light(weight.size());
      std::array<std::vector<float>, 3> towards;
      for (int c = 0; c < 3; ++c)
        for (const auto& n : normal_) towards[c].push_back(n[c]);
      for (std::size_t b = begin; b < end; ++b) {
        for (std::size_t l = 0; cells && l < near_; ++l) {
          lightCells(towards[0].data(), towards[1].data(), towards[2].data(), kHits, cells->resolution, cell.data());
          nearestWeights(*cells, towards[0].data(), towards[1].data(), towards[2].data(), cell.data(), kHits, list_.k(),
                         kHits, weight.data(), light.data());
        }
        for (std::size_t h = 0; h < kHits; ++h) {
          const std::uint64_t* const rows[3] = {rows_[h][0].data(), rows_[h][1].data(), rows_[h][2].data()};
          shareBits(rows, share.data(), 3, pad_, lit.data());
          shareBits(rows, share.data(), 3, pad_, usable.data());
          facingCaptured(normal_[h], captured, pad_, lit.data(), usable.data(), facing.data());
          shownBySight(lit.data(), facing.data(), nullptr, pad_, shown.data());
          std::fill(energy.begin(), energy.end(), 0.f);
          distantSums(normal_[h], {directions(direction_), energy_.data()}, lanes(answer_, h * energy_.size()),
                      sight_[h].data(), about_.data(), {shown.data(), pad_, nullptr}, energy_.size(), energy.data());
          std::array<const float*, 4> of;
          for (std::size_t i = 0; i < 4; ++i) of[i] = vectors.data() + (h + i) % 8 * 3 * pad_;
          blendVectors(of, {0.4f, 0.3f, 0.2f, 0.1f}, 3 * pad_, blended.data());
          const ResidualShares shares{0.2f,
                                      0.2f,
                                      2,
                                      energy.data(),
                                      gate.data(),
                                      lit.data(),
                                      usable.data(),
                                      {blended.data(), blended.data() + pad_, blended.data() + 2 * pad_}};
          std::size_t photographs = 0;
          float* const own = own_.data() + (b * kHits + h) * 3 * pad_;
          usedLights(captured, pad_, &shares, nullptr, {own, own + pad_, own + 2 * pad_},
                     {{used_direction[0].data(), used_direction[1].data(), used_direction[2].data()},
                      {used_model[0].data(), used_model[1].data(), used_model[2].data()}},
                     photographs);
        }
      }
    });
  }

 private:
  static constexpr std::size_t kHits = 64;
  const AcquiredLights& list_;
  std::size_t distant_, near_, pad_;
  std::vector<float> known_, energy_;
  std::vector<std::uint32_t> about_;
  std::vector<float> own_;  ///< what is made of each hit
  std::array<std::vector<float>, 3> captured_, irradiance_, direction_, answer_;
  std::array<std::array<std::vector<std::uint64_t>, 3>, kHits> rows_;
  std::array<std::array<float, 3>, kHits> normal_;
  std::array<std::vector<std::int8_t>, kHits> sight_;
};

// Streams `taps` texels of 3 x `lights` halves from `texels` (wrapping around) against one weight vector.
float bareDot(const std::vector<std::uint16_t>& texels, std::size_t lights, std::size_t begin, std::size_t end,
              const std::vector<float>& weights) {
  const std::size_t stride = 3 * lights, held = texels.size() / stride;
  float sum = 0;
#if defined(__AVX2__) && defined(__F16C__)
  __m256 total = _mm256_setzero_ps();
  for (std::size_t t = begin; t < end; ++t) {
    const std::uint16_t* texel = texels.data() + (t % held) * stride;
    __m256 a = _mm256_setzero_ps(), b = a;
    for (std::size_t i = 0; i < stride; i += 16) {
      a = _mm256_fmadd_ps(_mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(texel + i))),
                          _mm256_loadu_ps(weights.data() + i), a);
      b = _mm256_fmadd_ps(_mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(texel + i + 8))),
                          _mm256_loadu_ps(weights.data() + i + 8), b);
    }
    total = _mm256_add_ps(total, _mm256_add_ps(a, b));
  }
  alignas(32) float lanes[8];
  _mm256_store_ps(lanes, total);
  sum = std::accumulate(lanes, lanes + 8, 0.f);
#endif
  return sum;
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("stage-benchmark", "times the stages of a frame beside the machine's limits");
  std::string scene_file, srf_folder;
  int repeats = 11;
  std::vector<std::string> overrides, exact;
  std::string row;
  program.app().add_option("SCENE", scene_file, "scene.json; its frames are rendered in turn")->required();
  program.app().add_option("--srf", srf_folder, "the field")->required();
  program.app().add_option("--repeats", repeats, "timed frames");
  program.app().add_option("--set", overrides, "/json/pointer=value in the scene");
  program.app().add_option("--exact", exact, "/json/pointer=value: another setting to compare the pictures with");
  program.app().add_option("--row", row, "print one row of this label in place of the table");
  return program.run(argc, argv, [&](Reporter& reporter) {
    const Scene scene = readScene(scene_file, overrides, reporter);
    const SrfManifest manifest = readManifest(srf_folder);
    const DeformableModel model = loadModel(srf_folder, manifest);
    const LightSet light_set(scene, manifest, reporter);
    const std::optional<ReflectanceFit> fit = guidingFit(scene, srf_folder, manifest, model);
    FrameRenderer renderer(srf_folder, manifest, model, frameSettings(scene, fit, program.memoryBudget()), reporter);
    DeformedModel deformed(model);

    const auto frame_at = [&](int i) { return scene.frames[static_cast<std::size_t>(i) % scene.frames.size()]; };
    const auto render = [&](int frame, double& deform_ms) {
      deform_ms = bench::milliseconds([&] { deformed.deform(scene.deformation.at(frame)); });
      renderer.render(scene.cameraAt(frame), deformed, light_set.at(frame));
    };
    double unused = 0;
    for (std::size_t i = 0; i < std::min<std::size_t>(scene.frames.size(), repeats); ++i)
      render(frame_at(static_cast<int>(i)), unused);  // warm: blocks decoded

    std::map<std::string, bench::Series> stages;
    bench::Series whole, embree, frames, refit, dot, views, blend, read, occlusion, model_values, residual, stage_sum,
        limit_sum;
    std::map<std::string, double> before = reporter.figures();
    std::map<std::string, std::uint64_t> counted = reporter.counters();
    double operations = 0, hits = 0, shadow_rays = 0, values = 0;
    std::vector<std::uint16_t> texels(64 << 20);
    for (std::size_t i = 0; i < texels.size(); ++i) texels[i] = static_cast<std::uint16_t>(0x3000 + i % 512);
    const std::size_t lights = manifest.views.empty() ? 16 : (manifest.views[0].lights.size() + 15) / 16 * 16;
    const std::vector<float> weights(3 * lights, 0.01f);
    Box<AcquisitionSpace> box;
    for (const auto& p : model.p0) box.extend(p);
    const AcquiredLights list(manifest.views[0].lights, manifest.lights, box, scene.accuracy.lights);
    volatile float sink = 0;
    for (int i = 0; i < repeats; ++i) {
      const int frame = frame_at(i);
      double deform_ms = 0;
      whole.add(bench::milliseconds([&] { render(frame, deform_ms); }));
      stages["deform"].add(deform_ms);
      for (const auto& [name, value] : reporter.figures())
        if (name.starts_with("seconds.")) stages[name.substr(8)].add(1e3 * (value - before[name]));
      before = reporter.figures();
      const auto counters = reporter.counters();
      const auto taken = [&](const char* name) {
        const auto a = counters.find(name);
        const auto b = counted.find(name);
        return static_cast<double>((a == counters.end() ? 0 : a->second) - (b == counted.end() ? 0 : b->second));
      };
      operations += taken("operations") / repeats, hits += taken("hits") / repeats;
      if (model.kind == ModelKind::mesh) {
        BareEmbree bare(deformed.positions(), model.triangles, scene.cameraAt(frame));
        bare.trace();
        embree.add(bench::milliseconds([&] { bare.trace(); }));
        bare.refit(deformed.positions());
        refit.add(bench::milliseconds([&] { bare.refit(deformed.positions()); }));
      }
      shadow_rays += taken("shadow_rays") / repeats, values += taken("model_values") / repeats;
      if (const auto rays = static_cast<std::size_t>(taken("shadow_rays"))) {
        const BareShadows bare(deformed, rays);
        occlusion.add(bench::milliseconds([&] { bare.trace(); }));
        model_values.add(
            bench::milliseconds([&] { bareModelValues(static_cast<std::size_t>(taken("model_values"))); }));
        BareResidualWeights bare_weights(list, light_set.at(frame), static_cast<std::size_t>(taken("hits")));
        residual.add(bench::milliseconds([&] { bare_weights.run(); }));
      }
      const auto hit_count = static_cast<std::size_t>(taken("hits"));
      if (hit_count > 0) {
        const std::size_t k = static_cast<std::size_t>(scene.accuracy.views) + 1;
        const BareViews bare(manifest.views[0].camera, hit_count, k * hit_count, (manifest.views.size() + 1) / 2);
        views.add(bench::milliseconds([&] { bare.run(); }));
        blend.add(bench::milliseconds([&] { bareBlend(hit_count, lights); }));
        if (model.kind == ModelKind::mesh) frames.add(bench::milliseconds([&] { bareFrames(hit_count); }));
      }
      const std::size_t taps = static_cast<std::size_t>(4 * taken("operations"));
      counted = counters;
      dot.add(bench::milliseconds([&] {
        parallelFor(taps, 1 << 14,
                    [&](std::size_t a, std::size_t b) { sink = bareDot(texels, lights, a, b, weights); });
      }));
      stage_sum.add(whole.values.back());
      double limits = 0;
      for (const bench::Series* bare : {&embree, &frames, &refit, &views, &dot, &occlusion, &model_values,
                                        residual.values.empty() ? &blend : &residual})
        if (!bare->values.empty()) limits += bare->values.back();
      limit_sum.add(limits);
      std::vector<std::uint64_t> partial(64);
      read.add(bench::milliseconds([&] {
        const auto* words = reinterpret_cast<const std::uint64_t*>(texels.data());
        const std::size_t count = texels.size() / 4;
        parallelFor(64, 1, [&](std::size_t a, std::size_t) {
          std::uint64_t sum = 0;
          for (std::size_t k = count / 64 * a; k < count / 64 * (a + 1); ++k) sum += words[k];
          partial[a] = sum;
        });
        sink = static_cast<float>(partial[63] & 1);
      }));
    }
    const auto camera = scene.cameraAt(frame_at(0));
    const auto printError = [&] {
      std::vector<std::string> all = overrides;
      all.insert(all.end(), exact.begin(), exact.end());
      const Scene other = readScene(scene_file, all, reporter);
      FrameRenderer reference(srf_folder, manifest, model, frameSettings(other, fit, program.memoryBudget()), reporter);
      std::vector<double> errors;
      double squares = 0, peak = 0, sum = 0;
      std::size_t values_compared = 0;
      const std::size_t last = std::min<std::size_t>(scene.frames.size(), 3);
      for (std::size_t i = 0; i < last; ++i) {
        const int frame = frame_at(static_cast<int>(i));
        deformed.deform(scene.deformation.at(frame));
        const Frame got = renderer.render(scene.cameraAt(frame), deformed, light_set.at(frame));
        const Frame want = reference.render(scene.cameraAt(frame), deformed, light_set.at(frame));
        for (std::size_t p = 0; p < got.rgba.data().size(); p += 4) {
          if (!(want.rgba.data()[p + 3] > 0)) continue;
          double off = 0, all_channels = 0;
          for (int c = 0; c < 3; ++c) {
            const double difference = got.rgba.data()[p + c] - want.rgba.data()[p + c];
            off += std::fabs(difference), all_channels += want.rgba.data()[p + c];
            squares += square(difference), ++values_compared;
            peak = std::max<double>(peak, want.rgba.data()[p + c]);
          }
          if (all_channels > 0) errors.push_back(off / all_channels);
        }
      }
      std::sort(errors.begin(), errors.end());
      for (const double error : errors) sum += error;
      if (errors.empty()) return;
      std::printf(
          "against %s: error of a pixel, of its value: mean %.3f %%, 99th percentile %.3f %%, largest %.2f %%; "
          "%.1f dB",
          exact[0].c_str(), 100 * sum / static_cast<double>(errors.size()), 100 * errors[errors.size() * 99 / 100],
          100 * errors.back(), 10 * std::log10(square(peak) / (squares / static_cast<double>(values_compared))));
    };
    if (!row.empty()) {
      std::printf("| %s | %s | %.1f | %s |", row.c_str(), bench::shown(whole).c_str(), 1000 / whole.median(),
                  bench::shownRatio(bench::ratios(whole, limit_sum)).c_str());
      if (!exact.empty()) {
        std::printf(" ");
        printError();
        std::printf(" |");
      }
      std::printf("\n");
      return;
    }
    std::printf(
        "%s, %d threads; %d x %d pixels, %zu model points, %zu triangles, %zu views, %zu lights, %.0f hits and "
        "%.0f operations a frame; %d frames after a warm-up; milliseconds as median (least .. most).\n\n",
        bench::processorName().c_str(), threadCount(), camera.lens.width, camera.lens.height, model.size(),
        model.triangles.size(), manifest.views.size(), manifest.lights.size(), hits, operations, repeats);
    if (values > 0)
      std::printf("Guided by the fit: %.0f shadow rays and %.0f values of the model a frame.\n\n", shadow_rays, values);
    std::printf("| stage | ms | limit on this machine, same run | ratio |\n|---|---|---|---|\n");
    for (const auto& [name, series] : stages) {
      std::string limit = "", ratio = "";
      const auto against = [&](const bench::Series& bare, const char* what) {
        if (bare.values.empty()) return;
        limit = std::string(what) + " " + bench::shown(bare);
        ratio = bench::shownRatio(bench::ratios(series, bare));
      };
      if (name == "trace") against(embree, "bare Embree loop");
      if (name == "hits") against(frames, "bare blend of frames");
      if (name == "shadows") against(occlusion, "bare occlusion loop");
      if (name == "deform") against(refit, "bare turn and refit");
      if (name == "views") against(views, "bare kernels");
      if (name == "weights" && residual.values.empty()) against(blend, "bare blend of vectors");
      if (name == "weights") against(residual, "bare residual weights");
      if (name == "model_values") against(model_values, "bare model values");
      if (name == "execute") against(dot, "bare dot kernel");
      std::printf("| %s | %s | %s | %s |\n", name.c_str(), bench::shown(series).c_str(), limit.c_str(), ratio.c_str());
    }
    std::printf("| whole frame | %s | sum of the limits %s | %s |\n", bench::shown(whole).c_str(),
                bench::shown(limit_sum).c_str(), bench::shownRatio(bench::ratios(stage_sum, limit_sum)).c_str());
    std::printf("| memory read, %zu MB | %s | %.1f GB/s | |\n", texels.size() * 2 >> 20, bench::shown(read).c_str(),
                texels.size() * 2 / read.median() / 1e6);
    std::printf("\n%.1f frames a second.\n", 1000 / whole.median());
    if (!exact.empty()) {
      std::printf("\nThe pictures ");
      printError();
      std::printf(".\n");
    }
  });
}
