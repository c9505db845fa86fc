#include "acquire/capture_pictures.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "base/parallel.h"
#include "base/ray_scene.h"
#include "base/text.h"

namespace srf {
namespace {

const cv::Scalar kRed(230, 60, 50), kGreen(60, 190, 70), kBlue(70, 120, 250), kWhite(255, 255, 255), kBlack(0, 0, 0);

/// The picture's own memory as OpenCV sees it.
cv::Mat matOf(Image8& image) {
  return {image.height(), image.width(), CV_8UC3, image.data().data()};
}

void label(cv::Mat& on, const std::string& text, cv::Point at, const cv::Scalar& colour, double scale) {
  at.x = std::clamp(at.x, 2, std::max(2, on.cols - 2 - static_cast<int>(text.size() * 10 * scale)));
  at.y = std::clamp(at.y, static_cast<int>(14 * scale), std::max(14, on.rows - 4));
  cv::putText(on, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.5 * scale, kBlack, 3, cv::LINE_AA);
  cv::putText(on, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.5 * scale, colour, 1, cv::LINE_AA);
}

cv::Point pixelOf(const Vec2& p) {  // OpenCV counts from the first pixel's centre
  const auto whole = [](double v) { return cvRound(std::clamp(v - 0.5, -3e4, 3e4)); };
  return {whole(p.x), whole(p.y)};
}

/// The end of a name, in letters that OpenCV's fonts hold.
std::string asciiName(const std::string& name, std::size_t most) {
  std::string out = name.size() > most ? name.substr(name.size() - most) : name;
  for (char& c : out)
    if (c < ' ' || c > '~') c = '?';
  return out;
}

void arrow(cv::Mat& on, cv::Point from, cv::Point to, const cv::Scalar& colour) {
  cv::arrowedLine(on, from, to, kBlack, 5, cv::LINE_AA, 0, 0.12);
  cv::arrowedLine(on, from, to, colour, 2, cv::LINE_AA, 0, 0.12);
}

}  // namespace

Intrinsics reduced(const Intrinsics& lens, int factor) {
  Intrinsics out = lens;
  out.width = (lens.width + factor - 1) / factor;
  out.height = (lens.height + factor - 1) / factor;
  for (double* v : {&out.fl_x, &out.fl_y, &out.cx, &out.cy, &out.skew}) *v /= factor;
  return out;
}

Image8 reduced(const Image8& mask, int factor) {
  if (factor == 1) return mask;
  Image8 out((mask.width() + factor - 1) / factor, (mask.height() + factor - 1) / factor, 1);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      int sum = 0, count = 0;
      for (int j = y * factor; j < std::min((y + 1) * factor, mask.height()); ++j)
        for (int i = x * factor; i < std::min((x + 1) * factor, mask.width()); ++i) sum += mask.at(i, j), ++count;
      out.at(x, y) = static_cast<std::uint8_t>((sum + count / 2) / count);
    }
  return out;
}

Image8 axesPicture(const Image8& picture, const Camera<AcquisitionSpace>& camera, const Point<AcquisitionSpace>& center,
                   double axis_length) {
  Image8 out = picture;
  cv::Mat on = matOf(out);
  const double scale = static_cast<double>(picture.width()) / camera.lens.width;
  const auto place = [&](const Point<AcquisitionSpace>& p) -> std::optional<cv::Point> {
    const auto seen = camera.project(p);
    if (!seen) return std::nullopt;
    return pixelOf({seen->pixel.x * scale, seen->pixel.y * scale});
  };
  struct Axis {
    Vec3 along;
    const char* name;
    cv::Scalar colour;
  };
  const Axis axes[] = {{{1, 0, 0}, "+x", kRed}, {{0, 1, 0}, "+y", kGreen}, {{0, 0, 1}, "+z", kBlue}};
  // Those that point away from the camera first, so that nearer ones lie over them.
  std::vector<const Axis*> order{&axes[0], &axes[1], &axes[2]};
  std::stable_sort(order.begin(), order.end(), [&](const Axis* a, const Axis* b) {
    return dot(a->along, camera.forward().raw()) > dot(b->along, camera.forward().raw());
  });
  const auto from = place(center);
  for (const Axis* axis : order) {
    const auto to = place(center + Vector<AcquisitionSpace>(axis_length * axis->along));
    if (!from || !to) continue;
    arrow(on, *from, *to, axis->colour);
    label(on, axis->name, *to + cv::Point(6, 6), axis->colour, 1);
  }
  // The picture's own axes: x right, y down, from its top left corner.
  const int reach = std::max(24, picture.width() / 8);
  arrow(on, {3, 3}, {3 + reach, 3}, kWhite);
  arrow(on, {3, 3}, {3, 3 + reach}, kWhite);
  label(on, "pixel x", {8 + reach, 12}, kWhite, 0.8);
  label(on, "pixel y", {8, 14 + reach}, kWhite, 0.8);
  return out;
}

Image8 agreementSheet(const AcquisitionMesh& hull, const std::vector<SilhouetteView>& views,
                      const std::vector<double>& iou, int columns, int tile) {
  const int rows = (static_cast<int>(views.size()) + columns - 1) / columns, line = 18;
  Image8 sheet(columns * tile, rows * (tile + line), 3, 255);
  const auto scene = RayScene<AcquisitionSpace>::ofTriangles(hull.positions, hull.triangles);
  parallelFor(views.size(), 1, [&](std::size_t i, std::size_t) {
    const SilhouetteView& view = views[i];
    const int x0 = static_cast<int>(i) % columns * tile, y0 = static_cast<int>(i) / columns * (tile + line);
    const int longest = std::max(view.mask.width(), view.mask.height());
    for (int y = 0; y < tile; ++y)
      for (int x = 0; x < tile; ++x) {
        const Vec2 pixel{(x + 0.5) * longest / tile, (y + 0.5) * longest / tile};
        if (pixel.x >= view.mask.width() || pixel.y >= view.mask.height()) continue;
        const bool object = view.mask.at(static_cast<int>(pixel.x), static_cast<int>(pixel.y)) >= 128;
        const auto ray = view.camera.ray(pixel);
        const bool hit = ray && scene.intersect(*ray).hit();
        const std::uint8_t colour[4][3] = {{20, 20, 20}, {70, 120, 250}, {230, 60, 50}, {170, 170, 170}};
        std::copy_n(colour[2 * object + hit], 3, &sheet.at(x0 + x, y0 + y));
      }
  });
  cv::Mat on = matOf(sheet);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const int x0 = static_cast<int>(i) % columns * tile, y0 = static_cast<int>(i) / columns * (tile + line);
    const std::string text = " " + fixedNumber(iou[i], 3);
    cv::putText(on, asciiName(views[i].name, static_cast<std::size_t>(std::max(4, tile / 7 - 6))) + text,
                {x0 + 2, y0 + tile + 13}, cv::FONT_HERSHEY_SIMPLEX, 0.36, kBlack, 1, cv::LINE_AA);
  }
  return sheet;
}

}  // namespace srf
