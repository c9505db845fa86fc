#include "acquire/synthetic_capture.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <span>

#include "acquire/synthetic_indirect.h"
#include "base/image_io.h"
#include "base/json.h"
#include "base/mesh_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "base/ray_scene.h"
#include "field/capture_file.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kMeshCells = 128;         // 200k triangles: within 2e-5 units of a sphere, 1e-4 of the narrowest edge
constexpr double kFill = 0.8;           // of the picture's side
constexpr double kLightDistance = 3;    // of a point light, in radii of the object
constexpr double kShadowOffset = 5e-4;  // units: beyond the tessellation's error, far below a pixel
constexpr double kGoldenAngle = 2.39996322972865332;
constexpr int kTurntableCameras = 3;
constexpr double kTurntableElevation[kTurntableCameras] = {10, 35, 60};  // degrees
constexpr double kDomeLowest = 8, kDomeHighest = 80;                     // degrees
constexpr std::size_t kPhotoMemory = std::size_t{1} << 29;               // bytes: photographs under construction
constexpr double kNoiseFloor = 0.05;  // share of white whose shot noise equals the noise of black

// Random numbers that depend on nothing but their key (SplitMix64), so that no order of work changes them.
class KeyedRandom {
 public:
  KeyedRandom(std::initializer_list<std::uint64_t> key) {
    for (const std::uint64_t k : key) state_ = mix(state_ + 0x9e3779b97f4a7c15u) ^ mix(k + 0x632be59bd9b4e019u);
  }
  double uniform() {
    state_ += 0x9e3779b97f4a7c15u;
    return (static_cast<double>(mix(state_) >> 11) + 0.5) * 0x1p-53;
  }
  double normal() {
    const double r = std::sqrt(-2 * std::log(uniform()));
    return r * std::cos(2 * kPi * uniform());
  }

 private:
  static std::uint64_t mix(std::uint64_t z) {
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  std::uint64_t state_ = 0;
};
enum RandomStream : std::uint64_t { kNoiseStream = 1, kExposureStream, kMaskStream, kMissingStream, kRangeStream };

Vec3 fibonacci(int i, int count, double turn) {
  const double z = 1 - (2.0 * i + 1) / count, r = std::sqrt(1 - z * z), a = kGoldenAngle * i + turn;
  return {r * std::cos(a), r * std::sin(a), z};
}
Vec3 fromElevation(double elevation_degrees, double azimuth) {
  const double e = radians(elevation_degrees);
  return {std::cos(e) * std::cos(azimuth), std::cos(e) * std::sin(azimuth), std::sin(e)};
}

std::vector<Vec3> domeDirections(int count) {
  // As many rings as make the spacing along and between rings about equal; each ring's share is that of its
  // circumference.
  const double height = radians(kDomeHighest - kDomeLowest);
  const int rings = std::clamp(static_cast<int>(std::lround(std::sqrt(count * height / (2 * kPi * 0.7)))), 1, count);
  std::vector<double> elevation(rings), share(rings);
  double sum = 0;
  for (int r = 0; r < rings; ++r) {
    elevation[r] = rings == 1 ? 30 : lerp(kDomeLowest, kDomeHighest, static_cast<double>(r) / (rings - 1));
    sum += share[r] = std::cos(radians(elevation[r]));
  }
  std::vector<Vec3> directions;
  double cumulated = 0;
  for (int r = 0; r < rings; ++r) {
    cumulated += share[r];
    const int end = r + 1 == rings ? count : static_cast<int>(std::lround(count * cumulated / sum));
    const int begin = static_cast<int>(directions.size()), in_ring = end - begin;
    for (int i = 0; i < in_ring; ++i)
      directions.push_back(fromElevation(elevation[r], 2 * kPi * (i + 0.5 * (r % 2)) / in_ring));
  }
  return directions;
}

std::string numbered(const char* letter, int number, int count) {
  const std::size_t digits = std::max<std::size_t>(3, std::to_string(count - 1).size());
  std::string text = std::to_string(number);
  return letter + std::string(digits - std::min(digits, text.size()), '0') + text;
}

// One light of the rig, turned about z with its step of the turntable.
CaptureLight rigLight(const SyntheticCaptureOptions& options, int index, const Mat3& turn, double radius) {
  CaptureLight light;
  light.kind = options.light_kind;
  // Turned by a radian against the cameras' own lattice: else, with equal counts, each light would sit in a camera.
  light.direction = Direction<AcquisitionSpace>::fromUnit(turn * fibonacci(index, options.lights, 1));
  const double distance = kLightDistance * radius;
  light.position = Point<AcquisitionSpace>(distance * light.direction.raw());
  const double strength = light.kind == LightKind::point ? distance * distance : 1;  // irradiance 1 at the centre
  light.strength = {strength, strength, strength};
  return light;
}

// Leaves photographs out at random, but of no view and of no light the last one.
void leaveOut(const SyntheticCaptureOptions& options, Capture& capture) {
  std::vector<int> of_light(capture.lights.size(), 0);
  for (const CaptureView& view : capture.views)
    for (const Photo& photo : view.photos) ++of_light[photo.light->value];
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    std::vector<Photo>& photos = capture.views[v].photos;
    std::size_t left = photos.size();
    std::erase_if(photos, [&](const Photo& photo) {
      int& others = of_light[photo.light->value];
      const bool out = KeyedRandom{options.seed, kMissingStream, v, photo.light->value}.uniform() < options.missing;
      if (!out || others == 1 || left == 1) return false;
      --others, --left;
      return true;
    });
  }
}

// Cameras, lights, and which photograph shows what.
Capture layOut(const SyntheticCaptureOptions& options, double radius, const fs::path& folder) {
  const bool turntable = options.rig == SyntheticRig::turntable;
  const int steps = turntable ? (options.views + kTurntableCameras - 1) / kTurntableCameras : 1;
  Intrinsics lens = pinholeFromFov(options.size, options.size, options.vfov);
  lens.model = CameraModel::opencv;
  const double half_picture = std::atan(kFill * std::tan(radians(options.vfov) / 2));
  const double distance = options.distance > 0 ? options.distance : radius / std::sin(half_picture);
  if (distance <= 1.05 * radius)
    throw Error(ErrorKind::usage,
                "found " + std::to_string(options.distance) + ", which lies inside the object of radius " +
                    std::to_string(radius) + "; give more, or 0 to have it found",
                "--distance");

  Capture capture;
  capture.folder = folder;
  std::vector<Mat3> turns(steps);
  for (int s = 0; s < steps; ++s) {
    turns[s] = rotationAbout({0, 0, 1}, -2 * kPi * s / steps);  // the object turns forward, its surroundings back
    for (int l = 0; l < options.lights; ++l) {
      CaptureLight light = rigLight(options, l, turns[s], radius);
      light.name = numbered("L", l, options.lights);
      if (turntable) light.name = numbered("S", s, steps) + light.name;
      capture.lights.push_back(light);
    }
  }

  const std::vector<Vec3> dome =
      options.rig == SyntheticRig::dome ? domeDirections(options.views) : std::vector<Vec3>();
  for (int v = 0; v < options.views; ++v) {
    const int step = turntable ? v / kTurntableCameras : 0;
    const Vec3 toward = turntable ? turns[step] * fromElevation(kTurntableElevation[v % kTurntableCameras], 0)
                        : options.rig == SyntheticRig::dome ? dome[v]
                                                            : fibonacci(v, options.views, 0);
    CaptureView view;
    view.name = numbered("v", v, options.views);
    const Vector<AcquisitionSpace> up =
        std::fabs(toward.z) < 0.999 ? Vector<AcquisitionSpace>(0, 0, 1) : Vector<AcquisitionSpace>(0, 1, 0);
    view.camera = {lens, *lookAt(Point<AcquisitionSpace>(distance * toward), Point<AcquisitionSpace>(), up)};
    view.mask_file = folder / "masks" / (view.name + ".png");
    for (int l = 0; l < options.lights; ++l) {
      const LightId id{static_cast<std::uint32_t>(step * options.lights + l)};
      view.photos.push_back({folder / "images" / view.name / (capture.lights[id.value].name + ".exr"), id});
    }
    capture.views.push_back(std::move(view));
  }
  leaveOut(options, capture);
  return capture;
}

// The photographs of one view under all its lights, exact, and where its samples met the object.
struct ExactView {
  std::vector<ImageF> photos;  // one a light; radiance premultiplied by coverage
  Image8 inside;  // supersampling times as wide and high as a photograph: 1 where the sample met the object
};

class Photographer {
 public:
  Photographer(const SyntheticObject& object, const AcquisitionMesh& mesh, std::span<const CaptureLight> lights)
      : object_(object),
        lights_(lights),
        scene_(RayScene<AcquisitionSpace>::ofTriangles(mesh.positions, mesh.triangles)) {
    if (object.material() == SyntheticMaterial::glass)
      casters_ = RayScene<AcquisitionSpace>::ofTriangles(mesh.positions, object.casters(mesh));
    if (object.transport() == SyntheticTransport::direct) return;
    indirect_.emplace(object);
    std::vector<Sample> probes;
    for (const auto& p : indirect_->probes()) {
      const ShadingPoint point = object.shadingPoint(p);
      probes.push_back({0, 1, point, point.normal, {}});
    }
    indirect_->solve(lights.size(), [&](std::size_t l) {
      std::vector<Vec3> irradiance(probes.size());
      illuminate(probes, lights_[l],
                 [&](std::size_t i, const Direction<AcquisitionSpace>&, const Vec3& e) { irradiance[i] = e; });
      return irradiance;
    });
  }

  /// `lights`: of the list given at construction.
  ExactView take(const Camera<AcquisitionSpace>& camera, std::span<const LightId> lights, int supersampling) const {
    const int width = camera.lens.width, height = camera.lens.height, n = supersampling;
    ExactView view;
    view.photos.assign(lights.size(), ImageF(width, height, 3));
    view.inside = Image8(width * n, height * n, 1);
    parallelFor(height, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t y = begin; y < end; ++y) takeRow(camera, lights, n, static_cast<int>(y), view);
    });
    return view;
  }

 private:
  struct Sample {
    int x;
    double weight;
    ShadingPoint point;
    Direction<AcquisitionSpace> view;
    IndirectLight::Place place;
  };

  void takeRow(const Camera<AcquisitionSpace>& camera, std::span<const LightId> lights, int n, int y,
               ExactView& out) const {
    const std::vector<Sample> samples = meetRow(camera, n, y, out.inside);
    if (samples.empty()) return;
    std::vector<Vec3> sum(camera.lens.width);
    for (std::size_t l = 0; l < lights.size(); ++l) {
      std::fill(sum.begin(), sum.end(), Vec3{});
      illuminate(samples, lights_[lights[l].value],
                 [&](std::size_t i, const Direction<AcquisitionSpace>& direction, const Vec3& irradiance) {
                   const Sample& s = samples[i];
                   sum[s.x] += s.weight * (brdf(s.point, direction, s.view) * irradiance);
                 });
      if (indirect_)
        for (const Sample& s : samples)
          sum[s.x] += (1 / kPi) * (s.point.albedo * indirect_->at(s.place, lights[l].value));
      float* row = out.photos[l].row(y);
      for (int x = 0; x < camera.lens.width; ++x)
        for (int c = 0; c < 3; ++c) row[3 * x + c] = static_cast<float>(sum[x][c] / (n * n));
    }
  }

  // Calls use(sample, direction, irradiance on the surface there) for each sample that the light reaches.
  template <class Use>
  void illuminate(const std::vector<Sample>& samples, const CaptureLight& light, const Use& use) const {
    std::vector<std::size_t> lit;
    std::vector<Ray<AcquisitionSpace>> rays;
    std::vector<double> far;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const ShadingPoint& at = samples[i].point;
      const auto direction = light.directionFrom(at.p);
      if (dot(at.normal, direction) <= 0) continue;
      lit.push_back(i);
      rays.push_back({at.p + kShadowOffset * at.normal, direction});
      far.push_back(light.kind == LightKind::point ? distance(light.position, at.p) : INFINITY);
    }
    std::vector<std::uint8_t> blocked(rays.size(), 0);
    if (!object_.convex()) (casters_ ? *casters_ : scene_).occluded(rays, far, 0, blocked);
    for (std::size_t k = 0; k < lit.size(); ++k) {
      if (blocked[k]) continue;
      const ShadingPoint& at = samples[lit[k]].point;
      use(lit[k], rays[k].direction, dot(at.normal, rays[k].direction) * light.irradianceAt(at.p));
    }
  }

  // The samples of a row of pixels that meet the object, those of a pixel together.
  std::vector<Sample> meetRow(const Camera<AcquisitionSpace>& camera, int n, int y, Image8& inside) const {
    std::vector<Ray<AcquisitionSpace>> rays;
    std::vector<Vec2> pixel;
    for (int x = 0; x < camera.lens.width; ++x)
      for (int k = 0; k < n * n; ++k) {
        const Vec2 at{x + (k % n + 0.5) / n, y + (k / n + 0.5) / n};
        rays.push_back(*camera.ray(at));
        pixel.push_back(at);
      }
    std::vector<TriangleHit> hits(rays.size());
    scene_.intersect(rays, hits);
    std::vector<Sample> samples;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      if (!hits[i].hit()) continue;
      const auto exact = object_.meet(rays[i], hits[i].distance);
      // A ray that passes the surface within the tessellation's error is taken at the nearest point.
      const auto p = exact ? *exact : object_.project(rays[i].origin + double{hits[i].distance} * rays[i].direction);
      inside.at(static_cast<int>(pixel[i].x * n), static_cast<int>(pixel[i].y * n)) = 1;
      for (const auto& [point, view, weight] : object_.seenAt(p, camera.viewDirection(p)))
        samples.push_back({static_cast<int>(pixel[i].x), weight, point, view,
                           indirect_ ? indirect_->place(point.p, point.normal) : IndirectLight::Place{}});
    }
    return samples;
  }

  const SyntheticObject& object_;
  std::span<const CaptureLight> lights_;
  RayScene<AcquisitionSpace> scene_;
  std::optional<RayScene<AcquisitionSpace>> casters_;  // where they are fewer
  std::optional<IndirectLight> indirect_;
};

Image8 coverageOf(const Image8& inside, int n) {
  Image8 coverage(inside.width() / n, inside.height() / n, 1);
  for (int y = 0; y < coverage.height(); ++y)
    for (int x = 0; x < coverage.width(); ++x) {
      int count = 0;
      for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) count += inside.at(x * n + i, y * n + j);
      coverage.at(x, y) = static_cast<std::uint8_t>((255 * count + n * n / 2) / (n * n));
    }
  return coverage;
}

// The shape moved by (dx, dy) cells and grown by a disc of `growth` cells (shrunk where negative).
Image8 misjudged(const Image8& inside, int dx, int dy, double growth) {
  const int w = inside.width(), h = inside.height(), reach = static_cast<int>(std::fabs(growth));
  const std::uint8_t spreads = growth > 0 ? 1 : 0;  // growing spreads the inside, shrinking the outside
  const auto source = [&](int x, int y) {
    x -= dx, y -= dy;
    return x >= 0 && y >= 0 && x < w && y < h ? inside.at(x, y) : std::uint8_t{0};
  };
  Image8 result(w, h, 1);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) result.at(x, y) = source(x, y);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      if (source(x, y) != spreads) continue;
      const bool border = source(x - 1, y) != spreads || source(x + 1, y) != spreads || source(x, y - 1) != spreads ||
                          source(x, y + 1) != spreads;
      if (!border) continue;
      for (int j = std::max(0, y - reach); j <= std::min(h - 1, y + reach); ++j)
        for (int i = std::max(0, x - reach); i <= std::min(w - 1, x + reach); ++i)
          if (square(i - x) + square(j - y) <= square(growth)) result.at(i, j) = spreads;
    }
  return result;
}

Image8 maskOf(const ExactView& exact, const SyntheticCaptureOptions& options, std::uint64_t view) {
  const int n = options.supersampling;
  if (options.mask_error == 0) return coverageOf(exact.inside, n);
  KeyedRandom random{options.seed, kMaskStream, view};
  const double cells = n * options.mask_error, turn = 2 * kPi * random.uniform(), shift = cells * random.uniform();
  const double growth = cells * (2 * random.uniform() - 1);
  return coverageOf(misjudged(exact.inside, static_cast<int>(std::lround(shift * std::cos(turn))),
                              static_cast<int>(std::lround(shift * std::sin(turn))), growth),
                    n);
}

// Gain error of the photograph, and noise with the square root of the light, as photons have it. A sensor gives nothing
// below zero, and nothing above its full scale.
void disturb(ImageF& photo, const CaptureLight& light, const SyntheticCaptureOptions& options, std::uint64_t view,
             std::uint64_t light_index) {
  if (options.exposure == 0 && options.noise == 0 && options.saturation == 0) return;
  const double full = options.saturation > 0 ? options.saturation : INFINITY;
  const double gain =
      std::exp(options.exposure * KeyedRandom{options.seed, kExposureStream, view, light_index}.normal());
  const Vec3 white = light.irradianceAt(Point<AcquisitionSpace>()) * (1 / kPi);
  for (int y = 0; y < photo.height(); ++y)
    for (int x = 0; x < photo.width(); ++x) {
      const auto pixel = static_cast<std::uint64_t>(y) * photo.width() + x;
      KeyedRandom random{options.seed, kNoiseStream, view, light_index, pixel};
      for (int c = 0; c < 3; ++c) {
        const double value = gain * photo.at(x, y, c), floor = kNoiseFloor * white[c];
        const double sigma = options.noise * std::sqrt((value + floor) * white[c]);
        photo.at(x, y, c) = static_cast<float>(std::clamp(value + sigma * random.normal(), 0.0, full));
      }
    }
}

Json description(const SyntheticCaptureOptions& o) {
  Json json;
  json["version"] = 1;
  json["object"] = syntheticShapeNames()[static_cast<std::size_t>(o.shape)];
  json["material"] = syntheticMaterialNames()[static_cast<std::size_t>(o.material)];
  json["interreflection"] = o.interreflection;
  json["rig"] = syntheticRigNames()[static_cast<std::size_t>(o.rig)];
  json["light_type"] = o.light_kind == LightKind::point ? "point" : "directional";
  json["views"] = o.views, json["lights"] = o.lights, json["size"] = o.size, json["supersampling"] = o.supersampling;
  json["fov"] = o.vfov, json["distance"] = o.distance;
  json["noise"] = o.noise, json["exposure"] = o.exposure, json["saturate"] = o.saturation,
  json["mask_error"] = o.mask_error, json["seed"] = o.seed;
  json["mesh_cells"] = o.mesh_cells, json["range_views"] = o.range_views, json["range_noise"] = o.range_noise,
  json["range_outliers"] = o.range_outliers;
  return json;
}

fs::path withoutSlash(const fs::path& folder) {
  const fs::path normal = folder.lexically_normal();
  return normal.has_filename() ? normal : normal.parent_path();
}

// A folder under construction beside its final place; removed by the destructor unless it was moved there.
class PartialFolder {
 public:
  explicit PartialFolder(const fs::path& folder)
      : folder_(withoutSlash(folder)), part_(folder_.string() + ".part-" + std::to_string(::getpid())) {
    std::error_code code;
    if (fs::exists(folder_, code) && !(fs::is_directory(folder_, code) && fs::is_empty(folder_, code)) &&
        !fs::exists(folder_ / "synthetic.json", code))
      throw badInput(folder_.string(),
                     "is there already and is not a synthetic capture; name another folder, or remove it");
    fs::remove_all(part_, code);
    fs::create_directories(part_, code);
    if (code) throw Error(ErrorKind::failed, "the folder cannot be made: " + code.message(), part_.string());
  }
  ~PartialFolder() {
    std::error_code code;
    fs::remove_all(part_, code);
  }
  PartialFolder(const PartialFolder&) = delete;
  PartialFolder& operator=(const PartialFolder&) = delete;
  const fs::path& path() const { return part_; }
  void commit() {
    const fs::path old = part_.string() + "-old";
    std::error_code code, restored;
    const bool replaces = fs::exists(folder_, code);
    if (replaces) fs::rename(folder_, old, code);
    if (!code) {
      fs::rename(part_, folder_, code);
      if (code && replaces) fs::rename(old, folder_, restored);
    }
    if (code) throw Error(ErrorKind::failed, "the folder cannot be put in place: " + code.message(), folder_.string());
    fs::remove_all(old, code);
  }

 private:
  fs::path folder_, part_;
};

// Takes the view's photographs, as many at once as the memory allows, and writes them and the mask.
void writeView(const SyntheticCaptureOptions& options, const Photographer& photographer, const Capture& capture,
               std::uint64_t v, Reporter& reporter, Reporter::Stage& stage) {
  const CaptureView& view = capture.views[v];
  const std::size_t photo_bytes = std::size_t{3 * sizeof(float)} * options.size * options.size;
  const std::size_t at_once = std::max<std::size_t>(kPhotoMemory / photo_bytes, 1);
  for (std::size_t first = 0; first < view.photos.size(); first += at_once) {
    const auto photos = std::span(view.photos).subspan(first, std::min(at_once, view.photos.size() - first));
    std::vector<LightId> lights;
    for (const Photo& photo : photos) lights.push_back(*photo.light);
    ExactView exact = photographer.take(view.camera, lights, options.supersampling);
    if (first == 0) writePng(view.mask_file, maskOf(exact, options, v));
    parallelFor(photos.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t l = begin; l < end; ++l) {
        disturb(exact.photos[l], capture.lights[lights[l].value], options, v, lights[l].value % options.lights);
        const std::size_t clamped = writeExr(photos[l].file, exact.photos[l]);
        if (clamped) reporter.count("pixels.clamped", clamped);
        stage.advance();
      }
    });
  }
}

// What a laser scanner sees from places all around: the true surface along each beam, noise, and beams that went
// astray.
void writeRangeViews(const SyntheticCaptureOptions& options, const SyntheticObject& object, const AcquisitionMesh& mesh,
                     double radius, const fs::path& folder) {
  constexpr double kGrazing = 0.17;  // cosine: beams that come in flatter than this give nothing
  constexpr double kStray = 1.2;     // radii about the centre, within which stray points lie
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(mesh.positions, mesh.triangles);
  const double distance = 3 * radius;
  Intrinsics lens = pinholeFromFov(options.size, options.size, 2 * degrees(std::asin(radius / distance)) * 1.05);
  for (int v = 0; v < options.range_views; ++v) {
    const Vec3 toward = fibonacci(v, options.range_views, 0.5);
    const Vector<AcquisitionSpace> up =
        std::fabs(toward.z) < 0.999 ? Vector<AcquisitionSpace>(0, 0, 1) : Vector<AcquisitionSpace>(0, 1, 0);
    const Camera<AcquisitionSpace> scanner{
        lens, *lookAt(Point<AcquisitionSpace>(distance * toward), Point<AcquisitionSpace>(), up)};
    RangeView view;
    view.sensor = scanner.center();
    for (int y = 0; y < options.size; ++y)
      for (int x = 0; x < options.size; ++x) {
        const auto ray = scanner.ray({x + 0.5, y + 0.5});
        const TriangleHit hit = scene.intersect(*ray);
        if (!hit.hit()) continue;
        const auto p = object.meet(*ray, hit.distance);
        if (!p || -dot(ray->direction, object.normal(*p)) < kGrazing) continue;
        KeyedRandom random{options.seed, kRangeStream, static_cast<std::uint64_t>(v),
                           static_cast<std::uint64_t>(y) * options.size + x};
        double along = length(*p - ray->origin) + options.range_noise * random.normal();
        if (random.uniform() < options.range_outliers) along = distance + kStray * radius * (2 * random.uniform() - 1);
        view.points.positions.push_back(ray->origin + along * ray->direction);
      }
    writeRangeView(folder / (numbered("", v, options.range_views) + ".ply"), view);
  }
}

}  // namespace

const std::vector<std::string>& syntheticRigNames() {
  static const std::vector<std::string> names{"sphere", "dome", "turntable"};
  return names;
}

void SyntheticCaptureOptions::validate() const {
  std::string faults;
  const auto require = [&](const char* name, double value, double least, double most) {
    if (value >= least && value <= most) return;
    char text[160];
    std::snprintf(text, sizeof text, "%s--%s: found %g, expected %g to %g", faults.empty() ? "" : "; ", name, value,
                  least, most);
    faults += text;
  };
  require("views", views, 1, 10000);
  require("lights", lights, 1, 10000);
  require("size", size, 4, 8192);
  require("supersampling", supersampling, 1, 16);
  require("fov", vfov, 1, 150);
  require("distance", distance, 0, 1e6);
  require("noise", noise, 0, 10);
  require("exposure", exposure, 0, 10);
  require("saturate", saturation, 0, 1e6);
  require("mask-error", mask_error, 0, 100);
  require("missing", missing, 0, 1);
  require("range-views", range_views, 0, 999);
  require("mesh-cells", mesh_cells, 16, 512);
  require("range-noise", range_noise, 0, 1);
  require("range-outliers", range_outliers, 0, 0.9);
  const std::string fault = SyntheticObject::faultOf(shape, material, interreflection);
  if (!fault.empty()) faults += (faults.empty() ? "" : "; ") + fault;
  if (!faults.empty()) throw Error(ErrorKind::usage, faults);
}

void writeSyntheticCapture(const SyntheticCaptureOptions& options, const fs::path& folder, Reporter& reporter) {
  options.validate();
  const SyntheticObject object(options.shape, options.material, options.interreflection);
  const AcquisitionMesh mesh = object.tessellate(kMeshCells);
  double radius = 0;
  for (const auto& p : mesh.positions) radius = std::max(radius, length(p.raw()));
  PartialFolder part(folder);
  const Capture capture = layOut(options, radius, part.path());
  {
    const Photographer photographer(object, mesh, capture.lights);
    std::uint64_t photo_count = 0;
    for (const CaptureView& view : capture.views) photo_count += view.photos.size();
    Reporter::Stage stage(reporter, "photographs", photo_count);
    for (std::size_t v = 0; v < capture.views.size(); ++v) {
      throwIfInterrupted();
      writeView(options, photographer, capture, v, reporter, stage);
    }
  }
  writePly(part.path() / "model.ply", options.mesh_cells == kMeshCells ? mesh : object.tessellate(options.mesh_cells));
  if (options.range_views > 0) {
    std::error_code code;
    fs::create_directory(part.path() / "ranges", code);
    writeRangeViews(options, object, mesh, radius, part.path() / "ranges");
  }
  writeJsonFile(part.path() / "synthetic.json", description(options));
  writeCapture(part.path(), capture);
  part.commit();
}

SyntheticObject readSyntheticObject(const fs::path& folder) {
  if (!fs::exists(folder / "synthetic.json"))
    throw badInput(folder.string(), "has no synthetic.json; expected a capture that srf synth wrote");
  const JsonNode root = readJsonFile(folder / "synthetic.json");
  root["version"].integer(1, 1);
  const auto index = [&](const char* key, const std::vector<std::string>& names) {
    const std::string found = root[key].string();
    const auto at = std::find(names.begin(), names.end(), found);
    if (at != names.end()) return at - names.begin();
    std::string list;
    for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
    throw root[key].error("found '" + found + "', expected one of: " + list);
  };
  const auto shape = static_cast<SyntheticShape>(index("object", syntheticShapeNames()));
  const auto material = static_cast<SyntheticMaterial>(index("material", syntheticMaterialNames()));
  const bool interreflection = root.has("interreflection") && root["interreflection"].boolean();
  const std::string fault = SyntheticObject::faultOf(shape, material, interreflection);
  if (!fault.empty()) throw root["material"].error(fault);
  return {shape, material, interreflection};
}

}  // namespace srf
