// *.srffit: "SRFFIT\0\0", u32 version, u32 bytes of the header, the header (JSON), then, little-endian: a record of 48
// bytes for each point, and the rows of the five tables of bits, lit_by_rays only where it differs from lit. The
// manifest holds the hash of the file.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/json.h"
#include "base/numeric.h"
#include "model/reflectance_fit.h"

static_assert(std::endian::native == std::endian::little, "fit files are copied to and from memory as they are");

namespace srf {
namespace {

constexpr char kMagic[8] = {'S', 'R', 'F', 'F', 'I', 'T', 0, 0};
constexpr std::size_t kPrefix = sizeof kMagic + 2 * sizeof(std::uint32_t);
constexpr std::size_t kMostRoughnesses = 256;

struct Record {
  std::uint16_t coefficient[kModelTerms][3];  ///< halves
  std::int16_t normal[2];                     ///< octahedral, -32767 .. 32767
  std::uint16_t tangent;                      ///< angle from anyPerpendicular(normal), 65536 to the half turn
  std::uint8_t roughness;                     ///< position in the header's list
  std::uint8_t gate, indirect;                ///< 0 .. 255
  std::uint8_t indirect_shadow, slant;
  std::uint8_t none;
  float turn[3];  ///< along u u, u v, v v: u = anyPerpendicular(normal), v = n x u
};
static_assert(sizeof(Record) == 48);

// Cigolle et al. 2014: the sphere folded onto a square.
std::array<std::int16_t, 2> octahedral(const std::array<float, 3>& n) {
  const double sum = std::fabs(n[0]) + std::fabs(n[1]) + std::fabs(n[2]);
  double x = n[0] / sum, y = n[1] / sum;
  if (n[2] < 0) {
    const double fold = (1 - std::fabs(y)) * std::copysign(1.0, x);
    y = (1 - std::fabs(x)) * std::copysign(1.0, y);
    x = fold;
  }
  const auto quantised = [](double v) {
    return static_cast<std::int16_t>(std::lround(std::clamp(v, -1.0, 1.0) * 32767));
  };
  return {quantised(x), quantised(y)};
}
Direction<AcquisitionSpace> fromOctahedral(const std::int16_t (&at)[2]) {
  double x = std::max(at[0] / 32767.0, -1.0), y = std::max(at[1] / 32767.0, -1.0);
  const double z = 1 - std::fabs(x) - std::fabs(y);
  if (z < 0) {
    const double fold = (1 - std::fabs(y)) * std::copysign(1.0, x);
    y = (1 - std::fabs(x)) * std::copysign(1.0, y);
    x = fold;
  }
  return *normalize(Vector<AcquisitionSpace>(x, y, z));  // |x| + |y| + |z| is 1
}
Vec3 vec(const std::array<float, 3>& v) {
  return {v[0], v[1], v[2]};
}
std::uint8_t byte(float share) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(share, 0.f, 1.f) * 255));
}

float product(const SymmetricMatrix& m, const Vec3& a, const Vec3& b) {
  const auto [xx, xy, xz, yy, yz, zz] = m;
  return static_cast<float>(dot(a, Mat3{{Vec3{xx, xy, xz}, Vec3{xy, yy, yz}, Vec3{xz, yz, zz}}} * b));
}

Record pack(const FittedPoint& point, std::uint8_t roughness) {
  Record record{};
  const PointReflectance& r = point.reflectance;
  for (int k = 0; k < kModelTerms; ++k)
    for (int c = 0; c < 3; ++c) record.coefficient[k][c] = halfFromFloat(r.coefficient[k][c]);
  const auto normal = octahedral(r.normal);
  std::copy(normal.begin(), normal.end(), record.normal);
  // The angle is that to the normal as it will be read.
  const Direction<AcquisitionSpace> n = fromOctahedral(record.normal), u = anyPerpendicular(n);
  const double angle = std::atan2(dot(cross(n.raw(), u.raw()), vec(r.tangent)), dot(u.raw(), vec(r.tangent)));
  record.tangent = static_cast<std::uint16_t>(std::lround((angle < 0 ? angle + kPi : angle) / kPi * 65536) % 65536);
  record.roughness = roughness;
  record.gate = byte(point.gate);
  record.indirect = byte(point.indirect);
  record.indirect_shadow = byte(point.indirect_shadow);
  record.slant = byte(point.slant);
  const Vec3 v = cross(n.raw(), u.raw());
  record.turn[0] = product(point.turn, u.raw(), u.raw());
  record.turn[1] = product(point.turn, u.raw(), v);
  record.turn[2] = product(point.turn, v, v);
  return record;
}

FittedPoint unpack(const Record& record, const std::vector<std::array<float, 2>>& roughnesses) {
  FittedPoint point;
  PointReflectance& r = point.reflectance;
  for (int k = 0; k < kModelTerms; ++k)
    for (int c = 0; c < 3; ++c) r.coefficient[k][c] = floatFromHalf(record.coefficient[k][c]);
  const Direction<AcquisitionSpace> n = fromOctahedral(record.normal), u = anyPerpendicular(n);
  const double angle = record.tangent * kPi / 65536;
  r.normal = floats(n.raw());
  r.tangent = floats(std::cos(angle) * u.raw() + std::sin(angle) * cross(n.raw(), u.raw()));
  r.alpha_x = roughnesses[record.roughness][0], r.alpha_y = roughnesses[record.roughness][1];
  point.gate = static_cast<float>(record.gate) / 255;
  point.indirect = static_cast<float>(record.indirect) / 255;
  point.indirect_shadow = static_cast<float>(record.indirect_shadow) / 255;
  point.slant = static_cast<float>(record.slant) / 255;
  point.turn = symmetricInPlane(record.turn[0], record.turn[1], record.turn[2], u.raw(), cross(n.raw(), u.raw()));
  return point;
}

ReflectanceFit parseFit(const std::vector<std::byte>& bytes, const std::string& file, std::size_t points,
                        std::size_t lights, std::size_t views) {
  const auto damaged = [&file](const std::string& what) {
    return badInput(file, what + "; the file is damaged: make it again with srf model");
  };
  if (bytes.size() < kPrefix || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0)
    throw damaged("does not begin as a fit does");
  std::uint32_t version, header_bytes;
  std::memcpy(&version, &bytes[sizeof kMagic], sizeof version);
  std::memcpy(&header_bytes, &bytes[sizeof kMagic + sizeof version], sizeof header_bytes);
  if (version != kFitVersion)
    throw badInput(file, "has version " + std::to_string(version) + ", this program reads version " +
                             std::to_string(kFitVersion) + "; make the model again with srf model");
  if (header_bytes > bytes.size() - kPrefix) throw damaged("ends within its header");
  const JsonNode header = parseJson(std::string(reinterpret_cast<const char*>(&bytes[kPrefix]), header_bytes), file);
  const auto must_be = [&](const char* key, std::size_t expected) {
    const long found = header[key].integer(0, std::numeric_limits<std::int32_t>::max());
    if (static_cast<std::size_t>(found) != expected)
      throw badInput(file, "was made for " + std::to_string(found) + " " + key + ", there are " +
                               std::to_string(expected) + "; make it again with srf model");
  };
  must_be("points", points);
  must_be("lights", lights);
  must_be("views", views);

  ReflectanceFit fit;
  fit.error_plain = header["error_plain"].number();
  fit.error_guided = header["error_guided"].number();
  const JsonNode list = header["roughness"];
  std::vector<std::array<float, 2>> roughnesses;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const std::array<float, 2> alpha{static_cast<float>(list.at(i).at(0).number()),
                                     static_cast<float>(list.at(i).at(1).number())};
    // modelTerms promises finite values for these alone.
    if (!(alpha[0] >= 0.005f && alpha[0] <= 1 && alpha[1] >= 0.005f && alpha[1] <= 1))
      throw list.at(i).error("is no roughness from 0.005 to 1");
    roughnesses.push_back(alpha);
  }
  std::size_t at = kPrefix + header_bytes;
  const auto take = [&](void* to, std::size_t size) {
    if (size > bytes.size() - at) throw damaged("ends early");
    if (size > 0) std::memcpy(to, &bytes[at], size);
    at += size;
  };
  if (points > (bytes.size() - at) / sizeof(Record)) throw damaged("ends early");
  fit.points.reserve(points);
  for (std::size_t i = 0; i < points; ++i) {
    Record record;
    take(&record, sizeof record);
    if (record.roughness >= roughnesses.size()) throw damaged("names a roughness that is not there");
    for (const auto& term : record.coefficient)
      for (const std::uint16_t half : term)
        if (half >= 0x7c00) throw damaged("has a coefficient that is negative or not finite");
    for (const float turn : record.turn)
      if (!std::isfinite(turn)) throw damaged("has a turn of the normal that is not finite");
    fit.points.push_back(unpack(record, roughnesses));
  }
  const auto take_bits = [&](std::size_t columns) {
    const std::size_t words = (columns + 63) / 64;
    if (words > 0 && points > (bytes.size() - at) / (8 * words)) throw damaged("ends early");
    VisibilityBits bits(points, columns);
    take(bits.words().data(), 8 * bits.words().size());
    if (columns % 64 != 0)
      for (std::size_t i = 0; i < points; ++i)
        if (bits.row(i)[columns / 64] >> (columns % 64) != 0) throw damaged("has bits of nothing");
    return bits;
  };
  fit.lit = take_bits(lights);
  fit.lit_around = take_bits(lights);
  fit.seen_around = take_bits(views);
  fit.worse = take_bits(lights);
  fit.lit_by_rays = header["corrected"].boolean() ? take_bits(lights) : fit.lit;
  if (at != bytes.size()) throw damaged("has " + std::to_string(bytes.size() - at) + " bytes too many");
  return fit;
}

}  // namespace

void storeFit(const std::filesystem::path& srf_folder, const ReflectanceFit& fit, const std::string& name) {
  SrfManifest manifest = readManifest(srf_folder);
  Json header;
  header["points"] = fit.points.size();
  header["lights"] = fit.lit.views();
  header["views"] = fit.seen_around.views();
  header["error_plain"] = fit.error_plain;
  header["error_guided"] = fit.error_guided;
  const bool corrected = fit.lit.words() != fit.lit_by_rays.words();
  header["corrected"] = corrected;
  header["roughness"] = Json::array();
  std::map<std::array<float, 2>, std::uint8_t> roughnesses;
  std::vector<Record> records;
  records.reserve(fit.points.size());
  for (const FittedPoint& point : fit.points) {
    const std::array<float, 2> alpha{point.reflectance.alpha_x, point.reflectance.alpha_y};
    const auto [entry, is_new] = roughnesses.try_emplace(alpha, static_cast<std::uint8_t>(roughnesses.size()));
    SRF_CHECK(roughnesses.size() <= kMostRoughnesses);
    if (is_new) header["roughness"].push_back({alpha[0], alpha[1]});
    records.push_back(pack(point, entry->second));
  }
  const std::string text = header.dump();

  std::vector<std::byte> bytes;
  const auto append = [&bytes](const void* data, std::size_t size) {
    const auto* from = static_cast<const std::byte*>(data);
    bytes.insert(bytes.end(), from, from + size);
  };
  const auto header_bytes = static_cast<std::uint32_t>(text.size());
  append(kMagic, sizeof kMagic);
  append(&kFitVersion, sizeof kFitVersion);
  append(&header_bytes, sizeof header_bytes);
  append(text.data(), text.size());
  append(records.data(), records.size() * sizeof(Record));
  for (const VisibilityBits* bits : {&fit.lit, &fit.lit_around, &fit.seen_around, &fit.worse})
    append(bits->words().data(), 8 * bits->words().size());
  if (corrected) append(fit.lit_by_rays.words().data(), 8 * fit.lit_by_rays.words().size());

  StoredFile entry{name, "fit", "", contentHash(bytes.data(), bytes.size())};
  entry.file = "models/" + name + "-" + hexHash(entry.hash) + ".srffit";
  writeBinaryFile(srf_folder / entry.file, bytes.data(), bytes.size());
  std::erase_if(manifest.fits, [&name](const StoredFile& other) { return other.name == name; });
  manifest.fits.push_back(entry);
  writeManifest(srf_folder, manifest);
}

std::optional<ReflectanceFit> loadFit(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                                      const DeformableModel& model) {
  const StoredFile* entry = manifest.fit(manifest.active_model);
  if (!entry) return std::nullopt;
  const std::filesystem::path file = srf_folder / entry->file;
  const std::vector<std::byte> bytes = readBinaryFile(file);
  if (contentHash(bytes.data(), bytes.size()) != entry->hash)
    throw badInput(file.string(),
                   "is damaged: its content is not what the manifest says; make it again with srf model");
  return parseFit(bytes, file.string(), model.size(), manifest.lights.size(), manifest.views.size());
}

}  // namespace srf
