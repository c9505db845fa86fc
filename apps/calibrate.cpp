// `srf calibrate`: photographs to a capture's cameras and lights; a calibration board to print.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "acquire/board.h"
#include "acquire/calibration_report.h"
#include "acquire/camera_calibration.h"
#include "acquire/camera_import.h"
#include "acquire/shoot.h"
#include "acquire/structure_from_motion.h"
#include "apps/calibrate_job.h"
#include "apps/calibrate_lights.h"
#include "apps/calibrate_masks.h"
#include "apps/program.h"
#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "field/capture_file.h"
#include "field/capture_json.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

std::string text(const char* format, auto... values) {
  char line[512];
  std::snprintf(line, sizeof line, format, values...);
  return line;
}

/// The place of a turntable in a name: its last number, e.g. 7 of "stop_007". Nothing where it has none.
std::optional<double> lastNumber(const std::string& name) {
  const std::size_t end = name.find_last_of("0123456789");
  if (end == std::string::npos) return std::nullopt;
  std::size_t begin = end;
  while (begin > 0 && std::isdigit(static_cast<unsigned char>(name[begin - 1])) && end - begin < 14) --begin;
  return std::stod(name.substr(begin, end + 1 - begin));
}

/// Stops of the photographs by view: numbers of the names less the least, or the order where a name has none.
std::map<std::string, double> stopsOf(const std::vector<ShootPhoto>& photos) {
  std::map<std::string, double> stops;
  std::vector<std::string> names;
  for (const ShootPhoto& photo : photos)
    if (std::find(names.begin(), names.end(), photo.view) == names.end()) names.push_back(photo.view);
  std::sort(names.begin(), names.end(), naturallyBefore);
  bool numbered = true;
  double least = INFINITY;
  std::set<double> taken;
  for (const std::string& name : names) {
    const auto number = lastNumber(name);
    numbered = numbered && number && taken.insert(*number).second;
    if (number) least = std::min(least, *number);
  }
  for (std::size_t i = 0; i < names.size(); ++i)
    stops[names[i]] = numbered ? *lastNumber(names[i]) - least : static_cast<double>(i);
  return stops;
}

// ---- The board in them

struct Sightings {
  BoardCalibrationInput input;
  std::vector<std::string> without;  ///< photographs that do not show the board
};

std::size_t indexIn(std::vector<std::string>& names, const std::string& name) {
  const auto at = std::find(names.begin(), names.end(), name);
  if (at != names.end()) return static_cast<std::size_t>(at - names.begin());
  names.push_back(name);
  return names.size() - 1;
}

Sightings findBoards(const CalibrationJob& job, const Board& board, const fs::path& folder,
                     const std::vector<ShootPhoto>& photos, bool shots_by_view, Reporter& reporter) {
  Sightings out;
  BoardCalibrationInput& input = out.input;
  input.board = board;
  input.millimetre = 1 / unitInMillimetres(job.units);
  input.lens = job.lens.value_or(CameraModel::opencv);
  std::vector<std::optional<BoardCorners>> corners(photos.size());
  std::vector<ImageSize> sizes(photos.size());
  Reporter::Stage stage(reporter, "boards", photos.size());
  parallelFor(photos.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Image8 grey = greyPhotograph(photos[i].file);
      sizes[i] = {grey.width(), grey.height()};
      corners[i] = findBoard(board, grey, photos[i].file);
      stage.advance();
    }
  });
  for (std::size_t i = 0; i < photos.size(); ++i) {
    const ShootPhoto& photo = photos[i];
    const std::string name = photo.file.lexically_relative(folder).generic_string();
    if (!corners[i]) {
      out.without.push_back(name);
      continue;
    }
    BoardSighting s;
    s.name = name;
    s.file = photo.file;
    s.camera = indexIn(input.cameras, photo.camera);
    s.shot = indexIn(input.shots, shots_by_view ? photo.view : photo.view.empty() ? name : photo.view);
    s.corners = std::move(*corners[i]);
    if (s.camera == input.sizes.size()) input.sizes.push_back(sizes[i]);
    const ImageSize& size = input.sizes[s.camera];
    if (size.width != sizes[i].width || size.height != sizes[i].height)
      throw badInput(photo.file.string(),
                     text("is %d x %d, the other photographs of camera '%s' %d x %d; calibrate "
                          "photographs of one size, none of them turned",
                          sizes[i].width, sizes[i].height, photo.camera.c_str(), size.width, size.height));
    input.sightings.push_back(std::move(s));
  }
  if (input.sightings.empty())
    throw badInput(folder.string(), "none of " + std::to_string(photos.size()) + " photographs shows the board " +
                                        board.text() +
                                        ": a chessboard is given by its inner corners (a board of 10 x 7 squares is "
                                        "9x6), a ChArUco board by its squares; all of a chessboard must be in sight");
  return out;
}

/// Lenses of another capture's views, by the camera that the name of a view begins with, or its only lens.
void holdLenses(const fs::path& file, BoardCalibrationInput& input) {
  const Capture known = readCapture(file);
  input.known_lens.resize(input.cameras.size());
  for (std::size_t c = 0; c < input.cameras.size(); ++c) {
    for (const CaptureView& view : known.views) {
      const bool same = view.name == input.cameras[c] || view.name.starts_with(input.cameras[c] + "_");
      if (same || known.views.front().camera.lens == known.views.back().camera.lens)
        input.known_lens[c] = view.camera.lens;
      if (same) break;
    }
    if (!input.known_lens[c])
      throw badInput(file.string(), "has no view of camera '" + input.cameras[c] +
                                        "'; name the cameras alike, or give a capture of one lens");
    const Intrinsics& lens = *input.known_lens[c];
    if (lens.width != input.sizes[c].width || lens.height != input.sizes[c].height)
      throw badInput(file.string(),
                     text("its lens is for %d x %d pixels, the photographs of camera '%s' have %d x %d", lens.width,
                          lens.height, input.cameras[c].c_str(), input.sizes[c].width, input.sizes[c].height));
  }
}

void tell(const BoardCalibrationInput& input, const BoardCalibration& found, const std::string& units,
          Reporter& reporter) {
  for (std::size_t c = 0; c < input.cameras.size(); ++c) {
    const CalibratedCamera& camera = found.cameras[c];
    const auto count = std::count_if(input.sightings.begin(), input.sightings.end(),
                                     [&](const BoardSighting& s) { return s.camera == c; });
    std::string line =
        text("%s: %zd photographs, %zu corners, rms %.3f px", camera.name.c_str(), count, camera.corners, camera.rms);
    for (const LensParameter& p : camera.parameters)
      line += text(", %s %.6g +- %.2g", p.name.c_str(), p.value, p.deviation);
    reporter.result(line);
    reporter.figure("calibrate.rms." + camera.name, camera.rms);
  }
  if (found.turntable) {
    const TurntableFit& t = *found.turntable;
    std::string line = text("turntable: step %.5g degrees", degrees(t.step));
    if (!t.free_step) line += text(" +- %.2g", degrees(t.step_deviation));
    line +=
        text(", axis known to %.2g degrees and %.2g %s", degrees(t.axis_deviation), t.point_deviation, units.c_str());
    reporter.result(line);
    if (t.free_step && std::fabs(*t.free_step - t.step) > 3 * t.free_step_deviation)
      reporter.warn(
          text("turntable: the step is given as %.6g degrees and the board's photographs say %.6g +- %.2g; "
               "leave --step out to take theirs",
               degrees(t.step), degrees(*t.free_step), degrees(t.free_step_deviation)));
  }
  if (!found.converged) reporter.warn("the calibration did not converge; photograph the board from more sides");
  std::vector<double> rms;
  for (const SightingResidual& r : found.residuals) rms.push_back(r.rms);
  std::nth_element(rms.begin(), rms.begin() + static_cast<std::ptrdiff_t>(rms.size() / 2), rms.end());
  for (std::size_t i = 0; i < input.sightings.size(); ++i)
    if (found.residuals[i].stands_out)
      reporter.warn(
          text("%s: its rms of %.3g px stands out, the middle one is %.3g px; look at its picture, and leave "
               "it out with --leave-out %s if the board moved or is blurred",
               input.sightings[i].name.c_str(), found.residuals[i].rms, rms[rms.size() / 2],
               input.sightings[i].name.c_str()));
}

void writeReport(const CalibrationJob& job, const BoardCalibrationInput& input, const BoardCalibration& found,
                 const std::vector<std::string>& without, Reporter& reporter) {
  const fs::path folder = job.output / "calibration";
  const double exaggeration = residualExaggeration(found);
  Reporter::Stage stage(reporter, "pictures", input.sightings.size());
  parallelFor(input.sightings.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const BoardSighting& s = input.sightings[i];
      std::string name = s.name;
      std::replace(name.begin(), name.end(), '/', '_');
      writePng(folder / (name + ".png"), residualPicture(greyPhotograph(s.file), s, found.residuals[i], exaggeration));
      stage.advance();
    }
  });
  Json json = calibrationJson(input, found, job.units);
  json["photographs_without_board"] = without;
  json["left_out"] = job.leave_out;
  json["picture_exaggeration"] = exaggeration;
  writeJsonFile(folder / "calibration.json", json);
}

// ---- The capture

using CapturePose = Rigid<AcquisitionSpace, CameraSpace>;

/// A view of the capture, before its photographs.
struct PlacedView {
  std::string name, camera, view;  ///< camera and view as the shoot names them; an empty view stands for every one
  Camera<AcquisitionSpace> camera_at;
  double turn = 0;  ///< radians that a turntable has turned the object about +z since the lights were measured
};

Camera<AcquisitionSpace> placed(const Intrinsics& lens, const Mat3& rotation, const Vec3& center) {
  return {lens, CapturePose(Orthogonal<AcquisitionSpace, CameraSpace>(rotation), Point<AcquisitionSpace>(center))};
}

/// Camera `c` as it stood in shot `s`, in the space of the board then.
Camera<AcquisitionSpace> cameraOverBoard(const BoardCalibration& found, std::size_t c, std::size_t s) {
  const CalibratedCamera& camera = found.cameras[c];
  return placed(camera.lens, (found.shots[s].pose.rotation() * camera.pose.rotation()).raw(),
                (found.shots[s].pose * camera.pose.origin()).raw());
}

/// A camera that went round a board that lay still: acquisition space is the board's.
std::vector<PlacedView> placeByBoard(const BoardCalibrationInput& input, const BoardCalibration& found) {
  std::vector<PlacedView> views;
  for (const BoardSighting& s : input.sightings)
    views.push_back({fs::path(s.name).replace_extension().generic_string(), input.cameras[s.camera],
                     input.shots[s.shot], cameraOverBoard(found, s.camera, s.shot)});
  return views;
}

/// Cameras that stand still: acquisition space is the board's in the shot `world`, else in the first that the most
/// cameras see.
std::vector<PlacedView> placeRig(const CalibrationJob& job, const BoardCalibrationInput& input,
                                 const BoardCalibration& found, bool photos_of_the_board, Reporter& reporter) {
  std::vector<std::size_t> seen(input.shots.size());
  for (const BoardSighting& s : input.sightings) ++seen[s.shot];
  auto world = static_cast<std::size_t>(std::max_element(seen.begin(), seen.end()) - seen.begin());
  if (!job.world.empty()) {
    const auto at = std::find(input.shots.begin(), input.shots.end(), job.world);
    if (at == input.shots.end())
      throw usage("--world '" + job.world + "': no shot of that name shows the board; the first is '" + input.shots[0] +
                  "'");
    world = static_cast<std::size_t>(at - input.shots.begin());
  }
  reporter.result("acquisition space is that of the board in shot '" + input.shots[world] + "'");
  std::vector<PlacedView> views;
  for (std::size_t c = 0; c < input.cameras.size(); ++c)
    views.push_back({input.cameras[c], input.cameras[c], photos_of_the_board ? input.shots[world] : "",
                     cameraOverBoard(found, c, world)});
  return views;
}

/// Each stop of a turntable is a view; acquisition space turns with the table: z is its axis, x points to the first
/// camera at stop 0, the origin lies in the board's plane, or next to the board's centre where the board stands
/// upright.
std::vector<PlacedView> placeTurntable(const BoardCalibrationInput& input, const BoardCalibration& found,
                                       const std::vector<ShootPhoto>& photos) {
  const TurntableFit& table = *found.turntable;
  const Vec3 z = table.axis.raw(), point = table.point.raw();
  const double along = std::fabs(z.z) > 0.5 ? -point.z / z.z : -dot(point, z);
  const Vec3 origin = point + along * z;
  const Vec3 to_camera = found.cameras[0].pose.origin().raw() - origin;
  const Vec3 across = to_camera - dot(to_camera, z) * z;
  const Vec3 x = length(across) > 1e-6 * length(to_camera) ? across / length(across)
                                                           : anyPerpendicular(Direction<BoardSpace>::fromUnit(z)).raw();
  const Mat3 table_from_room{{x, cross(z, x), z}};
  const auto stops = stopsOf(photos);
  std::vector<PlacedView> views;
  for (std::size_t c = 0; c < input.cameras.size(); ++c) {
    const Mat3 rotation = table_from_room * found.cameras[c].pose.rotation().raw();
    const Vec3 center = table_from_room * (found.cameras[c].pose.origin().raw() - origin);
    for (const auto& [view, stop] : stops) {
      const double turn = table.step * stop;
      const Mat3 back = rotationAbout({0, 0, 1}, -turn);
      const std::string name = input.cameras.size() == 1 ? view : input.cameras[c] + "_" + view;
      views.push_back(
          {name, input.cameras[c], view, placed(found.cameras[c].lens, back * rotation, back * center), turn});
    }
  }
  return views;
}

std::vector<CaptureLight> readLights(const fs::path& file) {
  const JsonNode root = readJsonFile(file);
  std::vector<CaptureLight> lights;
  const JsonNode list = root["lights"];
  for (std::size_t i = 0; i < list.size(); ++i) lights.push_back(readLight(list.at(i)));
  return lights;
}

/// The light as an object on a turntable meets it: turned back about +z.
CaptureLight turnedBack(const CaptureLight& light, double turn, const std::string& view) {
  const Mat3 back = rotationAbout({0, 0, 1}, -turn);
  CaptureLight out = light;
  out.name = view + "/" + light.name;
  out.direction = Direction<AcquisitionSpace>::fromUnit(back * light.direction.raw());
  out.position = Point<AcquisitionSpace>(back * light.position.raw());
  return out;
}

/// Views with their photographs and lights. `lights` stand still in the room; each stop of a turntable has its own in
/// the object's frame.
Capture assemble(const CalibrationJob& job, const std::vector<PlacedView>& placed_views,
                 const std::vector<ShootPhoto>& photos, const std::vector<CaptureLight>& lights, Reporter& reporter) {
  Capture capture;
  capture.folder = job.output;
  capture.units = job.units;
  capture.lights = lights;
  const bool turns = job.turntable && !lights.empty();
  if (lights.empty()) capture.lights = {{.name = "captured", .kind = LightKind::captured}};
  if (turns) capture.lights.clear();
  std::vector<bool> used(photos.size(), false);
  std::set<std::string> unknown_lights;
  for (const PlacedView& place : placed_views) {
    CaptureView view;
    view.name = place.name;
    view.camera = place.camera_at;
    for (std::size_t i = 0; i < photos.size(); ++i) {
      const ShootPhoto& photo = photos[i];
      if (photo.camera != place.camera || (!place.view.empty() && photo.view != place.view)) continue;
      used[i] = true;
      Photo entry{photo.file, std::nullopt};
      if (lights.empty()) {
        entry.light = LightId{0};
      } else if (!photo.light.empty() || lights.size() == 1) {
        const auto at = std::find_if(lights.begin(), lights.end(), [&](const CaptureLight& l) {
          return l.name == photo.light || lights.size() == 1;
        });
        if (at == lights.end()) {
          unknown_lights.insert(photo.light);
          continue;
        }
        if (turns) capture.lights.push_back(turnedBack(*at, place.turn, place.name));
        entry.light = LightId{static_cast<std::uint32_t>(turns ? capture.lights.size() - 1
                                                               : static_cast<std::size_t>(at - lights.begin()))};
      }
      view.photos.push_back(std::move(entry));
    }
    if (lights.empty() && view.photos.size() > 1)
      throw badInput(
          view.photos[1].file.string(),
          "is a second photograph of view '" + view.name + "' beside " + view.photos[0].file.string() +
              ", and nothing says how they were lit: give the lights, with {light} in --photos, or leave one "
              "out");
    if (!view.photos.empty()) capture.views.push_back(std::move(view));
  }
  if (!unknown_lights.empty())
    reporter.warn("photographs under " + std::to_string(unknown_lights.size()) + " lights that the table lacks ('" +
                  *unknown_lights.begin() + "') are left out of the capture");
  const auto unused = std::count(used.begin(), used.end(), false);
  if (unused > 0)
    reporter.warn(
        std::to_string(unused) + " photographs have no view in the capture, the first is " +
        photos[static_cast<std::size_t>(std::find(used.begin(), used.end(), false) - used.begin())].file.string());
  // A light of the table that no photograph shows has no place in a capture.
  if (!turns && !lights.empty()) {
    std::vector<std::optional<std::uint32_t>> renumbered(lights.size());
    std::vector<CaptureLight> kept;
    for (CaptureView& view : capture.views)
      for (Photo& photo : view.photos) {
        if (!photo.light) continue;
        auto& number = renumbered[photo.light->value];
        if (!number) number = static_cast<std::uint32_t>(kept.size()), kept.push_back(lights[photo.light->value]);
        photo.light = LightId{*number};
      }
    if (kept.size() < lights.size())
      reporter.warn(std::to_string(lights.size() - kept.size()) + " lights of the table light no photograph");
    capture.lights = kept;
  }
  if (capture.views.empty())
    throw badInput(job.photos.string(),
                   "no photograph belongs to a calibrated camera; name the cameras of both folders alike");
  return capture;
}

/// With --copy the photographs lie in the capture, else it refers to where they are.
void writeResult(const CalibrationJob& job, const fs::path& root, Capture& capture, Reporter& reporter) {
  std::size_t photos = 0;
  for (CaptureView& view : capture.views)
    for (Photo& photo : view.photos) {
      ++photos;
      if (!job.copy || job.developed) continue;
      const fs::path to = job.output / "images" / photo.file.lexically_relative(root);
      std::error_code code;
      fs::create_directories(to.parent_path(), code);
      fs::copy_file(photo.file, to, fs::copy_options::overwrite_existing, code);
      if (code)
        throw Error(ErrorKind::failed, "could not be copied to " + to.string() + ": " + code.message(),
                    photo.file.string());
      photo.file = to;
    }
  writeCapture(job.output, capture);
  reporter.result(text("%s: %zu views, %zu photographs %s", (job.output / "transforms.json").c_str(),
                       capture.views.size(), photos,
                       job.developed ? "developed into images/"
                       : job.copy    ? "copied into images/"
                                     : "referred to where they lie (--copy copies them)"));
}

// ---- The ways

/// The views of a capture with their photographs and lenses as they were taken.
Capture shotOf(const Capture& capture, const fs::path& folder, const std::vector<PlacedView>& placed_views,
               const std::vector<ShootPhoto>& photos) {
  Capture shot;
  shot.folder = folder;
  for (const CaptureView& view : capture.views) {
    const auto place = std::find_if(placed_views.begin(), placed_views.end(),
                                    [&](const PlacedView& p) { return p.name == view.name; });
    CaptureView taken;
    taken.name = view.name;
    taken.camera = place->camera_at;
    for (const ShootPhoto& photo : photos)
      if (photo.camera == place->camera && (place->view.empty() || photo.view == place->view))
        taken.photos.push_back({photo.file, std::nullopt});
    shot.views.push_back(std::move(taken));
  }
  return shot;
}

/// Linear images and lights where they are asked for, and the capture.
void finish(const CalibrationJob& job, LightsAndImages& studio, std::vector<PlacedView> views,
            const std::vector<ShootPhoto>& photos, Reporter& reporter) {
  std::vector<PlacedCamera> cameras;
  for (const PlacedView& view : views) cameras.push_back({view.camera, view.view, view.camera_at});
  const auto bracketed = [](const ShootPhoto& photo) { return !photo.exposure.empty(); };
  if (!studio.develops() && std::any_of(photos.begin(), photos.end(), bracketed))
    throw usage("{exposure} in --photos needs --develop, which merges the exposures");
  const std::vector<ShootPhoto> pictures =
      studio.develops() ? studio.developed(photos, cameras, job.output, reporter) : photos;
  std::vector<CaptureLight> lights;
  if (studio.findsLights())
    lights = studio.lights(job.photos, photos, cameras, reporter);
  else if (!job.lights.empty())
    lights = readLights(job.lights);
  studio.setStrengthsOf(lights, job.photos, cameras, reporter);
  const std::vector<PlacedView> shot = views;
  if (studio.undistorts())
    for (PlacedView& view : views) view.camera_at.lens = Undistortion::pinholeOf(view.camera_at.lens);
  Capture capture = assemble(job, views, pictures, lights, reporter);
  capture.integer_transfer = studio.integerTransfer();
  // Developed pictures lie elsewhere than the photographs, and masks are found beside those.
  if (studio.develops() || !job.masks.empty())
    carryMasks(shotOf(capture, job.photos, shot, photos), job.masks, capture, reporter);
  if (!studio.develops()) return writeResult(job, job.photos, capture, reporter);
  CalibrationJob result = job;
  result.developed = true;
  writeResult(result, job.photos, capture, reporter);
}

/// One camera that nothing calibrates: photographs under many lights, as for reflectance transformation imaging.
void calibrateOneView(const CalibrationJob& job, LightsAndImages& studio, Reporter& reporter) {
  std::set<std::string> left_out;
  const std::vector<ShootPhoto> photos = job.photographs(job.photos, job.pattern, left_out);
  job.checkLeftOut(left_out);
  for (const ShootPhoto& photo : photos)
    if (photo.view != photos.front().view || photo.camera != photos.front().camera)
      throw badInput(photo.file.string(),
                     "is of another view than " + photos.front().file.string() +
                         ", and --one-view takes one: name the photographs by {light} in --photos");
  const ImageF first = readPhotograph(photos.front().file).pixels;
  const std::string name = photos.front().view.empty() ? "view" : photos.front().view;
  finish(job, studio,
         {{name, photos.front().camera, photos.front().view, studio.oneViewCamera({first.width(), first.height()})}},
         photos, reporter);
}

void calibrateByBoard(const CalibrationJob& job, LightsAndImages& studio, Reporter& reporter) {
  const Board board = parseBoard(job.board);
  const bool apart = !job.board_photos.empty();
  std::set<std::string> left_out;
  const std::vector<ShootPhoto> photos = job.photographs(job.photos, job.pattern, left_out);
  const std::vector<ShootPhoto> of_board =
      apart ? job.photographs(job.board_photos, job.board_pattern, left_out) : photos;
  job.checkLeftOut(left_out);
  const bool still = job.rig || job.turntable || apart;  // the cameras stand still, the board moves
  const fs::path board_folder = apart ? job.board_photos : job.photos;
  Sightings sightings = findBoards(job, board, board_folder, of_board, still, reporter);
  reporter.result(text("%s found in %zu of %zu photographs", board.text().c_str(), sightings.input.sightings.size(),
                       of_board.size()));
  if (!sightings.without.empty())
    reporter.warn(std::to_string(sightings.without.size()) + " photographs do not show the board, the first is " +
                  sightings.without.front());

  BoardCalibrationInput& input = sightings.input;
  if (!job.lens_from.empty()) holdLenses(job.lens_from, input);
  if (job.turntable) {
    input.turntable.emplace();
    const auto stops = stopsOf(of_board);
    for (const std::string& shot : input.shots) input.turntable->stops.push_back(stops.at(shot));
    if (job.step) input.turntable->step = radians(*job.step);
  }
  const BoardCalibration found = calibrateWithBoard(input);
  tell(input, found, job.units, reporter);
  writeReport(job, input, found, sightings.without, reporter);

  const std::vector<PlacedView> views = job.turntable ? placeTurntable(input, found, photos)
                                        : still       ? placeRig(job, input, found, !apart, reporter)
                                                      : placeByBoard(input, found);
  finish(job, studio, views, photos, reporter);
}

/// The only lens of a capture.
Intrinsics oneLens(const fs::path& file) {
  const Capture known = readCapture(file);
  for (const CaptureView& view : known.views)
    if (!(view.camera.lens == known.views.front().camera.lens))
      throw badInput(file.string(), "has views of different lenses; structure from motion takes one");
  return known.views.front().camera.lens;
}

const CaptureView& viewNamed(const Capture& capture, const std::string& name, const std::string& where) {
  const CaptureView* found = nullptr;
  for (const CaptureView& view : capture.views) {
    const fs::path& file = view.photos.at(0).file;
    if (view.name != name && file.filename() != name && file.stem() != name) continue;
    if (found) throw usage(where + ": '" + name + "' names more than one photograph");
    found = &view;
  }
  if (!found) throw usage(where + ": no registered photograph is named '" + name + "'");
  return *found;
}

/// A place marked in photographs: {"a.jpg": [x, y], "b.jpg": [x, y]}.
Triangulated markedPoint(const Capture& capture, const JsonNode& marks) {
  std::vector<Ray<AcquisitionSpace>> rays;
  for (const auto& [name, pixel] : marks.raw().items()) {
    const std::vector<double> xy = marks[name].numbers(2);
    const Camera<AcquisitionSpace>& camera = viewNamed(capture, name, marks.where()).camera;
    if (!(xy[0] >= 0 && xy[1] >= 0 && xy[0] <= camera.lens.width && xy[1] <= camera.lens.height))
      throw marks[name].error(
          text("lies outside its photograph of %d x %d pixels; give x and y from the top left "
               "corner",
               camera.lens.width, camera.lens.height));
    const auto ray = camera.ray({xy[0], xy[1]});
    if (!ray) throw marks[name].error("lies where the lens shows nothing");
    rays.push_back(*ray);
  }
  const auto point = triangulate(rays);
  if (!point) throw marks.error("is not marked in two photographs from different places");
  return *point;
}

/// The scale that structure from motion cannot know: from a board in the photographs, two photographs or two places.
void setScale(const CalibrationJob& job, Capture& capture, Reporter& reporter) {
  if (!job.board.empty() && job.board_photos.empty()) {
    const Board board = parseBoard(job.board);
    std::vector<std::optional<BoardCorners>> seen(capture.views.size());
    Reporter::Stage stage(reporter, "boards", seen.size());
    parallelFor(seen.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const fs::path& file = capture.views[i].photos.at(0).file;
        seen[i] = findBoard(board, greyPhotograph(file), file);
        stage.advance();
      }
    });
    const BoardAlignment fit = alignWithBoard(capture, board, 1 / unitInMillimetres(job.units), seen);
    applySimilarity(capture, fit.similarity);
    reporter.result(text("scale and acquisition space by the board: %zu corners, %.3g %s off in the root mean square",
                         fit.corners, fit.residual, job.units.c_str()));
    return;
  }
  Similarity similarity;
  if (!job.distance.empty()) {
    double wanted = 0;
    try {
      wanted = std::stod(job.distance[2]);
    } catch (const std::exception&) {}
    const double found = distance(viewNamed(capture, job.distance[0], "--distance").camera.center(),
                                  viewNamed(capture, job.distance[1], "--distance").camera.center());
    if (!(wanted > 0) || !std::isfinite(wanted)) throw usage("--distance: '" + job.distance[2] + "' is no length");
    if (!(found > 0)) throw usage("--distance: both photographs were taken from one place");
    similarity.scale = wanted / found;
  } else if (!job.points.empty()) {
    const JsonNode root = readJsonFile(job.points);
    root.onlyKeys({"distance", "a", "b"});
    const Triangulated a = markedPoint(capture, root["a"]), b = markedPoint(capture, root["b"]);
    const double found = distance(a.point, b.point);
    if (!(found > 0)) throw root.error("marks one place twice");
    similarity.scale = root["distance"].positiveNumber() / found;
    reporter.result(text("places to scale by: their rays pass by at %.3g and %.3g %s", similarity.scale * a.distance,
                         similarity.scale * b.distance, job.units.c_str()));
    if (const double miss = std::max(a.distance, b.distance); miss > 0.05 * found)
      reporter.warn(
          text("%s: the marks of a place lie %.0f %% of the distance apart; look whether they show the same "
               "place in each photograph",
               job.points.c_str(), 100 * miss / found));
  } else {
    capture.units = "unknown";
    reporter.warn(
        "nothing sets the scale: the capture's units are unknown; give --board with a board in the "
        "photographs, --distance A B LENGTH or --points");
    return;
  }
  applySimilarity(capture, similarity);
  reporter.result(text("scale: %.6g %s for each unit of COLMAP's", similarity.scale, job.units.c_str()));
}

void calibrateByFeatures(const CalibrationJob& job, Reporter& reporter) {
  fs::path model = job.colmap_model;
  std::set<std::string> left_out;
  std::vector<ShootPhoto> photos;
  if (job.sfm) {
    photos = job.photographs(job.photos, job.pattern, left_out);
    StructureFromMotionOptions options;
    options.photos = job.photos;
    for (const ShootPhoto& photo : photos) {
      options.names.push_back(photo.file.lexically_relative(job.photos).generic_string());
      options.cameras.push_back(photo.camera);
    }
    options.masks = job.masks;
    options.workspace = job.output / "colmap";
    options.lens = job.lens.value_or(CameraModel::simple_radial);
    if (job.features) options.most_features = *job.features;
    if (job.largest_side) options.largest_side = *job.largest_side;
    if (!job.lens_from.empty()) options.known_lens = oneLens(job.lens_from);
    if (!job.board_photos.empty()) {
      const std::vector<ShootPhoto> of_board = job.photographs(job.board_photos, job.board_pattern, left_out);
      CalibrationJob lens_job = job;
      if (!job.lens) lens_job.lens = CameraModel::simple_radial;
      Sightings sightings = findBoards(lens_job, parseBoard(job.board), job.board_photos, of_board, false, reporter);
      if (sightings.input.cameras.size() > 1)
        throw usage("--sfm with --board-photos takes one camera's lens, the board's photographs are of several");
      const BoardCalibration found = calibrateWithBoard(sightings.input);
      tell(sightings.input, found, job.units, reporter);
      writeReport(job, sightings.input, found, sightings.without, reporter);
      options.known_lens = found.cameras[0].lens;
    }
    model = runStructureFromMotion(options, reporter);
  }
  Capture capture = readColmap(model, job.photos, reporter);
  capture.folder = job.output;
  capture.units = job.units;
  std::erase_if(capture.views, [&](const CaptureView& view) {
    const auto name = job.leavesOut(job.photos, view.photos[0].file);
    if (name) left_out.insert(*name);
    return name.has_value();
  });
  job.checkLeftOut(left_out);
  if (capture.views.empty()) throw badInput(model.string(), "no view is left; name fewer with --leave-out");
  if (!job.masks.empty()) {
    std::size_t without = 0;
    for (CaptureView& view : capture.views) {
      view.mask_file = maskFileOf(job.masks, view.photos[0].file.lexically_relative(job.photos).generic_string());
      without += view.mask_file.empty();
    }
    if (without == capture.views.size())
      throw badInput(job.masks.string(), "holds no mask of any photograph: expected for example " +
                                             capture.views[0].photos[0].file.filename().string() + ".png");
    if (without > 0 && !job.sfm)  // --sfm has told of them
      reporter.warn(job.masks.string() + ": " + std::to_string(without) + " photographs have no mask");
  }
  setScale(job, capture, reporter);
  writeResult(job, job.photos, capture, reporter);
}

int run(int argc, char** argv) {
  Program program("calibrate",
                  "From photographs to a capture: cameras (lens and pose) and lights. doc/calibration.md "
                  "tells how to photograph for it.");
  CLI::App& app = program.app();
  CalibrationJob job;
  job.addOptions(app);
  LightsAndImages studio;
  studio.addOptions(app);

  return program.run(argc, argv, [&](Reporter& reporter) {
    if (!job.print_board.empty()) {
      if (job.board.empty()) job.board = "charuco:8x11:20mm:15mm:5X5_100";
      const Board board = parseBoard(job.board);
      printBoard(board, job.print_board);
      reporter.result(job.print_board.string() + ": print it at its true size and calibrate with --board " +
                      board.text());
      return;
    }
    job.validate(studio);
    if (job.byFeatures()) return calibrateByFeatures(job, reporter);
    studio.oneView() ? calibrateOneView(job, studio, reporter) : calibrateByBoard(job, studio, reporter);
  });
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  return srf::run(argc, argv);
}
