#include "acquire/registration.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "base/error.h"
#include "base/quantile.h"
#include "field/capture_file.h"
#include "field/reflectance_store.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr int kMargin = 2;      // texels around the mask: neighbours of a bilinear fetch
constexpr float kMost = 65504;  // largest half
constexpr double kDark = 0.02;  // of the object's level: a background below it is black
// Pixels around the silhouette that are no sure background: lens blur, a mask a bit too small.
constexpr int kKeepOff = 3;
// Bytes a pixel: a photograph of four floats while it is read, the sum, the mask without its rim and what is between.
constexpr std::size_t kReadingBytes = 28;
constexpr std::size_t kWorkingBytes = 4 << 20;  // of decoders, compressors and the blocks on their way
// Pixels at the edge of a thresholded mask: the blur of sharp photographs.
constexpr int kRim = 2;

// Bytes of one row of tiles of all photographs.
std::size_t rowBytes(std::size_t photo_count, std::size_t width) {
  return photo_count * kTile * width * 3 * sizeof(std::uint16_t);
}

Error wrongSize(const Capture& capture, const CaptureView& view, const fs::path& file, int width, int height) {
  const Intrinsics& lens = view.camera.lens;
  return badInput(file.string(), "is " + std::to_string(width) + " x " + std::to_string(height) + " pixels, expected " +
                                     std::to_string(lens.width) + " x " + std::to_string(lens.height) +
                                     " as the camera of view '" + view.name + "' in " + capture.folder.string() +
                                     " says; mend w and h there or the file");
}

// Where the store lies in the photograph: the mask's bounding box with its margin, rounded up to whole tiles.
StoreGeometry geometryOf(const CaptureView& view, const Image8& mask, int light_count) {
  int x0 = mask.width(), x1 = -1, y0 = mask.height(), y1 = -1;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x)
      if (mask.at(x, y) > 0) {
        x0 = std::min(x0, x), x1 = std::max(x1, x);
        y0 = std::min(y0, y), y1 = std::max(y1, y);
      }
  if (x1 < 0)
    throw badInput(view.mask_file.empty() ? "view '" + view.name + "'" : view.mask_file.string(),
                   "is empty: no pixel of the object; mend the mask or remove the view");
  StoreGeometry g;
  g.image_width = mask.width(), g.image_height = mask.height();
  g.crop_x = std::max(0, x0 - kMargin), g.crop_y = std::max(0, y0 - kMargin);
  g.tiles_x = (std::min(mask.width(), x1 + 1 + kMargin) - g.crop_x + kTile - 1) / kTile;
  g.tiles_y = (std::min(mask.height(), y1 + 1 + kMargin) - g.crop_y + kTile - 1) / kTile;
  g.light_count = light_count;
  g.levels = g.mostLevels();
  return g;
}

// Sets pixels whose neighbourhood of `reach` pixels holds some mask.
Image8 widened(const Image8& mask, int reach) {
  Image8 rows(mask.width(), mask.height(), 1), out(mask.width(), mask.height(), 1);
  const auto spread = [&](const Image8& from, Image8& to, int dx, int dy) {
    for (int y = 0; y < mask.height(); ++y)
      for (int x = 0; x < mask.width(); ++x) {
        if (from.at(x, y) == 0) continue;
        for (int k = -reach; k <= reach; ++k) {
          const int u = x + k * dx, v = y + k * dy;
          if (u >= 0 && u < mask.width() && v >= 0 && v < mask.height()) to.at(u, v) = 255;
        }
      }
  };
  spread(mask, rows, 1, 0);
  spread(rows, out, 0, 1);
  return out;
}

// Whether the mask was found by a threshold in the photographs: it has no soft values then.
bool isSegmented(const CaptureView& view, const Image8& mask) {
  return view.mask_file.empty() &&
         std::all_of(mask.data().begin(), mask.data().end(), [](std::uint8_t v) { return v == 0 || v == 255; });
}

// A threshold takes in all that stands out of the background, so the outermost pixels are mixed with it, by an unknown
// share: a dark rim that shows as a seam where the surface turns. They are left out, but for parts so thin that nothing
// would remain.
Image8 withoutRim(const Image8& mask) {
  Image8 outside = mask;
  for (std::uint8_t& v : outside.data()) v = 255 - v;
  Image8 kept = widened(outside, kRim);
  for (std::uint8_t& v : kept.data()) v = 255 - v;
  const Image8 near = widened(kept, 2 * kRim);
  for (std::size_t i = 0; i < mask.data().size(); ++i)
    if (near.data()[i] == 0) kept.data()[i] = mask.data()[i];
  return kept;
}

// Whether edge pixels may be taken as the object's light times coverage. Each pixel's mean over the photographs
// decides: single lights leave much of the object dark and noise in the rest, the mean is free of both. The 99th
// percentile of the sure background is compared with the median of the object, so that a few stray reflections do not
// decide, but a lit table or wall in a part of the picture does. Where no sure background is in sight the answer is no,
// the cautious one.
bool hasBlackBackground(const ImageF& sum, const Image8& mask) {
  const Image8 near = widened(mask, kKeepOff);
  std::vector<float> object, background;
  for (std::size_t i = 0; i < mask.data().size(); ++i) {
    if (mask.data()[i] == 255) object.push_back(sum.data()[i]);
    if (near.data()[i] == 0) background.push_back(sum.data()[i]);
  }
  if (object.empty() || background.empty()) return false;
  return quantile(background, 0.99) <= kDark * quantile(object, 0.5);
}

std::string safeName(const std::string& name) {
  std::string out = name.substr(0, 40);
  for (char& c : out)
    if (!std::isalnum(static_cast<unsigned char>(c)) && c != '_' && c != '-') c = '_';
  return out;
}

class Registration {
 public:
  Registration(const Capture& capture, ViewId id, const Image8& mask, const RegistrationOptions& options,
               Reporter::Stage& stage, Reporter& reporter)
      : capture_(capture),
        id_(id),
        view_(capture.views[id.value]),
        mask_(mask),
        options_(options),
        stage_(stage),
        reporter_(reporter) {
    for (const Photo& photo : view_.photos)
      if (photo.light) photos_.push_back(&photo);
    // In the order of the lights, whatever that of the frames: views under the same lights then share one list of them,
    // which the fit needs to foretell one view by the others and a frame needs to weigh its lights once for all.
    std::sort(photos_.begin(), photos_.end(), [](const Photo* a, const Photo* b) { return *a->light < *b->light; });
  }

  StoredView run(const fs::path& srf_folder) {
    StoredView stored;
    stored.name = view_.name;
    stored.camera = view_.camera;
    for (const Photo* photo : photos_) stored.lights.push_back(*photo->light);
    if (photos_.empty()) return stored;
    geometry_ = geometryOf(view_, mask_, static_cast<int>(photos_.size()));
    stored.file = "views/" + fileName();
    const fs::path file = srf_folder / stored.file;
    if (!takeFinished(file, stored)) {
      stored.hash = write(file);
      stored.black_background = geometry_.black_background;
    }
    return stored;
  }

 private:
  // All that the store depends on goes into its name.
  std::string fileName() const {
    std::string identity = "3";  // raise it when registration changes what it writes
    const auto add = [&](const auto& value) { identity.append(reinterpret_cast<const char*>(&value), sizeof value); };
    for (const Photo* photo : photos_) {
      std::error_code code;
      const auto bytes = fs::file_size(photo->file, code);
      if (code) throw badInput(photo->file.string(), "could not be read: " + code.message() + "; check the path");
      add(bytes);
      add(fs::last_write_time(photo->file, code).time_since_epoch().count());
      identity += fs::absolute(photo->file).lexically_normal().string() + '\n';
    }
    const Intrinsics& c = view_.camera.lens;
    for (const double x : {c.fl_x, c.fl_y, c.cx, c.cy, c.skew, c.k1, c.k2, c.k3, c.k4, c.p1, c.p2}) add(x);
    add(view_.camera.pose.rotation().raw());
    add(view_.camera.pose.origin().raw());
    for (const int x : {static_cast<int>(c.model), c.width, c.height, static_cast<int>(options_.coding.compression),
                        static_cast<int>(capture_.integer_transfer), static_cast<int>(isSegmented(view_, mask_))})
      add(x);
    if (options_.coding.compression == Compression::pca) add(options_.coding.error);
    const std::uint64_t seed = contentHash(mask_.data().data(), mask_.data().size());
    char number[16];
    std::snprintf(number, sizeof number, "%04u", id_.value);
    return std::string(number) + "-" + safeName(view_.name) + "-" +
           hexHash(contentHash(identity.data(), identity.size(), seed)) + ".blk";
  }

  bool takeFinished(const fs::path& file, StoredView& stored) const {
    if (!fs::exists(file)) return false;
    try {
      const ReflectanceStore store(file);
      stored.hash = store.contentHash();
      stored.black_background = store.geometry().black_background;
    } catch (const Error&) {
      return false;  // damaged since: write it anew
    }
    reporter_.count("views.reused");
    stage_.advance(photos_.size());
    return true;
  }

  ImageF load(const Photo& photo) const {
    ImageF pixels = readImage(photo.file, capture_.integer_transfer).pixels;
    if (pixels.width() != mask_.width() || pixels.height() != mask_.height())
      throw wrongSize(capture_, view_, photo.file, pixels.width(), pixels.height());
    return pixels;
  }

  // What must be known of all photographs before the first block is written: usable texels, black background or not.
  void survey(const ImageF& pixels) {
    const int colours = std::min(pixels.channels(), 3);
    for (int y = 0; y < pixels.height(); ++y)
      for (int x = 0; x < pixels.width(); ++x) {
        const float* p = pixels.row(y) + static_cast<std::ptrdiff_t>(x) * pixels.channels();
        float brightest = 0;
        bool finite = true;
        for (int c = 0; c < colours; ++c) {
          finite = finite && std::isfinite(p[c]);
          brightest = std::max(brightest, p[c]);
        }
        if (finite) {
          sum_.at(x, y) += brightest;
          continue;
        }
        ++not_finite_;
        const int u = x - geometry_.crop_x, v = y - geometry_.crop_y;
        if (u >= 0 && u < coverage_.width() && v >= 0 && v < coverage_.height() && coverage_.at(u, v) > 0) {
          coverage_.at(u, v) = 0;
          ++masked_;
        }
      }
  }

  // The rows of tiles [first, last) of one photograph as halves [row][column][3].
  void keep(const ImageF& pixels, int first, int last, std::vector<std::uint16_t>& plane) {
    plane.assign(static_cast<std::size_t>(last - first) * kTile * geometry_.cropWidth() * 3, 0);
    const int rows = std::min((last - first) * kTile, pixels.height() - geometry_.crop_y - first * kTile);
    const int columns = std::min(geometry_.cropWidth(), pixels.width() - geometry_.crop_x);
    for (int r = 0; r < rows; ++r) {
      const int y = first * kTile + r;
      const float* from =
          pixels.row(geometry_.crop_y + y) + static_cast<std::ptrdiff_t>(geometry_.crop_x) * pixels.channels();
      std::uint16_t* to = plane.data() + static_cast<std::size_t>(r) * geometry_.cropWidth() * 3;
      for (int x = 0; x < columns; ++x, from += pixels.channels(), to += 3) {
        if (coverage_.at(x, y) == 0) continue;
        bool negative = false, clamped = false;
        for (int c = 0; c < 3; ++c) {
          const float value = from[pixels.channels() < 3 ? 0 : c];
          if (!std::isfinite(value)) continue;
          negative = negative || value < 0;
          clamped = clamped || value > kMost;
          to[c] = halfFromFloat(value > 0 ? std::min(value, kMost) : 0.f);
        }
        negative_ += negative;
        clamped_ += clamped;
      }
    }
  }

  void writeRow(ReflectanceStoreWriter& writer, int tile_y, int first,
                const std::vector<std::vector<std::uint16_t>>& planes) const {
    const int width = geometry_.cropWidth(), pad = geometry_.lightPad();
    std::vector<std::uint16_t> block(geometry_.blockHalves());
    for (int tile_x = 0; tile_x < geometry_.tiles_x; ++tile_x) {
      bool covered = false;
      for (int i = 0; i < kTile * kTile; ++i) {
        const bool use = coverage_.at(tile_x * kTile + i % kTile, tile_y * kTile + i / kTile) > 0;
        covered = covered || use;
        for (std::size_t k = 0; k < planes.size(); ++k) {
          const std::size_t texel =
              static_cast<std::size_t>((tile_y - first) * kTile + i / kTile) * width + tile_x * kTile + i % kTile;
          for (int c = 0; c < 3; ++c)
            block[(static_cast<std::size_t>(i) * 3 + c) * pad + k] = use ? planes[k][3 * texel + c] : 0;
        }
      }
      if (covered) writer.writeTile(tile_x, tile_y, block);
    }
  }

  std::uint64_t write(const fs::path& file) {
    const Image8 mask = isSegmented(view_, mask_) ? withoutRim(mask_) : mask_;
    coverage_ = Image8(geometry_.cropWidth(), geometry_.cropHeight(), 1);
    for (int y = 0; y < coverage_.height(); ++y)
      for (int x = 0; x < coverage_.width(); ++x) {
        const int u = x + geometry_.crop_x, v = y + geometry_.crop_y;
        if (u < mask_.width() && v < mask_.height()) coverage_.at(x, y) = mask.at(u, v);
      }
    sum_ = ImageF(mask_.width(), mask_.height(), 1);

    // As many rows of tiles at a time as fit; the photographs are read once for each such band.
    const std::size_t row_bytes = rowBytes(photos_.size(), static_cast<std::size_t>(geometry_.cropWidth()));
    // Coarser levels of the store wait for their other half: a row of blocks over all levels, less than as wide as
    // ours.
    const std::size_t kept_bytes = mask_.data().size() * kReadingBytes + kWorkingBytes + row_bytes;
    const std::size_t budget = options_.memory_bytes > kept_bytes ? options_.memory_bytes - kept_bytes : 0;
    const int band = static_cast<int>(std::clamp<std::size_t>(budget / row_bytes, 1, geometry_.tiles_y));

    std::vector<std::vector<std::uint16_t>> planes(photos_.size());
    for (std::size_t k = 0; k < photos_.size(); ++k) {
      const ImageF pixels = load(*photos_[k]);
      survey(pixels);
      keep(pixels, 0, band, planes[k]);
      stage_.advance();
    }
    const auto& left = coverage_.data();
    if (std::all_of(left.begin(), left.end(), [](std::uint8_t c) { return c == 0; }))
      throw badInput(photos_.front()->file.parent_path().string(),
                     "view '" + view_.name +
                         "' has no pixel of the object that is a number in all "
                         "its photographs; write them again");
    geometry_.black_background = hasBlackBackground(sum_, mask_);
    sum_ = ImageF();

    ReflectanceStoreWriter writer(file, geometry_, coverage_, options_.coding);
    for (int first = 0; first < geometry_.tiles_y; first += band) {
      const int last = std::min(first + band, geometry_.tiles_y);
      if (first > 0)
        for (std::size_t k = 0; k < photos_.size(); ++k) {
          keep(load(*photos_[k]), first, last, planes[k]);
          throwIfInterrupted();
        }
      for (int tile_y = first; tile_y < last; ++tile_y) {
        writeRow(writer, tile_y, first, planes);
        throwIfInterrupted();
      }
    }
    report();
    return writer.commit();
  }

  void report() const {
    if (not_finite_ > 0) reporter_.count("pixels.nan", not_finite_);
    if (clamped_ > 0) reporter_.count("pixels.clamped", clamped_);
    if (negative_ > 0) reporter_.count("pixels.negative", negative_);
    if (masked_ > 0)
      reporter_.warn("view '" + view_.name + "': " + std::to_string(masked_) +
                     " pixels of the object are NaN or infinite in a photograph and are left out");
  }

  const Capture& capture_;
  ViewId id_;
  const CaptureView& view_;
  const Image8& mask_;
  const RegistrationOptions& options_;
  Reporter::Stage& stage_;
  Reporter& reporter_;
  std::vector<const Photo*> photos_;  ///< those under a light
  StoreGeometry geometry_;
  Image8 coverage_;  ///< of the crop
  ImageF sum_;       ///< over the photographs, brightest channel
  std::uint64_t not_finite_ = 0, masked_ = 0, clamped_ = 0, negative_ = 0;
};

}  // namespace

std::size_t leastRegistrationMemory(const CaptureView& view) {
  const auto width = static_cast<std::size_t>(view.camera.lens.width);
  const auto lit = std::count_if(view.photos.begin(), view.photos.end(), [](const Photo& p) { return p.light; });
  return width * static_cast<std::size_t>(view.camera.lens.height) * kReadingBytes + kWorkingBytes +
         2 * rowBytes(static_cast<std::size_t>(lit), width);
}

void checkPhotographs(const Capture& capture, ViewId id) {
  const CaptureView& view = capture.views[id.value];
  requireFiles(view);
  for (const Photo& photo : view.photos) {
    const ImageSize size = readImageSize(photo.file);
    if (size.width != view.camera.lens.width || size.height != view.camera.lens.height)
      throw wrongSize(capture, view, photo.file, size.width, size.height);
  }
}

StoredView registerView(const Capture& capture, ViewId view, const Image8& mask, const fs::path& srf_folder,
                        const RegistrationOptions& options, Reporter::Stage& stage, Reporter& reporter) {
  return Registration(capture, view, mask, options, stage, reporter).run(srf_folder);
}

}  // namespace srf
