// FLIP: Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom, Fairchild, "FLIP: A Difference Evaluator for Alternating
// Images", HPG 2020; the numbers of its sections 4.1 to 4.3 stand below where they are used. All filters are sums of
// products of a function of x and one of y, and are applied so.
#include "base/image_metrics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "base/error.h"
#include "base/image_io.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "base/vec.h"

namespace srf {
namespace {

using Plane = Image<double>;
using Planes = std::array<Plane, 3>;

template <class Body>
void forRows(int height, const Body& body) {
  parallelFor(static_cast<std::size_t>(height), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) body(static_cast<int>(y));
  });
}

int clampIndex(int i, int count) {
  return std::clamp(i, 0, count - 1);
}
/// d c b a | a b c d | d c b a
int mirrorIndex(int i, int count) {
  i = ((i % (2 * count)) + 2 * count) % (2 * count);
  return i < count ? i : 2 * count - 1 - i;
}

/// Correlation with kernel_x(i) kernel_y(j), both of odd length; `border` maps an index outside the image into it.
Plane filtered(const Plane& in, const std::vector<double>& kernel_x, const std::vector<double>& kernel_y,
               int (*border)(int, int)) {
  const int width = in.width(), height = in.height();
  const int rx = static_cast<int>(kernel_x.size() / 2), ry = static_cast<int>(kernel_y.size() / 2);
  Plane across(width, height, 1), out(width, height, 1);
  forRows(height, [&](int y) {
    std::vector<double> row(width + 2 * rx);
    for (int x = -rx; x < width + rx; ++x) row[x + rx] = in.at(border(x, width), y);
    for (int x = 0; x < width; ++x) {
      double sum = 0;
      for (std::size_t i = 0; i < kernel_x.size(); ++i) sum += kernel_x[i] * row[x + i];
      across.at(x, y) = sum;
    }
  });
  forRows(height, [&](int y) {
    for (int j = -ry; j <= ry; ++j) {
      const double weight = kernel_y[j + ry];
      const double* from = across.row(border(y + j, height));
      double* to = out.row(y);
      for (int x = 0; x < width; ++x) to[x] += weight * from[x];
    }
  });
  return out;
}

/// Per pixel, over channels: skimage's and Wang's definition with a uniform window and the sample covariance.
Plane ssimMap(const Planes& a, const Planes& b) {
  constexpr int kWindow = 7;
  constexpr double kSample = kWindow * kWindow / (kWindow * kWindow - 1.0);
  constexpr double kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03;  // for values 0..1
  const std::vector<double> box(kWindow, 1.0 / kWindow);
  const int width = a[0].width(), height = a[0].height();
  Plane map(width, height, 1);
  const auto windowMean = [&](const Plane& p, const Plane& q) {
    Plane product(width, height, 1);
    for (std::size_t i = 0; i < product.data().size(); ++i) product.data()[i] = p.data()[i] * q.data()[i];
    return filtered(product, box, box, mirrorIndex);
  };
  for (int c = 0; c < 3; ++c) {
    const Plane mean_a = filtered(a[c], box, box, mirrorIndex), mean_b = filtered(b[c], box, box, mirrorIndex);
    const Plane aa = windowMean(a[c], a[c]), bb = windowMean(b[c], b[c]), ab = windowMean(a[c], b[c]);
    for (std::size_t i = 0; i < map.data().size(); ++i) {
      const double ma = mean_a.data()[i], mb = mean_b.data()[i];
      const double va = kSample * (aa.data()[i] - ma * ma), vb = kSample * (bb.data()[i] - mb * mb);
      const double vab = kSample * (ab.data()[i] - ma * mb);
      map.data()[i] += (2 * ma * mb + kC1) * (2 * vab + kC2) / ((ma * ma + mb * mb + kC1) * (va + vb + kC2)) / 3;
    }
  }
  return map;
}

// Linear Rec.709 to XYZ, D65, as the paper has it.
const Mat3 kXyzFromRgb{{Vec3{10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794},
                        Vec3{2613072.0 / 12288897, 8788810.0 / 12288897, 887015.0 / 12288897},
                        Vec3{1425312.0 / 73733382, 8788810.0 / 73733382, 70074185.0 / 73733382}}};
const Vec3 kWhiteXyz = kXyzFromRgb * Vec3{1, 1, 1};
const Mat3 kRgbFromXyz = inverse(kXyzFromRgb);

/// The opponent space in which the eye's contrast sensitivity is given; linear in the colour.
Vec3 opponentFromRgb(const Vec3& rgb) {
  const Vec3 q = (kXyzFromRgb * rgb) / kWhiteXyz;
  return {116 * q.y - 16, 500 * (q.x - q.y), 200 * (q.y - q.z)};
}
Vec3 rgbFromOpponent(const Vec3& o) {
  const double y = (o.x + 16) / 116;
  return kRgbFromXyz * (Vec3{y + o.y / 500, y, y - o.z / 200} * kWhiteXyz);
}
/// CIELAB with chroma scaled by lightness (the Hunt effect).
Vec3 huntLab(const Vec3& rgb) {
  const Vec3 q = (kXyzFromRgb * rgb) / kWhiteXyz;
  const auto f = [](double t) {
    constexpr double kDelta = 6.0 / 29;
    return t > kDelta * kDelta * kDelta ? std::cbrt(t) : t / (3 * kDelta * kDelta) + 4.0 / 29;
  };
  const double lightness = 116 * f(q.y) - 16;
  return {lightness, 0.01 * lightness * 500 * (f(q.x) - f(q.y)), 0.01 * lightness * 200 * (f(q.y) - f(q.z))};
}
double hyab(const Vec3& a, const Vec3& b) {
  return std::fabs(a.x - b.x) + std::hypot(a.y - b.y, a.z - b.z);
}

constexpr double kPixelsPerDegree = 0.7 * 3840 / 0.7 * kPi / 180;  // 0.7 m from a display 0.7 m and 3840 pixels wide
constexpr double kColourExponent = 0.7, kFeatureExponent = 0.5;    // q_c, q_f
constexpr double kBend = 0.4, kBendValue = 0.95;  // p_c, p_t: where the colour error is bent, and its value
constexpr double kFeatureWidth = 0.082;           // degrees

/// Values of `f` at pixels -radius..radius.
template <class Function>
std::vector<double> sampled(int radius, const Function& f) {
  std::vector<double> values(2 * radius + 1);
  for (int i = -radius; i <= radius; ++i) values[i + radius] = f(static_cast<double>(i));
  return values;
}
double sumOf(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v;
  return sum;
}
std::vector<double> scaled(std::vector<double> values, double factor) {
  for (double& v : values) v *= factor;
  return values;
}
/// Positive values made to sum to 1 and negative ones to -1.
std::vector<double> balanced(std::vector<double> values) {
  double positive = 0, negative = 0;
  for (const double v : values) (v > 0 ? positive : negative) += v;
  for (double& v : values) v /= v > 0 ? positive : -negative;
  return values;
}

/// What the eye resolves of the linear image, as linear RGB again (section 4.1.1).
Planes seenColours(const Planes& opponent) {
  constexpr double kWidest = 0.04;  // of the b below
  const int radius = static_cast<int>(std::ceil(3 * std::sqrt(kWidest / (2 * kPi * kPi)) * kPixelsPerDegree));
  const auto gaussian = [&](double b) {
    return sampled(radius, [&](double i) { return std::exp(-square(kPi * i / kPixelsPerDegree) / b); });
  };
  const auto single = [&](const Plane& plane, double b) {
    const auto g = gaussian(b);
    return filtered(plane, scaled(g, 1 / sumOf(g)), scaled(g, 1 / sumOf(g)), clampIndex);
  };
  // The blue-yellow channel is a sum of two. Amplitudes are a sqrt(pi / b), as in the authors' program.
  const auto narrow = gaussian(0.025), wide = gaussian(0.04);
  const double narrow_amplitude = 13.5 * std::sqrt(kPi / 0.025), wide_amplitude = 34.1 * std::sqrt(kPi / 0.04);
  const double total = narrow_amplitude * square(sumOf(narrow)) + wide_amplitude * square(sumOf(wide));
  Planes seen{single(opponent[0], 0.0047), single(opponent[1], 0.0053),
              filtered(opponent[2], narrow, scaled(narrow, narrow_amplitude / total), clampIndex)};
  const Plane second = filtered(opponent[2], wide, scaled(wide, wide_amplitude / total), clampIndex);
  for (std::size_t i = 0; i < second.data().size(); ++i) {
    const Vec3 rgb = rgbFromOpponent({seen[0].data()[i], seen[1].data()[i], seen[2].data()[i] + second.data()[i]});
    for (int c = 0; c < 3; ++c) seen[c].data()[i] = std::clamp(rgb[c], 0.0, 1.0);
  }
  return seen;
}

struct Features {
  Plane edge_x, edge_y, point_x, point_y;
  double edges(std::size_t i) const { return std::hypot(edge_x.data()[i], edge_y.data()[i]); }
  double points(std::size_t i) const { return std::hypot(point_x.data()[i], point_y.data()[i]); }
};
/// Edges and points of the lightness by the first and second derivatives of a Gaussian (section 4.2).
Features features(const Plane& lightness) {
  constexpr double kSigma = 0.5 * kFeatureWidth * kPixelsPerDegree;
  const int radius = static_cast<int>(std::ceil(3 * kSigma));
  const auto g = [&](double x) { return std::exp(-square(x / kSigma) / 2); };
  auto smooth = sampled(radius, g);
  smooth = scaled(smooth, 1 / sumOf(smooth));
  const auto first = balanced(sampled(radius, [&](double x) { return -x * g(x); }));
  const auto second = balanced(sampled(radius, [&](double x) { return (square(x / kSigma) - 1) * g(x); }));
  return {filtered(lightness, first, smooth, clampIndex), filtered(lightness, smooth, first, clampIndex),
          filtered(lightness, second, smooth, clampIndex), filtered(lightness, smooth, second, clampIndex)};
}

/// FLIP per pixel of linear images within 0..1.
ImageF flipMap(const Planes& image, const Planes& reference) {
  const int width = reference[0].width(), height = reference[0].height();
  const auto opponent = [&](const Planes& rgb) {
    Planes planes{Plane(width, height, 1), Plane(width, height, 1), Plane(width, height, 1)};
    for (std::size_t i = 0; i < rgb[0].data().size(); ++i) {
      const Vec3 o = opponentFromRgb({rgb[0].data()[i], rgb[1].data()[i], rgb[2].data()[i]});
      for (int c = 0; c < 3; ++c) planes[c].data()[i] = o[c];
    }
    return planes;
  };
  const auto lightness = [](Plane y) {
    for (double& v : y.data()) v = (v + 16) / 116;
    return y;
  };
  const Planes opponent_a = opponent(image), opponent_b = opponent(reference);
  const Planes seen_a = seenColours(opponent_a), seen_b = seenColours(opponent_b);
  const Features features_a = features(lightness(opponent_a[0])), features_b = features(lightness(opponent_b[0]));
  const double largest = std::pow(hyab(huntLab({0, 1, 0}), huntLab({0, 0, 1})), kColourExponent);
  ImageF map(width, height, 1);
  forRows(height, [&](int y) {
    for (std::size_t i = static_cast<std::size_t>(y) * width, end = i + width; i < end; ++i) {
      const auto lab = [&](const Planes& p) { return huntLab({p[0].data()[i], p[1].data()[i], p[2].data()[i]}); };
      const double raw = std::pow(hyab(lab(seen_a), lab(seen_b)), kColourExponent), bend = kBend * largest;
      const double colour =
          raw < bend ? kBendValue / bend * raw : kBendValue + (raw - bend) / (largest - bend) * (1 - kBendValue);
      const double feature = std::max(std::fabs(features_a.edges(i) - features_b.edges(i)),
                                      std::fabs(features_a.points(i) - features_b.points(i)));
      map.data()[i] = static_cast<float>(
          std::pow(colour, 1 - std::pow(std::clamp(feature / std::sqrt(2.0), 0.0, 1.0), kFeatureExponent)));
    }
  });
  return map;
}

/// The value below which `share` of the values lie, linear between ranks.
double percentile(std::vector<double> values, double share) {
  const double rank = share * static_cast<double>(values.size() - 1);
  const auto low = static_cast<std::size_t>(rank);
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(low), values.end());
  const double a = values[low];
  if (low + 1 == values.size()) return a;
  const double b = *std::min_element(values.begin() + static_cast<std::ptrdiff_t>(low) + 1, values.end());
  return lerp(a, b, rank - static_cast<double>(low));
}

/// One step of erosion by the four neighbours; beyond the border is outside.
Image8 eroded(const Image8& in) {
  Image8 out(in.width(), in.height(), 1);
  for (int y = 1; y + 1 < in.height(); ++y)
    for (int x = 1; x + 1 < in.width(); ++x)
      out.at(x, y) = in.at(x, y) && in.at(x - 1, y) && in.at(x + 1, y) && in.at(x, y - 1) && in.at(x, y + 1);
  return out;
}

std::string sizeText(const ImageF& image) {
  return std::to_string(image.width()) + " x " + std::to_string(image.height());
}

/// RGB of a grey, RGB or RGBA image.
Planes colourPlanes(const ImageF& image) {
  Planes planes;
  for (int c = 0; c < 3; ++c) {
    planes[c] = Plane(image.width(), image.height(), 1);
    const int channel = image.channels() < 3 ? 0 : c;
    for (int y = 0; y < image.height(); ++y)
      for (int x = 0; x < image.width(); ++x) planes[c].at(x, y) = image.at(x, y, channel);
  }
  return planes;
}

double brightest(const Planes& p, std::size_t i) {
  return maxComponent({p[0].data()[i], p[1].data()[i], p[2].data()[i]});
}

/// The pixels that count as inside: none where nothing is.
Image8 insideOf(const ImageF& mask, const Planes& reference) {
  Image8 whole(reference[0].width(), reference[0].height(), 1);
  for (std::size_t i = 0; i < whole.data().size(); ++i)
    whole.data()[i] = mask.empty() ? brightest(reference, i) > 0 : mask.data()[i * mask.channels()] > 0.999f;
  Image8 inside = eroded(eroded(whole));
  const auto count = [](const Image8& m) { return std::count(m.data().begin(), m.data().end(), 1); };
  if (count(inside) < 50) inside = whole;
  if (count(inside) == 0 && !mask.empty())
    throw badInput("mask", "holds no pixel above 0.999, expected the object's coverage; choose another mask");
  return count(inside) ? inside : Image8();
}

}  // namespace

ImageDifference compareImages(const ImageF& image, const ImageF& reference, const ImageF& mask) {
  if (image.width() != reference.width() || image.height() != reference.height())
    throw badInput("image", "is " + sizeText(image) + " and the reference " + sizeText(reference) +
                                ", expected the same size; render or crop one to the other");
  if (!mask.empty() && (mask.width() != reference.width() || mask.height() != reference.height()))
    throw badInput("mask",
                   "is " + sizeText(mask) + " and the reference " + sizeText(reference) + ", expected the same size");
  ImageDifference result;
  Planes a = colourPlanes(image);
  const Planes b = colourPlanes(reference);
  const std::size_t count = b[0].data().size();
  for (std::size_t i = 0; i < count; ++i) {
    const auto finite = [&](const Planes& p) { return isFinite(Vec3{p[0].data()[i], p[1].data()[i], p[2].data()[i]}); };
    if (!finite(b)) throw badInput("reference", "holds NaN or Inf, expected finite values; choose a clean reference");
    result.not_finite += !finite(a);
    for (int c = 0; c < 3; ++c)
      if (!std::isfinite(a[c].data()[i])) a[c].data()[i] = 0;
  }

  Image8 inside = insideOf(mask, b);
  if (inside.empty()) inside = Image8(reference.width(), reference.height(), 1, 1);  // a black reference without a mask
  std::vector<double> levels;
  for (std::size_t i = 0; i < count; ++i)
    if (inside.data()[i]) levels.push_back(brightest(b, i));
  result.peak = percentile(levels, 0.999);
  result.white = percentile(levels, 0.99);
  if (!(result.peak > 0)) result.peak = result.white = 1;
  if (!(result.white > 0)) result.white = result.peak;

  const auto displayed = [&](const Planes& linear, bool encode) {
    Planes out = linear;
    for (Plane& plane : out)
      for (double& v : plane.data()) {
        v = std::clamp(v / result.white, 0.0, 1.0);
        if (encode) v = srgbFromLinear(static_cast<float>(v));
      }
    return out;
  };
  const Plane ssim = ssimMap(displayed(a, true), displayed(b, true));
  result.flip_map = flipMap(displayed(a, false), displayed(b, false));

  const auto figures = [&](bool all) {
    MetricFigures f;
    double squared = 0;
    for (std::size_t i = 0; i < count; ++i) {
      if (!all && !inside.data()[i]) continue;
      ++f.pixels;
      for (int c = 0; c < 3; ++c) {
        const double r = b[c].data()[i], error = square(a[c].data()[i] - r);
        squared += error;
        f.relative_mse += error / (r * r + square(result.peak / 100));
      }
      f.ssim += ssim.data()[i];
      f.flip += result.flip_map.data()[i];
    }
    const double n = static_cast<double>(f.pixels);
    f.psnr = 10 * std::log10(square(result.peak) / std::max(squared / (3 * n), 1e-20));
    f.relative_mse /= 3 * n;
    f.ssim /= n;
    f.flip /= n;
    return f;
  };
  result.inside = figures(false);
  result.full = figures(true);
  double sum_a = 0, sum_b = 0;
  for (int c = 0; c < 3; ++c)
    for (std::size_t i = 0; i < count; ++i)
      if (inside.data()[i]) sum_a += a[c].data()[i], sum_b += b[c].data()[i];
  result.bias = (sum_a - sum_b) / std::max(sum_b, 1e-12);

  std::vector<double> errors;
  for (std::size_t i = 0; i < count; ++i) {
    const double truth = brightest(b, i);
    if (!(truth > 0 || brightest(a, i) > 0)) continue;
    double largest = 0;
    for (int c = 0; c < 3; ++c) largest = std::max(largest, std::fabs(a[c].data()[i] - b[c].data()[i]));
    errors.push_back(largest / (std::max(truth, 0.0) + result.peak / 100));
  }
  for (const double error : errors) result.relative_error += error / static_cast<double>(errors.size());
  if (!errors.empty()) result.relative_error_tail = percentile(errors, 0.999);
  return result;
}

}  // namespace srf
