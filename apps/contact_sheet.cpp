#include "apps/contact_sheet.h"

#include <algorithm>

#include "base/image_io.h"

namespace srf {
namespace {

// Mean over the source pixels whose centres fall into each target pixel.
ImageF reduced(const ImageF& image, int tile) {
  const int longest = std::max(image.width(), image.height());
  const int factor = std::max(1, (longest + tile - 1) / tile);
  const int width = std::max(1, image.width() / factor), height = std::max(1, image.height() / factor);
  ImageF out(width, height, image.channels());
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < image.channels(); ++c) {
        float sum = 0;
        for (int dy = 0; dy < factor; ++dy)
          for (int dx = 0; dx < factor; ++dx)
            sum += image.at(std::min(x * factor + dx, image.width() - 1), std::min(y * factor + dy, image.height() - 1),
                            c);
        out.at(x, y, c) = sum / static_cast<float>(factor * factor);
      }
  return out;
}

}  // namespace

ImageF overBlack(const ImageF& rgba) {
  ImageF rgb(rgba.width(), rgba.height(), 3);
  for (int y = 0; y < rgba.height(); ++y)
    for (int x = 0; x < rgba.width(); ++x)
      for (int c = 0; c < 3; ++c) rgb.at(x, y, c) = rgba.at(x, y, c);
  return rgb;
}

double displayExposure(const std::vector<ImageF>& frames) {
  std::vector<float> brightest;
  for (const ImageF& frame : frames)
    for (int y = 0; y < frame.height(); ++y)
      for (int x = 0; x < frame.width(); ++x)
        if (frame.at(x, y, 3) > 0.5f)
          brightest.push_back(std::max({frame.at(x, y, 0), frame.at(x, y, 1), frame.at(x, y, 2)}));
  if (brightest.empty()) return 1;
  const auto at = brightest.begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(brightest.size() - 1));
  std::nth_element(brightest.begin(), at, brightest.end());
  return *at > 0 ? 0.9 / *at : 1;
}

Image8 contactSheet(const std::vector<ImageF>& frames, int columns, int tile, double exposure) {
  std::vector<Image8> tiles;
  for (const ImageF& frame : frames) tiles.push_back(displayImage(reduced(overBlack(frame), tile), exposure));
  const int width = tiles.front().width(), height = tiles.front().height();
  const int used = std::min(columns, static_cast<int>(tiles.size()));
  const int rows = (static_cast<int>(tiles.size()) + columns - 1) / columns;
  Image8 sheet(used * width, rows * height, 3);
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    const int x0 = static_cast<int>(i) % columns * width, y0 = static_cast<int>(i) / columns * height;
    for (int y = 0; y < height; ++y) std::copy_n(tiles[i].row(y), 3 * width, &sheet.at(x0, y0 + y));
  }
  return sheet;
}

}  // namespace srf
