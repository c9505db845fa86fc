// Random deformations of small fields: compositions of all kinds, amplitudes from nothing to absurd, objects far from
// the origin, tiny and huge. 200 of them, 10,000 with SRF_NIGHTLY=1.
#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "render/frame_renderer.h"
#include "tests/support/formula_field.h"
#include "tests/support/hard_case.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

using test::atMost;
using test::recordHardCase;

constexpr double kAlbedo = 0.6;
constexpr int kPicture = 16;

class Draw {
 public:
  explicit Draw(int seed) : engine_(static_cast<std::uint64_t>(seed)) {}
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) * 0x1p-53);
  }
  int below(int count) { return static_cast<int>(engine_() % static_cast<std::uint64_t>(count)); }
  double magnitude(double low, double high) { return std::pow(10, uniform(low, high)); }
  Vec3 direction() {
    const double z = uniform(-1, 1), phi = uniform(0, 2 * kPi), r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
  }

 private:
  std::mt19937_64 engine_;
};

std::string text(double x) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, "%.17g", x);
  return buffer;
}
std::string text(const Vec3& a) {
  return "[" + text(a.x) + "," + text(a.y) + "," + text(a.z) + "]";
}

// One step for an object of the given middle and size (half its extent).
std::string drawStep(Draw& draw, const Vec3& middle, double size) {
  const double sign = draw.below(2) ? 1 : -1, amount = sign * draw.magnitude(-8, 3);
  const Vec3 origin = middle + draw.uniform(0, 1.5) * size * draw.direction();
  const std::string around = R"("origin": )" + text(origin) + R"(, "axis": )" + text(draw.direction());
  switch (draw.below(7)) {
    case 0: {  // anything affine, scaled by 1e-6 to 1e6, sent up to 1e6 away
      Mat3 m;
      for (Vec3& row : m.row) row += std::min(std::fabs(amount), 10.0) * draw.direction();
      const double scale = draw.magnitude(-6, 6);
      const Vec3 offset = draw.magnitude(-3, 6) * draw.direction() - scale * (m * middle);
      std::string matrix;
      for (int i = 0; i < 3; ++i) {
        const Vec3 row = scale * m.row[i];
        matrix += "[" + text(row.x) + "," + text(row.y) + "," + text(row.z) + "," + text(offset[i]) + "],";
      }
      return R"({"type": "affine", "matrix": [)" + matrix + "[0,0,0,1]]}";
    }
    case 1:
      return R"({"type": "twist", )" + around + R"(, "degrees_per_unit": )" + text(100 * amount / size) + "}";
    case 2:
      return R"({"type": "taper", )" + around + R"(, "per_unit": )" + text(amount / size) + "}";
    case 3:
      return R"({"type": "bend", )" + around + R"(, "toward": )" + text(draw.direction()) +
             R"(, "degrees_per_unit": )" + text(60 * amount / size) +
             (draw.below(2) ? R"(, "range": )" + ("[" + text(-0.7 * size) + "," + text(0.5 * size) + "]") : "") + "}";
    case 4:
      return R"({"type": "wave", )" + around + R"(, "direction": )" + text(draw.direction()) + R"(, "amplitude": )" +
             text(0.2 * amount * size) + R"(, "wavelength": )" + text(draw.magnitude(-2, 2) * size) + "}";
    case 5: {
      const int n = 2 + draw.below(3);
      std::string points;
      for (int i = 0; i < n * n * n; ++i) {
        const Vec3 cell{double(i % n), double(i / n % n), double(i / n / n)};
        const Vec3 rest = middle + 1.2 * size * (2.0 / (n - 1) * cell - Vec3{1, 1, 1});
        points += (i ? "," : "") + text(rest + (0.3 * std::fabs(amount) * size) * draw.direction());
      }
      return R"({"type": "ffd", "min": )" + text(middle - 1.2 * size * Vec3{1, 1, 1}) + R"(, "max": )" +
             text(middle + 1.2 * size * Vec3{1, 1, 1}) + R"(, "resolution": )" +
             ("[" + std::to_string(n) + "," + std::to_string(n) + "," + std::to_string(n) + "]") + R"(, "points": [)" +
             points + "]}";
    }
    default:  // a mirror
      return R"({"type": "affine", "matrix": [[-1,0,0,)" + text(2 * middle.x) + "],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}";
  }
}

Deformation psiOf(const std::string& steps) {
  return AnimatedDeformation::parse(parseJson("[" + steps + "]", "drawn"), ".", Reporter::silent()).at(0);
}

// One to four steps, each fitted to what the ones before made of the object.
std::string drawDeformation(Draw& draw, const DeformableModel& model) {
  std::string steps;
  const int count = 1 + draw.below(4);
  for (int i = 0; i < count; ++i) {
    Box<ObjectSpace> box;
    const Deformation so_far = psiOf(steps);
    for (std::size_t k = 0; k < model.size(); k += 7) {
      const auto p = so_far.map(model.p0[k]);
      if (isFinite(p)) box.extend(p);
    }
    const double size = box.empty() ? 1 : 0.3 * box.diameter();
    if (!(size > 1e-12 && size < 1e12)) break;
    const std::string step = drawStep(draw, box.center().raw(), size);
    try {
      psiOf(step);
    } catch (const Error&) {  // a bend toward its axis, a singular matrix: refused by name
      continue;
    }
    steps += (steps.empty() ? "" : ", ") + step;
  }
  return steps;
}

struct Tally {
  double not_finite = 0, weights_off = 0, views_off = 0, unlike_bits = 0, dark = 0, unfolded = 0;
  test::Largest mean_energy, energy;
};

void tryDeformation(const test::FormulaField& field, FrameRenderer& renderer, const std::string& steps, Draw& draw,
                    const FrameLights& sky, Tally& tally) {
  const Deformation psi = psiOf(steps);
  DeformedModel deformed(field.model);
  setThreadCount(1);
  deformed.deform(psi);
  const auto positions = deformed.positions();
  const auto box = deformed.bounds();
  const double size = box.empty() ? 1 : std::max(box.diameter(), 1e-9);
  const Vec3 middle = box.empty() ? Vec3{} : box.center().raw(), away = draw.direction();
  Camera<ObjectSpace> camera;
  camera.lens = pinholeFromFov(kPicture, kPicture, 35);
  const auto pose = lookAt(Point<ObjectSpace>(middle + 1.8 * size * away), Point<ObjectSpace>(middle),
                           Vector<ObjectSpace>(anyPerpendicular(Direction<ObjectSpace>::fromUnit(away)).raw()));
  if (!pose) return;
  camera.pose = *pose;

  const Frame one = renderer.render(camera, deformed, sky);
  const PixelExplanation why = renderer.explain(camera, deformed, sky, kPicture / 2, kPicture / 2);
  setThreadCount(2);
  deformed.deform(psi);
  const Frame two = renderer.render(camera, deformed, sky);
  tally.unlike_bits += one.rgba.data() != two.rgba.data();
  for (std::size_t i = 0; i < positions.size(); ++i)
    tally.unlike_bits += std::memcmp(&positions[i], &deformed.positions()[i], sizeof positions[i]) != 0;

  for (const float value : one.rgba.data()) tally.not_finite += !std::isfinite(value) || value < 0;
  for (const auto& [name, layer] : one.layers) {
    tally.unlike_bits += layer.data() != two.layers.at(name).data();
    for (const float value : layer.data()) tally.not_finite += !std::isfinite(value);
  }
  for (const ExplainedHit& hit : why.hits) {
    double points = 0, views = 0;
    for (int i = 0; i < hit.hit.count; ++i) points += hit.hit.weight[i];
    for (const ChosenView& view : hit.chosen) views += view.weight;
    tally.weights_off += !(std::fabs(points - 1) <= 1e-6);
    tally.views_off += !hit.chosen.empty() && !(std::fabs(views - 1) <= 1e-9);
  }
  const DeformedStatistics& statistics = deformed.statistics();
  const bool folds = statistics.not_finite > 0 || statistics.collapsed > 0 ||
                     (statistics.mirrored > 0 && statistics.mirrored < field.model.size());
  if (folds) return;
  double sum = 0, count = 0;
  for (int i = 0; i < kPicture * kPicture; ++i) {
    // Surfels smaller than a pixel have several samples in it, so that the rim is covered in part.
    const double alpha = one.rgba.data()[4 * i + 3];
    if (alpha == 0) continue;
    const double value = one.rgba.data()[4 * i + 1] / (alpha * kAlbedo);
    if (value == 0)
      ++tally.dark;  // no photograph covers it
    else
      tally.energy.add(std::fabs(value - 1));
    sum += value, ++count;
  }
  if (count >= 20) tally.mean_energy.add(std::fabs(sum / count - 1));
  tally.unfolded += count >= 20;
}

TEST(Stress, RandomDeformationsKeepFinitePicturesTheirEnergyAndTheirBits) {
  const test::TemporaryFolder folder;
  const auto lambert = [](const Vec3& n, const Vec3& l, const Vec3&) {
    return (kAlbedo / kPi * std::max(0.0, dot(n, l))) * Vec3{1, 1, 1};
  };
  std::vector<test::FormulaField> fields;
  for (const bool surfels : {false, true})
    for (const auto& [middle, radius] : {std::pair{Vec3{}, 1.0}, {Vec3{1e6, -1e6, 1e6}, 1.0}, {Vec3{}, 1e-3}}) {
      test::FormulaFieldOptions options{.views = 20, .lights = 64, .size = 40, .subdivision = 4};
      options.middle = middle;
      options.radius = radius;
      options.model.kind = surfels ? ModelKind::surfels : ModelKind::mesh;
      options.model.surfels = 250;  // an absurd pose splits each into 343, all across one pixel
      fields.push_back(
          test::makeSphereField(folder / ("f" + std::to_string(fields.size()) + ".srf"), options, lambert));
    }
  FrameLights sky;
  sky.distant = sampleEnvironment(ImageF(64, 32, 3, 1.f), 256).lights;
  FrameSettings settings;
  for (const std::string& layer : knownLayers()) settings.layers.insert(layer);
  std::vector<std::unique_ptr<FrameRenderer>> renderers;
  for (const auto& field : fields)
    renderers.push_back(
        std::make_unique<FrameRenderer>(field.folder, field.manifest, field.model, settings, Reporter::silent()));

  Tally all;
  const int trials = test::sized(200, 10000);
  for (int trial = 0; trial < trials; ++trial) {
    Draw draw(trial);
    const std::size_t which = static_cast<std::size_t>(trial) % fields.size();
    const std::string steps = drawDeformation(draw, fields[which].model);
    Tally before = all;
    tryDeformation(fields[which], *renderers[which], steps, draw, sky, all);
    if (all.not_finite != before.not_finite || all.weights_off != before.weights_off ||
        all.views_off != before.views_off || all.unlike_bits != before.unlike_bits || all.energy.value > 0.02)
      ADD_FAILURE() << "trial " << trial << ", field " << which << ", energy off by " << all.energy.value << ": "
                    << steps.substr(0, 3000);
    if (HasFailure() && trial > 20) break;
  }
  setThreadCount(0);
  std::printf("%.0f of %d pictures without folds; %.0f of their pixels that no photograph covers\n", all.unfolded,
              trials, all.dark);
  EXPECT_GT(all.unfolded, trials / 8) << "hardly any deformation had no folds";
  recordHardCase(43, "200 (nightly 10,000) drawn deformations: values that are negative, NaN or infinite",
                 all.not_finite, atMost(0));
  recordHardCase(43, "drawn deformations: hits whose weights of points do not sum to one", all.weights_off, atMost(0));
  recordHardCase(43, "drawn deformations: hits whose weights of views do not sum to one", all.views_off, atMost(0));
  recordHardCase(43, "drawn deformations, 1 and 2 threads: positions, layers and pictures whose bits differ",
                 all.unlike_bits, atMost(0));
  recordHardCase(43, "drawn deformations without folds, white furnace: largest error of a picture's mean",
                 all.mean_energy.value, atMost(0.005));
  recordHardCase(43, "drawn deformations without folds, white furnace: largest error of a pixel", all.energy.value,
                 atMost(0.02));
}

}  // namespace
}  // namespace srf
