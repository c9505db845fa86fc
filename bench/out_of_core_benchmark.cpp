// A field larger than memory (claims 19, 20): a strongly twisted sphere whose views hold ten times the data that the
// program is allowed, rendered in the order of the blocks and hit by hit, with caches from one block on, from the disk
// past the system's cache of files. Beside it the time in which as many bytes come from the disk with nothing else
// done. Prints Markdown, and draws time against the size of the cache.
#include <fcntl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>

#include "apps/program.h"
#include "base/error.h"
#include "base/parallel.h"
#include "bench/timing.h"
#include "render/frame_renderer.h"
#include "tests/support/formula_field.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

struct Extent {
  int views = 30, lights = 100, size = 512;
};
constexpr int kSubdivision = 6;  // 32768 triangles

// A matt and glossy sphere with bands, and noise like that of photons, 2 % at white.
Vec3 radiance(const Vec3& p, const Vec3& l, const Vec3& v) {
  const double cosine = dot(p, l);
  if (cosine <= 0) return {};
  const Vec3 half = l + v;
  const double gloss = 0.3 * std::pow(std::max(0.0, dot(p, half) / length(half)), 40);
  const double band = 0.6 + 0.4 * std::sin(25 * p.z + 3 * p.x);
  Vec3 value = cosine * (Vec3{0.25 * band, 0.2, 0.15 + 0.1 * band} + gloss * Vec3{1, 1, 1});
  std::uint64_t bits = 0x9e3779b97f4a7c15u;
  for (const double x : {p.x, p.y, l.x, l.z, v.x}) {
    bits ^= static_cast<std::uint64_t>(static_cast<std::int64_t>(x * 1e9));
    bits *= 0xff51afd7ed558ccdu;
    bits ^= bits >> 32;
  }
  for (int c = 0; c < 3; ++c) {
    double sum = -3;  // of six uniform numbers: nearly normal, variance 1/2
    for (int k = 0; k < 6; ++k) {
      bits = bits * 6364136223846793005u + 1442695040888963407u;
      sum += static_cast<double>(bits >> 11) * 0x1p-53;
    }
    value[c] = std::max(0.0, value[c] + 0.02 * std::sqrt((value[c] + 0.016) * 0.318) * 1.414 * sum);
  }
  return value;
}

// In a process of its own, whose memory does not count for this one.
void makeField(const fs::path& folder, const Extent& extent, Compression compression) {
  if (fs::exists(folder / "manifest.json")) return;
  const pid_t child = ::fork();
  if (child == 0) {
    test::FormulaFieldOptions options;
    options.views = extent.views, options.lights = extent.lights, options.size = extent.size;
    options.subdivision = 2;  // the model is made by the parent
    options.levels = true;
    options.coding.compression = compression;
    int code = 0;
    try {
      makeSphereField(folder, options, radiance);
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

std::uint64_t bytesOf(const fs::path& folder) {
  std::uint64_t bytes = 0;
  for (const auto& entry : fs::directory_iterator(folder / "views")) bytes += entry.file_size();
  return bytes;
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
  double milliseconds = 0, execute = 0, waiting = 0;
  double read = 0, misses = 0, reread = 0, requests = 0;
  Frame frame;
};

class Bench {
 public:
  Bench(const fs::path& folder, const SrfManifest& manifest, int size, Reporter& reporter)
      : manifest_(manifest),
        model_(buildModel(test::unitSphere(kSubdivision), "sphere", 1e-6, manifest, {}, reporter)),
        deformed_(model_),
        folder_(folder),
        reporter_(reporter) {
    camera_.lens = pinholeFromFov(size, size, 40);
    camera_.pose =
        *lookAt(Point<ObjectSpace>(Vec3{1, -3.2, 0.6}), Point<ObjectSpace>(), Vector<ObjectSpace>(Vec3{0, 0, 1}));
    const JsonNode twist = parseJson(R"([{"type":"twist","axis":[0,0,1],"degrees_per_unit":120}])", "twist");
    deformed_.deform(AnimatedDeformation::parse(twist, folder, reporter).at(0));
    for (int i = 0; i < 128; ++i)
      lights_.distant.push_back({Direction<ObjectSpace>::fromUnit(test::fibonacci(i, 128)),
                                 (0.5 + 0.5 * test::fibonacci(i, 128).z) * Vec3{0.05, 0.05, 0.06}});
  }
  /// One frame of a renderer that has not read anything, or its second where `warm`.
  Timing frame(const fs::path& folder, const SrfManifest& manifest, std::optional<std::size_t> cache_bytes,
               ExecutionOrder order, bool direct, std::size_t memory_bytes, bool warm = false) {
    FrameSettings settings;
    settings.memory_bytes = memory_bytes;
    settings.cache_bytes = cache_bytes;
    settings.order = order;
    settings.direct_reads = direct;
    FrameRenderer renderer(folder, manifest, model_, settings, reporter_);
    Timing t;
    const auto before = [&](const char* name) {
      const auto figures = reporter_.figures();
      const auto at = figures.find(name);
      return at == figures.end() ? 0.0 : at->second;
    };
    double execute = 0;
    if (warm) {
      renderer.render(camera_, deformed_, lights_);
      execute = before("seconds.execute");
    }
    t.milliseconds = bench::milliseconds([&] { t.frame = renderer.render(camera_, deformed_, lights_); });
    t.execute = 1e3 * (before("seconds.execute") - execute);
    t.waiting = 1e3 * before("seconds.waiting");
    t.read = before("cache.bytes_read"), t.misses = before("cache.misses");
    t.reread = before("cache.reread"), t.requests = before("cache.requests");
    return t;
  }
  const fs::path& folder() const { return folder_; }
  const SrfManifest& manifest() const { return manifest_; }

 private:
  SrfManifest manifest_;
  DeformableModel model_;
  DeformedModel deformed_;
  fs::path folder_;
  Reporter& reporter_;
  Camera<ObjectSpace> camera_;
  FrameLights lights_;
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
  Extent extent;
  int size = 256, repeats = 3;
  double share = 10;
  program.app().add_option("FOLDER", work, "where the fields are kept; on the disk that is measured")->required();
  program.app().add_option("--plot", plot, "curve of time against cache size (.svg)");
  program.app().add_option("--views", extent.views, "of the field");
  program.app().add_option("--lights", extent.lights, "of the field");
  program.app().add_option("--field-size", extent.size, "pixels across a photograph");
  program.app().add_option("--size", size, "pixels across the picture");
  program.app().add_option("--repeats", repeats, "timed frames of what is short");
  program.app().add_option("--share", share, "bytes of the field for each byte of memory allowed");
  return program.run(argc, argv, [&](Reporter& reporter) {
    const fs::path lossless = fs::path(work) / "lossless.srf", pca = fs::path(work) / "pca.srf";
    const auto seconds = [](double ms) { return ms / 1e3; };
    const double make_lossless = bench::milliseconds([&] { makeField(lossless, extent, Compression::lossless); });
    const double make_pca = bench::milliseconds([&] { makeField(pca, extent, Compression::pca); });
    const std::uint64_t bytes = bytesOf(lossless), pca_bytes = bytesOf(pca);

    // What the program may allocate from now on, all in all; what is larger fails. Files mapped read-only do not count.
    const auto limit = static_cast<rlim_t>(static_cast<double>(bytes) / share);
    const rlimit data{limit, limit};
    if (::setrlimit(RLIMIT_DATA, &data) != 0) throw Error(ErrorKind::failed, "setrlimit(RLIMIT_DATA) failed", "");

    const SrfManifest manifest = readManifest(lossless), pca_manifest = readManifest(pca);
    std::size_t covered = 0, tiles = 0, index = 0, block = 0;
    for (const StoredView& view : manifest.views) {
      const ReflectanceStore store(lossless / view.file);
      const StoreGeometry& g = store.geometry();
      for (int y = 0; y < g.cropHeight(); ++y)
        for (int x = 0; x < g.cropWidth(); ++x) covered += store.coverage().at(x, y) > 0;
      tiles += g.allTiles(), index += store.bytesInMemory(), block = g.blockBytes();
    }
    Bench one(lossless, manifest, size, reporter);
    const std::size_t memory = limit / 2;  // the rest: threads' stacks, the model, Embree's tree

    std::printf(
        "%s, %d threads; %d views x %d lights x %d x %d pixels: %.2f GB lossless, %.2f GB of covered texels as half "
        "floats; a block is %zu KiB. Allowed: %.0f MB of data (RLIMIT_DATA), %.1f times less than the field. Reads go "
        "past the system's cache of files (O_DIRECT). Picture: %d x %d, a sphere twisted by 120 degrees a radius, "
        "128 lights.\n\n",
        bench::processorName().c_str(), threadCount(), extent.views, extent.lights, extent.size, extent.size,
        bytes / 1e9, 6e-9 * extent.lights * static_cast<double>(covered), block >> 10, limit / 1e6,
        static_cast<double>(bytes) / static_cast<double>(limit), size, size);
    std::printf(
        "| order | cache, blocks | s a frame | MB read | blocks read | of these again | requests | the disk alone, s | "
        "ratio |\n"
        "|---|---|---|---|---|---|---|---|---|\n");
    std::vector<std::pair<double, double>> sorted_curve, immediate_curve;
    std::optional<Frame> reference;
    bool same = true;
    double at_three[2] = {0, 0}, disk_at_three = 0;
    const auto row = [&](const char* name, std::size_t blocks, const Timing& t, const bench::Series& s, double disk) {
      if (!reference) reference = t.frame;
      same = same && reference->rgba.data() == t.frame.rgba.data();
      std::printf("| %s | %zu | %.2f (%.2f .. %.2f) | %.0f | %.0f | %.0f | %.0f | %.2f | %.2f |\n", name, blocks,
                  seconds(s.median()), seconds(s.at(0)), seconds(s.at(1)), t.read / 1e6, t.misses, t.reread, t.requests,
                  seconds(disk), s.median() / disk);
      std::fflush(stdout);
    };
    for (const std::size_t blocks : {1, 3, 10, 30, 100, 200}) {
      bench::Series s, disk;
      Timing t;
      for (int i = 0; i < repeats; ++i) {
        t = one.frame(lossless, manifest, blocks * block, ExecutionOrder::sorted, true, memory);
        s.add(t.milliseconds);
        disk.add(bareDisk(lossless, static_cast<std::uint64_t>(t.read)));
      }
      row("sorted", blocks, t, s, disk.median());
      sorted_curve.emplace_back(blocks, seconds(s.median()));
      if (blocks == 3) at_three[0] = s.median(), disk_at_three = disk.median();
    }
    for (const std::size_t blocks : {3, 30, 200}) {
      const Timing t = one.frame(lossless, manifest, blocks * block, ExecutionOrder::immediate, true, memory);
      bench::Series s;
      s.add(t.milliseconds);
      row("hit by hit", blocks, t, s, bareDisk(lossless, static_cast<std::uint64_t>(t.read)));
      immediate_curve.emplace_back(blocks, seconds(t.milliseconds));
      if (blocks == 3) at_three[1] = t.milliseconds;
    }
    std::printf(
        "\nWith a cache of 3 blocks the order of the blocks is %.0f times faster than hit by hit, and takes %.2f times "
        "what the disk needs for the bytes. The pictures are %s. Most memory resident: %.0f MB.\n\n",
        at_three[1] / at_three[0], at_three[0] / disk_at_three, same ? "the same, bit for bit" : "NOT THE SAME", [] {
          rusage usage{};
          getrusage(RUSAGE_SELF, &usage);
          return usage.ru_maxrss * 1024 / 1e6;
        }());

    std::printf("## Principal components\n\n| | lossless | principal components | ratio |\n|---|---|---|---|\n");
    const auto compare = [&](const char* name, double a, double b) {
      std::printf("| %s | %.2f | %.2f | %.1f |\n", name, a, b, a / b);
    };
    compare("GB on disk", bytes / 1e9, pca_bytes / 1e9);
    bench::Series times[2], executions[2];
    Timing kept[2];
    for (int i = 0; i < repeats; ++i)
      for (int k = 0; k < 2; ++k) {
        kept[k] =
            one.frame(k ? pca : lossless, k ? pca_manifest : manifest, 3 * block, ExecutionOrder::sorted, true, memory);
        times[k].add(seconds(kept[k].milliseconds));
      }
    compare("s a frame from the disk, 3 blocks", times[0].median(), times[1].median());
    compare("MB read for it", kept[0].read / 1e6, kept[1].read / 1e6);
    std::printf(
        "\nGB of covered texels as half floats over GB on disk (with all levels): %.1f lossless, %.1f principal "
        "components. The pictures differ by %.2f %% (root mean square), noise and all.\n\n",
        6e-9 * extent.lights * covered / (bytes / 1e9), 6e-9 * extent.lights * covered / (pca_bytes / 1e9),
        100 * pictureDistance(kept[1].frame, kept[0].frame));

    std::printf(
        "## 300 views x 100 lights x 1 megapixel, extrapolated\n\n"
        "| | measured here | for each | there (40 %% of the pixels are the object's) |\n|---|---|---|---|\n");
    const double texels = static_cast<double>(covered), there = 300 * 0.4e6, light_share = 100.0 / extent.lights;
    std::printf("| lossless | %.2f GB | %.0f bytes a covered texel | %.0f GB |\n", bytes / 1e9, bytes / texels,
                bytes / texels * there * light_share / 1e9);
    std::printf("| principal components | %.2f GB | %.0f bytes a covered texel | %.1f GB |\n", pca_bytes / 1e9,
                pca_bytes / texels, pca_bytes / texels * there * light_share / 1e9);
    std::printf("| written, lossless | %.0f s | %.2f us a texel, one thread | %.0f s |\n", seconds(make_lossless),
                1e3 * make_lossless / texels, make_lossless / texels * there * light_share / 1e3);
    std::printf("| written, principal components | %.0f s | %.2f us a texel, one thread | %.0f s |\n",
                seconds(make_pca), 1e3 * make_pca / texels, make_pca / texels * there * light_share / 1e3);
    std::printf("| indices and coverage in memory | %.2f MB | %.1f bytes a tile | %.0f MB |\n", index / 1e6,
                static_cast<double>(index) / tiles,
                static_cast<double>(index) / tiles * (300.0 * 64 * 64 * 4 / 3) / 1e6);
    std::printf(
        "| visibility | | one bit a point and view, and with a fit one a point and light | %.0f MB for a million "
        "points |\n",
        1e6 * (300 + 100) / 8 / 1e6);
    if (!plot.empty()) draw(plot, {{"hit by hit", immediate_curve}, {"sorted", sorted_curve}}, seconds(disk_at_three));
  });
}
