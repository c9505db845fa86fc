#include "acquire/light_calibration.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "acquire/shoot.h"
#include "base/error.h"
#include "base/files.h"
#include "base/numeric.h"
#include "field/capture_json.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

// Solves the symmetric 4 x 4 system A x = b by elimination with pivots; nothing where A is singular. `inverse_diagonal`
// receives the diagonal of the inverse.
using Vec4 = std::array<double, 4>;
std::optional<Vec4> solve4(std::array<Vec4, 4> a, Vec4 b, Vec4* inverse_diagonal = nullptr) {
  std::array<Vec4, 4> inverse{};
  for (int i = 0; i < 4; ++i) inverse[i][i] = 1;
  for (int k = 0; k < 4; ++k) {
    int pivot = k;
    for (int i = k + 1; i < 4; ++i)
      if (std::fabs(a[i][k]) > std::fabs(a[pivot][k])) pivot = i;
    if (!(std::fabs(a[pivot][k]) > 1e-12)) return std::nullopt;
    std::swap(a[k], a[pivot]), std::swap(b[k], b[pivot]), std::swap(inverse[k], inverse[pivot]);
    for (int i = 0; i < 4; ++i) {
      if (i == k) continue;
      const double f = a[i][k] / a[k][k];
      for (int j = 0; j < 4; ++j) a[i][j] -= f * a[k][j], inverse[i][j] -= f * inverse[k][j];
      b[i] -= f * b[k];
    }
  }
  for (int i = 0; i < 4; ++i) {
    b[i] /= a[i][i];
    if (inverse_diagonal) (*inverse_diagonal)[i] = inverse[i][i] / a[i][i];
  }
  return b;
}

std::optional<double> numberWithComma(std::string text) {
  // A decimal comma: as many a locale writes it.
  std::replace(text.begin(), text.end(), ',', '.');
  double value = 0;
  const char* begin = text.data() + (!text.empty() && text[0] == '+');
  const auto [end, code] = std::from_chars(begin, text.data() + text.size(), value);
  if (code != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

}  // namespace

std::optional<LambertFit> fitLambertBall(const ImageF& image, const Intrinsics& lens, const OutlineParameters& outline,
                                         const LambertOptions& options) {
  struct Sample {
    Vec3 normal;
    Vec3 value;
    double mean;
  };
  std::vector<Sample> samples;
  const Ball ball = ballFromOutline(lens, outline);
  double x0 = image.width(), x1 = 0, y0 = image.height(), y1 = 0;
  for (const Vec2& p : outlinePixels(lens, outline, 64)) {
    x0 = std::min(x0, p.x), x1 = std::max(x1, p.x);
    y0 = std::min(y0, p.y), y1 = std::max(y1, p.y);
  }
  for (int y = std::max(0, static_cast<int>(y0)); y < std::min<double>(image.height(), y1); ++y)
    for (int x = std::max(0, static_cast<int>(x0)); x < std::min<double>(image.width(), x1); ++x) {
      const auto r = reflectionAt(lens, ball, {x + 0.5, y + 0.5});
      if (!r) continue;
      const Vec3 n = (r->point - ball.center).raw() / ball.radius;
      const Vec3 v = lens.isOrthographic() ? Vec3{0, 0, -1} : -r->point.raw() / length(r->point.raw());
      // sin of the angle from the viewer's axis is the distance from the middle as a share of the radius.
      if (square(dot(n, v)) < 1 - square(1 - options.margin)) continue;
      Sample s{n, {}, 0};
      bool usable = true;
      for (int c = 0; c < 3; ++c) {
        const double value = image.at(x, y, image.channels() < 3 ? 0 : c);
        usable = usable && std::isfinite(value) && value < options.white;
        s.value[c] = value;
      }
      s.mean = (s.value.x + s.value.y + s.value.z) / 3;
      if (usable) samples.push_back(s);
    }
  if (samples.size() < 20) return std::nullopt;

  // The unlit part holds the stray light alone. Which part is lit is known once the direction is: found in turn.
  double brightest = 0;
  for (const Sample& s : samples) brightest = std::max(brightest, s.mean);
  const auto fit = [&](const auto& is_lit, const auto& value, Vec4* inverse_diagonal) {
    std::array<Vec4, 4> a{};
    Vec4 b{};
    for (const Sample& s : samples) {
      const bool lit = is_lit(s);
      const Vec4 row{lit ? s.normal.x : 0, lit ? s.normal.y : 0, lit ? s.normal.z : 0, 1};
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) a[i][j] += row[i] * row[j];
        b[i] += row[i] * value(s);
      }
    }
    if (!options.stray) {  // the even term is 0
      for (int i = 0; i < 4; ++i) a[i][3] = a[3][i] = i == 3;
      b[3] = 0;
    }
    return solve4(a, b, inverse_diagonal);
  };
  Vec3 g;
  const auto bright = [&](const Sample& s) { return s.mean > 0.25 * brightest; };
  const auto mean_of = [](const Sample& s) { return s.mean; };
  auto first = fit(bright, mean_of, nullptr);
  if (!first) return std::nullopt;
  g = {(*first)[0], (*first)[1], (*first)[2]};
  const auto lit = [&](const Sample& s) { return dot(s.normal, g) > 0; };
  double stray = (*first)[3];
  Vec4 spread{};
  for (int round = 0; round < 50; ++round) {
    const auto next = fit(lit, mean_of, &spread);
    if (!next) break;
    const Vec3 changed{(*next)[0], (*next)[1], (*next)[2]};
    const bool done = length(changed - g) < 1e-10 * length(g);
    g = changed, stray = (*next)[3];
    if (done) break;
  }
  const auto direction = normalize(Vector<CameraSpace>(g));
  if (!direction) return std::nullopt;
  double squares = 0, sum = 0, count = 0;
  for (const Sample& s : samples) {
    if (!lit(s)) continue;
    squares += square(s.mean - dot(s.normal, g) - stray), sum += s.mean, ++count;
  }
  if (count < 20 || !(sum > 0)) return std::nullopt;
  LambertFit result;
  result.direction = *direction;
  const double deviation = std::sqrt(squares / count);
  result.residual = deviation * count / sum;
  result.sigma = deviation * std::sqrt(std::max({spread[0], spread[1], spread[2]})) / length(g);
  for (int c = 0; c < 3; ++c) {
    // Along the direction found, so that the channels agree on it.
    double nn = 0, n1 = 0, one = 0, nv = 0, v1 = 0;
    for (const Sample& s : samples) {
      const double n = std::max(0.0, dot(s.normal, direction->raw())), v = s.value[c];
      nn += n * n, n1 += n, one += 1, nv += n * v, v1 += v;
    }
    const double det = options.stray ? nn * one - n1 * n1 : nn;
    if (!(det > 0)) return std::nullopt;
    result.level[c] = (options.stray ? nv * one - n1 * v1 : nv) / det;
    result.stray[c] = options.stray ? (nn * v1 - n1 * nv) / det : 0;
  }
  return result;
}

std::vector<LpLight> readLp(const fs::path& file) {
  std::string text = readTextFile(file);
  if (text.starts_with("\xEF\xBB\xBF")) text.erase(0, 3);
  std::vector<LpLight> lights;
  long expected = -1;
  int line_number = 0;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    std::vector<std::string> words;
    std::vector<std::size_t> starts;
    const std::string line = text.substr(at, end - at);
    at = end + 1;
    ++line_number;
    for (std::size_t i = 0; i < line.size();) {
      i = line.find_first_not_of(" \t\r", i);
      if (i == std::string::npos) break;
      const std::size_t stop = std::min(line.find_first_of(" \t\r", i), line.size());
      words.push_back(line.substr(i, stop - i)), starts.push_back(i);
      i = stop;
    }
    if (words.empty()) continue;
    const auto wrong = [&](const std::string& what) {
      return badInput(file.string() + ", line " + std::to_string(line_number), what);
    };
    if (expected < 0) {
      const auto count = words.size() == 1 ? numberWithComma(words[0]) : std::nullopt;
      if (!count || *count < 1 || *count > 1e6 || *count != std::floor(*count))
        throw wrong("is '" + line.substr(0, 40) + "', expected the number of lights alone");
      expected = static_cast<long>(*count);
      continue;
    }
    if (words.size() < 4) throw wrong("has " + std::to_string(words.size()) + " words, expected 'file x y z'");
    LpLight light;
    for (int c = 0; c < 3; ++c) {
      const std::string& word = words[words.size() - 3 + c];
      const auto value = numberWithComma(word);
      if (!value) throw wrong("has '" + word + "' where a number was expected; a line is 'file x y z'");
      light.direction[c] = *value;
    }
    // The name is all before the numbers: it may hold blanks.
    const std::size_t name_end = starts[words.size() - 4] + words[words.size() - 4].size();
    light.file = line.substr(starts[0], name_end - starts[0]);
    const double len = length(light.direction);
    if (!(len > 1e-6)) throw wrong("has a direction of no length");
    light.normalised_here = std::fabs(len - 1) > 1e-3;
    light.direction = light.direction / len;
    lights.push_back(light);
  }
  if (expected < 0) throw badInput(file.string(), "is empty, expected the number of lights and a line for each");
  if (expected != static_cast<long>(lights.size()))
    throw badInput(file.string(), "says " + std::to_string(expected) + " lights and has " +
                                      std::to_string(lights.size()) + "; mend its first line or add what is missing");
  return lights;
}

void writeLp(const fs::path& file, const std::vector<LpLight>& lights) {
  std::string text = std::to_string(lights.size()) + "\n";
  for (const LpLight& light : lights) {
    char numbers[100];
    std::snprintf(numbers, sizeof numbers, " %.17g %.17g %.17g\n", light.direction.x, light.direction.y,
                  light.direction.z);
    text += light.file + numbers;
  }
  writeTextFile(file, text);
}

std::vector<CaptureLight> readDome(const fs::path& file, const Camera<AcquisitionSpace>& camera) {
  const JsonNode root = readJsonFile(file);
  std::vector<CaptureLight> lights;
  if (const auto listed = root.find("lights")) {
    for (std::size_t i = 0; i < listed->size(); ++i) {
      lights.push_back(readLight(listed->at(i)));
      for (std::size_t j = 0; j < i; ++j)
        if (lights[j].name == lights[i].name) throw listed->at(i)["name"].error("is the name of two lights");
    }
  } else if (const auto directions = root.find("directions")) {
    if (const auto kind = root.find("lightConfiguration"); kind && kind->string() != "directional")
      throw kind->error("is '" + kind->string() +
                        "': positions of a .dome file have no stated unit; write them as \"lights\" with \"type\": "
                        "\"point\" in the capture's units");
    for (std::size_t i = 0; i < directions->size(); ++i) {
      const JsonNode d = directions->at(i);
      const auto unit = normalize(Vector<CameraSpace>(d["x"].number(), -d["y"].number(), -d["z"].number()));
      if (!unit) throw d.error("has no length");
      CaptureLight light;
      light.name = std::to_string(i);
      light.direction = camera.pose * *unit;
      if (const auto adjust = root.find("ledAdjust"); adjust && adjust->size() == directions->size()) {
        const JsonNode a = adjust->at(i);  // pixels are multiplied by it: the light is as much weaker
        light.strength =
            Vec3{1, 1, 1} / Vec3{a["r"].positiveNumber(), a["g"].positiveNumber(), a["b"].positiveNumber()};
      }
      lights.push_back(light);
    }
  } else {
    throw root.error("has neither \"lights\" as a transforms.json has them nor \"directions\" as a .dome file");
  }
  if (lights.empty()) throw root.error("lists no light");
  return lights;
}

Vec3 meanRadiance(const ImageF& image, const Image8& region, double white) {
  if (image.width() != region.width() || image.height() != region.height())
    throw badInput("white target", "its mask is " + std::to_string(region.width()) + " x " +
                                       std::to_string(region.height()) + " pixels, the photograph " +
                                       std::to_string(image.width()) + " x " + std::to_string(image.height()));
  Vec3 sum;
  double used = 0, lost = 0;
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x) {
      if (region.at(x, y) < 128) continue;
      Vec3 value;
      bool usable = true;
      for (int c = 0; c < 3; ++c) {
        value[c] = image.at(x, y, image.channels() < 3 ? 0 : c);
        usable = usable && std::isfinite(value[c]) && value[c] < white;
      }
      if (usable)
        sum += value, ++used;
      else
        ++lost;
    }
  if (used == 0 || lost > 0.01 * (used + lost))
    throw badInput("white target", std::to_string(static_cast<long>(lost)) + " of " +
                                       std::to_string(static_cast<long>(used + lost)) +
                                       " pixels are saturated; expose it shorter, or choose a part that is not");
  return sum / used;
}

Vec3 strengthFromWhite(const CaptureLight& light, const Vec3& radiance, const WhiteTarget& target) {
  const double cosine = dot(light.directionFrom(target.position), target.normal);
  if (!(cosine > std::sin(radians(5))))
    throw badInput("white target", "light '" + light.name + "' stands " +
                                       std::to_string(static_cast<int>(std::lround(degrees(std::acos(cosine))))) +
                                       " degrees off the target's normal, expected less than 85; turn the target's "
                                       "normal the right way or take the strengths from a table");
  // A matt target sends out reflectance * irradiance / pi.
  Vec3 strength = (kPi / cosine) * (radiance / target.reflectance);
  if (light.kind == LightKind::point) strength *= square(distance(light.position, target.position));
  if (!(minComponent(strength) > 0) || !isFinite(strength))
    throw badInput("white target", "is black under light '" + light.name + "'");
  return strength;
}

void setStrengths(std::vector<CaptureLight>& lights, const fs::path& table) {
  std::map<std::string, std::vector<double>> rows;
  bool grey = false;
  try {
    rows = readNamedTable(table, 3);
  } catch (const Error& three) {
    try {
      rows = readNamedTable(table, 1);
      grey = true;
    } catch (const Error&) {
      throw three;
    }
  }
  std::size_t used = 0;
  for (CaptureLight& light : lights) {
    const auto row = rows.find(light.name);
    if (row == rows.end())
      throw badInput(table.string(), "has no row for light '" + light.name + "'; give each light one");
    light.strength = grey ? row->second[0] * Vec3{1, 1, 1} : Vec3{row->second[0], row->second[1], row->second[2]};
    if (!(minComponent(light.strength) > 0))
      throw badInput(table.string(), "gives light '" + light.name + "' a strength that is not above 0");
    ++used;
  }
  if (used < rows.size()) {
    std::vector<std::string> names;
    for (const CaptureLight& light : lights) names.push_back(light.name);
    for (const auto& [name, values] : rows) {
      if (std::find(names.begin(), names.end(), name) != names.end()) continue;
      const std::string meant = nearestWord(name, names);
      throw badInput(table.string(), "names light '" + name + "', which the photographs do not have" +
                                         (meant.empty() ? "" : "; is '" + meant + "' meant?"));
    }
  }
}

}  // namespace srf
