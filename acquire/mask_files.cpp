#include "acquire/mask_files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <functional>
#include <map>
#include <set>
#include <vector>

#include "base/image_io.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

// In the order of preference: of OpenIllumination's two, obj_masks is the object and com_masks the object on its stand.
const std::vector<std::string> kFolders{"masks",        "mask",          "obj_masks",  "object_masks", "object_mask",
                                        "silhouettes",  "silhouette",    "mattes",     "matte",        "alpha",
                                        "segmentation", "segmentations", "foreground", "sam_masks",    "com_masks"};
const std::vector<std::string> kEndings{".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".exr"};

// Files of a folder by their name in small letters: every naming is looked up here and not on the disk.
class Folders {
 public:
  // The file itself, or nothing.
  fs::path find(const fs::path& wanted) {
    const fs::path folder = wanted.lexically_normal().parent_path();
    auto [it, fresh] = known_.try_emplace(folder);
    if (fresh) {
      std::error_code code;
      for (const auto& entry : fs::directory_iterator(folder, code))
        if (entry.is_regular_file(code)) it->second.emplace(lower(entry.path().filename().string()), entry.path());
    }
    const auto found = it->second.find(lower(wanted.filename().string()));
    return found == it->second.end() ? fs::path() : found->second;
  }

 private:
  static std::string lower(std::string text) {
    for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return text;
  }
  std::map<fs::path, std::map<std::string, fs::path>> known_;
};

// Names that a mask of `photo` may have; `%` of the label is the photograph's name without its ending.
struct Name {
  std::string label;
  std::function<std::string(const fs::path&)> of;  // without an ending where `any_ending`
  bool any_ending;
};
const std::vector<Name>& decorated() {
  static const std::vector<Name> names = [] {
    std::vector<Name> out{{"%.EXT.png", [](const fs::path& p) { return p.filename().string() + ".png"; }, false}};
    for (const char* word : {"mask", "matte", "alpha", "silhouette", "seg"})
      for (const char* joint : {"_", "-", "."}) {
        const std::string tail = std::string(joint) + word;
        out.push_back({"%" + tail, [tail](const fs::path& p) { return p.stem().string() + tail; }, true});
      }
    for (const char* head : {"mask_", "mask-"})
      out.push_back({std::string(head) + "%", [head](const fs::path& p) { return head + p.stem().string(); }, true});
    return out;
  }();
  return names;
}

struct Rule {
  std::string label;
  // The mask of a view, or an empty path.
  std::function<fs::path(const CaptureView&, Folders&)> find;
};

fs::path findWithEnding(const fs::path& stem, Folders& folders) {
  for (const std::string& ending : kEndings)
    if (fs::path found = folders.find(stem.string() + ending); !found.empty()) return found;
  return {};
}

// The folder that all photographs lie below.
fs::path commonFolder(const Capture& capture) {
  fs::path common;
  for (const CaptureView& view : capture.views)
    for (const Photo& photo : view.photos) {
      const fs::path folder = photo.file.lexically_normal().parent_path();
      if (common.empty()) {
        common = folder;
        continue;
      }
      fs::path shared;
      for (auto a = common.begin(), b = folder.begin(); a != common.end() && b != folder.end() && *a == *b; ++a, ++b)
        shared /= *a;
      common = shared;
    }
  return common;
}

std::vector<Rule> rulesOf(const Capture& capture) {
  const fs::path images = commonFolder(capture);
  std::vector<Rule> rules;
  const auto firstPhoto = [](const CaptureView& view) {
    return view.photos.empty() ? fs::path() : view.photos.front().file.lexically_normal();
  };
  const auto nameIn = [](const Name& name, const fs::path& folder, const fs::path& photo, Folders& folders) {
    const fs::path wanted = folder / name.of(photo);
    return name.any_ending ? findWithEnding(wanted, folders) : folders.find(wanted);
  };
  // Views of one photograph: a mask beside it. Its own name would be itself, so only decorated ones count.
  for (const Name& name : decorated())
    rules.push_back({name.label + " beside the photographs", [=](const CaptureView& view, Folders& folders) {
                       const fs::path photo = firstPhoto(view);
                       return photo.empty() ? photo : nameIn(name, photo.parent_path(), photo, folders);
                     }});
  std::vector<Name> names{{"%", [](const fs::path& p) { return p.stem().string(); }, true}};
  names.insert(names.end(), decorated().begin(), decorated().end());
  std::vector<fs::path> roots;
  for (const fs::path& root : {capture.folder.lexically_normal(), images.parent_path(), images})
    if (!root.empty() && std::find(roots.begin(), roots.end(), root) == roots.end()) roots.push_back(root);
  for (const std::string& folder : kFolders)
    for (const fs::path& root : roots) {
      const fs::path masks = root / folder;
      std::error_code code;
      if (!fs::is_directory(masks, code) || masks == images) continue;
      const std::string shown = masks.lexically_relative(capture.folder).generic_string() + "/";
      for (const Name& name : names)
        for (const bool nested : {true, false})
          rules.push_back({shown + name.label, [=](const CaptureView& view, Folders& folders) {
                             const fs::path photo = firstPhoto(view);
                             if (photo.empty()) return photo;
                             const fs::path below = photo.parent_path().lexically_relative(images);
                             return nameIn(name, nested ? masks / below : masks, photo, folders);
                           }});
      rules.push_back({shown + "VIEW", [=](const CaptureView& view, Folders& folders) {
                         if (fs::path named = findWithEnding(masks / view.name, folders); !named.empty()) return named;
                         const fs::path photo = firstPhoto(view);
                         return view.photos.size() < 2
                                    ? fs::path()
                                    : findWithEnding(masks / photo.parent_path().filename(), folders);
                       }});
    }
  for (const char* word : {"mask", "matte", "alpha", "silhouette"})
    rules.push_back({std::string("VIEW/") + word, [=](const CaptureView& view, Folders& folders) {
                       const fs::path photo = firstPhoto(view);
                       return view.photos.size() < 2 ? fs::path() : findWithEnding(photo.parent_path() / word, folders);
                     }});
  return rules;
}

}  // namespace

void findMaskFiles(Capture& capture, Reporter& reporter) {
  const auto bare = [](const CaptureView& view) { return view.mask_file.empty(); };
  if (!std::all_of(capture.views.begin(), capture.views.end(), bare)) return;
  std::set<fs::path> photographs;
  for (const CaptureView& view : capture.views)
    for (const Photo& photo : view.photos) photographs.insert(photo.file.lexically_normal());
  Folders folders;
  std::vector<fs::path> best;
  std::size_t best_count = 0;
  std::string best_label, passed_over;
  for (const Rule& rule : rulesOf(capture)) {
    std::vector<fs::path> found(capture.views.size());
    std::set<fs::path> distinct;
    std::size_t count = 0;
    for (std::size_t v = 0; v < found.size(); ++v) {
      found[v] = rule.find(capture.views[v], folders);
      if (photographs.contains(found[v].lexically_normal())) found[v].clear();
      if (found[v].empty()) continue;
      distinct.insert(found[v]);
      ++count;
    }
    if (count == 0 || distinct.size() != count) continue;  // one file for several views is no mask of theirs
    if (count > best_count) {
      best = std::move(found), best_count = count, best_label = rule.label;
    } else if (count == best_count && std::find(best.begin(), best.end(), *distinct.begin()) == best.end()) {
      passed_over = rule.label;
    }
  }
  if (best_count == 0) return;
  for (std::size_t v = 0; v < best.size(); ++v) capture.views[v].mask_file = best[v];
  reporter.count("masks.found", best_count);
  const std::string where = capture.folder.string() + ": masks are " + best_label + ", found for ";
  if (best_count == capture.views.size())
    reporter.info(where + "all " + std::to_string(best_count) + " views");
  else
    reporter.warn(where + std::to_string(best_count) + " of " + std::to_string(capture.views.size()) +
                  " views; the others are segmented, add their masks");
  if (!passed_over.empty())
    reporter.warn(capture.folder.string() + ": masks lie in " + passed_over + " too; taken are " + best_label +
                  "; name the ones that are meant with mask_path in transforms.json");
}

Image8 readMaskFile(const fs::path& file, MaskPolarity polarity, std::string& note) {
  const LoadedImage image = readImage(file, Transfer::linear);
  const ImageF& p = image.pixels;
  const int colours = std::min(p.channels(), 3);
  bool use_alpha = false;
  if (image.has_alpha) {
    float low = 1, high = 0;
    for (std::size_t i = 0; i < p.data().size(); i += p.channels())
      low = std::fmin(low, p.data()[i + p.channels() - 1]), high = std::fmax(high, p.data()[i + p.channels() - 1]);
    use_alpha = low < high;
  }
  Image8 mask(p.width(), p.height(), 1);
  std::array<std::size_t, 256> counts{};
  for (std::size_t i = 0; i < mask.data().size(); ++i) {
    const float* pixel = p.data().data() + i * p.channels();
    float value = 0;
    if (use_alpha)
      value = pixel[p.channels() - 1];
    else
      for (int c = 0; c < colours; ++c) value += pixel[c] / static_cast<float>(colours);
    mask.data()[i] = static_cast<std::uint8_t>(std::lround(255 * (value > 0 ? std::min(value, 1.f) : 0.f)));
    ++counts[mask.data()[i]];
  }
  const auto kinds = std::count_if(counts.begin(), counts.end(), [](std::size_t n) { return n > 0; });
  int brightest = 255;
  while (brightest > 0 && counts[brightest] == 0) --brightest;
  if (kinds == 2 && counts[0] > 0 && brightest < 128) {
    for (std::uint8_t& v : mask.data()) v = v ? 255 : 0;
    note = "holds 0 and " + std::to_string(brightest) + ": taken as labels, " + std::to_string(brightest) +
           " is the object";
  }
  if (polarity == MaskPolarity::automatic) {
    // The object stays off most of the picture's edge; a close-up leaves background in the middle of none.
    std::size_t edge = 0, edge_white = 0, white = 0;
    for (int y = 0; y < mask.height(); ++y)
      for (int x = 0; x < mask.width(); ++x) {
        const bool rim = x == 0 || y == 0 || x == mask.width() - 1 || y == mask.height() - 1;
        const bool is_white = mask.at(x, y) >= 128;
        edge += rim, edge_white += rim && is_white, white += is_white;
      }
    const bool inverted = edge_white >= 0.9 * static_cast<double>(edge) && white < mask.data().size();
    if (inverted) {
      polarity = MaskPolarity::black_is_object;
      note += std::string(note.empty() ? "" : "; ") + "is white at the picture's edge and black within: taken as " +
              "inverted, black is the object";
    }
  }
  if (polarity == MaskPolarity::black_is_object)
    for (std::uint8_t& v : mask.data()) v = static_cast<std::uint8_t>(255 - v);
  return mask;
}

}  // namespace srf
