// The byte layout stands in doc/field_format.md. Every size and offset is proven against the file's size, and every
// hash against the bytes, before anything is used.
#include "field/reflectance_store.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "base/check.h"
#include "base/error.h"
#include "base/half.h"

namespace srf {
namespace {

static_assert(std::endian::native == std::endian::little, "files are little-endian and read as they are");

constexpr char kMagic[8] = {'S', 'R', 'F', 'B', 'L', 'O', 'C', 'K'};
constexpr std::uint32_t kVersion = 3;  // the header is that of version 2, which has no packed blocks
constexpr int kZstdLevel = 1;          // level 3 saves nothing here and writes at two thirds of the speed
// Packed blocks are read several times faster than those of zstd, which must save so much to be worth it.
constexpr double kZstdShare = 0.7;
constexpr std::uint32_t kBlackBackground = 1;

constexpr std::size_t kDirectUnit = 4096;  // offsets, sizes and addresses of direct reading

struct Header {
  char magic[8];
  std::uint32_t version, flags;
  std::int32_t image_width, image_height, crop_x, crop_y, tiles_x, tiles_y, light_count;
  std::int32_t levels;                                           ///< 0 in version 1, which has one
  std::uint64_t coverage_offset, coverage_bytes, coverage_hash;  ///< hash of the stored bytes
  std::uint64_t index_offset, index_hash;
  std::uint64_t content_hash;  ///< of what the store holds, wherever its parts lie in the file
  // Version 1 has its header_hash here.
  std::uint32_t compression;
  std::uint16_t highest, reserved;
  std::uint64_t highest_count;
  double asked_error, relative_error, largest_error;
  std::uint64_t header_hash;  ///< of the bytes before
};
static_assert(sizeof(Header) == 144);
constexpr std::size_t kHeaderHash1 = offsetof(Header, compression);

enum class Encoding : std::uint32_t { absent = 0, raw = 1, zstd = 2, pca = 3, packed = 4, packed_pca = 5 };
struct IndexEntry {
  std::uint64_t offset;
  std::uint32_t bytes;
  Encoding encoding;
  std::uint64_t hash;  ///< of the stored bytes, seeded with the tile's number so that exchanged tiles are found
};
static_assert(sizeof(IndexEntry) == 24);

std::uint64_t contentOf(const StoreGeometry& g, std::uint64_t coverage_hash, const std::vector<IndexEntry>& index) {
  const std::int32_t shape[] = {g.image_width, g.image_height, g.crop_x,      g.crop_y,
                                g.tiles_x,     g.tiles_y,      g.light_count, g.black_background};
  std::uint64_t hash = contentHash(shape, sizeof shape, coverage_hash);
  if (g.levels > 1) hash = contentHash(&g.levels, sizeof g.levels, hash);
  std::vector<std::uint64_t> tiles;
  for (const IndexEntry& e : index) tiles.push_back(e.hash);
  return contentHash(tiles.data(), tiles.size() * sizeof tiles[0], hash);
}

// One context a thread: making one costs as much as a small block.
struct Zstd {
  ZSTD_CCtx* pack = nullptr;
  ZSTD_DCtx* unpack = nullptr;
  std::vector<std::byte> stored, plain, packed;
  ~Zstd() {
    ZSTD_freeCCtx(pack);
    ZSTD_freeDCtx(unpack);
  }
};
Zstd& zstd() {
  thread_local Zstd z;
  return z;
}

/// Bytes used in z.stored.
std::size_t compress(Zstd& z, const void* data, std::size_t bytes) {
  if (!z.pack) z.pack = ZSTD_createCCtx();
  z.stored.resize(ZSTD_compressBound(bytes));
  const std::size_t n = ZSTD_compressCCtx(z.pack, z.stored.data(), z.stored.size(), data, bytes, kZstdLevel);
  SRF_CHECK(!ZSTD_isError(n));  // the bound is large enough, nothing else can go wrong
  return n;
}

bool decompress(Zstd& z, void* to, std::size_t bytes, const void* from, std::size_t stored) {
  if (!z.unpack) z.unpack = ZSTD_createDCtx();
  return ZSTD_decompressDCtx(z.unpack, to, bytes, from, stored) == bytes;
}

bool sane(const StoreGeometry& g) {
  const auto within = [](int x, int least, int most) { return x >= least && x <= most; };
  constexpr int kMost = 65536;
  return within(g.image_width, 1, kMost) && within(g.image_height, 1, kMost) && within(g.crop_x, 0, g.image_width) &&
         within(g.crop_y, 0, g.image_height) && within(g.tiles_x, 0, kMost / kTile) &&
         within(g.tiles_y, 0, kMost / kTile) && g.crop_x + g.cropWidth() < g.image_width + kTile &&
         g.crop_y + g.cropHeight() < g.image_height + kTile && within(g.light_count, 1, kMost) &&
         within(g.levels, 1, g.mostLevels());
}

/// Coverage of the next level: the mean of 2 x 2, or where edges hold background, all or nothing by majority.
Image8 halved(const StoreGeometry& g, int level, const Image8& fine) {
  Image8 coarse(g.tilesX(level) * kTile, g.tilesY(level) * kTile, 1);
  for (int y = 0; y < coarse.height(); ++y)
    for (int x = 0; x < coarse.width(); ++x) {
      int sum = 0, whole = 0;
      for (int k = 0; k < 4; ++k) {
        const int u = 2 * x + k % 2, v = 2 * y + k / 2;
        const int one = u < fine.width() && v < fine.height() ? fine.at(u, v) : 0;
        sum += one;
        whole += one >= kWhollyCovered;
      }
      coarse.at(x, y) = static_cast<std::uint8_t>(g.black_background ? (sum + 2) / 4 : whole >= 2 ? 255 : 0);
    }
  return coarse;
}

struct TileError {
  double squares = 0, all = 0, largest = 0;
};
TileError differences(std::span<const std::uint16_t> truth, std::span<const std::uint16_t> stored) {
  TileError error;
  float a[16], b[16];
  for (std::size_t i = 0; i < truth.size(); i += 16) {
    floatsFromHalves(&truth[i], a, 16);
    floatsFromHalves(&stored[i], b, 16);
    for (int k = 0; k < 16; ++k) {
      const double d = static_cast<double>(a[k]) - b[k];
      error.squares += d * d, error.all += static_cast<double>(a[k]) * a[k];
      error.largest = std::max(error.largest, std::fabs(d));
    }
  }
  return error;
}

}  // namespace

struct ReflectanceStoreWriter::State {
  State(const std::filesystem::path& path, const StoreGeometry& g, const StoreCoding& how)
      : file(path), geometry(g), coding(how) {}

  bool covered(int level, int tile_x, int tile_y) const {
    if (tile_x >= geometry.tilesX(level) || tile_y >= geometry.tilesY(level)) return false;
    for (int i = 0; i < kTile * kTile; ++i)
      if (coverage[level].at(tile_x * kTile + i % kTile, tile_y * kTile + i / kTile) > 0) return true;
    return false;
  }
  void write(const TilePlace& at, std::span<const std::uint16_t> block);
  void addToNextLevel(const TilePlace& at, std::span<const std::uint16_t> block);

  /// A tile above level 0 of which not all parts have come.
  struct Unfinished {
    std::vector<std::uint16_t> block;
    int missing = 0;
  };

  PartialFile file;
  StoreGeometry geometry;
  StoreCoding coding;
  std::vector<Image8> coverage;  ///< of each level
  Header header{};
  std::vector<IndexEntry> index;
  std::vector<TileError> errors;  ///< of each tile of level 0
  std::unordered_map<std::uint32_t, Unfinished> unfinished;
  std::mutex mutex;
};

ReflectanceStoreWriter::ReflectanceStoreWriter(const std::filesystem::path& file, const StoreGeometry& geometry,
                                               const Image8& coverage, const StoreCoding& coding)
    : state_(std::make_unique<State>(file, geometry, coding)) {
  SRF_CHECK(sane(geometry));
  SRF_CHECK(coverage.width() == geometry.cropWidth() && coverage.height() == geometry.cropHeight());
  State& s = *state_;
  s.index.resize(geometry.allTiles(), IndexEntry{0, 0, Encoding::absent, 0});
  s.errors.resize(geometry.tileCount());
  s.file.write(&s.header, sizeof s.header);  // its place; filled in by commit
  s.coverage.push_back(coverage);
  for (int level = 1; level < geometry.levels; ++level)
    s.coverage.push_back(halved(geometry, level, s.coverage.back()));
  std::vector<std::uint8_t> all;
  for (const Image8& level : s.coverage) all.insert(all.end(), level.data().begin(), level.data().end());
  Zstd& z = zstd();
  s.header.coverage_offset = s.file.size();
  s.header.coverage_bytes = compress(z, all.data(), all.size());
  s.header.coverage_hash = contentHash(z.stored.data(), s.header.coverage_bytes);
  s.file.write(z.stored.data(), s.header.coverage_bytes);
}

ReflectanceStoreWriter::~ReflectanceStoreWriter() = default;

void ReflectanceStoreWriter::writeTile(int tile_x, int tile_y, std::span<const std::uint16_t> block) {
  const StoreGeometry& g = state_->geometry;
  SRF_CHECK(block.size() == g.blockHalves() && tile_x >= 0 && tile_x < g.tiles_x && tile_y >= 0 && tile_y < g.tiles_y);
  state_->write({0, tile_x, tile_y}, block);
}

void ReflectanceStoreWriter::State::write(const TilePlace& at, std::span<const std::uint16_t> block) {
  const StoreGeometry& g = geometry;
  const std::uint32_t tile = g.tileNumber(at);
  Zstd& z = zstd();
  const void* data = block.data();
  std::size_t bytes = g.blockBytes();
  Encoding encoding = Encoding::raw;
  TileError error;
  std::vector<std::byte> components;
  if (coding.compression == Compression::pca) {
    if (auto compressed = compressBlock(g, block, coding.error)) {
      if (at.level == 0) {
        std::vector<std::uint16_t> expanded(g.blockHalves());
        expandBlock(g, compressed->block, expanded);
        error = differences(block, expanded);
      }
      components = std::move(compressed->stored);
      bytes = components.size();
      data = components.data();
      encoding = Encoding::packed_pca;
    }
  }
  if (encoding == Encoding::raw && coding.compression != Compression::none) {
    z.plain.resize(g.blockBytes());
    shuffleBlock(g, block.data(), z.plain.data());
    packBlock(g, block.data(), z.packed);
    const std::size_t stored = compress(z, z.plain.data(), g.blockBytes());
    if (static_cast<double>(stored) < kZstdShare * static_cast<double>(std::min(z.packed.size(), g.blockBytes()))) {
      data = z.stored.data();
      bytes = stored;
      encoding = Encoding::zstd;
    } else if (z.packed.size() < g.blockBytes()) {
      data = z.packed.data();
      bytes = z.packed.size();
      encoding = Encoding::packed;
    }
  }
  if (encoding != Encoding::packed_pca && at.level == 0) error = differences(block, block);
  std::uint16_t highest = 0;
  for (const std::uint16_t value : block) highest = std::max(highest, value);
  const auto times = static_cast<std::uint64_t>(std::count(block.begin(), block.end(), highest));
  const std::uint64_t hash = contentHash(data, bytes, tile);
  {
    const std::lock_guard lock(mutex);
    SRF_CHECK(index[tile].encoding == Encoding::absent);
    index[tile] = {file.size(), static_cast<std::uint32_t>(bytes), encoding, hash};
    file.write(data, bytes);
    if (at.level == 0) {
      errors[tile] = error;
      if (highest > header.highest) header.highest = highest, header.highest_count = 0;
      if (highest == header.highest) header.highest_count += times;
    }
  }
  if (at.level + 1 < g.levels) addToNextLevel(at, block);
}

void ReflectanceStoreWriter::State::addToNextLevel(const TilePlace& at, std::span<const std::uint16_t> block) {
  const StoreGeometry& g = geometry;
  const TilePlace above{at.level + 1, at.x / 2, at.y / 2};
  constexpr int kHalf = kTile / 2;
  const int texel_halves = static_cast<int>(g.texelHalves());
  // This tile's quarter of the one above.
  std::vector<std::uint16_t> quarter(g.blockHalves() / 4, 0);
  std::vector<float> sum(g.texelHalves()), one(g.texelHalves());
  for (int y = 0; y < kHalf; ++y)
    for (int x = 0; x < kHalf; ++x) {
      const int to = coverage[above.level].at(at.x * kHalf + x, at.y * kHalf + y);
      if (to == 0) continue;
      std::fill(sum.begin(), sum.end(), 0.f);
      int total = 0;  // coverage, or of texels that are wholly covered
      for (int k = 0; k < 4; ++k) {
        const int u = 2 * x + k % 2, v = 2 * y + k / 2;
        const int part = coverage[at.level].at(at.x * kTile + u, at.y * kTile + v);
        if (g.black_background ? part == 0 : part < kWhollyCovered) continue;
        total += g.black_background ? part : 255;
        floatsFromHalves(&block[(v * kTile + u) * g.texelHalves()], one.data(), texel_halves);
        for (int i = 0; i < texel_halves; ++i) sum[i] += one[i];
      }
      const float scale = static_cast<float>(to) / static_cast<float>(total);
      for (float& value : sum) value = std::min(value * scale, 65504.f);
      halvesFromFloats(sum.data(), &quarter[(y * kHalf + x) * g.texelHalves()], texel_halves);
    }
  std::vector<std::uint16_t> whole;
  {
    const std::lock_guard lock(mutex);
    Unfinished& parent = unfinished[g.tileNumber(above)];
    if (parent.block.empty()) {
      parent.block.assign(g.blockHalves(), 0);
      for (int k = 0; k < 4; ++k) parent.missing += covered(at.level, 2 * above.x + k % 2, 2 * above.y + k / 2);
    }
    for (int y = 0; y < kHalf; ++y)
      std::copy_n(&quarter[y * kHalf * g.texelHalves()], kHalf * g.texelHalves(),
                  &parent.block[((at.y % 2 * kHalf + y) * kTile + at.x % 2 * kHalf) * g.texelHalves()]);
    if (--parent.missing > 0) return;
    whole = std::move(parent.block);
    unfinished.erase(g.tileNumber(above));
  }
  if (covered(above.level, above.x, above.y)) write(above, whole);
}

std::uint64_t ReflectanceStoreWriter::commit() {
  State& s = *state_;
  const StoreGeometry& g = s.geometry;
  Header& h = s.header;
  SRF_CHECK(s.unfinished.empty());  // every tile that is covered came
  h.index_offset = s.file.size();
  h.index_hash = contentHash(s.index.data(), s.index.size() * sizeof(IndexEntry));
  s.file.write(s.index.data(), s.index.size() * sizeof(IndexEntry));
  std::memcpy(h.magic, kMagic, sizeof kMagic);
  h.version = kVersion;
  h.flags = g.black_background ? kBlackBackground : 0;
  h.image_width = g.image_width, h.image_height = g.image_height;
  h.crop_x = g.crop_x, h.crop_y = g.crop_y, h.tiles_x = g.tiles_x, h.tiles_y = g.tiles_y, h.light_count = g.light_count;
  h.levels = g.levels;
  h.compression = static_cast<std::uint32_t>(s.coding.compression);
  h.asked_error = s.coding.compression == Compression::pca ? s.coding.error : 0;
  double squares = 0, all = 0;
  for (const TileError& tile : s.errors) {  // in this order whatever the order of writing
    squares += tile.squares, all += tile.all;
    h.largest_error = std::max(h.largest_error, tile.largest);
  }
  h.relative_error = all > 0 ? std::sqrt(squares / all) : 0;
  h.content_hash = contentOf(g, h.coverage_hash, s.index);
  h.header_hash = contentHash(&h, offsetof(Header, header_hash));
  s.file.writeAt(0, &h, sizeof h);
  s.file.commit();
  return h.content_hash;
}

std::byte* ReadBuffer::reserve(std::size_t bytes) {
  if (bytes > capacity_) {
    const std::size_t rounded = (bytes + kDirectUnit - 1) / kDirectUnit * kDirectUnit;
    memory_.reset(static_cast<std::byte*>(std::aligned_alloc(kDirectUnit, rounded)));
    capacity_ = memory_ ? rounded : 0;
    if (!memory_) throw std::bad_alloc();
  }
  return memory_.get();
}

struct ReflectanceStore::State {
  std::filesystem::path file;
  int descriptor = -1, direct = -1;
  std::uint64_t size = 0, content_hash = 0;
  StoreGeometry geometry;
  StoreFidelity fidelity;
  std::vector<Coverage> coverage;
  std::vector<IndexEntry> index;
  ~State() {
    if (descriptor >= 0) ::close(descriptor);
    if (direct >= 0) ::close(direct);
  }

  Error damaged(const std::string& what) const {
    return badInput(file.string(), what + "; the file is damaged: run `srf acquire` again");
  }
  bool inside(std::uint64_t offset, std::uint64_t bytes) const { return offset <= size && bytes <= size - offset; }
  /// Reads `bytes`, and beyond them up to `most` as it comes.
  void read(int from, void* to, std::size_t bytes, std::size_t most, std::uint64_t offset) const {
    char* at = static_cast<char*>(to);
    for (std::size_t done = 0; done < bytes;) {
      const ssize_t n = ::pread(from, at + done, most - done, static_cast<off_t>(offset + done));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) throw badInput(file.string(), std::string("could not be read: ") + std::strerror(errno));
      if (n == 0) throw damaged("ends early");
      done += static_cast<std::size_t>(n);
    }
  }
  void read(void* to, std::size_t bytes, std::uint64_t offset) const { read(descriptor, to, bytes, bytes, offset); }
};

ReflectanceStore::ReflectanceStore(const std::filesystem::path& file, bool direct) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.file = file;
  s.descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  struct stat info {};
  if (s.descriptor < 0 || ::fstat(s.descriptor, &info) != 0)
    throw badInput(file.string(),
                   std::string("could not be opened: ") + std::strerror(errno) + "; run `srf acquire` again");
  if (!S_ISREG(info.st_mode)) throw badInput(file.string(), "is not a file, expected a view's store");
  s.size = static_cast<std::uint64_t>(info.st_size);
  // Blocks are asked for where they are wanted; the system's own reading ahead would read others.
  ::posix_fadvise(s.descriptor, 0, 0, POSIX_FADV_RANDOM);
  if (direct) {
    s.direct = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_DIRECT);
    if (s.direct < 0)
      throw badInput(file.string(), std::string("cannot be read directly: ") + std::strerror(errno) +
                                        "; choose a file system that can or do without");
  }

  Header h{};
  if (s.size < kHeaderHash1 + sizeof h.header_hash)
    throw s.damaged("ends early (" + std::to_string(s.size) + " bytes)");
  s.read(&h, std::min<std::size_t>(sizeof h, s.size), 0);
  if (std::memcmp(h.magic, kMagic, sizeof kMagic) != 0)
    throw badInput(file.string(), "is not a view's store (.blk) of an SRF");
  if (h.version > kVersion)
    throw badInput(file.string(), "has version " + std::to_string(h.version) + ", this program reads up to " +
                                      std::to_string(kVersion) + "; use a newer program or run `srf acquire` again");
  const std::size_t hashed = h.version == 1 ? kHeaderHash1 : offsetof(Header, header_hash);
  std::uint64_t header_hash = 0;
  std::memcpy(&header_hash, reinterpret_cast<const char*>(&h) + hashed, sizeof header_hash);
  if (h.version == 1) h.levels = 1;
  StoreGeometry& g = s.geometry;
  g = {h.image_width, h.image_height, h.crop_x,      h.crop_y,
       h.tiles_x,     h.tiles_y,      h.light_count, (h.flags & kBlackBackground) != 0,
       h.levels};
  Header as_stored = h;
  if (h.version == 1) as_stored.levels = 0;
  if (s.size < hashed + sizeof header_hash || header_hash != srf::contentHash(&as_stored, hashed) || h.version < 1 ||
      !sane(g))
    throw s.damaged("has a header that does not fit its checksum");
  if (h.version > 1)
    s.fidelity = {static_cast<Compression>(h.compression),
                  h.asked_error,
                  h.relative_error,
                  h.largest_error,
                  h.highest,
                  h.highest_count};

  const std::uint64_t index_bytes = sizeof(IndexEntry) * static_cast<std::uint64_t>(g.allTiles());
  if (!s.inside(h.index_offset, index_bytes) || !s.inside(h.coverage_offset, h.coverage_bytes))
    throw s.damaged("ends early (" + std::to_string(s.size) + " bytes)");
  s.index.resize(g.allTiles());
  s.read(s.index.data(), index_bytes, h.index_offset);
  if (h.index_hash != srf::contentHash(s.index.data(), index_bytes))
    throw s.damaged("has an index that does not fit its checksum");
  for (const IndexEntry& e : s.index) {
    const bool packed = e.encoding >= Encoding::zstd && e.encoding <= Encoding::packed_pca;
    const bool whole =
        e.encoding == Encoding::absent ||
        (s.inside(e.offset, e.bytes) && (packed || (e.encoding == Encoding::raw && e.bytes == g.blockBytes())));
    if (!whole) throw s.damaged("has an index entry outside of the file");
  }
  std::vector<std::byte> stored(h.coverage_bytes);
  s.read(stored.data(), stored.size(), h.coverage_offset);
  std::vector<std::uint8_t> all(g.allTiles() * std::size_t{kTile * kTile});
  if (h.coverage_hash != srf::contentHash(stored.data(), stored.size()) ||
      !decompress(zstd(), all.data(), all.size(), stored.data(), stored.size()))
    throw s.damaged("has a coverage that does not fit its checksum");
  auto from = all.begin();
  for (int level = 0; level < g.levels; ++level) {
    Image8 image(g.tilesX(level) * kTile, g.tilesY(level) * kTile, 1);
    std::copy_n(from, image.data().size(), image.data().begin());
    from += static_cast<std::ptrdiff_t>(image.data().size());
    s.coverage.emplace_back(image);
  }
  s.content_hash = contentOf(g, h.coverage_hash, s.index);
  if (s.content_hash != h.content_hash) throw s.damaged("has a content that does not fit its checksum");
}

ReflectanceStore::~ReflectanceStore() = default;
ReflectanceStore::ReflectanceStore(ReflectanceStore&&) noexcept = default;
ReflectanceStore& ReflectanceStore::operator=(ReflectanceStore&&) noexcept = default;

const StoreGeometry& ReflectanceStore::geometry() const {
  return state_->geometry;
}
const Coverage* ReflectanceStore::coverages() const {
  return state_->coverage.data();
}
const StoreFidelity& ReflectanceStore::fidelity() const {
  return state_->fidelity;
}
std::uint64_t ReflectanceStore::contentHash() const {
  return state_->content_hash;
}
std::uint64_t ReflectanceStore::bytesOnDisk() const {
  return state_->size;
}
std::size_t ReflectanceStore::bytesInMemory() const {
  std::size_t bytes = sizeof(State) + state_->index.capacity() * sizeof(IndexEntry);
  for (const Coverage& level : state_->coverage) bytes += sizeof level + level.bytes();
  return bytes;
}
const std::filesystem::path& ReflectanceStore::file() const {
  return state_->file;
}

bool ReflectanceStore::hasTile(std::uint32_t tile) const {
  return tile < state_->index.size() && state_->index[tile].encoding != Encoding::absent;
}

bool ReflectanceStore::hasTile(int tile_x, int tile_y) const {
  const StoreGeometry& g = state_->geometry;
  return tile_x >= 0 && tile_x < g.tiles_x && tile_y >= 0 && tile_y < g.tiles_y &&
         hasTile(g.tileNumber({0, tile_x, tile_y}));
}

ReflectanceStore::Place ReflectanceStore::place(std::uint32_t tile) const {
  if (!hasTile(tile)) return {};
  const IndexEntry& e = state_->index[tile];
  return {e.offset, e.bytes};
}

std::span<const std::byte> ReflectanceStore::read(const Place& place, ReadBuffer& buffer) const {
  const State& s = *state_;
  if (s.direct < 0) {
    std::byte* to = buffer.reserve(place.bytes);
    s.read(to, place.bytes, place.offset);
    return {to, place.bytes};
  }
  const std::uint64_t first = place.offset / kDirectUnit * kDirectUnit;
  const std::size_t wanted = place.offset - first + place.bytes;
  const std::size_t most = (wanted + kDirectUnit - 1) / kDirectUnit * kDirectUnit;
  std::byte* to = buffer.reserve(most);
  s.read(s.direct, to, wanted, most, first);
  return {to + (place.offset - first), place.bytes};
}

void ReflectanceStore::decode(std::uint32_t tile, std::span<const std::byte> stored, ReflectanceBlock& out) const {
  const State& s = *state_;
  const StoreGeometry& g = s.geometry;
  out.rank = 0;
  out.basis.clear();
  if (!hasTile(tile)) {
    out.pad = g.lightPad();
    out.halves.assign(g.blockHalves(), 0);
    return;
  }
  const IndexEntry& e = s.index[tile];
  const auto complain = [&](const std::string& what) {
    const TilePlace at = g.place(tile);
    return s.damaged("has a tile (" + std::to_string(at.x) + ", " + std::to_string(at.y) + ") of level " +
                     std::to_string(at.level) + ' ' + what);
  };
  if (stored.size() != e.bytes || e.hash != srf::contentHash(stored.data(), e.bytes, tile))
    throw complain("that does not fit its checksum");
  if (e.encoding == Encoding::packed_pca) {
    if (!unpackCompressed(g, stored, out)) throw complain("that cannot be unpacked");
    return;
  }
  if (e.encoding == Encoding::pca) {
    Zstd& z = zstd();
    const auto bytes = ZSTD_getFrameContentSize(stored.data(), stored.size());
    if (bytes > g.blockBytes()) throw complain("that cannot be unpacked");  // also where it is not known
    z.plain.resize(bytes);
    if (!decompress(z, z.plain.data(), bytes, stored.data(), stored.size()) ||
        !unpackShuffledCompressed(g, z.plain, out))
      throw complain("that cannot be unpacked");
    return;
  }
  out.pad = g.lightPad();
  out.halves.resize(g.blockHalves());
  if (e.encoding == Encoding::raw) {
    std::memcpy(out.halves.data(), stored.data(), stored.size());
    return;
  }
  if (e.encoding == Encoding::packed) {
    if (!unpackBlock(g, stored, out.halves.data())) throw complain("that cannot be unpacked");
    return;
  }
  Zstd& z = zstd();
  z.plain.resize(g.blockBytes());
  if (!decompress(z, z.plain.data(), g.blockBytes(), stored.data(), stored.size()))
    throw complain("that cannot be unpacked");
  unshuffleBlock(g, z.plain.data(), out.halves.data());
}

std::size_t ReflectanceStore::readTile(int tile_x, int tile_y, std::span<std::uint16_t> out) const {
  const StoreGeometry& g = state_->geometry;
  SRF_CHECK(out.size() == g.blockHalves());
  if (!hasTile(tile_x, tile_y)) {
    std::memset(out.data(), 0, g.blockBytes());
    return 0;
  }
  thread_local ReadBuffer buffer;
  thread_local ReflectanceBlock block;
  const std::uint32_t tile = g.tileNumber({0, tile_x, tile_y});
  const Place at = place(tile);
  decode(tile, read(at, buffer), block);
  expandBlock(g, block, out);
  return at.bytes;
}

std::uint64_t recodeStore(const ReflectanceStore& store, const std::filesystem::path& file, const StoreCoding& coding) {
  const StoreGeometry& geometry = store.geometry();
  ReflectanceStoreWriter writer(file, geometry, store.coverage().image(), coding);
  std::vector<std::uint16_t> block(geometry.blockHalves());
  for (int y = 0; y < geometry.tiles_y; ++y)
    for (int x = 0; x < geometry.tiles_x; ++x)
      if (store.hasTile(x, y)) {
        store.readTile(x, y, block);
        writer.writeTile(x, y, block);
      }
  return writer.commit();
}

}  // namespace srf
