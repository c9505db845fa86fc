// What a user would take in place of two parts of the renderer, in turn with ours: OpenImageIO's ImageCache in place of
// the cache of blocks, and a search of all views in place of that among those which see a hit's points. One thread.
// Prints rows of Markdown.
#include <OpenImageIO/imagecache.h>
#include <OpenImageIO/imageio.h>

#include <cstdio>
#include <filesystem>
#include <functional>
#include <numeric>

#include "apps/program.h"
#include "base/error.h"
#include "base/numeric.h"
#include "bench/timing.h"
#include "field/block_cache.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"
#include "model/local_frame.h"
#include "render/reflectance_dot.h"
#include "render/view_selection.h"

namespace srf {
namespace {

/// A walk over the stored rectangle of a view at two steps a texel, as a picture's hits go, or the same sorted by
/// block.
std::vector<ShadingOperation> fetches(const ReflectanceStore& store, bool sorted) {
  const StoreGeometry& geometry = store.geometry();
  std::vector<ShadingOperation> operations;
  for (int y = 0; y < 2 * geometry.cropHeight(); ++y)
    for (int x = 0; x < 2 * geometry.cropWidth(); ++x) {
      ShadingOperation operation{};
      operation.tile = geometry.tileNumber({0, x / 2 / kTile, y / 2 / kTile});
      if (!store.hasTile(operation.tile)) continue;
      operation.x = static_cast<std::uint8_t>(std::min(x / 2 % kTile, kTile - 2));
      operation.y = static_cast<std::uint8_t>(std::min(y / 2 % kTile, kTile - 2));
      for (float& tap : operation.tap) tap = 0.25f;
      operations.push_back(operation);
    }
  if (sorted)
    std::stable_sort(operations.begin(), operations.end(),
                     [](const auto& a, const auto& b) { return blockKey(a) < blockKey(b); });
  return operations;
}

/// The view's texels as a tiled OpenEXR file, a channel of halves for each colour and light, as others would keep them.
void writeTiledImage(const ReflectanceStore& store, const std::filesystem::path& file) {
  const StoreGeometry& geometry = store.geometry();
  OIIO::ImageSpec spec(geometry.cropWidth(), geometry.cropHeight(), static_cast<int>(geometry.texelHalves()),
                       OIIO::TypeDesc::HALF);
  spec.tile_width = spec.tile_height = kTile;
  spec.attribute("compression", "zip");
  const auto out = OIIO::ImageOutput::create(file.string());
  if (!out || !out->open(file.string(), spec)) throw Error(ErrorKind::failed, "cannot be written", file.string());
  std::vector<std::uint16_t> block(geometry.blockHalves());
  for (int ty = 0; ty < geometry.tiles_y; ++ty)
    for (int tx = 0; tx < geometry.tiles_x; ++tx) {
      store.readTile(tx, ty, block);
      if (!out->write_tile(tx * kTile, ty * kTile, 0, OIIO::TypeDesc::HALF, block.data()))
        throw Error(ErrorKind::failed, out->geterror(), file.string());
    }
  out->close();
}

using Work = std::function<void()>;
/// Both in turn, after a run to warm them. Prints a row.
void compare(const char* what, double count, const Work& ours, const Work& other, int repeats) {
  bench::Series a, b;
  ours(), other();
  for (int i = 0; i < repeats; ++i) a.add(bench::milliseconds(ours)), b.add(bench::milliseconds(other));
  std::printf("| %s | %.0f | %.0f | %s |\n", what, 1e6 * a.median() / count, 1e6 * b.median() / count,
              bench::shownRatio(bench::ratios(b, a)).c_str());
}

void compareCaches(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                   const std::filesystem::path& work, int repeats) {
  const ReflectanceStore store(srf_folder / manifest.views.at(0).file);
  const StoreGeometry& geometry = store.geometry();
  const std::filesystem::path file = work / "view.exr";
  if (!std::filesystem::exists(file)) writeTiledImage(store, file);
  const std::vector<float> weights(geometry.texelHalves(), 0.01f);
  const ReflectanceStore* stores[] = {&store};
  constexpr std::size_t kAll = std::size_t{1} << 32;
  [[maybe_unused]] volatile float sink = 0;

  OIIO::ImageCache* const images = OIIO::ImageCache::create(/*shared=*/false);
  images->attribute("max_memory_MB", 4096.f);
  const OIIO::ustring name(file.string());
  // Four texels with all their lights, laid out as the product wants them.
  std::vector<std::uint16_t> texels(geometry.blockHalves());
  const auto fromImages = [&](const std::vector<ShadingOperation>& operations) {
    OIIO::ImageCache::ImageHandle* const image = images->get_image_handle(name);
    const OIIO::stride_t texel = static_cast<OIIO::stride_t>(2 * geometry.texelHalves());
    for (const ShadingOperation& operation : operations) {
      const TilePlace tile = geometry.place(operation.tile);
      const int x = tile.x * kTile + operation.x, y = tile.y * kTile + operation.y;
      if (!images->get_pixels(image, nullptr, 0, 0, x, x + 2, y, y + 2, 0, 1, 0,
                              static_cast<int>(geometry.texelHalves()), OIIO::TypeDesc::HALF, texels.data(), texel,
                              kTile * texel, OIIO::AutoStride))
        throw Error(ErrorKind::failed, images->geterror(), file.string());
      ShadingOperation first = operation;
      first.x = first.y = 0;
      sink = reflectanceDot(texels.data(), geometry.lightPad(), first, weights.data())[0];
    }
  };
  const auto fromBlocks = [&](BlockCache& cache, const std::vector<ShadingOperation>& operations) {
    for (const ShadingOperation& operation : operations) {
      const BlockCache::Handle handle = cache.get(ViewId{0}, operation.tile);
      sink = reflectanceDot(handle.block().halves.data(), geometry.lightPad(), operation, weights.data())[0];
    }
  };
  // As the renderer does it: a block is asked for once for all that falls on it.
  const auto fromBlocksOnceEach = [&](BlockCache& cache, const std::vector<ShadingOperation>& operations) {
    BlockCache::Handle handle;
    std::uint64_t held = ~std::uint64_t{0};
    for (const ShadingOperation& operation : operations) {
      if (blockKey(operation) != held) {
        handle = {};
        handle = cache.get(ViewId{0}, operation.tile);
        held = blockKey(operation);
      }
      sink = reflectanceDot(handle.block().halves.data(), geometry.lightPad(), operation, weights.data())[0];
    }
  };
  const auto by_hit = fetches(store, false), by_block = fetches(store, true);
  BlockCache cache(stores, kAll);
  const auto count = static_cast<double>(by_hit.size());
  compare(
      "fetch and product, hit by hit, all in memory", count, [&] { fromBlocks(cache, by_hit); },
      [&] { fromImages(by_hit); }, repeats);
  compare(
      "the same, sorted by block", count, [&] { fromBlocksOnceEach(cache, by_block); }, [&] { fromImages(by_block); },
      repeats);
  compare(
      "the same, decoded anew each time", count,
      [&] {
        BlockCache cold(stores, kAll);
        fromBlocksOnceEach(cold, by_block);
      },
      [&] {
        images->invalidate_all(true);
        fromImages(by_block);
      },
      repeats);
  OIIO::ImageCache::destroy(images, /*teardown=*/true);
}

/// The k nearest of all views by their penalties, each asked whether it sees the hit.
void searchAll(const std::vector<SourceView>& views, const VisibilityBits& visible, const ViewQuery& query, int k,
               std::vector<Penalised>& candidates, std::vector<Weighted>& weights) {
  candidates.clear();
  for (std::uint32_t v = 0; v < views.size(); ++v) {
    double sees = 0;
    for (std::size_t i = 0; i < query.points.size(); ++i)
      if (visible.get(query.points[i], v)) sees += double{query.point_weights[i]};
    if (!(sees > 0) || !views[v].coverage) continue;
    const auto pixel = views[v].camera.project(query.p);
    if (!pixel) continue;
    const Direction<AcquisitionSpace> d = views[v].camera.viewDirection(query.p);
    const double far = distance(views[v].camera.center(), query.p);
    candidates.push_back({viewPenalty(angleBetween(query.view, d), resolutionPenalty(far, query.eye_distance),
                                      sees * std::sqrt(std::max(dot(query.normal, d), 1e-3))),
                          v});
  }
  lumigraphWeights(candidates, k, weights);
}

void compareSearches(const DeformableModel& model, const SrfManifest& manifest,
                     const std::vector<std::unique_ptr<ReflectanceStore>>& stores, int repeats) {
  // The manifest's views, and the same 2 and 8 times over: what the search costs grows with what it must look at.
  for (const std::size_t times : {1, 2, 8}) {
    const std::size_t given = manifest.views.size();
    std::vector<SourceView> views;
    VisibilityBits visible(model.size(), given * times);
    for (std::size_t t = 0; t < times; ++t)
      for (std::size_t v = 0; v < given; ++v) {
        const Camera<AcquisitionSpace>& camera = manifest.views[v].camera;
        const Vector<AcquisitionSpace> aside(0, 0, 1e-3 * static_cast<double>(t));  // none stands where another does
        SourceView view{{camera.lens, {camera.pose.rotation(), camera.center() + aside}},
                        {},
                        nullptr,
                        manifest.views[v].black_background,
                        false};
        if (stores[v]) view.geometry = stores[v]->geometry(), view.coverage = stores[v]->coverages();
        views.push_back(view);
        for (std::uint32_t p = 0; p < model.size(); ++p)
          if (model.visible.get(p, static_cast<std::uint32_t>(v)))
            visible.set(p, static_cast<std::uint32_t>(t * given + v));
      }
    const ViewSelection selection(views, visible, 4);
    // A hit at every seventh point, looked at from aslant.
    std::vector<std::uint32_t> points;
    for (std::uint32_t p = 0; p < model.size(); p += 7) points.push_back(p);
    const float whole = 1;
    std::vector<ViewQuery> queries;
    for (const std::uint32_t& p : points) {
      const Direction<AcquisitionSpace> n =
          rotationFromRodrigues(model.r0[p]) * Direction<TangentSpace>::fromUnit({0, 0, 1});
      const auto v = normalize(Vector<AcquisitionSpace>(n.raw() + 0.5 * anyPerpendicular(n).raw()));
      queries.push_back({model.p0[p], *v, n, 3.0, {&p, 1}, {&whole, 1}});
    }
    const std::vector<std::uint8_t> allowed(views.size(), 1);
    ViewSelection::Scratch scratch;
    ViewSelection::Chosen chosen;
    std::vector<Penalised> candidates;
    std::vector<Weighted> weights;
    const std::string what = "4 nearest of " + std::to_string(views.size()) + " views, with their fetches";
    constexpr std::size_t kAtOnce = 256;
    compare(
        what.c_str(), static_cast<double>(queries.size()),
        [&] {
          for (std::size_t i = 0; i < queries.size(); i += kAtOnce)
            selection.select(std::span(queries).subspan(i, std::min(kAtOnce, queries.size() - i)), allowed, scratch,
                             chosen);
        },
        [&] {
          for (const ViewQuery& query : queries) searchAll(views, visible, query, 4, candidates, weights);
        },
        repeats);
  }
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("alternatives-benchmark",
                  "what others would use in place of parts of the renderer, in turn with ours");
  std::string srf_folder, work;
  int repeats = 11;
  program.app().add_option("SRF", srf_folder, "the field")->required();
  program.app().add_option("WORK", work, "folder for the image that the other cache reads")->required();
  program.app().add_option("--repeats", repeats, "of each, in turn");
  return program.run(argc, argv, [&](Reporter&) {
    const SrfManifest manifest = readManifest(srf_folder);
    const DeformableModel model = loadModel(srf_folder, manifest);
    std::printf("| what | ours, ns each | the other, ns each | the other over ours |\n|---|---|---|---|\n");
    compareCaches(srf_folder, manifest, work, repeats);
    std::vector<std::unique_ptr<ReflectanceStore>> stores;
    for (const StoredView& view : manifest.views)
      stores.push_back(view.file.empty()
                           ? nullptr
                           : std::make_unique<ReflectanceStore>(std::filesystem::path(srf_folder) / view.file));
    compareSearches(model, manifest, stores, repeats);
  });
}
