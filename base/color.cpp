#include "base/color.h"

#include <OpenImageIO/color.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "base/error.h"
#include "base/parallel.h"

namespace srf {
namespace {

struct Space {
  std::string name;
  std::vector<std::string> aliases;  ///< as configurations call it
  Vec2 red, green, blue, white;      ///< chromaticities
};

// ITU-R BT.709; ACES: SMPTE ST 2065-1 and S-2014-004.
const std::vector<Space>& spaces() {
  static const std::vector<Space> kSpaces{
      {"lin_rec709",
       {"lin_rec709_scene", "Linear Rec.709 (sRGB)", "lin_srgb", "Utility - Linear - sRGB",
        "Utility - Linear - Rec.709", "Rec.709", "rec709"},
       {0.64, 0.33},
       {0.30, 0.60},
       {0.15, 0.06},
       {0.3127, 0.3290}},
      {"ACEScg",
       {"acescg", "lin_ap1", "lin_ap1_scene", "ACES - ACEScg"},
       {0.713, 0.293},
       {0.165, 0.830},
       {0.128, 0.044},
       {0.32168, 0.33767}},
      {"ACES2065-1",
       {"aces2065_1", "aces", "lin_ap0", "lin_ap0_scene", "ACES - ACES2065-1"},
       {0.7347, 0.2653},
       {0.0, 1.0},
       {0.0001, -0.077},
       {0.32168, 0.33767}}};
  return kSpaces;
}

const Space* findSpace(const std::string& name) {
  for (const Space& space : spaces())
    if (space.name == name || std::find(space.aliases.begin(), space.aliases.end(), name) != space.aliases.end())
      return &space;
  return nullptr;
}

Vec3 xyzOf(const Vec2& chromaticity) {
  return {chromaticity.x / chromaticity.y, 1, (1 - chromaticity.x - chromaticity.y) / chromaticity.y};
}

Mat3 scaled(const Mat3& columns, const Vec3& by) {
  return Mat3::fromColumns(by.x * columns.column(0), by.y * columns.column(1), by.z * columns.column(2));
}

Mat3 xyzFrom(const Space& s) {
  // Not scaled by y, which may be 0 or negative for a primary: z = 1 - x - y.
  const auto column = [](const Vec2& c) { return Vec3{c.x, c.y, 1 - c.x - c.y}; };
  const Mat3 primaries = Mat3::fromColumns(column(s.red), column(s.green), column(s.blue));
  return scaled(primaries, inverse(primaries) * xyzOf(s.white));
}

std::string list(const std::vector<std::string>& names) {
  std::string out;
  for (std::size_t i = 0; i < names.size(); ++i) out += (i ? ", " : "") + names[i];
  return out;
}

}  // namespace

const std::vector<std::string>& knownColorSpaces() {
  static const std::vector<std::string> kNames = [] {
    std::vector<std::string> names;
    for (const Space& space : spaces()) names.push_back(space.name);
    return names;
  }();
  return kNames;
}

Mat3 xyzFromColorSpace(const std::string& name) {
  const Space* space = findSpace(name);
  if (!space)
    throw Error(ErrorKind::usage,
                "is no colour space known here; expected one of " + list(knownColorSpaces()) +
                    ", or set OCIO to a configuration that has it",
                "'" + name + "'");
  return xyzFrom(*space);
}

Mat3 colorMatrix(const std::string& from, const std::string& to) {
  const Mat3 xyz_from = xyzFromColorSpace(from), xyz_to = xyzFromColorSpace(to);
  const Vec3 white_from = xyzOf(findSpace(from)->white), white_to = xyzOf(findSpace(to)->white);
  const Mat3 cone{{Vec3{0.8951, 0.2664, -0.1614}, Vec3{-0.7502, 1.7135, 0.0367}, Vec3{0.0389, -0.0685, 1.0296}}};
  const Vec3 a = cone * white_from, b = cone * white_to;
  const Mat3 gain{{Vec3{b.x / a.x, 0, 0}, Vec3{0, b.y / a.y, 0}, Vec3{0, 0, b.z / a.z}}};
  return inverse(xyz_to) * (inverse(cone) * gain * cone) * xyz_from;
}

struct ColorConversion::State {
  Mat3 matrix;
  std::unique_ptr<OIIO::ColorConfig> config;
  OIIO::ColorProcessorHandle processor;
  bool identity = false;
  std::string means = "none";
};

ColorConversion::ColorConversion(const std::string& from, const std::string& to) : state_(std::make_unique<State>()) {
  const Space *a = findSpace(from), *b = findSpace(to);
  if (from == to || (a && a == b)) {
    if (!a) xyzFromColorSpace(from);
    state_->identity = true;
    return;
  }
  const char* ocio = std::getenv("OCIO");
  if (ocio && *ocio) {
    state_->config = std::make_unique<OIIO::ColorConfig>(ocio);
    if (state_->config->has_error())
      throw badInput(ocio, "could not be read as the OpenColorIO configuration that OCIO names (" +
                               state_->config->geterror() + "); mend or unset OCIO");
    const auto names = [](const std::string& name, const Space* space) {
      std::vector<std::string> out{name};
      if (space) {
        out.push_back(space->name);
        out.insert(out.end(), space->aliases.begin(), space->aliases.end());
      }
      return out;
    };
    for (const std::string& f : names(from, a))
      for (const std::string& t : names(to, b)) {
        if (state_->processor) break;
        state_->processor = state_->config->createColorProcessor(f, t);
        if (!state_->processor) state_->config->geterror();
      }
    if (state_->processor) {
      state_->means = std::string("OCIO ") + ocio;
      return;
    }
    if (!a || !b)
      throw Error(
          ErrorKind::usage,
          "is no colour space of " + std::string(ocio) + ", which has " + list(state_->config->getColorSpaceNames()),
          "'" + (a ? to : from) + "'");
  }
  state_->matrix = colorMatrix(from, to);
  state_->means = "matrix";
}
ColorConversion::~ColorConversion() = default;
ColorConversion::ColorConversion(ColorConversion&&) noexcept = default;

void ColorConversion::apply(ImageF& image) const {
  if (state_->identity || image.channels() < 3) return;
  const int channels = image.channels();
  parallelFor(static_cast<std::size_t>(image.height()), 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      float* row = image.row(static_cast<int>(y));
      for (int x = 0; x < image.width(); ++x) {
        float* p = row + static_cast<std::ptrdiff_t>(x) * channels;
        if (std::isnan(p[0]) || std::isnan(p[1]) || std::isnan(p[2])) {
          p[0] = p[1] = p[2] = NAN;
          continue;
        }
        if (state_->processor) {
          state_->processor->apply(p, 1, 1, 3, sizeof(float), 3 * sizeof(float), 3 * sizeof(float));
          continue;
        }
        const Vec3 v = state_->matrix * Vec3{p[0], p[1], p[2]};
        for (int c = 0; c < 3; ++c) p[c] = static_cast<float>(v[c]);
      }
    }
  });
}
bool ColorConversion::identity() const {
  return state_->identity;
}
const std::string& ColorConversion::means() const {
  return state_->means;
}

}  // namespace srf
