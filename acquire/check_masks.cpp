#include "acquire/check_masks.h"

#include <algorithm>
#include <cmath>

#include "acquire/capture_pictures.h"
#include "acquire/check_section.h"
#include "acquire/silhouette.h"
#include "base/error.h"
#include "base/parallel.h"
#include "base/text.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

/// Share of the picture's border that is white.
double whiteBorder(const Image8& mask) {
  std::size_t white = 0, all = 0;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); x += (y == 0 || y == mask.height() - 1) ? 1 : std::max(1, mask.width() - 1)) {
      ++all;
      white += mask.at(x, y) >= 128;
    }
  return static_cast<double>(white) / static_cast<double>(std::max<std::size_t>(1, all));
}

std::size_t tilesTouched(const Image8& mask) {
  std::size_t tiles = 0;
  for (int ty = 0; ty < mask.height(); ty += kTile)
    for (int tx = 0; tx < mask.width(); tx += kTile) {
      bool covered = false;
      for (int y = ty; y < std::min(ty + kTile, mask.height()) && !covered; ++y)
        covered = std::any_of(mask.row(y) + tx, mask.row(y) + std::min(tx + kTile, mask.width()),
                              [](std::uint8_t m) { return m > 0; });
      tiles += covered;
    }
  return tiles;
}

struct MaskFacts {
  std::string fault, mend;
};

/// Faults of a mask file as the silhouette reader sees them, and its polarity, which that cannot know.
MaskFacts lookAtMask(const CaptureView& view, int factor, KeptMask& kept) {
  const std::string file = view.mask_file.string();
  Capture one;
  one.views = {view};
  MaskFacts facts;
  try {
    // As it is stored: acquisition would turn it about by itself, and say so.
    SilhouetteOptions as_stored;
    as_stored.polarity = MaskPolarity::white_is_object;
    Image8 mask = silhouette(one, ViewId{0}, as_stored, Reporter::silent());
    if (const double border = whiteBorder(mask); border > 0.8) {
      facts = {fixedNumber(100 * border, 0) + " % of the picture's border is white",
               "invert it: white is the object, black the background"};
      for (std::uint8_t& m : mask.data()) m = static_cast<std::uint8_t>(255 - m);
      kept.inverted = true;
    }
    kept.tiles = tilesTouched(mask);
    kept.mask = reduced(mask, factor);
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    facts.fault = wordsWithout(file, e);
  }
  return facts;
}

}  // namespace

int maskFactor(const Capture& capture, std::size_t memory) {
  double pixels = 0;
  int longest = 1;
  for (const CaptureView& view : capture.views) {
    pixels += static_cast<double>(view.camera.lens.width) * view.camera.lens.height;
    longest = std::max({longest, view.camera.lens.width, view.camera.lens.height});
  }
  const int for_memory = static_cast<int>(std::ceil(std::sqrt(24 * pixels / static_cast<double>(memory))));
  return std::clamp(std::max(longest / 512, for_memory), 1, std::max(1, longest / 64));
}

void checkMasks(const Capture& capture, int factor, std::vector<KeptMask>& kept, CheckReport& report) {
  Section section(report, "masks");
  std::vector<std::size_t> with, without;
  for (std::size_t v = 0; v < capture.views.size(); ++v)
    (capture.views[v].mask_file.empty() ? without : with).push_back(v);
  std::vector<MaskFacts> facts(with.size());
  parallelFor(with.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) facts[i] = lookAtMask(capture.views[with[i]], factor, kept[with[i]]);
  });
  for (std::size_t i = 0; i < with.size(); ++i)
    if (!facts[i].fault.empty())
      section.fault(capture.views[with[i]].mask_file.string(),
                    withPlace(facts[i].fault, capture.views[with[i]].mask_place), facts[i].mend);
  if (!with.empty())
    for (const std::size_t v : without)
      section.warn(capture.views[v].name, "has no mask, while other views have one",
                   "add its mask; until then alpha or the dark background tells the silhouette");
  section.finish(with.empty() ? "none: alpha, or a plain dark background, tells the silhouettes"
                              : counted(with.size(), "mask") + " of their cameras' size, neither empty nor full");
}

void segmentOthers(const Capture& capture, const AllPhotos& photos, int factor, std::vector<KeptMask>& kept,
                   CheckReport& report) {
  Capture rest = capture;
  rest.views.clear();
  std::vector<std::size_t> which;
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    const auto& facts = photos.facts[v];
    if (!capture.views[v].mask_file.empty() ||
        std::any_of(facts.begin(), facts.end(), [](const PhotoFacts& f) { return !f.fault.empty(); }))
      continue;
    rest.views.push_back(capture.views[v]);
    which.push_back(v);
  }
  if (which.empty()) return;
  Section section(report, "silhouettes");
  try {
    Reporter segmenting(ProgressMode::none, LogLevel::error);
    const auto views = silhouettes(rest, {}, segmenting);
    for (const std::string& warning : segmenting.warnings()) section.warn("", warning, "");
    for (std::size_t i = 0; i < which.size(); ++i)
      kept[which[i]] = {reduced(views[i].mask, factor), tilesTouched(views[i].mask), false};
  } catch (const Error& e) {
    if (e.kind() == ErrorKind::interrupted) throw;
    section.fault(e);
  }
  section.finish(counted(which.size(), "silhouette") + " from alpha or the dark background");
}

}  // namespace srf
