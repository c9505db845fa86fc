#include "acquire/signed_silhouette.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "base/numeric.h"

namespace srf {
namespace {

constexpr int kPadding = 24;               // pixels kept around the silhouette's box
constexpr double kSoftBlur = 0.7;          // pixels; standard deviation
constexpr double kHardBlur = 1.4;          // for masks without soft values: evens out the stairs
constexpr double kBoxVariance = 1.0 / 12;  // of a pixel's area across an edge, at any angle of the edge
constexpr float kNear = 1.0f;              // pixels: where the blurred value itself tells the distance
constexpr float kFootprint = 0.6f;         // pixels: half length of the piece of contour that a near pixel stands for

// The blurred step of an edge at signed distance d is the normal distribution at -d / sigma.
float distanceOfBlurredStep(float value, double sigma) {
  const double p = 1 - static_cast<double>(value);
  double x = (p - 0.5) * std::sqrt(2 * kPi);
  for (int i = 0; i < 3; ++i) {
    const double error = 0.5 * std::erfc(-x / std::sqrt(2.0)) - p;
    x -= error * std::sqrt(2 * kPi) * std::exp(0.5 * x * x);
  }
  return static_cast<float>(sigma * x);
}

// The piece of contour that a pixel near it stands for: a segment about `x, y` along (dx, dy).
struct Piece {
  float x, y, dx, dy;
  float distance(float px, float py) const {
    const float ax = px - x, ay = py - y;
    const float along = std::clamp(ax * dx + ay * dy, -kFootprint, kFootprint);
    const float x_off = ax - along * dx, y_off = ay - along * dy;
    return std::sqrt(x_off * x_off + y_off * y_off);
  }
};

bool hasSoftValues(const Image8& mask) {
  // Exact coverage makes about one soft pixel for each step along the contour; a hard mask may still have a few.
  std::size_t soft = 0, steps = 0;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x) {
      const int value = mask.at(x, y);
      soft += value > 16 && value < 239;
      steps += x > 0 && (value >= 128) != (mask.at(x - 1, y) >= 128);
    }
  return 2 * soft >= steps;
}

}  // namespace

SignedSilhouette::SignedSilhouette(const Image8& mask) {
  int left = mask.width(), top = mask.height(), right = -1, bottom = -1;
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); ++x)
      if (mask.at(x, y) >= 128) {
        left = std::min(left, x), right = std::max(right, x);
        top = std::min(top, y), bottom = std::max(bottom, y);
      }
  SRF_CHECK(right >= left);
  cropped_ = left == 0 || top == 0 || right == mask.width() - 1 || bottom == mask.height() - 1;
  const int inner[4] = {left, top, right, bottom};
  left = std::max(left - kPadding, 0), right = std::min(right + kPadding, mask.width() - 1);
  top = std::max(top - kPadding, 0), bottom = std::min(bottom + kPadding, mask.height() - 1);
  const cv::Rect box(left, top, right - left + 1, bottom - top + 1);

  const double blur = hasSoftValues(mask) ? kSoftBlur : kHardBlur;
  const double sigma = std::sqrt(blur * blur + kBoxVariance);
  const cv::Mat whole(mask.height(), mask.width(), CV_8U, const_cast<std::uint8_t*>(mask.data().data()));
  cv::Mat coverage;
  whole(box).convertTo(coverage, CV_32F, 1.0 / 255);
  cv::GaussianBlur(coverage, coverage, cv::Size(11, 11), blur, blur, cv::BORDER_REPLICATE);

  distance_ = ImageF(std::max(box.width, 2), std::max(box.height, 2), 1);
  left_ = left, top_ = top, last_x_ = distance_.width() - 1, last_y_ = distance_.height() - 1;

  inner_left_ = inner[0] - left, inner_right_ = inner[2] - left;
  inner_top_ = inner[1] - top, inner_bottom_ = inner[3] - top;

  // Near pixels have their distance from the blurred value; each gives a piece of the contour.
  const float low = static_cast<float>(0.5 * std::erfc(kNear / sigma / std::sqrt(2.0)));
  cv::Mat apart(box.height, box.width, CV_8U, cv::Scalar(255));
  std::vector<Piece> pieces(1);
  for (int y = 0; y < box.height; ++y) {
    const float* row = coverage.ptr<float>(y);
    const float *above = coverage.ptr<float>(std::max(y - 1, 0)),
                *below = coverage.ptr<float>(std::min(y + 1, box.height - 1));
    for (int x = 0; x < box.width; ++x) {
      if (!(row[x] >= low && row[x] <= 1 - low)) continue;
      apart.at<std::uint8_t>(y, x) = 0;
      const float d = distanceOfBlurredStep(row[x], sigma);
      distance_.at(x, y) = d;
      float gx = row[std::max(x - 1, 0)] - row[std::min(x + 1, box.width - 1)], gy = above[x] - below[x];
      const float length = std::hypot(gx, gy);
      if (length > 0) gx /= length, gy /= length;
      pieces.push_back({x - d * gx, y - d * gy, -gy, gx});
    }
  }

  // The others measure to the piece of their nearest near pixel.
  cv::Mat coarse, label;
  cv::distanceTransform(apart, coarse, label, cv::DIST_L2, cv::DIST_MASK_5, cv::DIST_LABEL_PIXEL);
  for (int y = 0; y < box.height; ++y)
    for (int x = 0; x < box.width; ++x) {
      if (apart.at<std::uint8_t>(y, x) == 0) continue;
      const float size = std::max(pieces[label.at<int>(y, x)].distance(x, y), kNear - 0.25f);
      distance_.at(x, y) = coverage.at<float>(y, x) >= 0.5f ? -size : size;
    }
  // A box of one pixel's width is doubled, so that there is always a cell to interpolate in.
  if (box.width == 1)
    for (int y = 0; y < box.height; ++y) distance_.at(1, y) = distance_.at(0, y);
  if (box.height == 1)
    for (int x = 0; x < distance_.width(); ++x) distance_.at(x, 1) = distance_.at(x, 0);
}

void SignedSilhouette::at(const double* x, const double* y, int count, double* distance) const {
  // In blocks: loops without branches, which become vector instructions, about one that fetches.
  constexpr int kBlock = 64;
  struct Pixels {
    float left, right;
  };
  const float* const data = distance_.data().data();
  const int width = distance_.width();
  const double left = left_, top = top_, last_x = last_x_, last_y = last_y_;
  for (int begin = 0; begin < count; begin += kBlock) {
    const int n = std::min(kBlock, count - begin);
    double s[kBlock], t[kBlock];
    int offset[kBlock], beyond = 0;
    for (int k = 0; k < n; ++k) {
      const double u = x[begin + k] - 0.5 - left, v = y[begin + k] - 0.5 - top;
      const double cu = std::min(std::max(u, 0.0), last_x), cv = std::min(std::max(v, 0.0), last_y);
      const int i = static_cast<int>(std::min(cu, last_x - 1)), j = static_cast<int>(std::min(cv, last_y - 1));
      s[k] = cu - i, t[k] = cv - j;
      offset[k] = j * width + i;
      beyond += (std::fabs(u - cu) > 0.5) | (std::fabs(v - cv) > 0.5);
    }
    Pixels upper[kBlock], lower[kBlock];
    for (int k = 0; k < n; ++k) {
      std::memcpy(&upper[k], data + offset[k], sizeof upper[k]);
      std::memcpy(&lower[k], data + offset[k] + width, sizeof lower[k]);
    }
    for (int k = 0; k < n; ++k) {
      const double above = upper[k].left + s[k] * (upper[k].right - upper[k].left);
      const double below = lower[k].left + s[k] * (lower[k].right - lower[k].left);
      distance[begin + k] = above + t[k] * (below - above);
    }
    for (int k = begin; beyond > 0 && k < begin + n; ++k) distance[k] = at(x[k], y[k]);
  }
}

}  // namespace srf
