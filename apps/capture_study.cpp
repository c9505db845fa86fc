#include "apps/capture_study.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>
#include <random>
#include <utility>

#include "base/error.h"
#include "base/files.h"
#include "base/json.h"
#include "base/numeric.h"
#include "base/text.h"
#include "field/reflectance_store.h"
#include "render/frame_renderer.h"

namespace srf {
namespace {

constexpr std::size_t kFewest = 4;  // views, or lights: of fewer none is left out
constexpr double kLeastLit = 0.02;  // share of the object that a photograph must show for its prediction to tell

/// How many of `count` are left out: an eighth, of small sets more, so that the mean tells something.
std::size_t leftOutOf(std::size_t count) {
  if (count < kFewest) return 0;
  return std::clamp<std::size_t>(count / 8, std::min<std::size_t>(2, count / 4), 12);
}

/// Which views or lights are there, in the order of the steps: left out, kept by every subset, kept by the first ...
struct Choice {
  std::vector<std::size_t> out;   ///< in no subset
  std::vector<std::size_t> kept;  ///< the first half, or quarter, of these is a subset that is well spread
};

/// At random, for every n-th of a grid would be one of its columns.
Choice choose(const std::vector<std::size_t>& of, const std::vector<Vec3>& directions) {
  std::vector<std::size_t> order(of.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::mt19937_64 random(7);
  for (std::size_t i = 0; i + 1 < order.size(); ++i) std::swap(order[i], order[i + random() % (order.size() - i)]);
  const std::size_t left_out = leftOutOf(of.size());
  Choice choice;
  std::vector<std::size_t> kept;
  std::vector<Vec3> kept_directions;
  for (std::size_t i = 0; i < order.size(); ++i) {
    if (i < left_out) {
      choice.out.push_back(of[order[i]]);
    } else {
      kept.push_back(of[order[i]]);
      kept_directions.push_back(directions[order[i]]);
    }
  }
  for (const std::size_t i : farthestFirst(kept_directions)) choice.kept.push_back(kept[i]);
  return choice;
}

/// The part of the kept ones that a subset of 1 / `divisor` has.
std::size_t thinned(std::size_t kept, int divisor) {
  return (kept + divisor - 1) / static_cast<std::size_t>(divisor);
}

/// What the study looks at.
struct Plan {
  std::vector<std::size_t> views;  ///< with photographs
  Choice view_choice;
  std::vector<Choice> light_choices;  ///< of each list of lights, what no list before it has decided
};

Plan planOf(const SrfManifest& field, const Point<AcquisitionSpace>& middle) {
  Plan plan;
  std::vector<Vec3> directions;
  for (std::size_t v = 0; v < field.views.size(); ++v) {
    if (field.views[v].file.empty()) continue;
    plan.views.push_back(v);
    directions.push_back(field.views[v].camera.viewDirection(middle).raw());
  }
  plan.view_choice = choose(plan.views, directions);
  if (field.unknownIllumination()) return plan;
  std::vector<std::uint8_t> decided(field.lights.size(), 0);
  for (const std::size_t v : plan.views) {
    std::vector<std::size_t> lights;
    std::vector<Vec3> to_lights;
    for (const LightId id : field.views[v].lights) {
      if (std::exchange(decided[id.value], 1)) continue;
      lights.push_back(id.value);
      to_lights.push_back(field.lights[id.value].directionFrom(middle).raw());
    }
    if (!lights.empty()) plan.light_choices.push_back(choose(lights, to_lights));
  }
  return plan;
}

/// Everything but 1 / view_divisor of the kept views and 1 / light_divisor of the kept lights.
LeftOut leftOut(const SrfManifest& field, const Plan& plan, int view_divisor, int light_divisor) {
  LeftOut out{std::vector<std::uint8_t>(field.views.size(), 1),
              std::vector<std::uint8_t>(field.lights.size(), !plan.light_choices.empty())};
  const auto keep = [](const Choice& choice, int divisor, std::vector<std::uint8_t>& flags) {
    const std::size_t count = thinned(choice.kept.size(), divisor);
    for (std::size_t i = 0; i < count; ++i) flags[choice.kept[i]] = 0;
  };
  keep(plan.view_choice, view_divisor, out.views);
  for (const Choice& choice : plan.light_choices) keep(choice, light_divisor, out.lights);
  return out;
}

CaptureSubset counted(const SrfManifest& field, const LeftOut& out) {
  CaptureSubset subset;
  for (std::size_t v = 0; v < field.views.size(); ++v) {
    if (field.views[v].file.empty() || out.views[v]) continue;
    ++subset.views;
    for (const LightId id : field.views[v].lights) subset.lights += !out.lights[id.value];
  }
  if (subset.views > 0) subset.lights /= subset.views;
  return subset;
}

/// A photograph to predict. Read again whenever it is needed: a dozen large ones would not fit into memory.
struct Question {
  std::size_t view = 0;
  std::size_t light_at = 0;  ///< position in the view's lights
  friend bool operator==(const Question&, const Question&) = default;
};

/// What lies in a rectangle.
ImageF cut(const ImageF& image, int x0, int y0, int width, int height) {
  ImageF part(width, height, image.channels());
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < image.channels(); ++c) part.at(x, y, c) = image.at(x0 + x, y0 + y, c);
  return part;
}

/// The part of the pictures that shows the object.
void cutToObject(ShownPrediction& shown) {
  const ImageF& inside = shown.photograph.inside;
  int x0 = inside.width(), y0 = inside.height(), x1 = 0, y1 = 0;
  for (int y = 0; y < inside.height(); ++y)
    for (int x = 0; x < inside.width(); ++x)
      if (inside.at(x, y) > 0) x0 = std::min(x0, x), y0 = std::min(y0, y), x1 = std::max(x1, x), y1 = std::max(y1, y);
  const int width = x1 - x0 + 1, height = y1 - y0 + 1;
  shown.prediction = cut(shown.prediction, x0, y0, width, height);
  shown.photograph = {cut(shown.photograph.rgb, x0, y0, width, height), cut(inside, x0, y0, width, height)};
}

class StudyingCapture {
 public:
  StudyingCapture(const std::filesystem::path& srf_folder, const CaptureStudyOptions& options, Reporter& reporter)
      : folder_(srf_folder),
        options_(options),
        reporter_(reporter),
        field_(readManifest(srf_folder)),
        model_(loadModel(srf_folder, field_)),
        deformed_(model_),
        plan_(planOf(field_, model_.bounds().center())) {}

  CaptureStudy run(std::vector<ShownPrediction>& shown) {
    const LeftOut nothing{std::vector<std::uint8_t>(field_.views.size(), 0),
                          std::vector<std::uint8_t>(field_.lights.size(), 0)};
    const CaptureSubset all = counted(field_, nothing), kept = counted(field_, leftOut(field_, plan_, 1, 1));
    study_.field = folder_.string();
    const auto manifest = readBinaryFile(folder_ / "manifest.json");
    study_.field_hash = hexHash(contentHash(manifest.data(), manifest.size()));
    study_.views = all.views, study_.lights = all.lights;
    study_.unknown_light = field_.unknownIllumination();
    study_.views_out = static_cast<int>(plan_.view_choice.out.size());
    bool lights_out = false;
    for (const Choice& choice : plan_.light_choices) lights_out |= !choice.out.empty();
    if (lights_out) study_.lights_out = all.lights - kept.lights;
    if (study_.views_out == 0 && !lights_out)
      throw badInput(folder_.string(),
                     format("has %d views with photographs and %.3g lights; at least %zu views, or %zu lights of known "
                            "direction, are needed to leave one out",
                            all.views, all.lights, kFewest, kFewest));
    for (const std::size_t v : plan_.views)
      study_.lossy |= ReflectanceStore(folder_ / field_.views[v].file).fidelity().compression == Compression::pca;
    if (study_.unknown_light)
      study_.no_fit = "the illumination is unknown";
    else if (field_.fit(field_.active_model) == nullptr)
      study_.no_fit = "the field's model holds no fit";

    if (study_.views_out > 0) ask(Unseen::view);
    if (lights_out) ask(Unseen::light);
    if (study_.views_out > 0 && lights_out) ask(Unseen::both);

    std::vector<std::array<int, 2>> divisors{{1, 1}};
    for (const int divisor : {2, 4}) {
      if (study_.views_out > 0 && thinned(plan_.view_choice.kept.size(), divisor) >= 2)
        divisors.push_back({divisor, 1});
      if (lights_out && kept.lights / divisor >= 3) divisors.push_back({1, divisor});
    }
    const std::vector<bool> ways = study_.no_fit.empty() ? std::vector<bool>{false, true} : std::vector<bool>{false};
    std::size_t pictures = 0;
    for (const auto& asked : questions_) pictures += asked.size();
    Reporter::Stage stage(reporter_, "hold-out", divisors.size() * ways.size() * pictures);
    for (const auto& [views, lights] : divisors)
      for (const bool guided : ways) predict(views, lights, guided, stage, shown);
    return std::move(study_);
  }

 private:
  /// Which photographs are predicted: views and lights in turn, those that are not black.
  void ask(Unseen unseen) {
    const std::vector<std::size_t>& views = unseen == Unseen::light ? plan_.view_choice.kept : plan_.view_choice.out;
    std::vector<std::uint8_t> light_out(field_.lights.size(), 0);
    for (const Choice& choice : plan_.light_choices)
      for (const std::size_t light : choice.out) light_out[light] = 1;
    std::vector<Question>& asked = questions_[static_cast<int>(unseen)];
    // View by view and light by light in steps of the golden ratio, so that few pictures see many of both.
    std::size_t step = 0;
    const std::size_t wanted = static_cast<std::size_t>(options_.pictures);
    for (std::size_t tried = 0; tried < 8 * wanted && asked.size() < wanted; ++tried) {
      const std::size_t view = views[tried % views.size()];
      std::vector<std::size_t> lights;
      for (std::size_t k = 0; k < field_.views[view].lights.size(); ++k) {
        const std::uint32_t light = field_.views[view].lights[k].value;
        if (field_.unknownIllumination() || (light_out[light] != 0) == (unseen != Unseen::view)) lights.push_back(k);
      }
      if (lights.empty()) continue;
      const double turn = 0.6180339887498949 * static_cast<double>(++step);
      const std::size_t at = lights[static_cast<std::size_t>((turn - std::floor(turn)) * lights.size())];
      const Question question{view, at};
      if (std::find(asked.begin(), asked.end(), question) != asked.end()) continue;
      if (lightInside(storedPhotograph(folder_, field_.views[view], at)) >= kLeastLit) asked.push_back(question);
    }
    if (asked.empty())
      throw badInput(folder_.string(), "every photograph that was left out is black or shows nothing of the object");
  }

  /// The share of the pixels inside that are brighter than a fiftieth of the brightest.
  static double lightInside(const StoredPhotograph& photograph) {
    double most = 0;
    std::size_t bright = 0, inside = 0;
    for (const float value : photograph.rgb.data()) most = std::max(most, static_cast<double>(value));
    for (int y = 0; y < photograph.rgb.height(); ++y)
      for (int x = 0; x < photograph.rgb.width(); ++x) {
        if (!(photograph.inside.at(x, y) > 0)) continue;
        ++inside;
        bright += photograph.rgb.at(x, y, 1) > most / 50;
      }
    return inside > 50 ? static_cast<double>(bright) / static_cast<double>(inside) : 0;
  }

  void predict(int view_divisor, int light_divisor, bool guided, Reporter::Stage& stage,
               std::vector<ShownPrediction>& shown) {
    const LeftOut out = leftOut(field_, plan_, view_divisor, light_divisor);
    const SrfManifest left = without(field_, out);
    CaptureSubset subset = counted(field_, out);
    subset.guided = guided;
    std::uint64_t steps = 0;
    for (const auto& asked : questions_) steps += asked.size();
    // What cannot be warned of twice: the field is sound, and a subset of it misses what it misses.
    Reporter quiet(ProgressMode::none, LogLevel::error);
    std::optional<ReflectanceFit> fit;
    if (guided) {
      FitOptions fit_options;
      fit_options.memory_bytes = options_.memory_bytes / 2;
      fit = fitReflectance(folder_, left, model_, fit_options, quiet);
      if (!fit) {
        reporter_.info(format("hold-out: %.3g lights are too few for a fit: plain alone", subset.lights));
        stage.advance(steps);
        return;
      }
    }
    FrameSettings settings;
    settings.fit = fit ? &*fit : nullptr;
    settings.memory_bytes = options_.memory_bytes;
    FrameRenderer renderer(folder_, left, model_, settings, quiet);
    for (int kind = 0; kind < 3; ++kind) {
      const auto& asked = questions_[kind];
      const auto unseen = static_cast<Unseen>(kind);
      if (asked.empty()) continue;
      // A view or light that is not to be foretold has to be there.
      if ((unseen == Unseen::view && light_divisor > 1) || (unseen == Unseen::light && view_divisor > 1)) {
        stage.advance(asked.size());
        continue;
      }
      const bool show = view_divisor == 1 && light_divisor == 1 && guided == study_.no_fit.empty() &&
                        (unseen == Unseen::both || questions_[static_cast<int>(Unseen::both)].empty());
      std::vector<std::pair<double, ShownPrediction>> predictions;
      HoldoutCase found{subset, unseen, {}};
      for (const Question& question : asked) {
        const StoredView& view = field_.views[question.view];
        const LightId light = view.lights[question.light_at];
        const std::string& light_name = field_.lights[light.value].name;
        StoredPhotograph photograph = storedPhotograph(folder_, view, question.light_at);
        Frame frame = renderer.render(atRest(view.camera), deformed_, asSceneLight(field_, light));
        const PredictionScore score = scorePrediction(frame.rgba, photograph.rgb, photograph.inside);
        found.pictures.push_back({view.name, light_name, score});
        if (show) {
          ShownPrediction shown_one{view.name, study_.unknown_light ? "" : light_name, score, std::move(photograph),
                                    std::move(frame.rgba)};
          cutToObject(shown_one);
          predictions.emplace_back(score.figures.psnr, std::move(shown_one));
        }
        stage.advance();
      }
      std::stable_sort(predictions.begin(), predictions.end(),
                       [](const auto& a, const auto& b) { return a.first > b.first; });
      for (std::size_t i = 0; i < predictions.size(); ++i)
        if (i == 0 || i == predictions.size() / 2 || i + 1 == predictions.size())
          shown.push_back(std::move(predictions[i].second));
      study_.cases.push_back(std::move(found));
    }
  }

  const std::filesystem::path& folder_;
  const CaptureStudyOptions& options_;
  Reporter& reporter_;
  const SrfManifest field_;
  const DeformableModel model_;
  const DeformedModel deformed_;
  const Plan plan_;
  std::array<std::vector<Question>, 3> questions_;  ///< by Unseen
  CaptureStudy study_;
};

}  // namespace

double HoldoutCase::psnr() const {
  double sum = 0;
  for (const PredictedPicture& p : pictures) sum += p.score.figures.psnr / static_cast<double>(pictures.size());
  return sum;
}

double HoldoutCase::flip() const {
  double sum = 0;
  for (const PredictedPicture& p : pictures) sum += p.score.figures.flip / static_cast<double>(pictures.size());
  return sum;
}

double HoldoutCase::error() const {
  double difference2 = 0, square2 = 0;
  for (const PredictedPicture& p : pictures) difference2 += p.score.difference2, square2 += p.score.square2;
  return square2 > 0 ? std::sqrt(difference2 / square2) : 0;
}

const HoldoutCase* CaptureStudy::find(Unseen unseen, bool guided) const {
  const HoldoutCase* most = nullptr;
  for (const HoldoutCase& c : cases) {
    if (c.unseen != unseen || c.subset.guided != guided) continue;
    if (!most || std::pair(c.subset.views, c.subset.lights) > std::pair(most->subset.views, most->subset.lights))
      most = &c;
  }
  return most;
}

std::vector<CaptureTrend> CaptureStudy::trends() const {
  std::vector<CaptureTrend> found;
  for (const Unseen unseen : {Unseen::view, Unseen::light, Unseen::both})
    for (const bool guided : {false, true})
      for (const bool of_lights : {false, true}) {
        // More lights say nothing of a view under a light that is there, and the reverse.
        if (unseen == (of_lights ? Unseen::view : Unseen::light)) continue;
        const HoldoutCase* whole = find(unseen, guided);
        if (!whole) continue;
        CaptureTrend trend{unseen, guided, of_lights, {}, {}, of_lights ? lights : views};
        for (const HoldoutCase& c : cases) {
          const bool same = of_lights ? c.subset.views == whole->subset.views : c.subset.lights == whole->subset.lights;
          if (c.unseen == unseen && c.subset.guided == guided && same && c.error() > 0)
            trend.measured.push_back({of_lights ? c.subset.lights : c.subset.views, c.error()});
        }
        std::sort(trend.measured.begin(), trend.measured.end());
        if (trend.measured.size() < 2) continue;
        trend.law = fitPowerLaw(trend.measured);
        found.push_back(std::move(trend));
      }
  return found;
}

CaptureStudy studyCapture(const std::filesystem::path& srf_folder, const CaptureStudyOptions& options,
                          std::vector<ShownPrediction>& shown, Reporter& reporter) {
  return StudyingCapture(srf_folder, options, reporter).run(shown);
}

void writeCaptureStudy(const std::filesystem::path& file, const CaptureStudy& study) {
  Json out;
  out["field"] = study.field;
  out["field_hash"] = study.field_hash;
  out["views"] = study.views;
  out["lights"] = study.lights;
  out["views_left_out"] = study.views_out;
  out["lights_left_out"] = study.lights_out;
  out["unknown_illumination"] = study.unknown_light;
  out["lossy"] = study.lossy;
  if (!study.no_fit.empty()) out["plain_alone_because"] = study.no_fit;
  out["cases"] = Json::array();
  for (const HoldoutCase& c : study.cases) {
    Json pictures = Json::array();
    for (const PredictedPicture& p : c.pictures)
      pictures.push_back({{"view", p.view},
                          {"light", p.light},
                          {"psnr_db", p.score.figures.psnr},
                          {"ssim", p.score.figures.ssim},
                          {"flip", p.score.figures.flip},
                          {"relative_error", std::sqrt(p.score.difference2 / p.score.square2)}});
    out["cases"].push_back({{"left_out", kUnseen[static_cast<int>(c.unseen)]},
                            {"interpolation", c.subset.guided ? "guided" : "plain"},
                            {"views", c.subset.views},
                            {"lights", c.subset.lights},
                            {"psnr_db", c.psnr()},
                            {"flip", c.flip()},
                            {"relative_error", c.error()},
                            {"pictures", std::move(pictures)}});
  }
  out["trends"] = Json::array();
  for (const CaptureTrend& t : study.trends())
    out["trends"].push_back({{"left_out", kUnseen[static_cast<int>(t.unseen)]},
                             {"interpolation", t.guided ? "guided" : "plain"},
                             {"along", t.of_lights ? "lights" : "views"},
                             {"measured", t.measured},
                             {"exponent", t.law.exponent},
                             {"count", t.count},
                             {"extrapolated_error", t.law.at(t.count)},
                             {"extrapolated_error_of_twice", t.law.at(2 * t.count)}});
  writeJsonFile(file, out);
}

std::string captureTable(const CaptureStudy& study) {
  std::string out = "left_out,interpolation,views,lights,view,light,psnr_db,ssim,flip,relative_error\n";
  for (const HoldoutCase& c : study.cases)
    for (const PredictedPicture& p : c.pictures)
      out += format("%s,%s,%d,%.6g,", kUnseen[static_cast<int>(c.unseen)], c.subset.guided ? "guided" : "plain",
                    c.subset.views, c.subset.lights) +
             csvQuoted(p.view) + "," + csvQuoted(p.light) +
             format(",%.4f,%.6f,%.6f,%.6g\n", p.score.figures.psnr, p.score.figures.ssim, p.score.figures.flip,
                    std::sqrt(p.score.difference2 / p.score.square2));
  return out;
}

}  // namespace srf
