#include "render/light_set.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <queue>

#include "base/color.h"
#include "base/image_io.h"
#include "base/numeric.h"

namespace srf {
namespace {

/// A strength whose cubic keys may pass below 0 between them.
Vec3 notBelow0(const Vec3& v) {
  return {std::max(0.0, v.x), std::max(0.0, v.y), std::max(0.0, v.z)};
}

/// What a set of texels sends: irradiance on a plane facing each, and its first moment, both weighted by luminance.
struct Energy {
  double total = 0;
  Vec3 moment;  ///< integral of luminance x direction
  Energy& operator+=(const Energy& b) {
    total += b.total;
    moment += b.moment;
    return *this;
  }
  Energy& operator-=(const Energy& b) {
    total -= b.total;
    moment -= b.moment;
    return *this;
  }
  /// Integral of luminance x squared distance to the centroid: what a light at the centroid gets wrong, to the first
  /// order that does not vanish, for every smooth lobe.
  double spread() const { return total > 0 ? std::fmax(0, total - dot(moment, moment) / total) : 0; }
};

/// A latitude-longitude map: column 0 begins at azimuth pi (-x), azimuth falls to the right, row 0 begins at +z.
class SphereMap {
 public:
  SphereMap(const ImageF& map, std::size_t& unusable) : map_(map), sums_(index(map.width(), map.height()) + 1) {
    const double width = 2 * kPi / map.width();
    for (int x = 0; x < map.width(); ++x) {
      const double azimuth = kPi - (x + 0.5) * width;
      // The integral of (cos, sin) over the column's azimuths.
      column_.push_back({2 * std::sin(width / 2) * std::cos(azimuth), 2 * std::sin(width / 2) * std::sin(azimuth)});
    }
    for (int y = 0; y < map.height(); ++y) {
      const double top = kPi * y / map.height(), bottom = kPi * (y + 1) / map.height();
      const double middle = (top + bottom) / 2, half = (bottom - top) / 2;
      // cos top - cos bottom, the integral of sin^2 and that of sin cos, as products: no digits are lost at the poles.
      row_.push_back({.solid_angle = width * 2 * std::sin(middle) * std::sin(half),
                      .across = half - std::sin(half) * std::cos(half) * std::cos(2 * middle),
                      .up = width * std::sin(2 * middle) * std::sin(half) * std::cos(half)});
    }
    for (int y = 0; y < map.height(); ++y) {
      Energy along;
      for (int x = 0; x < map.width(); ++x) {
        bool usable = true;
        for (int c = 0; c < std::min(3, map.channels()); ++c)
          usable &= map.at(x, y, c) >= 0 && std::isfinite(map.at(x, y, c));
        unusable += !usable;
        along += texel(x, y);
        Energy& sum = sums_[index(x + 1, y + 1)] = sums_[index(x + 1, y)];
        sum += along;
      }
    }
  }
  int width() const { return map_.width(); }
  int height() const { return map_.height(); }

  Vec3 radiance(int x, int y) const {
    const auto value = [&](int c) {
      const float v = map_.at(x, y, map_.channels() < 3 ? 0 : c);
      return v > 0 && std::isfinite(v) ? static_cast<double>(v) : 0.0;
    };
    return {value(0), value(1), value(2)};
  }
  double solidAngle(int y) const { return row_[y].solid_angle; }
  Energy texel(int x, int y) const {
    const double luminance = dot(kLuminance, radiance(x, y));
    return {luminance * row_[y].solid_angle,
            luminance * Vec3{row_[y].across * column_[x].x, row_[y].across * column_[x].y, row_[y].up}};
  }
  /// Of the texels [x0, x1) x [y0, y1).
  Energy energy(int x0, int y0, int x1, int y1) const {
    Energy e = sums_[index(x1, y1)];
    e -= sums_[index(x0, y1)];
    e -= sums_[index(x1, y0)];
    return e += sums_[index(x0, y0)];
  }

 private:
  struct Row {
    double solid_angle;  ///< of a texel
    double across;       ///< integral of sin^2 of the polar angle
    double up;           ///< integral of z over a texel
  };
  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * (map_.width() + 1) + x; }
  const ImageF& map_;
  std::vector<Vec2> column_;
  std::vector<Row> row_;
  std::vector<Energy> sums_;  ///< of the texels above and to the left
};

// Cells by recursive cuts of least spread (after Viriyothai and Debevec 2009), the cell of most spread first. Relative
// error of the irradiance (rms over 300 normals, 64 / 256 lights) beside that of the Voronoi cells of a Fibonacci
// lattice with their energy centroids, the other way of theory.md 6: forest 0.40 / 0.09 % against 1.17 / 0.30 %, studio
// 0.10 / 0.02 against 0.56 / 0.23, sunset 0.54 / 0.12 against 0.90 / 0.23, venice 0.55 / 0.12 against 0.86 / 0.21,
// seven lamps 0.22 / 0.04 against 0.31 / 0.15, a sun of one degree 0.46 / 0.08 against 0.53 / 0.11. A lobe of cos^10
// comes out likewise, and 256 lights of a 1024 x 512 map take 0.04 s against 0.3 s.

/// A rectangle of texels that becomes one light.
struct Cell {
  int x0, y0, x1, y1;
  double spread;
  std::size_t order;  ///< of making: settles ties
  friend bool operator<(const Cell& a, const Cell& b) {
    return a.spread != b.spread ? a.spread < b.spread : a.order > b.order;
  }
};

/// The cut that leaves the least spread, or nothing where none lessens it.
std::optional<std::pair<Cell, Cell>> split(const SphereMap& map, const Cell& cell) {
  std::optional<std::pair<Cell, Cell>> best;
  double least = cell.spread * (1 - 1e-9);
  const auto attempt = [&](Cell a, Cell b) {
    a.spread = map.energy(a.x0, a.y0, a.x1, a.y1).spread();
    b.spread = map.energy(b.x0, b.y0, b.x1, b.y1).spread();
    if (a.spread + b.spread < least) {
      least = a.spread + b.spread;
      best = {a, b};
    }
  };
  for (int x = cell.x0 + 1; x < cell.x1; ++x) attempt({cell.x0, cell.y0, x, cell.y1}, {x, cell.y0, cell.x1, cell.y1});
  for (int y = cell.y0 + 1; y < cell.y1; ++y) attempt({cell.x0, cell.y0, cell.x1, y}, {cell.x0, y, cell.x1, cell.y1});
  return best;
}

/// The light of a cell, from its own texels: sums of differences would not keep the energy of dark cells.
DistantLight lightOf(const SphereMap& map, const Cell& cell) {
  DistantLight light;
  Vec3 moment;
  for (int y = cell.y0; y < cell.y1; ++y)
    for (int x = cell.x0; x < cell.x1; ++x) {
      light.irradiance += map.solidAngle(y) * map.radiance(x, y);
      moment += map.texel(x, y).moment;
    }
  // The moment vanishes only where one cell is the whole sphere, evenly lit: any direction then serves.
  light.direction = normalize(Vector<ObjectSpace>(moment)).value_or(Direction<ObjectSpace>());
  return light;
}

}  // namespace

namespace {

// A texel of a coarse map is wide, and one light at its middle would not be a constant over it: each is cut until the
// map has so many across and half as many down.
constexpr int kLeastWidth = 64;

int dividedInto(int texels, int least) {
  return (least + texels - 1) / texels;
}

/// Each texel as across x down equal ones.
ImageF divided(const ImageF& map, int across, int down) {
  ImageF out(map.width() * across, map.height() * down, map.channels());
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) std::copy_n(&map.at(x / across, y / down), map.channels(), &out.at(x, y));
  return out;
}

/// Orders lights so that neighbours in the list are neighbours on the sphere, eights of them above all: kernels pass
/// over lights behind a surface eight at a time.
void orderOnSphere(std::span<DistantLight> lights) {
  constexpr std::size_t kAtOnce = 8;
  if (lights.size() <= kAtOnce) return;
  const int axis = directionBox(lights).longest;
  const std::size_t half = (lights.size() / 2 + kAtOnce - 1) / kAtOnce * kAtOnce;
  if (half >= lights.size()) return;
  std::stable_sort(lights.begin(), lights.end(), [axis](const DistantLight& a, const DistantLight& b) {
    return a.direction.raw()[axis] < b.direction.raw()[axis];
  });
  orderOnSphere(lights.first(half));
  orderOnSphere(lights.subspan(half));
}

}  // namespace

DirectionBox directionBox(std::span<const DistantLight> lights) {
  DirectionBox box{lights[0].direction.raw(), lights[0].direction.raw()};
  auto& [low, high, longest] = box;
  for (const DistantLight& light : lights)
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], light.direction.raw()[k]);
      high[k] = std::max(high[k], light.direction.raw()[k]);
    }
  for (int k = 1; k < 3; ++k)
    if (high[k] - low[k] > high[longest] - low[longest]) longest = k;
  return box;
}

std::size_t mostEnvironmentLights(int width, int height) {
  return static_cast<std::size_t>(width) * dividedInto(width, kLeastWidth) * height *
         dividedInto(height, kLeastWidth / 2);
}

EnvironmentSamples sampleEnvironment(const ImageF& image, int samples) {
  EnvironmentSamples result;
  const int across = dividedInto(image.width(), kLeastWidth), down = dividedInto(image.height(), kLeastWidth / 2);
  const ImageF fine = across * down > 1 ? divided(image, across, down) : ImageF();
  const SphereMap map(fine.empty() ? image : fine, result.unusable_texels);
  result.unusable_texels /= static_cast<std::size_t>(across) * down;
  const auto add = [&](const Cell& cell) {
    const DistantLight light = lightOf(map, cell);
    if (maxComponent(light.irradiance) > 0) result.lights.push_back(light);
  };
  if (samples == 0) {
    for (int y = 0; y < map.height(); ++y)
      for (int x = 0; x < map.width(); ++x) add({x, y, x + 1, y + 1});
    return result;
  }
  const Cell whole{0, 0, map.width(), map.height(), map.energy(0, 0, map.width(), map.height()).spread(), 0};
  std::priority_queue<Cell> open;
  std::vector<Cell> done;
  open.push(whole);
  std::size_t made = 1;
  while (!open.empty() && open.size() + done.size() < static_cast<std::size_t>(samples)) {
    const Cell cell = open.top();
    open.pop();
    if (auto halves = split(map, cell)) {
      halves->first.order = made++;
      halves->second.order = made++;
      open.push(halves->first);
      open.push(halves->second);
    } else {
      done.push_back(cell);
    }
  }
  for (; !open.empty(); open.pop()) done.push_back(open.top());
  for (const Cell& cell : done) add(cell);
  orderOnSphere(result.lights);
  return result;
}

namespace {

std::string placeOf(const Scene& scene, std::size_t light) {
  return scene.file.string() + ": /lights/" + std::to_string(light);
}

EnvironmentSamples readEnvironment(const EnvironmentLight& light, Reporter& reporter) {
  const LoadedImage map = readImage(light.map);
  const int width = map.pixels.width(), height = map.pixels.height();
  if (width != 2 * height)
    reporter.warn(light.map.string() + ": is " + std::to_string(width) + " x " + std::to_string(height) +
                  "; a latitude-longitude map is twice as wide as high, and this one is stretched to that");
  EnvironmentSamples samples = sampleEnvironment(map.pixels, light.samples);
  if (samples.unusable_texels > 0) {
    reporter.count("environment.unusable_texels", samples.unusable_texels);
    reporter.warn(light.map.string() + ": " + std::to_string(samples.unusable_texels) +
                  " texels hold negative, NaN or infinite values, which count as 0");
  }
  return samples;
}

LightId findCaptured(const CapturedLight& wanted, const SrfManifest& field, const std::string& where) {
  if (wanted.light.empty() && field.unknownIllumination()) return LightId{0};
  std::vector<std::string> names;
  std::string list;
  for (std::uint32_t i = 0; i < field.lights.size(); ++i) {
    if (field.lights[i].name == wanted.light && !wanted.light.empty()) return LightId{i};
    names.push_back(field.lights[i].name);
    if (i < 8) list += (i ? ", " : "") + field.lights[i].name;
  }
  if (names.size() > 8) list += ", .. (" + std::to_string(names.size()) + " in all)";
  if (wanted.light.empty()) throw badInput(where, "names no light; add \"light\", one of " + list);
  const std::string near = nearestWord(wanted.light, names);
  throw badInput(where + "/light", "found '" + wanted.light + "', expected a light of the field (" + list + ")" +
                                       (near.empty() ? "" : "; did you mean '" + near + "'?"));
}

}  // namespace

LightSet::LightSet(const Scene& scene, const SrfManifest& field, Reporter& reporter) : scene_(scene) {
  if (scene.lights.empty()) reporter.warn(scene.file.string() + ": /lights: is empty: the object will be black");
  for (std::size_t i = 0; i < scene.lights.size(); ++i) {
    if (const auto* captured = std::get_if<CapturedLight>(&scene.lights[i])) {
      captured_.push_back(findCaptured(*captured, field, placeOf(scene, i)));
      continue;
    }
    if (field.unknownIllumination())
      throw badInput(placeOf(scene, i),
                     "the field was photographed under one unknown illumination and cannot be lit otherwise; use "
                     "{\"type\": \"captured\"} alone");
    if (const auto* environment = std::get_if<EnvironmentLight>(&scene.lights[i]))
      environments_.push_back(readEnvironment(*environment, reporter));
  }
}

FrameLights LightSet::at(double frame) const {
  FrameLights lights;
  std::size_t environments = 0, captured = 0;
  for (std::size_t i = 0; i < scene_.lights.size(); ++i) {
    if (const auto* point = std::get_if<PointLight>(&scene_.lights[i])) {
      lights.near_lights.push_back(
          {Point<ObjectSpace>(point->position.at(frame)), notBelow0(point->intensity.at(frame))});
    } else if (const auto* distant = std::get_if<DirectionalLight>(&scene_.lights[i])) {
      const auto direction = normalize(Vector<ObjectSpace>(distant->direction.at(frame)));
      if (!direction)
        throw badInput(placeOf(scene_, i) + "/direction", "passes through length 0 at frame " + std::to_string(frame) +
                                                              ", between opposed keys; add a key between them");
      lights.distant.push_back({*direction, notBelow0(distant->irradiance.at(frame))});
    } else if (const auto* environment = std::get_if<EnvironmentLight>(&scene_.lights[i])) {
      const Mat3 turn = rotationAbout({0, 0, 1}, radians(environment->rotation.at(frame)));
      const double scale = std::max(0.0, environment->scale.at(frame));
      for (const DistantLight& light : environments_[environments++].lights)
        lights.distant.push_back(
            {Direction<ObjectSpace>::fromUnit(turn * light.direction.raw()), scale * light.irradiance});
    } else if (const auto* from_file = std::get_if<FileLights>(&scene_.lights[i])) {
      for (const FileLights::Light& light : from_file->at(frame, scene_.fps)) {
        if (light.directional) {
          lights.distant.push_back({Direction<ObjectSpace>::fromUnit(light.place), light.amount});
        } else {
          lights.near_lights.push_back({Point<ObjectSpace>(light.place), light.amount});
        }
      }
    } else {
      lights.rest.push_back(
          {captured_[captured++], std::max(0.0, std::get<CapturedLight>(scene_.lights[i]).scale.at(frame))});
    }
  }
  return lights;
}

}  // namespace srf
