#include "acquire/calibration_report.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>

#include "base/numeric.h"
#include "field/capture_json.h"

namespace srf {
namespace {

Json degreesJson(const Vec3& v) {
  return vec3Json({degrees(v.x), degrees(v.y), degrees(v.z)});
}

template <class To>
Json poseJsonOf(const Rigid<To, CameraSpace>& pose) {
  Json rows = Json::array();
  for (int i = 0; i < 3; ++i) {
    const Vec3& r = pose.rotation().raw().row[i];
    rows.push_back({r.x, r.y, r.z, pose.origin().raw()[i]});
  }
  return rows;
}

}  // namespace

Json calibrationJson(const BoardCalibrationInput& input, const BoardCalibration& calibration,
                     const std::string& units) {
  Json root;
  root["board"] = input.board.text();
  root["units"] = units;
  root["rms"] = calibration.rms;
  root["converged"] = calibration.converged;
  for (const CalibratedCamera& camera : calibration.cameras) {
    Json c;
    c["name"] = camera.name;
    writeLens(c, camera.lens);
    for (const LensParameter& p : camera.parameters) c["deviation"][p.name] = p.deviation;
    c["rms"] = camera.rms;
    if (camera.opencv_rms > 0) c["rms_alone"] = camera.opencv_rms;
    c["corners"] = camera.corners;
    if (calibration.cameras.size() > 1 || calibration.turntable) {
      c["rig_from_camera"] = poseJsonOf(camera.pose);
      c["rotation_deviation_degrees"] = degreesJson(camera.deviation.rotation);
      c["center_deviation"] = vec3Json(camera.deviation.center);
    }
    root["cameras"].push_back(std::move(c));
  }
  if (calibration.turntable) {
    const TurntableFit& t = *calibration.turntable;
    Json& out = root["turntable"];
    out["axis"] = vec3Json(t.axis.raw());
    out["axis_deviation_degrees"] = degrees(t.axis_deviation);
    out["point"] = vec3Json(t.point.raw());
    out["point_deviation"] = t.point_deviation;
    out["step_degrees"] = degrees(t.step);
    out["step_deviation_degrees"] = degrees(t.step_deviation);
    if (t.free_step) {
      out["step_if_fitted_degrees"] = degrees(*t.free_step);
      out["step_if_fitted_deviation_degrees"] = degrees(t.free_step_deviation);
    }
  }
  for (std::size_t i = 0; i < input.sightings.size(); ++i) {
    const BoardSighting& s = input.sightings[i];
    const SightingResidual& r = calibration.residuals[i];
    const PoseDeviation& d = calibration.shots[s.shot].deviation;
    Json view;
    view["name"] = s.name;
    view["camera"] = input.cameras[s.camera];
    view["shot"] = input.shots[s.shot];
    view["corners"] = s.corners.ids.size();
    view["rms"] = r.rms;
    view["largest"] = r.largest;
    view["stands_out"] = r.stands_out;
    if (!calibration.turntable) {
      view["rotation_deviation_degrees"] = degreesJson(d.rotation);
      view["center_deviation"] = vec3Json(d.center);
    }
    root["photographs"].push_back(std::move(view));
  }
  return root;
}

double residualExaggeration(const BoardCalibration& calibration) {
  const double wanted = 12 / std::max(calibration.rms, 1e-3);
  const double decade = std::pow(10.0, std::floor(std::log10(wanted)));
  return std::max(1.0, decade * (wanted / decade >= 5 ? 5 : wanted / decade >= 2 ? 2 : 1));
}

Image8 residualPicture(const Image8& grey, const BoardSighting& sighting, const SightingResidual& residual,
                       double exaggeration) {
  const cv::Mat pixels(grey.height(), grey.width(), CV_8UC1, const_cast<std::uint8_t*>(grey.data().data()));
  const double scale = std::min(1.0, 1600.0 / std::max(grey.width(), grey.height()));
  cv::Mat small = pixels;
  if (scale < 1) cv::resize(pixels, small, {}, scale, scale, cv::INTER_AREA);
  Image8 out(small.cols, small.rows, 3);
  cv::Mat picture(small.rows, small.cols, CV_8UC3, out.data().data());  // R G B
  cv::cvtColor(small, picture, cv::COLOR_GRAY2RGB);
  constexpr int kShift = 4;  // OpenCV draws at sixteenths of a pixel
  const auto at = [&](double x, double y) {
    const auto fixed = [&](double v) {
      return static_cast<int>(std::lround(std::clamp(v, -1e4, 1e5) * (1 << kShift)));
    };
    return cv::Point(fixed(x * scale - 0.5), fixed(y * scale - 0.5));
  };
  for (std::size_t i = 0; i < sighting.corners.ids.size(); ++i) {
    const Vec2& found = sighting.corners.pixels[i];
    const Vec2& model = residual.reprojected[i];
    cv::line(picture, at(found.x, found.y),
             at(found.x + exaggeration * (model.x - found.x), found.y + exaggeration * (model.y - found.y)),
             cv::Scalar(255, 220, 0), 1, cv::LINE_AA, kShift);
    cv::circle(picture, at(found.x, found.y), 4 << kShift, cv::Scalar(0, 220, 60), 1, cv::LINE_AA, kShift);
    const double arm = 3 / scale;
    cv::line(picture, at(model.x - arm, model.y), at(model.x + arm, model.y), cv::Scalar(255, 40, 40), 1, cv::LINE_AA,
             kShift);
    cv::line(picture, at(model.x, model.y - arm), at(model.x, model.y + arm), cv::Scalar(255, 40, 40), 1, cv::LINE_AA,
             kShift);
  }
  char text[128];
  std::snprintf(text, sizeof text, "rms %.3f px, largest %.3f px, errors drawn x%.6g", residual.rms, residual.largest,
                exaggeration);
  cv::putText(picture, text, {8, 18}, cv::FONT_HERSHEY_SIMPLEX, 0.5, cv::Scalar(0, 0, 0), 3, cv::LINE_AA);
  cv::putText(picture, text, {8, 18}, cv::FONT_HERSHEY_SIMPLEX, 0.5,
              residual.stands_out ? cv::Scalar(255, 80, 80) : cv::Scalar(255, 255, 255), 1, cv::LINE_AA);
  return out;
}

}  // namespace srf
