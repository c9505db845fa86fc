// How well a capture supports what is asked of it: views and lights are left out of the field, predicted by the others,
// and compared with their stored photographs; with half and a quarter of the others too, which tells what more of them
// would bring.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "apps/holdout.h"
#include "base/reporter.h"

namespace srf {

/// What a prediction has not seen.
enum class Unseen { view, light, both };
constexpr std::array<const char*, 3> kUnseen{"view", "light", "both"};

/// The field without what is left out, and perhaps without more.
struct CaptureSubset {
  int views = 0;      ///< that hold photographs
  double lights = 0;  ///< of one of them, mean
  bool guided = false;
};

struct PredictedPicture {
  std::string view, light;
  PredictionScore score;
};

struct HoldoutCase {
  CaptureSubset subset;
  Unseen unseen = Unseen::view;
  std::vector<PredictedPicture> pictures;

  double psnr() const;  ///< dB, mean of the pictures
  double flip() const;
  double error() const;  ///< root mean square of the differences, of the photographs' own; over all pictures
};

/// A power law through what fewer views (or lights) gave, all else the same.
struct CaptureTrend {
  Unseen unseen = Unseen::view;
  bool guided = false, of_lights = false;       ///< along the number of lights, or else of views
  std::vector<std::array<double, 2>> measured;  ///< (count, error)
  PowerLaw law;
  double count = 0;  ///< what the capture holds; the law is asked there and at twice as many
};

struct CaptureStudy {
  std::string field, field_hash;
  int views = 0;          ///< that hold photographs
  double lights = 0;      ///< of one of them, mean
  int views_out = 0;      ///< 0: too few to leave any out
  double lights_out = 0;  ///< of a view, mean; 0 likewise, or one unknown light
  bool unknown_light = false;
  bool lossy = false;  ///< some stores hold what their compression left of the photographs
  std::string no_fit;  ///< why guided interpolation is not measured; empty: it is
  std::vector<HoldoutCase> cases;

  const HoldoutCase* find(Unseen unseen, bool guided) const;  ///< with nothing but the left out missing
  std::vector<CaptureTrend> trends() const;
};

struct CaptureStudyOptions {
  int pictures = 12;  ///< predicted, of each case
  std::size_t memory_bytes = std::size_t{1} << 30;
};
/// A prediction beside its photograph, for the page: no wider than the object.
struct ShownPrediction {
  std::string view, light;  ///< light empty: the unknown one
  PredictionScore score;
  StoredPhotograph photograph;
  ImageF prediction;
};
/// `shown`: the best, the middle and the worst prediction of what is hardest. Throws bad_input where the field has no
/// model, or too few views and lights to leave any out.
CaptureStudy studyCapture(const std::filesystem::path& srf_folder, const CaptureStudyOptions& options,
                          std::vector<ShownPrediction>& shown, Reporter& reporter);

void writeCaptureStudy(const std::filesystem::path& file, const CaptureStudy& study);
std::string captureTable(const CaptureStudy& study);  ///< CSV, a row a case and picture

}  // namespace srf
