#include "apps/calibrate_masks.h"

#include <algorithm>

#include "acquire/develop.h"
#include "acquire/mask_files.h"
#include "acquire/structure_from_motion.h"
#include "base/error.h"
#include "base/image_io.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

void findIn(const fs::path& masks, Capture& shot, Reporter& reporter) {
  std::size_t without = 0;
  for (CaptureView& view : shot.views) {
    for (const Photo& photo : view.photos)
      if (view.mask_file.empty())
        view.mask_file = maskFileOf(masks, photo.file.lexically_relative(shot.folder).generic_string());
    if (view.mask_file.empty()) view.mask_file = maskFileOf(masks, view.name);
    without += view.mask_file.empty();
  }
  if (without == shot.views.size())
    throw badInput(masks.string(), "holds no mask of any photograph or view: expected for example " +
                                       shot.views[0].photos[0].file.filename().string() + ".png or " +
                                       shot.views[0].name + ".png");
  if (without > 0) reporter.warn(masks.string() + ": " + std::to_string(without) + " views have no mask");
}

Image8 readMaskOf(const CaptureView& view, Reporter& reporter) {
  std::string note;
  Image8 mask = readMaskFile(view.mask_file, MaskPolarity::automatic, note);
  if (!note.empty()) reporter.warn(view.mask_file.string() + ": " + note);
  const Intrinsics& lens = view.camera.lens;
  if (mask.width() != lens.width || mask.height() != lens.height)
    throw badInput(view.mask_file.string(), "is " + std::to_string(mask.width()) + " x " +
                                                std::to_string(mask.height()) + ", its photographs " +
                                                std::to_string(lens.width) + " x " + std::to_string(lens.height) +
                                                "; make masks of the photographs' size");
  return mask;
}

}  // namespace

void carryMasks(Capture shot, const fs::path& masks, Capture& capture, Reporter& reporter) {
  if (masks.empty())
    findMaskFiles(shot, reporter);
  else
    findIn(masks, shot, reporter);
  std::vector<std::pair<Intrinsics, Undistortion>> lenses;
  for (std::size_t v = 0; v < shot.views.size(); ++v) {
    const CaptureView& from = shot.views[v];
    CaptureView& to = capture.views[v];
    if (from.mask_file.empty()) continue;
    to.mask_file = fs::absolute(from.mask_file);
    if (from.camera.lens == to.camera.lens) continue;
    auto at = std::find_if(lenses.begin(), lenses.end(), [&](const auto& l) { return l.first == from.camera.lens; });
    if (at == lenses.end()) at = lenses.insert(at, {from.camera.lens, Undistortion(from.camera.lens)});
    std::string name = to.name;
    std::replace(name.begin(), name.end(), '/', '_');
    to.mask_file = capture.folder / "masks" / (name + ".png");
    writePng(to.mask_file, at->second.apply(readMaskOf(from, reporter)));
  }
}

}  // namespace srf
