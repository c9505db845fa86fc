#include "model/fit_samples.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <limits>

#include "base/error.h"
#include "base/half.h"
#include "base/memory.h"
#include "base/parallel.h"
#include "field/bilinear_fetch.h"

namespace srf {
namespace {

constexpr double kLeastCosine = 0.1;    // n.v of a sample
constexpr double kLeastCovered = 0.98;  // of a sample's texels
constexpr std::size_t kChunk = 256;     // points
constexpr std::uint32_t kNone = 0xffffffffu;
// A value that this many texels hold exactly, none higher, is where the camera stopped counting.
constexpr std::uint64_t kPlateau = 64;
constexpr double kNearSaturation = 0.97;  // a blend of texels that comes this near holds saturated ones

// As many of the directions as wanted, each the farthest from those before it: the first is the most frontal one, and
// oblique ones follow at once.
void spread(std::vector<std::pair<std::uint32_t, Vec3>>& views, const Vec3& normal, std::size_t wanted,
            std::vector<double>& nearest) {
  if (views.size() <= wanted) return;
  nearest.assign(views.size(), std::numeric_limits<double>::infinity());
  std::size_t best = 0;
  for (std::size_t i = 1; i < views.size(); ++i)
    if (dot(views[i].second, normal) > dot(views[best].second, normal)) best = i;
  for (std::size_t taken = 0; taken < wanted; ++taken) {
    std::swap(views[taken], views[best]);
    std::swap(nearest[taken], nearest[best]);
    best = taken + 1;
    for (std::size_t i = taken + 1; i < views.size(); ++i) {
      const Vec3 chord = views[i].second - views[taken].second;
      nearest[i] = std::min(nearest[i], dot(chord, chord));
      if (nearest[i] > nearest[best]) best = i;
    }
  }
  views.resize(wanted);
  std::sort(views.begin(), views.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
}

SourceView source(const StoredView& view, const ReflectanceStore& store) {
  return {view.camera, store.geometry(), store.coverages(), view.black_background};
}

void addScaled(const std::uint16_t* halves, float weight, float* sum, int count) {
  float row[16];
  for (int i = 0; i < count; i += 8) {
    floatsFromHalves(halves + i, row, 8);
    for (int k = 0; k < 8; ++k) sum[i + k] += weight * row[k];
  }
}

}  // namespace

// Memory of the process, or of a file that has no name any more and goes when the program ends, however it ends.
class FitSamples::Buffer {
 public:
  Buffer(std::size_t bytes, std::size_t memory_bytes, const std::filesystem::path& folder) : bytes_(bytes) {
    if (bytes_ == 0) return;
    int descriptor = -1;
    if (bytes_ > memory_bytes) {
      std::string name = (folder / ".samples-XXXXXX").string();
      descriptor = ::mkstemp(name.data());
      if (descriptor < 0)
        throw Error(ErrorKind::failed, std::string("cannot be written to: ") + std::strerror(errno), folder.string());
      ::unlink(name.c_str());
      if (const int code = ::posix_fallocate(descriptor, 0, static_cast<off_t>(bytes_)); code != 0) {
        ::close(descriptor);
        throw Error(ErrorKind::out_of_budget,
                    "cannot hold " + std::to_string(bytes_ >> 20) + " MiB of samples: " + std::strerror(code) +
                        "; give more --memory or use --fit off",
                    folder.string());
      }
    }
    data_ = ::mmap(nullptr, bytes_, PROT_READ | PROT_WRITE,
                   descriptor < 0 ? MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE : MAP_SHARED, descriptor, 0);
    const int code = errno;
    is_file_ = descriptor >= 0;
    if (descriptor >= 0) ::close(descriptor);
    if (data_ == MAP_FAILED)
      throw Error(ErrorKind::out_of_budget,
                  "no memory for " + std::to_string(bytes_ >> 20) + " MiB of samples: " + std::strerror(code),
                  "--memory");
  }
  ~Buffer() {
    if (bytes_ > 0) ::munmap(data_, bytes_);
  }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  std::uint16_t* data() const { return static_cast<std::uint16_t*>(data_); }
  bool isFile() const { return is_file_; }
  /// The file's pages leave this process; they come back, with what was written to them, where they are asked for.
  void letGo() const { ::madvise(data_, bytes_, MADV_DONTNEED); }

 private:
  void* data_ = nullptr;
  std::size_t bytes_;
  bool is_file_ = false;
};

void FitSamples::keepMemory() const {
  constexpr std::uint32_t kEvery = 64;
  if (most_resident_ == 0 || asked_.fetch_add(1, std::memory_order_relaxed) % kEvery != 0) return;
  if (residentBytes() > most_resident_) buffer_->letGo();
}

FitSamples::FitSamples(const std::filesystem::path& srf_folder, const SrfManifest& field, const DeformableModel& model,
                       std::span<const Direction<AcquisitionSpace>> normals, const SampleOptions& options,
                       Reporter& reporter) {
  store_of_view_.assign(field.views.size(), kNone);
  for (std::size_t v = 0; v < field.views.size(); ++v) {
    pad_.push_back((static_cast<int>(field.views[v].lights.size()) + 7) / 8 * 8);
    if (field.views[v].file.empty()) continue;
    store_of_view_[v] = static_cast<std::uint32_t>(stores_.size());
    stores_.emplace_back(srf_folder / field.views[v].file);
    if (stores_.back().geometry().light_count != static_cast<int>(field.views[v].lights.size()))
      throw badInput(stores_.back().file().string(),
                     "holds " + std::to_string(stores_.back().geometry().light_count) + " lights, the manifest names " +
                         std::to_string(field.views[v].lights.size()) + "; run `srf acquire` again");
  }
  choose(field, model, normals, options.most_views, reporter);
  std::size_t halves = 0;
  for (std::size_t v = 0; v < field.views.size(); ++v) {
    base_.push_back(halves);
    halves += static_cast<std::size_t>(count_[v]) * 3 * pad_[v];
  }
  buffer_ = std::make_unique<Buffer>(2 * halves, memoryLeft(options.memory_bytes) / 2, srf_folder);
  values_ = buffer_->data();
  // An eighth is for what comes besides. With a budget that is spent already some samples must be there all the same.
  constexpr std::size_t kLeast = std::size_t{16} << 20;
  if (buffer_->isFile())
    most_resident_ = std::max(options.memory_bytes - options.memory_bytes / 8, residentBytes() + kLeast);
  gather(field, model, reporter);
  stores_.clear();
}

FitSamples::~FitSamples() = default;

void FitSamples::choose(const SrfManifest& field, const DeformableModel& model,
                        std::span<const Direction<AcquisitionSpace>> normals, int most_views, Reporter& reporter) {
  const std::size_t points = model.size(), most = static_cast<std::size_t>(most_views);
  std::vector<std::uint32_t> chosen(points * most, kNone);
  Reporter::Stage stage(reporter, "fit: choosing views", points);
  parallelFor(points, kChunk, [&](std::size_t begin, std::size_t end) {
    std::vector<std::pair<std::uint32_t, Vec3>> found;
    std::vector<double> nearest;
    for (std::size_t i = begin; i < end; ++i) {
      found.clear();
      for (std::uint32_t v = 0; v < field.views.size(); ++v) {
        if (store_of_view_[v] == kNone || !model.visible.get(i, v)) continue;
        const Camera<AcquisitionSpace>& camera = field.views[v].camera;
        const auto direction = camera.viewDirection(model.p0[i]);
        if (!(dot(normals[i], direction) > kLeastCosine)) continue;
        const auto at = camera.project(model.p0[i]);
        if (!at || !camera.lens.inside(at->pixel)) continue;
        if (bilinearFetch(source(field.views[v], stores_[store_of_view_[v]]), at->pixel).covered > kLeastCovered)
          found.emplace_back(v, direction.raw());
      }
      spread(found, normals[i].raw(), most, nearest);
      for (std::size_t k = 0; k < found.size(); ++k) chosen[i * most + k] = found[k].first;
    }
    stage.advance(end - begin);
  });
  count_.assign(field.views.size(), 0);
  first_.push_back(0);
  for (std::size_t i = 0; i < points; ++i) {
    for (std::size_t k = i * most; k < (i + 1) * most && chosen[k] != kNone; ++k)
      views_.push_back({chosen[k], count_[chosen[k]]++});
    first_.push_back(views_.size());
  }
}

void FitSamples::gather(const SrfManifest& field, const DeformableModel& model, Reporter& reporter) {
  // A view's samples lie together in the order of the points, so that a pass over the points reads each view's part
  // from front to back.
  std::vector<std::vector<std::uint32_t>> points(field.views.size());
  for (std::size_t v = 0; v < field.views.size(); ++v) points[v].reserve(count_[v]);
  for (std::size_t i = 0; i < model.size(); ++i)
    for (const PointView& at : views(i)) points[at.view].push_back(static_cast<std::uint32_t>(i));

  struct Seen {
    std::uint16_t highest = 0;  // half; none is negative, so they sort as integers
    std::uint64_t times = 0;
    std::uint64_t blocks = 0;
  };
  std::vector<Seen> seen(field.views.size());
  Reporter::Stage stage(reporter, "fit: gathering samples", views_.size());
  parallelFor(field.views.size(), 1, [&](std::size_t v, std::size_t) {
    if (points[v].empty()) return;
    const ReflectanceStore& store = stores_[store_of_view_[v]];
    const StoreGeometry& g = store.geometry();
    struct Fetched {
      Fetch fetch;
      std::uint32_t rank;
    };
    std::vector<std::vector<Fetched>> rows(g.tiles_y);  // by the tile row of the first texel
    std::vector<std::uint8_t> needed(g.tileCount(), 0);
    const SourceView view = source(field.views[v], store);
    for (std::uint32_t rank = 0; rank < points[v].size(); ++rank) {
      const Fetch fetch = bilinearFetch(view, field.views[v].camera.project(model.p0[points[v][rank]])->pixel);
      for (int t = 0; t < 4; ++t)
        if (fetch.tap[t] > 0) needed[(fetch.y + t / 2) / kTile * g.tiles_x + (fetch.x + t % 2) / kTile] = 1;
      rows[std::max(fetch.y, 0) / kTile].push_back({fetch, rank});
    }
    // A plateau is one of equal values; a basis does not keep them, so such a store remembers it.
    const bool keeps_values = store.fidelity().compression != Compression::pca;
    // Two rows of tiles at a time: a fetch reaches at most one texel down.
    std::array<std::vector<std::uint16_t>, 2> window;
    for (auto& row : window) row.resize(g.blockHalves() * g.tiles_x);
    const auto decode = [&](int row) {
      if (row >= g.tiles_y) return;
      for (int x = 0; x < g.tiles_x; ++x) {
        if (!needed[row * g.tiles_x + x] || !store.hasTile(x, row)) continue;
        const auto block = std::span(window[row % 2]).subspan(g.blockHalves() * x, g.blockHalves());
        store.readTile(x, row, block);
        ++seen[v].blocks;
        if (!keeps_values) continue;
        std::uint16_t highest = 0;
        for (const std::uint16_t value : block) highest = std::max(highest, value);
        if (highest < seen[v].highest) continue;
        if (highest > seen[v].highest) seen[v] = {highest, 0, seen[v].blocks};
        seen[v].times += std::count(block.begin(), block.end(), highest);
      }
    };
    if (!keeps_values) {
      seen[v].highest = store.fidelity().highest;
      seen[v].times = store.fidelity().highest_count;
    }
    std::vector<float> sum(3 * static_cast<std::size_t>(g.lightPad()));
    const int pad = pad_[v];
    decode(0);
    for (int row = 0; row < g.tiles_y; ++row) {
      decode(row + 1);
      for (const auto& [fetch, rank] : rows[row]) {
        std::fill(sum.begin(), sum.end(), 0.f);
        for (int t = 0; t < 4; ++t) {
          if (!(fetch.tap[t] > 0)) continue;
          const int x = fetch.x + t % 2, y = fetch.y + t / 2;
          const std::size_t texel = static_cast<std::size_t>(y % kTile) * kTile + x % kTile;
          const std::uint16_t* from =
              window[y / kTile % 2].data() + g.blockHalves() * (x / kTile) + texel * g.texelHalves();
          addScaled(from, fetch.tap[t], sum.data(), static_cast<int>(sum.size()));
        }
        // Un-premultiplying may lift a value over the range of halves.
        for (float& value : sum) value = std::min(value, 65504.f);
        keepMemory();
        std::uint16_t* to = values_ + base_[v] + static_cast<std::size_t>(rank) * 3 * pad;
        for (int c = 0; c < 3; ++c)
          halvesFromFloats(&sum[static_cast<std::size_t>(c) * g.lightPad()], to + c * pad, pad);
      }
      stage.advance(rows[row].size());
    }
  });
  Seen all;
  for (const Seen& s : seen) {
    blocks_decoded_ += s.blocks;
    if (s.highest > all.highest) all = {s.highest, 0, 0};
    if (s.highest == all.highest) all.times += s.times;
  }
  saturation_ =
      all.times >= kPlateau ? kNearSaturation * floatFromHalf(all.highest) : std::numeric_limits<double>::infinity();
}

}  // namespace srf
