// A field larger than memory (claims 19, 20): a strongly twisted sphere whose views hold ten times the data that the
// program is allowed, rendered in the order of the blocks and hit by hit, with caches from one block on, from the disk
// past the system's cache of files. Beside it the time in which as many bytes come from the disk with nothing else
// done. Then blocks as principal components beside lossless ones, from the disk and in memory, and what larger fields
// would take. Prints Markdown, and draws time against the size of the cache.
#include <fcntl.h>
#include <malloc.h>
#include <pthread.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <thread>

#include "apps/program.h"
#include "base/error.h"
#include "base/memory.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "bench/timing.h"
#include "render/frame_renderer.h"
#include "render/view_kernels.h"
#include "tests/support/formula_field.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

struct Extent {
  int views, lights, size;
};
constexpr int kSubdivision = 6;  // 32768 triangles

// A matt and glossy sphere with bands.
Vec3 clean(const Vec3& p, const Vec3& l, const Vec3& v) {
  const double cosine = dot(p, l);
  if (cosine <= 0) return {};
  const Vec3 half = l + v;
  const double shine = std::max(0.0, dot(p, half) / length(half));
  const double shine8 = square(square(square(shine)));
  const double gloss = 0.3 * square(square(shine8)) * shine8;
  const double band = 0.6 + 0.4 * std::sin(25 * p.z + 3 * p.x);
  return cosine * (Vec3{0.25 * band, 0.2, 0.15 + 0.1 * band} + gloss * Vec3{1, 1, 1});
}

// The same with noise like that of photons, 2 % at white.
Vec3 noisy(const Vec3& p, const Vec3& l, const Vec3& v) {
  Vec3 value = clean(p, l, v);
  if (dot(p, l) <= 0) return {};
  std::uint64_t bits = 0x9e3779b97f4a7c15u;
  for (const double x : {p.x, p.y, l.x, l.z, v.x}) {
    bits ^= static_cast<std::uint64_t>(static_cast<std::int64_t>(x * 1e9));
    bits *= 0xff51afd7ed558ccdu;
    bits ^= bits >> 32;
  }
  for (int c = 0; c < 3; ++c) {
    bits = bits * 6364136223846793005u + 1442695040888963407u;
    const std::uint64_t mixed = bits ^ bits >> 29;
    double sum = -2;  // of four uniform numbers: nearly normal, variance 1/3
    for (int k = 0; k < 4; ++k) sum += static_cast<double>(mixed >> 16 * k & 0xffff) * 0x1p-16;
    value[c] = std::max(0.0, value[c] + 0.02 * std::sqrt((value[c] + 0.016) * 0.318 * 3) * sum);
  }
  return value;
}

// In a process of its own, whose memory does not count for this one.
void makeApart(const fs::path& folder, const std::function<void()>& make) {
  if (fs::exists(folder / "manifest.json")) return;
  const pid_t child = ::fork();
  if (child == 0) {
    int code = 0;
    try {
      make();
    } catch (const std::exception& e) {
      std::fprintf(stderr, "%s\n", e.what());
      code = 1;
    }
    std::_Exit(code);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  if (status != 0) throw Error(ErrorKind::failed, "could not be made", folder.string());
}

void makeField(const fs::path& folder, const Extent& extent, Compression compression,
               const test::ReflectanceFormula& radiance) {
  makeApart(folder, [&] {
    test::FormulaFieldOptions options;
    options.views = extent.views, options.lights = extent.lights, options.size = extent.size;
    options.subdivision = 2;  // the model is made by the parent
    options.levels = true;
    options.coding.compression = compression;
    options.parallel = true;
    makeSphereField(folder, options, radiance);
  });
}

/// Every `step`-th view of a field, its blocks kept in another way.
void makeAgain(const fs::path& folder, const fs::path& from, Compression compression, std::size_t step = 1) {
  makeApart(folder, [&] {
    SrfManifest manifest = readManifest(from);
    std::vector<StoredView> kept;
    for (std::size_t v = 0; v < manifest.views.size(); v += step) kept.push_back(manifest.views[v]);
    manifest.views = kept;
    fs::create_directories(folder / "views");
    parallelFor(kept.size(), 1, [&](std::size_t v, std::size_t) {
      StoredView& view = manifest.views[v];
      view.hash = recodeStore(ReflectanceStore(from / view.file), folder / view.file, {compression});
    });
    writeManifest(folder, manifest);
  });
}

/// Milliseconds in which `bytes` come from the files of the field: 16 requests of 128 KiB at a time, past the cache of
/// files, from places spread over all of them.
double bareDisk(const fs::path& folder, std::uint64_t bytes) {
  constexpr std::size_t kRequest = 128 << 10;
  std::vector<std::pair<int, std::uint64_t>> files;
  std::uint64_t all = 0;
  for (const auto& entry : fs::directory_iterator(folder / "views")) {
    const int file = ::open(entry.path().c_str(), O_RDONLY | O_DIRECT | O_CLOEXEC);
    if (file < 0) throw badInput(entry.path().string(), "cannot be read directly; choose another file system");
    files.emplace_back(file, entry.file_size() / kRequest);
    all += files.back().second;
  }
  const std::uint64_t wanted = std::min(all, bytes / kRequest);
  std::atomic<std::uint64_t> next{0};
  const double taken = bench::milliseconds([&] {
    std::vector<std::jthread> readers;
    for (int i = 0; i < 16; ++i)
      readers.emplace_back([&] {
        ReadBuffer buffer;
        std::byte* to = buffer.reserve(kRequest);
        for (std::uint64_t i = next++; i < wanted; i = next++) {
          std::uint64_t at = i * all / wanted;
          std::size_t file = 0;
          while (at >= files[file].second) at -= files[file++].second;
          if (::pread(files[file].first, to, kRequest, static_cast<off_t>(at * kRequest)) < 0) std::abort();
        }
      });
  });
  for (const auto& [file, blocks] : files) ::close(file);
  return wanted > 0 ? taken * static_cast<double>(bytes) / static_cast<double>(wanted * kRequest) : 0;
}

/// Milliseconds in which all threads decode `count` blocks of the field's finest level, spread over all of it, whose
/// bytes are in memory.
double bareDecode(const fs::path& folder, const SrfManifest& manifest, std::size_t count) {
  std::vector<std::unique_ptr<ReflectanceStore>> stores;
  std::vector<std::pair<const ReflectanceStore*, std::uint32_t>> all;
  for (const StoredView& view : manifest.views) {
    stores.push_back(std::make_unique<ReflectanceStore>(folder / view.file, true));
    for (int tile = 0; tile < stores.back()->geometry().tileCount(); ++tile)
      if (stores.back()->hasTile(static_cast<std::uint32_t>(tile))) all.emplace_back(stores.back().get(), tile);
  }
  constexpr std::size_t kAtOnce = 64;
  ReadBuffer buffers[kAtOnce];
  double taken = 0;
  for (std::size_t first = 0; first < count; first += kAtOnce) {
    const std::size_t now = std::min(kAtOnce, count - first);
    const auto block = [&](std::size_t i) { return all[(first + i) * all.size() / count]; };
    std::span<const std::byte> bytes[kAtOnce];
    for (std::size_t i = 0; i < now; ++i)
      bytes[i] = block(i).first->read(block(i).first->place(block(i).second), buffers[i]);
    taken += bench::milliseconds([&] {
      parallelFor(now, 1, [&](std::size_t begin, std::size_t end) {
        thread_local ReflectanceBlock decoded;
        for (std::size_t i = begin; i < end; ++i) block(i).first->decode(block(i).second, bytes[i], decoded);
      });
    });
  }
  return taken;
}

double pictureDistance(const Frame& a, const Frame& b) {
  double sum = 0, all = 0;
  for (std::size_t i = 0; i < a.rgba.data().size(); ++i) {
    if (i % 4 == 3) continue;
    sum += std::pow(static_cast<double>(a.rgba.data()[i]) - b.rgba.data()[i], 2);
    all += std::pow(static_cast<double>(b.rgba.data()[i]), 2);
  }
  return std::sqrt(sum / std::max(all, 1e-30));
}

struct Timing {
  double milliseconds = 0, execute = 0, reading = 0;
  double read = 0, misses = 0, reread = 0;
  Frame frame;
};

/// Pictures of fields of the same views.
class Bench {
 public:
  Bench(const SrfManifest& manifest, int size, double texels, Reporter& reporter)
      : model_(buildModel(test::unitSphere(kSubdivision), "sphere", 1e-6, manifest, {}, reporter)),
        deformed_(model_),
        reporter_(reporter) {
    settings.accuracy.texels = texels;
    camera_.lens = pinholeFromFov(size, size, 40);
    camera_.pose =
        *lookAt(Point<ObjectSpace>(Vec3{1, -3.2, 0.6}), Point<ObjectSpace>(), Vector<ObjectSpace>(Vec3{0, 0, 1}));
    const JsonNode twist = parseJson(R"([{"type":"twist","axis":[0,0,1],"degrees_per_unit":120}])", "twist");
    deformed_.deform(AnimatedDeformation::parse(twist, ".", reporter).at(0));
    for (int i = 0; i < 128; ++i)
      lights_.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 128)),
                                 (0.5 + 0.5 * test::fibonacci(i, 128).z) * Vec3{0.05, 0.05, 0.06}});
  }
  /// A frame of a renderer that has not read anything, or its second where `warm`.
  Timing frame(const fs::path& folder, const SrfManifest& manifest, bool warm = false) {
    FrameRenderer renderer(folder, manifest, model_, settings, reporter_);
    if (warm) renderer.render(camera_, deformed_, lights_);
    auto before = warm ? reporter_.figures() : std::map<std::string, double>();
    Timing t;
    t.milliseconds = bench::milliseconds([&] { t.frame = renderer.render(camera_, deformed_, lights_); });
    auto after = reporter_.figures();
    const auto figure = [&](const char* name) { return after[name] - before[name]; };
    t.execute = 1e3 * figure("seconds.execute"), t.reading = 1e3 * figure("seconds.reading");
    t.read = figure("cache.bytes_read"), t.misses = figure("cache.misses"), t.reread = figure("cache.reread");
    return t;
  }

  FrameSettings settings;

 private:
  DeformableModel model_;
  DeformedModel deformed_;
  Reporter& reporter_;
  Camera<ObjectSpace> camera_;
  FrameLights lights_;
};

/// Bytes that count for RLIMIT_DATA.
std::size_t dataBytes() {
  std::size_t kilobytes = 0;
  if (FILE* file = std::fopen("/proc/self/status", "r")) {
    char line[256];
    while (std::fgets(line, sizeof line, file))
      if (std::sscanf(line, "VmData: %zu", &kilobytes) == 1) break;
    std::fclose(file);
  }
  return kilobytes << 10;
}

/// The field of the claim: what a frame takes from the disk, in both orders and with caches of several sizes.
struct Streamed {
  std::vector<std::pair<double, double>> sorted, immediate;  ///< blocks in the cache, seconds
  double sorted_at_three = 0, immediate_at_three = 0, disk_at_three = 0;
  bool same = true, once = true;
};
Streamed stream(Bench& one, const fs::path& folder, const SrfManifest& manifest, std::size_t block, int repeats,
                std::span<const std::size_t> sorted_blocks, std::span<const std::size_t> immediate_blocks) {
  std::printf(
      "| order | cache, blocks | s a frame | MB read | blocks read | of these again | the disk alone, s | ratio |\n"
      "|---|---|---|---|---|---|---|---|\n");
  Streamed result;
  std::optional<Frame> reference;
  bench::Series disk_at_three, decoding;
  one.settings.direct_reads = true;
  const auto row = [&](ExecutionOrder order, std::size_t blocks) {
    const bool sorted = order == ExecutionOrder::sorted;
    one.settings.order = order;
    one.settings.cache_bytes = blocks * block;
    bench::Series times, disk;
    Timing t;
    for (int i = 0; i < (sorted ? repeats : 1); ++i) {
      t = one.frame(folder, manifest);
      times.add(t.milliseconds);
      disk.add(bareDisk(folder, static_cast<std::uint64_t>(t.read)));
      if (!sorted || blocks != 3) continue;
      disk_at_three.add(disk.values.back());
      decoding.add(bareDecode(folder, manifest, static_cast<std::size_t>(t.misses)));
    }
    if (!reference) reference = t.frame;
    result.same = result.same && reference->rgba.data() == t.frame.rgba.data();
    if (sorted) result.once = result.once && t.reread == 0;
    std::printf("| %s | %zu | %.2f (%.2f .. %.2f) | %.0f | %.0f | %.0f | %.2f | %s |\n",
                sorted ? "sorted" : "hit by hit", blocks, times.median() / 1e3, times.at(0) / 1e3, times.at(1) / 1e3,
                t.read / 1e6, t.misses, t.reread, disk.median() / 1e3,
                bench::shownRatio(bench::ratios(times, disk)).c_str());
    std::fflush(stdout);
    (sorted ? result.sorted : result.immediate).emplace_back(blocks, times.median() / 1e3);
    if (blocks != 3) return;
    (sorted ? result.sorted_at_three : result.immediate_at_three) = times.median();
    if (sorted) result.disk_at_three = disk.median();
  };
  for (const std::size_t blocks : sorted_blocks) row(ExecutionOrder::sorted, blocks);
  for (const std::size_t blocks : immediate_blocks) row(ExecutionOrder::immediate, blocks);
  std::printf(
      "\nWith a cache of 3 blocks the order of the blocks is %.0f times faster than hit by hit, and takes %.2f times "
      "what the disk needs for the bytes. The pictures are %s; sorted, %s.\n\n",
      result.immediate_at_three / result.sorted_at_three, result.sorted_at_three / result.disk_at_three,
      result.same ? "the same, bit for bit" : "NOT THE SAME",
      result.once ? "every block is read once" : "SOME BLOCKS ARE READ AGAIN");
  std::printf(
      "Decoding as many blocks on %d threads, their bytes in memory and nothing else done, takes %.2f s, %s times what "
      "the disk needs: no order of evaluation is faster than the slower of the two.\n\n",
      threadCount(), decoding.median() / 1e3, bench::shownRatio(bench::ratios(decoding, disk_at_three)).c_str());
  return result;
}

/// What a field's stores hold.
struct Contents {
  explicit Contents(const fs::path& folder) : manifest(readManifest(folder)) {
    WholeTexels whole;
    for (const StoredView& view : manifest.views) {
      const ReflectanceStore store(folder / view.file);
      const StoreGeometry& g = store.geometry();
      for (int y = 0; y < g.cropHeight(); ++y)
        for (int x = 0; x < g.cropWidth(); ++x) texels += store.coverage().at(x, y) > 0;
      tiles += g.allTiles(), index += static_cast<double>(store.bytesInMemory()), block = g.blockBytes();
      bytes += static_cast<double>(store.bytesOnDisk());
      whole.add(store.coverage());
    }
    index += static_cast<double>(whole.bytes());
    halves = 6.0 * static_cast<double>(manifest.lights.size()) * texels;
  }
  SrfManifest manifest;
  double texels = 0, tiles = 0, index = 0, bytes = 0;  ///< texels that are covered
  double halves = 0;                                   ///< bytes of these as half floats
  std::size_t block = 0;                               ///< bytes
};

/// Time against the size of the cache, both axes logarithmic.
void draw(const fs::path& file,
          const std::vector<std::pair<std::string, std::vector<std::pair<double, double>>>>& curves, double limit) {
  double x0 = 1e30, x1 = 0, y0 = limit, y1 = 0;
  for (const auto& [name, points] : curves)
    for (const auto& [x, y] : points)
      x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
  y0 *= 0.7, y1 *= 1.5;
  const auto px = [&](double x) { return 70 + 500 * std::log(x / x0) / std::log(x1 / x0); };
  const auto py = [&](double y) { return 300 - 270 * std::log(y / y0) / std::log(y1 / y0); };
  std::string svg =
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"640\" height=\"360\" font-family=\"sans-serif\" "
      "font-size=\"12\">\n"
      "<rect width=\"640\" height=\"360\" fill=\"white\"/>\n";
  char text[400];
  const auto add = [&](auto... arguments) {
    std::snprintf(text, sizeof text, arguments...);
    svg += text;
  };
  for (double x = 1; x <= x1 * 1.01; x *= 10)
    if (x >= x0)
      add("<path d=\"M%.1f 30V300\" stroke=\"#ddd\"/><text x=\"%.1f\" y=\"316\" text-anchor=\"middle\">%g</text>\n",
          px(x), px(x), x);
  for (double y = 1e-3; y <= y1; y *= 10)
    if (y >= y0)
      add("<path d=\"M70 %.1fH570\" stroke=\"#ddd\"/><text x=\"64\" y=\"%.1f\" text-anchor=\"end\">%g s</text>\n",
          py(y), py(y) + 4, y);
  add("<text x=\"320\" y=\"340\" text-anchor=\"middle\">blocks in the cache</text>\n");
  add("<path d=\"M70 %.1fH570\" stroke=\"#888\" stroke-dasharray=\"6 4\"/>"
      "<text x=\"566\" y=\"%.1f\" text-anchor=\"end\" fill=\"#666\">the disk alone</text>\n",
      py(limit), py(limit) + 14);
  static constexpr const char* kColours[] = {"#c23", "#26b", "#2a2", "#b6b"};
  for (std::size_t i = 0; i < curves.size(); ++i) {
    const auto& [name, points] = curves[i];
    std::string path;
    for (const auto& [x, y] : points) {
      std::snprintf(text, sizeof text, "%s%.1f %.1f", path.empty() ? "M" : "L", px(x), py(y));
      path += text;
    }
    svg += "<path d=\"" + path + "\" fill=\"none\" stroke-width=\"2\" stroke=\"" + kColours[i % 4] + "\"/>\n";
    add("<text x=\"%.1f\" y=\"%.1f\" fill=\"%s\">%s</text>\n", px(points.front().first) + 6,
        py(points.front().second) - 6, kColours[i % 4], name.c_str());
  }
  writeTextFile(file, svg + "</svg>\n");
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("out-of-core-benchmark", "renders a field larger than memory, sorted and hit by hit");
  std::string work, plot;
  int views = 42, size = 256, repeats = 3, pca_repeats = 11;
  double share = 10;
  program.app().add_option("FOLDER", work, "where the fields are kept; on the disk that is measured")->required();
  program.app().add_option("--plot", plot, "curve of time against cache size (.svg)");
  program.app().add_option("--views", views, "of the field that is larger than memory");
  program.app().add_option("--size", size, "pixels across the picture");
  program.app().add_option("--repeats", repeats, "timed frames from the disk");
  program.app().add_option("--pca-repeats", pca_repeats, "timed frames of each kind of block");
  program.app().add_option("--share", share, "bytes of the field for each byte of memory allowed");
  return program.run(argc, argv, [&](Reporter& reporter) {
    const auto in = [&](const char* name) { return fs::path(work) / name; };
    const Extent large{views, 100, 512}, small{12, 100, 256};
    makeField(in("lossless.srf"), large, Compression::lossless, noisy);
    makeAgain(in("halves.srf"), in("lossless.srf"), Compression::none, 3);
    makeField(in("clean.srf"), small, Compression::lossless, clean);
    makeField(in("noisy.srf"), small, Compression::lossless, noisy);
    makeAgain(in("pca.srf"), in("noisy.srf"), Compression::pca);

    const Contents lossless(in("lossless.srf")), halves(in("halves.srf"));
    // What the program may allocate from now on, all in all; what is larger fails. Files mapped read-only do not count.
    const auto limit = static_cast<rlim_t>(std::min(lossless.bytes, halves.bytes) / share);
    // Small stacks: those of sixteen readers, 8 MiB each by default, would be most of it.
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, std::size_t{256} << 10);
    pthread_setattr_default_np(&attributes);
    pthread_attr_destroy(&attributes);
    // What one thread has freed serves the others too, instead of lying in an arena of its own.
    ::mallopt(M_ARENA_MAX, 1);
    const rlimit allowed{limit, RLIM_INFINITY};
    if (::setrlimit(RLIMIT_DATA, &allowed) != 0) throw Error(ErrorKind::failed, "setrlimit(RLIMIT_DATA) failed", "");
    std::printf(
        "%s, %d threads. Allowed: %.0f MB of data (RLIMIT_DATA), of which the program's libraries take %.0f before it "
        "does anything. Reads go past the system's cache of files (O_DIRECT); the disk alone: as many bytes in 16 "
        "requests of 128 KiB at a time. Picture: %d x %d, the finest level of the photographs, a sphere twisted by 120 "
        "degrees a radius, 128 lights.\n\n",
        bench::processorName().c_str(), threadCount(), limit / 1e6, dataBytes() / 1e6, size, size);
    const auto describe = [&](const char* how, const Contents& field) {
      std::printf(
          "%s: %zu views x %zu lights x 512 x 512 pixels, %.2f GB, %.1f times what is allowed; a block is %zu KiB"
          " of half floats.\n\n",
          how, field.manifest.views.size(), field.manifest.lights.size(), field.bytes / 1e9,
          field.bytes / static_cast<double>(limit), field.block >> 10);
    };
    Streamed streamed;
    // For blocks, operations and what else becomes resident before the first frame; the renderer keeps a quarter back.
    constexpr std::size_t kWorking = std::size_t{110} << 20;
    {
      Bench one(lossless.manifest, size, 0, reporter);
      one.settings.memory_bytes = (residentBytes() + kWorking) * 4 / 3;
      describe("Lossless blocks", lossless);
      static constexpr std::size_t kSorted[] = {1, 3, 10, 30, 100}, kImmediate[] = {3, 10, 30, 100};
      streamed = stream(one, in("lossless.srf"), lossless.manifest, lossless.block, repeats, kSorted, kImmediate);
    }
    {
      Bench one(halves.manifest, size, 0, reporter);
      one.settings.memory_bytes = (residentBytes() + kWorking) * 4 / 3;
      describe("Blocks as they are", halves);
      static constexpr std::size_t kThree[] = {3};
      stream(one, in("halves.srf"), halves.manifest, halves.block, repeats, kThree, kThree);
    }
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    std::printf("Most memory resident so far, libraries and all: %.0f MB.\n\n", usage.ru_maxrss * 1024 / 1e6);
    const rlimit lifted{RLIM_INFINITY, RLIM_INFINITY};
    ::setrlimit(RLIMIT_DATA, &lifted);
    if (!plot.empty())
      draw(plot, {{"hit by hit", streamed.immediate}, {"sorted", streamed.sorted}}, streamed.disk_at_three / 1e3);

    const Contents truth(in("clean.srf")), noise(in("noisy.srf")), pca(in("pca.srf"));
    Bench one(truth.manifest, size, FrameSettings().accuracy.texels, reporter);
    one.settings.memory_bytes = std::size_t{4} << 30;
    std::printf(
        "### Principal components\n\n%zu views x %zu lights x 256 x 256 pixels with noise of 2 %% at white. Frames in "
        "turn, %d of each kind.\n\n| | lossless | principal components | ratio |\n|---|---|---|---|\n",
        noise.manifest.views.size(), noise.manifest.lights.size(), pca_repeats);
    std::printf("| MB on disk with all levels | %.1f | %.1f | %.1f |\n", noise.bytes / 1e6, pca.bytes / 1e6,
                noise.bytes / pca.bytes);
    std::printf("| covered texels as half floats over that | %.1f | %.1f | |\n", noise.halves / noise.bytes,
                noise.halves / pca.bytes);
    const fs::path folders[] = {in("noisy.srf"), in("pca.srf")};
    const SrfManifest* manifests[] = {&noise.manifest, &pca.manifest};
    for (const bool warm : {false, true}) {
      one.settings.direct_reads = !warm;
      one.settings.cache_bytes.reset();
      if (!warm) one.settings.cache_bytes = 3 * noise.block;
      bench::Series frames[2], executions[2];
      Timing last[2];
      for (int i = 0; i < pca_repeats; ++i)
        for (int k = 0; k < 2; ++k) {
          last[k] = one.frame(folders[k], *manifests[k], warm);
          frames[k].add(last[k].milliseconds), executions[k].add(last[k].execute);
        }
      const auto compare = [&](const std::string& name, const bench::Series* of) {
        std::printf("| %s | %s | %s | %s |\n", name.c_str(), bench::shown(of[0]).c_str(), bench::shown(of[1]).c_str(),
                    bench::shownRatio(bench::ratios(of[0], of[1])).c_str());
      };
      const std::string where = warm ? ", in memory" : ", from the disk through 3 blocks";
      compare("ms a frame" + where, frames);
      compare("of it products with the blocks" + where, executions);
      bench::Series others;  // what the rest of a lossless frame takes
      for (std::size_t i = 0; i < frames[0].values.size(); ++i)
        others.add(frames[0].values[i] - executions[0].values[i]);
      std::printf("| the same frame if products and reading cost nothing%s | | %s | %s |\n", where.c_str(),
                  bench::shown(others).c_str(), bench::shownRatio(bench::ratios(frames[0], others)).c_str());
      if (warm) {
        const Frame exact = one.frame(in("clean.srf"), truth.manifest).frame;
        const double errors[] = {pictureDistance(last[0].frame, exact), pictureDistance(last[1].frame, exact)};
        std::printf("| the frame's error against that of a field without noise, %% | %.3f | %.3f | %+.2f dB |\n",
                    100 * errors[0], 100 * errors[1], 20 * std::log10(errors[1] / errors[0]));
      }
    }

    std::printf(
        "\n### 300 views x 100 lights x 1 megapixel, extrapolated\n\n"
        "| | measured here | for each | there (40 %% of the pixels are the object's) |\n|---|---|---|---|\n");
    const double there = 300 * 0.4e6;
    for (const bool as_pca : {false, true}) {
      const char* name = as_pca ? "principal components" : "lossless";
      const Contents& field = as_pca ? pca : lossless;
      std::printf("| %s | %.0f MB | %.0f bytes a covered texel | %.0f GB |\n", name, field.bytes / 1e6,
                  field.bytes / field.texels, field.bytes / field.texels * there / 1e9);
      const fs::path again = in("again.blk");
      const double taken = bench::milliseconds([&] {
        recodeStore(ReflectanceStore(in("halves.srf") / halves.manifest.views[0].file), again,
                    {as_pca ? Compression::pca : Compression::lossless});
      });
      fs::remove(again);
      const double texels = halves.texels / static_cast<double>(halves.manifest.views.size());
      std::printf("| a view's blocks written, %s | %.2f s | %.2f us a covered texel, one thread | %.0f s |\n", name,
                  taken / 1e3, 1e3 * taken / texels, taken / texels * there / 1e3);
    }
    std::printf("| indices and coverage in memory | %.2f MB | %.1f bytes a tile | %.0f MB |\n", lossless.index / 1e6,
                lossless.index / lossless.tiles, lossless.index / lossless.tiles * (300.0 * 64 * 64 * 4 / 3) / 1e6);
    std::printf(
        "| visibility | | one bit a point and view, and with a fit one a point and light | %.0f MB for a million "
        "points |\n",
        1e6 * (300 + 100) / 8 / 1e6);
  });
}
