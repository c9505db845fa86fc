#include "acquire/mask_pictures.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "acquire/silhouette.h"
#include "acquire/silhouette_agreement.h"
#include "base/error.h"
#include "base/image_io.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr int kLongest = 640, kTile = 240, kColumns = 6;

cv::Mat matOf(const Image8& image) {
  return {image.height(), image.width(), CV_8UC(image.channels()), const_cast<std::uint8_t*>(image.data().data())};
}

void drawOutline(cv::Mat& picture, const cv::Mat& object, const cv::Scalar& colour) {
  cv::Mat inner;
  cv::erode(object, inner, cv::getStructuringElement(cv::MORPH_CROSS, {3, 3}));
  picture.setTo(colour, object & ~inner);
}

// The exposure that shows the object: its 95th percentile becomes nearly white.
double exposureFor(const ImageF& photograph, const Image8& mask) {
  std::vector<float> values;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x)
      if (mask.at(x, y) >= 128)
        values.push_back(std::max({photograph.at(x, y, 0), photograph.at(x, y, 1), photograph.at(x, y, 2)}));
  if (values.empty()) return 1;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at > 0 ? 0.9 / *at : 1;
}

}  // namespace

void writeMaskPictures(const Capture& capture, const std::vector<SilhouetteView>& views, const AcquisitionMesh* hull,
                       const std::filesystem::path& folder, Reporter& reporter) {
  std::error_code code;
  std::filesystem::create_directories(folder, code);
  if (code) throw Error(ErrorKind::failed, "could not be made: " + code.message(), folder.string());
  Reporter::Stage stage(reporter, "mask pictures", views.size());
  std::vector<cv::Mat> tiles(views.size());
  parallelFor(views.size(), 1, [&](std::size_t i, std::size_t) {
    const SilhouetteView& view = views[i];
    cv::Mat picture;
    const double scale = std::min(1.0, double(kLongest) / std::max(view.mask.width(), view.mask.height()));
    const cv::Size size(std::max(1, static_cast<int>(std::lround(view.mask.width() * scale))),
                        std::max(1, static_cast<int>(std::lround(view.mask.height() * scale))));
    if (capture.views[i].photos.empty()) {
      picture = cv::Mat(size, CV_8UC3, cv::Scalar(128, 128, 128));
    } else {
      const ImageF photograph = meanPhotograph(capture, capture.views[i]);
      cv::resize(matOf(displayImage(photograph, exposureFor(photograph, view.mask))), picture, size, 0, 0,
                 cv::INTER_AREA);
    }
    cv::Mat mask;
    cv::resize(matOf(view.mask), mask, size, 0, 0, cv::INTER_AREA);
    for (int y = 0; y < size.height; ++y)
      for (int x = 0; x < size.width; ++x) {
        auto& pixel = picture.at<cv::Vec3b>(y, x);
        const double light = 0.3 + 0.7 * mask.at<std::uint8_t>(y, x) / 255;
        for (int c = 0; c < 3; ++c) pixel[c] = cv::saturate_cast<std::uint8_t>(light * pixel[c]);
      }
    if (hull) {
      const Camera<AcquisitionSpace> camera{resized(view.camera.lens, size.width, size.height), view.camera.pose};
      drawOutline(picture, matOf(projectedMesh(*hull, camera)), {255, 150, 0});
    }
    drawOutline(picture, mask >= 128, {60, 255, 60});
    Image8 out(size.width, size.height, 3);
    for (int y = 0; y < size.height; ++y) std::copy_n(picture.ptr<std::uint8_t>(y), 3 * size.width, out.row(y));
    writePng(folder / (view.name + ".png"), out);
    const double tile_scale = double(kTile) / std::max(size.width, size.height);
    cv::resize(picture, tiles[i], {}, tile_scale, tile_scale, cv::INTER_AREA);
    cv::putText(tiles[i], view.name, {4, tiles[i].rows - 5}, cv::FONT_HERSHEY_PLAIN, 0.9, {255, 255, 255}, 1,
                cv::LINE_AA);
    stage.advance();
  });
  const int columns = std::min<int>(kColumns, static_cast<int>(views.size()));
  const int rows = (static_cast<int>(views.size()) + columns - 1) / columns;
  Image8 sheet(columns * kTile, rows * kTile, 3);
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    const int x0 = static_cast<int>(i) % columns * kTile, y0 = static_cast<int>(i) / columns * kTile;
    for (int y = 0; y < std::min(tiles[i].rows, kTile); ++y)
      std::copy_n(tiles[i].ptr<std::uint8_t>(y), 3 * std::min(tiles[i].cols, kTile), &sheet.at(x0, y0 + y));
  }
  writePng(folder / "contact_sheet.png", sheet);
}

}  // namespace srf
