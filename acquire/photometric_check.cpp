// Photometric stereo turned round: with the surface roughly known, each light's own photographs tell where it stood.
#include "acquire/photometric_check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <opencv2/core.hpp>
#include <set>

#include "base/numeric.h"
#include "base/parallel.h"
#include "base/ray_scene.h"

namespace srf {
namespace {

using Point3 = Point<AcquisitionSpace>;

constexpr std::size_t kPoints = 1200;       // of the surface, compared between views
constexpr std::size_t kMostSamples = 2000;  // of a light, in its fit
constexpr std::size_t kFewest = 40;         // samples below which a light tells nothing
constexpr std::size_t kFewestInPhoto = 16;  // samples below which a photograph tells nothing
constexpr double kSteep = 0.35;             // cosine to the camera below which a point is left out
constexpr double kClearGain = 0.1;          // of correlation
constexpr double kClearShare = 0.6;         // of what the fit left unexplained, at most this remains
constexpr double kGoodFit = 0.5;            // correlation that a mended table must reach
constexpr double kBeyondDoubt = 0.98;       // correlation at which no better place is looked for
constexpr double kStray = 15;               // degrees
constexpr int kDirections = 1500;           // tried for a stray light: 3 degrees apart
constexpr std::size_t kMostGains = 256;     // views solved for one by one; more are taken in runs

/// A surface point in one view.
struct Sample {
  std::size_t view = 0, point = 0;
  Vec3 x, n;
  Vec2 pixel;               // of the photograph
  std::vector<double> lit;  // radiance over irradiance under each photograph of the view; NaN where there is none
  double sum = 0;           // of them
};

double bilinear(const SmallPhoto& photo, const Vec2& pixel) {
  const double x = std::clamp(pixel.x / photo.step - 0.5, 0.0, photo.width - 1.0),
               y = std::clamp(pixel.y / photo.step - 0.5, 0.0, photo.height - 1.0);
  const int x0 = std::min(static_cast<int>(x), std::max(0, photo.width - 2)),
            y0 = std::min(static_cast<int>(y), std::max(0, photo.height - 2));
  const int x1 = std::min(x0 + 1, photo.width - 1), y1 = std::min(y0 + 1, photo.height - 1);
  const auto at = [&](int i, int j) {
    return static_cast<double>(photo.luminance[static_cast<std::size_t>(j) * photo.width + i]);
  };
  return lerp(lerp(at(x0, y0), at(x1, y0), x - x0), lerp(at(x0, y1), at(x1, y1), x - x0), y - y0);
}

/// Whether the mask is white at a pixel and two blocks of the small photograph around it.
bool wellInside(const Image8& mask, const Intrinsics& lens, const Vec2& pixel, int step) {
  const int factor = (lens.width + mask.width() - 1) / mask.width();
  const double reach = 1.5 * step / factor;
  for (const double dx : {-reach, 0.0, reach})
    for (const double dy : {-reach, 0.0, reach}) {
      const int x = static_cast<int>(std::floor(pixel.x / factor + dx)),
                y = static_cast<int>(std::floor(pixel.y / factor + dy));
      if (x < 0 || y < 0 || x >= mask.width() || y >= mask.height() || mask.at(x, y) < 250) return false;
    }
  return true;
}

double grey(const Vec3& rgb) {
  return (rgb.x + rgb.y + rgb.z) / 3;
}

class Fit {
 public:
  Fit(const Capture& capture, const AcquisitionMesh& hull, const std::vector<std::vector<SmallPhoto>>& photos,
      const std::vector<const Image8*>& masks)
      : capture_(capture), photos_(photos), center_(hull.bounds().center()) {
    gather(hull, masks);
    for (const CaptureLight& light : capture.lights) {
      const double reach = light.kind == LightKind::point ? distance(light.position, center_) : 0;
      radius_.push_back(reach);
      told_.push_back(light.directionFrom(center_).raw());
    }
    entries_.resize(capture.lights.size());
    for (std::size_t s = 0; s < samples_.size(); ++s) {
      const auto& of = capture.views[samples_[s].view].photos;
      for (std::size_t p = 0; p < of.size(); ++p)
        if (of[p].light && std::isfinite(samples_[s].lit[p])) entries_[of[p].light->value].push_back({s, p});
    }
    for (auto& list : entries_) {  // every so manyth where there are too many
      const std::size_t stride = (list.size() + kMostSamples - 1) / kMostSamples;
      if (stride < 2) continue;
      std::vector<Entry> kept;
      for (std::size_t i = 0; i < list.size(); i += stride) kept.push_back(list[i]);
      list = std::move(kept);
    }
    useTable(told_);
  }

  const std::vector<Sample>& samples() const { return samples_; }
  const std::vector<Vec3>& told() const { return told_; }
  bool tells(std::size_t light) const { return entries_[light].size() >= kFewest; }

  /// Takes these directions as those of the lights: the sum over them is what albedo is divided out by.
  void useTable(const std::vector<Vec3>& directions) {
    table_ = directions;
    expected_.assign(samples_.size(), 0);
    parallelFor(samples_.size(), 64, [&](std::size_t begin, std::size_t end) {
      for (std::size_t s = begin; s < end; ++s) {
        const auto& of = capture_.views[samples_[s].view].photos;
        for (std::size_t p = 0; p < of.size(); ++p)
          if (of[p].light && std::isfinite(samples_[s].lit[p]))
            expected_[s] += shading(samples_[s], of[p].light->value, table_[of[p].light->value]);
      }
    });
  }

  /// How a light's photographs go with the shading that it would cast from there: their correlation over all samples.
  double score(std::size_t light, const Vec3& direction) const {
    Correlation sum;
    for (const Entry& e : entries_[light]) {
      const Sample& s = samples_[e.sample];
      if (!(expected_[e.sample] > 0)) continue;
      sum.add(shading(s, light, direction) / expected_[e.sample], s.lit[e.photo] / s.sum);
    }
    return sum.value();
  }
  /// Radiance summed over the lights of the sample's view over the shading that is to be expected; 0: none is.
  double perShading(std::size_t sample) const {
    return expected_[sample] > 0.2 ? samples_[sample].sum / expected_[sample] : 0;
  }
  double scoreAsTold(std::size_t light) const { return score(light, table_[light]); }

  /// The same for one photograph when it is looked up at other pixels.
  template <class Turn>
  double photoScore(std::size_t view, std::size_t photo, const std::vector<std::size_t>& of_view,
                    const Turn& turn) const {
    const SmallPhoto& small = photos_[view][photo];
    const std::size_t light = capture_.views[view].photos[photo].light->value;
    Correlation sum;
    std::size_t lit = 0;
    for (const std::size_t s : of_view) {
      if (!(expected_[s] > 0)) continue;
      const double shaded = shading(samples_[s], light, table_[light]);
      lit += shaded > 0.2;
      sum.add(shaded / expected_[s] * samples_[s].sum, bilinear(small, turn(samples_[s].pixel)));
    }
    return of_view.size() < kFewestInPhoto || 3 * lit < of_view.size() ? NAN : sum.value();
  }

 private:
  struct Entry {
    std::size_t sample, photo;
  };
  struct Correlation {
    double n = 0, x = 0, y = 0, xx = 0, yy = 0, xy = 0;
    void add(double a, double b) { n += 1, x += a, y += b, xx += a * a, yy += b * b, xy += a * b; }
    double value() const {
      const double vx = xx - x * x / n, vy = yy - y * y / n;
      return n > 2 && vx > 1e-12 * xx && vy > 1e-12 * yy ? (xy - x * y / n) / std::sqrt(vx * vy) : 0;
    }
  };

  /// Lambert's cosine, of a point light with its falloff against that at the object's centre.
  double shading(const Sample& s, std::size_t light, const Vec3& direction) const {
    const double r = radius_[light];
    if (!(r > 0)) return std::max(0.0, dot(s.n, direction));
    const Vec3 to = center_.raw() + r * direction - s.x;
    const double d2 = dot(to, to);
    return std::max(0.0, dot(s.n, to)) * r * r / (d2 * std::sqrt(d2));
  }

  void gather(const AcquisitionMesh& hull, const std::vector<const Image8*>& masks) {
    const auto scene = RayScene<AcquisitionSpace>::ofTriangles(hull.positions, hull.triangles);
    const double off = 0.01 * hull.bounds().diameter();
    const std::size_t stride = std::max<std::size_t>(1, hull.positions.size() / kPoints);
    std::vector<std::vector<Sample>> of_view(capture_.views.size());
    parallelFor(capture_.views.size(), 1, [&](std::size_t v, std::size_t) {
      if (!masks[v]) return;
      const CaptureView& view = capture_.views[v];
      int step = 0;
      for (const SmallPhoto& p : photos_[v]) step = std::max(step, p.step);
      for (std::size_t i = 0; i < hull.positions.size() && step > 0; i += stride) {
        const Point3 x = hull.positions[i];
        const Vec3 n = hull.normals[i].raw();
        const auto to_camera = view.camera.viewDirection(x);
        if (dot(n, to_camera.raw()) < kSteep) continue;
        const auto seen = view.camera.project(x);
        if (!seen || !wellInside(*masks[v], view.camera.lens, seen->pixel, step)) continue;
        const Ray<AcquisitionSpace> ray{x + off * Vector<AcquisitionSpace>(n), to_camera};
        if (scene.occluded(ray, 0, INFINITY)) continue;
        Sample s{v, i, x.raw(), n, seen->pixel, {}, 0};
        for (std::size_t p = 0; p < view.photos.size(); ++p) {
          double value = NAN;
          if (!photos_[v][p].empty() && view.photos[p].light) {
            const double e = grey(capture_.lights[view.photos[p].light->value].irradianceAt(x));
            if (e > 0) value = bilinear(photos_[v][p], seen->pixel) / e;
          }
          s.lit.push_back(value);
          if (std::isfinite(value)) s.sum += value;
        }
        if (s.sum > 0) of_view[v].push_back(std::move(s));
      }
    });
    for (auto& list : of_view) std::move(list.begin(), list.end(), std::back_inserter(samples_));
  }

  const Capture& capture_;
  const std::vector<std::vector<SmallPhoto>>& photos_;
  Point3 center_;
  std::vector<Sample> samples_;
  std::vector<double> radius_;               // of each light: to the centre; 0: directional
  std::vector<Vec3> told_, table_;           // direction of each light from the centre
  std::vector<double> expected_;             // of each sample: sum of the shading under its view's lights
  std::vector<std::vector<Entry>> entries_;  // of each light
};

bool clearlyBetter(double after, double before) {
  return after >= kGoodFit && after - before >= kClearGain && 1 - after <= kClearShare * (1 - before);
}

/// All 48 signed permutations, the identity first.
std::vector<Mat3> axisChanges() {
  std::vector<Mat3> all;
  std::array<int, 3> order{0, 1, 2};
  do
    for (int signs = 0; signs < 8; ++signs) {
      Mat3 m{{Vec3{}, Vec3{}, Vec3{}}};
      for (int i = 0; i < 3; ++i) m.row[i][order[i]] = signs >> i & 1 ? -1 : 1;
      all.push_back(m);
    }
  while (std::next_permutation(order.begin(), order.end()));
  return all;
}

std::vector<Vec3> turned(const Mat3& m, const std::vector<Vec3>& directions) {
  std::vector<Vec3> out;
  for (const Vec3& d : directions) out.push_back(m * d);
  return out;
}

double medianScore(const Fit& fit, std::size_t lights) {
  std::vector<double> scores(lights, NAN);
  parallelFor(lights, 1, [&](std::size_t l, std::size_t) {
    if (fit.tells(l)) scores[l] = fit.scoreAsTold(l);
  });
  std::erase_if(scores, [](double s) { return std::isnan(s); });
  return median(scores);
}

/// Lights that share a view with each: those whose photographs may have been exchanged with its own.
std::vector<std::set<std::size_t>> companions(const Capture& capture) {
  std::vector<std::set<std::size_t>> out(capture.lights.size());
  for (const CaptureView& view : capture.views)
    for (const Photo& a : view.photos)
      for (const Photo& b : view.photos)
        if (a.light && b.light) out[a.light->value].insert(b.light->value);
  return out;
}

void findForeignLights(const Capture& capture, const Fit& fit, const std::vector<Vec3>& table,
                       PhotometricReport& report) {
  const std::size_t count = capture.lights.size();
  const auto others = companions(capture);
  std::vector<std::optional<ForeignLight>> foreign(count);
  std::vector<std::optional<StrayLight>> stray(count);
  parallelFor(count, 1, [&](std::size_t l, std::size_t) {
    if (!fit.tells(l)) return;
    const double before = fit.scoreAsTold(l);
    if (before > kBeyondDoubt) return;
    double best = before;
    std::size_t at = l;
    for (const std::size_t k : others[l])
      if (const double s = fit.score(l, table[k]); s > best) best = s, at = k;
    Vec3 direction = table[at];
    double free = best;
    for (int i = 0; i < kDirections; ++i) {
      const double z = 1 - (2 * i + 1.0) / kDirections, r = std::sqrt(1 - z * z), turn = i * kPi * (3 - std::sqrt(5.0));
      const Vec3 d{r * std::cos(turn), r * std::sin(turn), z};
      if (const double s = fit.score(l, d); s > free) free = s, direction = d;
    }
    // Of another light's place it must be as good as of any place at all.
    const double off = degrees(angleBetweenUnit(direction, table[l]));
    if (at != l && clearlyBetter(best, before) && degrees(angleBetweenUnit(direction, table[at])) < 0.5 * off)
      foreign[l] =
          ForeignLight{LightId{static_cast<std::uint32_t>(l)}, LightId{static_cast<std::uint32_t>(at)}, before, best};
    else if (off > kStray && clearlyBetter(free, before))
      stray[l] = StrayLight{LightId{static_cast<std::uint32_t>(l)}, Direction<AcquisitionSpace>::fromUnit(direction),
                            off, before, free};
  });
  for (std::size_t l = 0; l < count; ++l) {
    if (foreign[l]) report.foreign.push_back(*foreign[l]);
    if (stray[l]) report.stray.push_back(*stray[l]);
  }
}

void findTurnedPhotos(const Capture& capture, const Fit& fit, PhotometricReport& report) {
  struct Turn {
    const char* how;
    bool swaps, flip_x, flip_y;  // where the true pixel (x, y) stands in the file: swapped first, then flipped
  };
  static constexpr Turn kTurns[] = {{"turned by 180 degrees", false, true, true},
                                    {"turned by 90 degrees clockwise", true, true, false},
                                    {"turned by 90 degrees counter-clockwise", true, false, true},
                                    {"mirrored left to right", false, true, false},
                                    {"mirrored top to bottom", false, false, true}};
  std::vector<std::vector<std::size_t>> of_view(capture.views.size());
  for (std::size_t s = 0; s < fit.samples().size(); ++s) of_view[fit.samples()[s].view].push_back(s);
  std::vector<std::vector<TurnedPhoto>> found(capture.views.size());
  parallelFor(capture.views.size(), 1, [&](std::size_t v, std::size_t) {
    const CaptureView& view = capture.views[v];
    const double w = view.camera.lens.width, h = view.camera.lens.height;
    for (std::size_t p = 0; p < view.photos.size(); ++p) {
      if (!view.photos[p].light || of_view[v].empty() || !std::isfinite(fit.samples()[of_view[v][0]].lit[p])) continue;
      const double before = fit.photoScore(v, p, of_view[v], [](const Vec2& q) { return q; });
      if (!(before < 0.7)) continue;
      TurnedPhoto best{v, p, "", before, before};
      for (const Turn& turn : kTurns) {
        if (turn.swaps && w != h) continue;
        const double after = fit.photoScore(v, p, of_view[v], [&](const Vec2& q) {
          Vec2 at = turn.swaps ? Vec2{q.y, q.x} : q;
          if (turn.flip_x) at.x = w - at.x;
          if (turn.flip_y) at.y = h - at.y;
          return at;
        });
        if (after > best.after) best.after = after, best.how = turn.how;
      }
      if (!best.how.empty() && best.after > 0.7 && best.after - before > 0.25) found[v].push_back(best);
    }
  });
  for (auto& list : found) std::move(list.begin(), list.end(), std::back_inserter(report.turned));
}

/// What is compared between the views of a point: the median over the lights of its radiance against that of the other
/// views under the same light, which highlights under a few lights leave alone. Where the views have lights of their
/// own, the sum over the lights as a share of the shading that is to be expected.
std::vector<double> brightnessOf(const Capture& capture, const Fit& fit) {
  std::vector<std::size_t> views_of(capture.lights.size(), 0);
  for (const CaptureView& view : capture.views)
    for (const Photo& photo : view.photos)
      if (photo.light) ++views_of[photo.light->value];
  const bool shared = 2 * *std::min_element(views_of.begin(), views_of.end()) > capture.views.size();
  const std::vector<Sample>& samples = fit.samples();
  std::vector<double> brightness(samples.size(), 0);
  if (!shared) {
    for (std::size_t s = 0; s < samples.size(); ++s) brightness[s] = fit.perShading(s);
    return brightness;
  }
  std::map<std::size_t, std::vector<std::size_t>> of_point;
  for (std::size_t s = 0; s < samples.size(); ++s) of_point[samples[s].point].push_back(s);
  for (const auto& [point, list] : of_point) {
    std::map<std::size_t, std::vector<double>> lit;  // of each light: in each view
    const auto each = [&](std::size_t s, const auto& take) {
      const auto& photos = capture.views[samples[s].view].photos;
      for (std::size_t p = 0; p < photos.size(); ++p)
        if (photos[p].light && std::isfinite(samples[s].lit[p])) take(photos[p].light->value, samples[s].lit[p]);
    };
    for (const std::size_t s : list) each(s, [&](std::size_t l, double v) { lit[l].push_back(v); });
    std::map<std::size_t, double> usual;
    double most = 0;
    for (const auto& [l, values] : lit) most = std::max(most, usual[l] = values.size() >= 3 ? median(values) : 0);
    for (const std::size_t s : list) {
      std::vector<double> ratios;
      each(s, [&](std::size_t l, double v) {
        if (usual[l] > 0.1 * most) ratios.push_back(v / usual[l]);
      });
      brightness[s] = median(ratios);
    }
  }
  return brightness;
}

/// Gains of the views from the points that they share: least squares of log radiance = gain of view + constant of
/// point, the points eliminated, reweighted thrice so that highlights and shadows count little.
void solveGains(const Capture& capture, const Fit& fit, const std::vector<double>& brightness,
                PhotometricReport& report) {
  const std::size_t views = capture.views.size(), groups = std::min(views, kMostGains);
  const auto group = [&](std::size_t view) { return view * groups / views; };
  std::map<std::size_t, std::vector<std::pair<std::size_t, double>>> of_point;  // group, log brightness
  for (std::size_t s = 0; s < fit.samples().size(); ++s)
    if (brightness[s] > 0)
      of_point[fit.samples()[s].point].push_back({group(fit.samples()[s].view), std::log(brightness[s])});
  std::erase_if(of_point, [](const auto& p) { return p.second.size() < 3; });
  std::vector<double> gain(groups, 0);
  std::vector<std::size_t> seen(groups, 0);
  for (int round = 0; round < 4; ++round) {
    cv::Mat a = cv::Mat::ones(static_cast<int>(groups), static_cast<int>(groups), CV_64F) * 1e-3;  // gauge: mean 0
    cv::Mat b = cv::Mat::zeros(static_cast<int>(groups), 1, CV_64F);
    std::fill(seen.begin(), seen.end(), 0);
    for (const auto& [point, list] : of_point) {
      std::vector<double> left;
      for (const auto& [g, value] : list) left.push_back(value - gain[g]);
      const double middle = median(left);
      std::vector<double> weight(list.size());
      double weights = 0, mean = 0;
      for (std::size_t i = 0; i < list.size(); ++i) {
        weight[i] = 1 / (1 + square((left[i] - middle) / 0.05));
        weights += weight[i];
        mean += weight[i] * list[i].second;
      }
      mean /= weights;
      for (std::size_t i = 0; i < list.size(); ++i) {
        const int gi = static_cast<int>(list[i].first);
        ++seen[list[i].first];
        a.at<double>(gi, gi) += weight[i];
        b.at<double>(gi) += weight[i] * (list[i].second - mean);
        for (std::size_t j = 0; j < list.size(); ++j)
          a.at<double>(gi, static_cast<int>(list[j].first)) -= weight[i] * weight[j] / weights;
      }
    }
    for (std::size_t g = 0; g < groups; ++g) a.at<double>(static_cast<int>(g), static_cast<int>(g)) += 1e-6;
    cv::Mat x;
    if (!cv::solve(a, b, x, cv::DECOMP_CHOLESKY)) return;
    for (std::size_t g = 0; g < groups; ++g) gain[g] = x.at<double>(static_cast<int>(g));
  }
  std::vector<double> at, value;
  for (std::size_t g = 0; g < groups; ++g)
    if (seen[g] >= kFewestInPhoto) {
      at.push_back(static_cast<double>(g) / static_cast<double>(groups - 1));
      value.push_back(gain[g]);
    }
  if (at.size() < 6 || 2 * at.size() < groups) return;
  double n = 0, mx = 0, my = 0;
  for (std::size_t i = 0; i < at.size(); ++i) n += 1, mx += at[i], my += value[i];
  mx /= n, my /= n;
  double xx = 0, xy = 0, rest = 0;
  for (std::size_t i = 0; i < at.size(); ++i) xx += square(at[i] - mx), xy += (at[i] - mx) * (value[i] - my);
  const double slope = xy / xx;
  for (std::size_t i = 0; i < at.size(); ++i) rest += square(value[i] - my - slope * (at[i] - mx));
  report.drift = std::exp(slope) - 1;
  report.drift_error = std::sqrt(rest / (n - 2) / xx);
  report.gain.resize(views);
  for (std::size_t v = 0; v < views; ++v) report.gain[v] = std::exp(gain[group(v)]);
}

}  // namespace

std::string axesText(const Mat3& m) {
  static constexpr const char* kNames[] = {"x", "y", "z"};
  std::string text = "(x, y, z) becomes (";
  std::vector<std::string> negated;
  bool diagonal = true;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      if (m.row[i][j] == 0) continue;
      text += std::string(i ? ", " : "") + (m.row[i][j] < 0 ? "-" : "") + kNames[j];
      diagonal &= i == j;
      if (i == j && m.row[i][j] < 0) negated.emplace_back(kNames[i]);
    }
  if (!diagonal || negated.empty()) return text + ")";
  std::string list;
  for (std::size_t i = 0; i < negated.size(); ++i) list += (i ? " and " : "") + negated[i];
  return list + " negated";
}

PhotometricReport checkPhotometry(const Capture& capture, const AcquisitionMesh& hull,
                                  const std::vector<std::vector<SmallPhoto>>& photos,
                                  const std::vector<const Image8*>& masks) {
  PhotometricReport report;
  Fit fit(capture, hull, photos, masks);
  const std::size_t lights = capture.lights.size();
  if (capture.unknownIllumination()) {
    report.why_not = "the light is unknown";
    solveGains(capture, fit, brightnessOf(capture, fit), report);
    return report;
  }
  std::size_t telling = 0;
  for (std::size_t l = 0; l < lights; ++l) telling += fit.tells(l);
  if (telling < 4 || 2 * telling < lights) {
    report.why_not = "too few points of the surface are seen under the same light by the views";
    return report;
  }
  report.fit = medianScore(fit, lights);
  std::vector<Vec3> table = fit.told();
  if (report.fit < kBeyondDoubt) {
    double best = report.fit;
    Mat3 change;
    for (const Mat3& m : axisChanges()) {
      fit.useTable(turned(m, fit.told()));
      if (const double s = medianScore(fit, lights); s > best) best = s, change = m;
    }
    if (clearlyBetter(best, report.fit)) {
      report.axes = change;
      report.axes_fit = best;
      table = turned(change, fit.told());
    }
    fit.useTable(table);
  }
  findForeignLights(capture, fit, table, report);
  for (const ForeignLight& f : report.foreign) table[f.light.value] = fit.told()[f.fits.value];
  if (report.axes)
    for (const ForeignLight& f : report.foreign) table[f.light.value] = *report.axes * fit.told()[f.fits.value];
  for (const StrayLight& s : report.stray) table[s.light.value] = s.seen_from.raw();
  fit.useTable(table);
  findTurnedPhotos(capture, fit, report);
  solveGains(capture, fit, brightnessOf(capture, fit), report);
  return report;
}

}  // namespace srf
