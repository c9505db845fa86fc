// The byte layout stands in doc/field_format.md. Every size and offset is proven against the file's size, and every
// hash against the bytes, before anything is used.
#include "field/reflectance_store.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

#include <atomic>
#include <bit>
#include <cerrno>
#include <cstring>
#include <mutex>
#include <vector>

#include "base/check.h"
#include "base/error.h"

namespace srf {
namespace {

static_assert(std::endian::native == std::endian::little, "files are little-endian and read as they are");

constexpr char kMagic[8] = {'S', 'R', 'F', 'B', 'L', 'O', 'C', 'K'};
constexpr std::uint32_t kVersion = 1;
constexpr int kZstdLevel = 1;  // level 3 saves nothing here and writes at two thirds of the speed
constexpr std::uint32_t kBlackBackground = 1;

struct Header {
  char magic[8];
  std::uint32_t version, flags;
  std::int32_t image_width, image_height, crop_x, crop_y, tiles_x, tiles_y, light_count, reserved;
  std::uint64_t coverage_offset, coverage_bytes, coverage_hash;  ///< hash of the stored bytes
  std::uint64_t index_offset, index_hash;
  std::uint64_t content_hash;  ///< of what the store holds, wherever its parts lie in the file
  std::uint64_t header_hash;   ///< of the bytes before
};
static_assert(sizeof(Header) == 104);

enum class Encoding : std::uint32_t { absent = 0, raw = 1, zstd = 2 };
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
  std::vector<std::uint64_t> tiles;
  for (const IndexEntry& e : index) tiles.push_back(e.hash);
  return contentHash(tiles.data(), tiles.size() * sizeof tiles[0], hash);
}

// One context a thread: making one costs as much as a small block.
struct Zstd {
  ZSTD_CCtx* pack = nullptr;
  ZSTD_DCtx* unpack = nullptr;
  std::vector<std::byte> stored, plain;
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

// Halves are bit patterns that grow with their values, so the difference to the texel above (in the first row: to the
// left) is mostly a small whole number. Low and high bytes are kept apart: the high ones are nearly all 0 or 255. How
// this was chosen is in doc/field_format.md.
void shuffle(const StoreGeometry& g, const std::uint16_t* block, std::byte* out) {
  const std::size_t all = g.blockHalves(), texel = g.texelHalves(), row = kTile * texel;
  const auto differ = [&](std::size_t begin, std::size_t end, std::size_t back) {
    for (std::size_t i = begin; i < end; ++i) {
      const unsigned d = block[i] - (back ? block[i - back] : 0u);
      out[i] = static_cast<std::byte>(d);
      out[all + i] = static_cast<std::byte>(d >> 8);
    }
  };
  differ(0, texel, 0);
  differ(texel, row, texel);
  differ(row, all, row);
}

void unshuffle(const StoreGeometry& g, const std::byte* in, std::uint16_t* block) {
  const std::size_t all = g.blockHalves(), texel = g.texelHalves(), row = kTile * texel;
  const auto* low = reinterpret_cast<const std::uint8_t*>(in);
  const std::uint8_t* high = low + all;
  const auto add = [&](std::size_t begin, std::size_t end, std::size_t back) {
    std::uint16_t* to = block + begin;
    const std::uint16_t* from =
        to - back;  // a row or a texel before `to`: never the same numbers within one step below
    for (std::size_t i = begin; i < end; i += kLightGroup, to += kLightGroup, from += kLightGroup)
      for (int k = 0; k < kLightGroup; ++k)
        to[k] = static_cast<std::uint16_t>((back ? from[k] : 0) + (low[i + k] | high[i + k] << 8));
  };
  add(0, texel, 0);
  add(texel, row, texel);
  add(row, all, row);
}

bool sane(const StoreGeometry& g) {
  const auto within = [](int x, int least, int most) { return x >= least && x <= most; };
  constexpr int kMost = 65536;
  return within(g.image_width, 1, kMost) && within(g.image_height, 1, kMost) && within(g.crop_x, 0, g.image_width) &&
         within(g.crop_y, 0, g.image_height) && within(g.tiles_x, 0, kMost / kTile) &&
         within(g.tiles_y, 0, kMost / kTile) && g.crop_x + g.cropWidth() < g.image_width + kTile &&
         g.crop_y + g.cropHeight() < g.image_height + kTile && within(g.light_count, 1, kMost);
}

}  // namespace

struct ReflectanceStoreWriter::State {
  State(const std::filesystem::path& path, const StoreGeometry& g, bool pack)
      : file(path), geometry(g), compressed(pack) {}
  PartialFile file;
  StoreGeometry geometry;
  bool compressed;
  Header header{};
  std::vector<IndexEntry> index;
  std::mutex mutex;
};

ReflectanceStoreWriter::ReflectanceStoreWriter(const std::filesystem::path& file, const StoreGeometry& geometry,
                                               const Image8& coverage, bool compressed)
    : state_(std::make_unique<State>(file, geometry, compressed)) {
  SRF_CHECK(sane(geometry));
  SRF_CHECK(coverage.width() == geometry.cropWidth() && coverage.height() == geometry.cropHeight());
  State& s = *state_;
  s.index.resize(geometry.tileCount(), IndexEntry{0, 0, Encoding::absent, 0});
  s.file.write(&s.header, sizeof s.header);  // its place; filled in by commit
  Zstd& z = zstd();
  s.header.coverage_offset = s.file.size();
  s.header.coverage_bytes = compress(z, coverage.data().data(), coverage.data().size());
  s.header.coverage_hash = contentHash(z.stored.data(), s.header.coverage_bytes);
  s.file.write(z.stored.data(), s.header.coverage_bytes);
}

ReflectanceStoreWriter::~ReflectanceStoreWriter() = default;

void ReflectanceStoreWriter::writeTile(int tile_x, int tile_y, std::span<const std::uint16_t> block) {
  State& s = *state_;
  const StoreGeometry& g = s.geometry;
  SRF_CHECK(block.size() == g.blockHalves() && tile_x >= 0 && tile_x < g.tiles_x && tile_y >= 0 && tile_y < g.tiles_y);
  const std::size_t tile = static_cast<std::size_t>(tile_y) * g.tiles_x + tile_x;
  const void* data = block.data();
  std::size_t bytes = g.blockBytes();
  Encoding encoding = Encoding::raw;
  if (s.compressed) {
    Zstd& z = zstd();
    z.plain.resize(bytes);
    shuffle(g, block.data(), z.plain.data());
    const std::size_t packed = compress(z, z.plain.data(), bytes);
    if (packed < bytes) {
      data = z.stored.data();
      bytes = packed;
      encoding = Encoding::zstd;
    }
  }
  const std::uint64_t hash = contentHash(data, bytes, tile);
  const std::lock_guard lock(s.mutex);
  SRF_CHECK(s.index[tile].encoding == Encoding::absent);
  s.index[tile] = {s.file.size(), static_cast<std::uint32_t>(bytes), encoding, hash};
  s.file.write(data, bytes);
}

std::uint64_t ReflectanceStoreWriter::commit() {
  State& s = *state_;
  const StoreGeometry& g = s.geometry;
  Header& h = s.header;
  h.index_offset = s.file.size();
  h.index_hash = contentHash(s.index.data(), s.index.size() * sizeof(IndexEntry));
  s.file.write(s.index.data(), s.index.size() * sizeof(IndexEntry));
  std::memcpy(h.magic, kMagic, sizeof kMagic);
  h.version = kVersion;
  h.flags = g.black_background ? kBlackBackground : 0;
  h.image_width = g.image_width, h.image_height = g.image_height;
  h.crop_x = g.crop_x, h.crop_y = g.crop_y, h.tiles_x = g.tiles_x, h.tiles_y = g.tiles_y, h.light_count = g.light_count;
  h.content_hash = contentOf(g, h.coverage_hash, s.index);
  h.header_hash = contentHash(&h, offsetof(Header, header_hash));
  s.file.writeAt(0, &h, sizeof h);
  s.file.commit();
  return h.content_hash;
}

struct ReflectanceStore::State {
  std::filesystem::path file;
  int descriptor = -1;
  std::uint64_t size = 0, content_hash = 0;
  StoreGeometry geometry;
  Image8 coverage;
  std::vector<IndexEntry> index;
  ~State() {
    if (descriptor >= 0) ::close(descriptor);
  }

  Error damaged(const std::string& what) const {
    return badInput(file.string(), what + "; the file is damaged: run `srf acquire` again");
  }
  bool inside(std::uint64_t offset, std::uint64_t bytes) const { return offset <= size && bytes <= size - offset; }
  void read(void* to, std::size_t bytes, std::uint64_t offset) const {
    char* at = static_cast<char*>(to);
    while (bytes > 0) {
      const ssize_t n = ::pread(descriptor, at, bytes, static_cast<off_t>(offset));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) throw badInput(file.string(), std::string("could not be read: ") + std::strerror(errno));
      if (n == 0) throw damaged("ends early");
      at += n;
      bytes -= static_cast<std::size_t>(n);
      offset += static_cast<std::uint64_t>(n);
    }
  }
};

ReflectanceStore::ReflectanceStore(const std::filesystem::path& file) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.file = file;
  s.descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  struct stat info {};
  if (s.descriptor < 0 || ::fstat(s.descriptor, &info) != 0)
    throw badInput(file.string(),
                   std::string("could not be opened: ") + std::strerror(errno) + "; run `srf acquire` again");
  if (!S_ISREG(info.st_mode)) throw badInput(file.string(), "is not a file, expected a view's store");
  s.size = static_cast<std::uint64_t>(info.st_size);

  Header h{};
  if (s.size < sizeof h) throw s.damaged("ends early (" + std::to_string(s.size) + " bytes)");
  s.read(&h, sizeof h, 0);
  if (std::memcmp(h.magic, kMagic, sizeof kMagic) != 0)
    throw badInput(file.string(), "is not a view's store (.blk) of an SRF");
  if (h.version > kVersion)
    throw badInput(file.string(), "has version " + std::to_string(h.version) + ", this program reads up to " +
                                      std::to_string(kVersion) + "; use a newer program or run `srf acquire` again");
  StoreGeometry& g = s.geometry;
  g = {h.image_width, h.image_height, h.crop_x,      h.crop_y,
       h.tiles_x,     h.tiles_y,      h.light_count, (h.flags & kBlackBackground) != 0};
  if (h.header_hash != srf::contentHash(&h, offsetof(Header, header_hash)) || h.version < 1 || !sane(g))
    throw s.damaged("has a header that does not fit its checksum");

  const std::uint64_t index_bytes = sizeof(IndexEntry) * static_cast<std::uint64_t>(g.tileCount());
  if (!s.inside(h.index_offset, index_bytes) || !s.inside(h.coverage_offset, h.coverage_bytes))
    throw s.damaged("ends early (" + std::to_string(s.size) + " bytes)");
  s.index.resize(g.tileCount());
  s.read(s.index.data(), index_bytes, h.index_offset);
  if (h.index_hash != srf::contentHash(s.index.data(), index_bytes))
    throw s.damaged("has an index that does not fit its checksum");
  for (const IndexEntry& e : s.index) {
    const bool whole = e.encoding == Encoding::absent ||
                       (s.inside(e.offset, e.bytes) &&
                        (e.encoding == Encoding::zstd || (e.encoding == Encoding::raw && e.bytes == g.blockBytes())));
    if (!whole) throw s.damaged("has an index entry outside of the file");
  }
  std::vector<std::byte> stored(h.coverage_bytes);
  s.read(stored.data(), stored.size(), h.coverage_offset);
  s.coverage = Image8(g.cropWidth(), g.cropHeight(), 1);
  if (h.coverage_hash != srf::contentHash(stored.data(), stored.size()) ||
      !decompress(zstd(), s.coverage.data().data(), s.coverage.data().size(), stored.data(), stored.size()))
    throw s.damaged("has a coverage that does not fit its checksum");
  s.content_hash = contentOf(g, h.coverage_hash, s.index);
  if (s.content_hash != h.content_hash) throw s.damaged("has a content that does not fit its checksum");
}

ReflectanceStore::~ReflectanceStore() = default;
ReflectanceStore::ReflectanceStore(ReflectanceStore&&) noexcept = default;
ReflectanceStore& ReflectanceStore::operator=(ReflectanceStore&&) noexcept = default;

const StoreGeometry& ReflectanceStore::geometry() const {
  return state_->geometry;
}
const Image8& ReflectanceStore::coverage() const {
  return state_->coverage;
}
std::uint64_t ReflectanceStore::contentHash() const {
  return state_->content_hash;
}
std::uint64_t ReflectanceStore::bytesOnDisk() const {
  return state_->size;
}
const std::filesystem::path& ReflectanceStore::file() const {
  return state_->file;
}

bool ReflectanceStore::hasTile(int tile_x, int tile_y) const {
  const StoreGeometry& g = state_->geometry;
  return tile_x >= 0 && tile_x < g.tiles_x && tile_y >= 0 && tile_y < g.tiles_y &&
         state_->index[static_cast<std::size_t>(tile_y) * g.tiles_x + tile_x].encoding != Encoding::absent;
}

std::size_t ReflectanceStore::readTile(int tile_x, int tile_y, std::span<std::uint16_t> out) const {
  const State& s = *state_;
  const StoreGeometry& g = s.geometry;
  SRF_CHECK(out.size() == g.blockHalves());
  if (!hasTile(tile_x, tile_y)) {
    std::memset(out.data(), 0, g.blockBytes());
    return 0;
  }
  const std::size_t tile = static_cast<std::size_t>(tile_y) * g.tiles_x + tile_x;
  const IndexEntry& e = s.index[tile];
  Zstd& z = zstd();
  std::byte* stored = reinterpret_cast<std::byte*>(out.data());
  if (e.encoding == Encoding::zstd) {
    z.stored.resize(e.bytes);
    stored = z.stored.data();
  }
  s.read(stored, e.bytes, e.offset);
  const std::string place = "has a tile (" + std::to_string(tile_x) + ", " + std::to_string(tile_y) + ") ";
  if (e.hash != srf::contentHash(stored, e.bytes, tile)) throw s.damaged(place + "that does not fit its checksum");
  if (e.encoding == Encoding::zstd) {
    z.plain.resize(g.blockBytes());
    if (!decompress(z, z.plain.data(), g.blockBytes(), stored, e.bytes))
      throw s.damaged(place + "that cannot be unpacked");
    unshuffle(g, z.plain.data(), out.data());
  }
  return e.bytes;
}

}  // namespace srf
