#include "apps/calibrate_job.h"

#include <algorithm>
#include <map>

#include "apps/calibrate_lights.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

/// "{view}.*", or "{camera}/{view}.*" where the photographs lie in folders.
std::string defaultPattern(const fs::path& folder) {
  std::error_code code;
  for (const auto& entry : fs::directory_iterator(folder, code))
    if (entry.is_regular_file(code) && entry.path().has_extension() && entry.path().extension() != ".txt" &&
        entry.path().extension() != ".json" && entry.path().extension() != ".md")
      return "{view}.*";
  return "{camera}/{view}.*";
}

}  // namespace

void CalibrationJob::addOptions(CLI::App& app) {
  app.add_option("--print-board", print_board,
                 "write the board of --board as .svg or .pdf to print, and do nothing else");
  app.add_option("PHOTOS", photos, "folder of photographs of the object");
  app.add_option("-o,--output", output, "folder of the capture");
  app.add_option("--photos", pattern,
                 "what their paths say: {camera}, {view}, {light}, e.g. \"{camera}/{view}_{light}.jpg\"; default "
                 "{view}.*, or {camera}/{view}.* where there are folders");
  app.add_option("--camera", cameras, "NAME=PATTERN, once a camera, in place of --photos: left=left{view}.jpg");
  app.add_option("--board", board,
                 "inner corners and square of a chessboard, 9x6:25mm, or charuco:8x11:20mm:15mm:5X5_100 (squares, "
                 "square, marker, dictionary)");
  app.add_option(
      "--board-photos", board_photos,
      "folder of the board's photographs, by cameras that then stood still; default: the board lies in PHOTOS");
  app.add_option("--board-pattern", board_pattern, "as --photos, for the board's photographs");
  app.add_flag("--rig", rig, "the cameras stand still and the board moves: {view} names its moments");
  app.add_flag("--turntable", turntable, "the board lies on a turntable; the last number in {view} is the stop");
  app.add_option("--step", step,
                 "degrees from stop to stop where known, counter-clockwise from above is positive; default: fitted");
  app.add_option("--world", world, "rig: the shot whose board is the origin; default: the one that most cameras see");
  static const std::map<std::string, CameraModel> kLenses{{"pinhole", CameraModel::pinhole},
                                                          {"simple_radial", CameraModel::simple_radial},
                                                          {"opencv", CameraModel::opencv}};
  app.add_option_function<std::string>(
         "--lens", [this](const std::string& word) { lens = kLenses.at(word); },
         "lens to fit: pinhole, simple_radial (k1) or opencv (k1 k2 p1 p2 k3)")
      ->check(CLI::IsMember({"pinhole", "simple_radial", "opencv"}))
      ->default_str("opencv, with --sfm simple_radial");
  app.add_option("--lens-from", lens_from, "capture whose lenses are held in place of fitting them");
  CLI::Option* sfm_option = app.add_flag("--sfm", sfm, "structure from motion: COLMAP finds the cameras by features");
  app.add_option("--colmap", colmap_model, "folder of a COLMAP model of PHOTOS (cameras, images: .bin or .txt)")
      ->excludes(sfm_option);
  app.add_option("--masks", masks,
                 "folder of masks, named as the photographs (name.jpg.png, name.png) or the views; sfm: black has no "
                 "features");
  app.add_option("--distance", distance, "scale by two photographs and the distance of their cameras: A B LENGTH")
      ->expected(3)
      ->type_name("A B LENGTH");
  app.add_option("--points", points,
                 "scale by two places marked in photographs: JSON {\"distance\": d, \"a\": {\"1.jpg\": [x, y], ..}, "
                 "\"b\": ..}");
  app.add_option("--features", features, "sfm: most features of a photograph")->check(CLI::Range(256, 65536));
  app.add_option("--largest-side", largest_side, "sfm: larger photographs are searched at this size, pixels")
      ->check(CLI::Range(128, 65536));
  app.add_option(
      "--lights", lights,
      "JSON file with a list \"lights\" as in transforms.json, in acquisition space at a turntable's stop 0");
  app.add_option("--units", units, "unit of the capture: m, cm or mm")->capture_default_str();
  app.add_option("--leave-out", leave_out, "names of photographs to take no notice of");
  app.add_flag("--copy", copy, "copy the photographs into the capture");
}

void CalibrationJob::validate(const LightsAndImages& studio) const {
  const auto only = [](bool given, const std::string& option, bool useful, const std::string& with) {
    if (given && !useful) throw usage(option + " needs " + with + ": without it the option would do nothing");
  };
  const auto apart = [](std::initializer_list<std::pair<const char*, bool>> options, const std::string& why) {
    std::string both;
    int given = 0;
    for (const auto& [name, is_given] : options)
      if (is_given) both += (given++ ? " and " : "") + std::string(name);
    if (given > 1) throw usage(both + " exclude each other: " + why);
  };
  if (photos.empty()) throw usage("no folder of photographs is given; see --help");
  if (output.empty()) throw usage("-o names the folder of the capture; it is missing");
  unitInMillimetres(units);
  const bool by_board = !byFeatures() && !studio.oneView();
  if (byFeatures() ? studio.oneView() : board.empty() != studio.oneView())
    throw usage("one way is to be given: --board, --sfm, --colmap or --one-view; see --help");
  studio.validate();
  if (byFeatures() && (rig || turntable || !lights.empty() || studio.develops() || studio.findsLights()))
    throw usage("--rig, --turntable, lights and --develop need --board or --one-view");
  if (board.empty() && !board_photos.empty()) throw usage("--board-photos needs --board");
  if (!colmap_model.empty() && (!board_photos.empty() || !lens_from.empty()))
    throw usage("--colmap takes its lenses from the model: leave out --board-photos and --lens-from");
  if (!byFeatures() && (!distance.empty() || !points.empty()))
    throw usage("--distance and --points need --sfm or --colmap");
  apart({{"--rig", rig}, {"--turntable", turntable}}, "a turntable's cameras are a rig");
  apart({{"--camera", !cameras.empty()}, {"--photos", !pattern.empty()}}, "each says what the paths mean");
  apart({{"--lens", lens.has_value()}, {"--lens-from", !lens_from.empty()}}, "a lens is fitted or held");
  apart({{"--copy", copy}, {"--develop", studio.develops()}}, "developed images lie in the capture already");
  apart({{"--lights", !lights.empty()}, {"--spheres, --lp and --dome", studio.findsLights()}},
        "lights come from one of them");
  if (byFeatures())
    apart({{"--distance", !distance.empty()},
           {"--points", !points.empty()},
           {"--board", !board.empty() && board_photos.empty()}},
          "one thing sets the scale");
  only(step.has_value(), "--step", turntable, "--turntable");
  only(!world.empty(), "--world", by_board && !turntable && (rig || !board_photos.empty()), "--rig or --board-photos");
  only(!board_pattern.empty(), "--board-pattern", !board_photos.empty(), "--board-photos");
  only(!lens_from.empty(), "--lens-from", by_board || sfm, "--board or --sfm");
  only(lens.has_value(), "--lens", by_board || sfm, "--board or --sfm");
  only(features.has_value(), "--features", sfm, "--sfm");
  only(largest_side.has_value(), "--largest-side", sfm, "--sfm");
  only(rig || turntable, rig ? "--rig" : "--turntable", by_board, "--board");
  only(studio.setsStrengths(), "--strengths or --white", studio.findsLights() || !lights.empty(),
       "lights (--spheres, --lp, --dome or --lights)");
}

std::optional<std::string> CalibrationJob::leavesOut(const fs::path& folder, const fs::path& file) const {
  const fs::path relative = file.lexically_relative(folder);
  const auto named = std::find_if(leave_out.begin(), leave_out.end(), [&](const std::string& name) {
    return relative == name || file.filename() == name || file.stem() == name ||
           fs::path(relative).replace_extension() == name;
  });
  return named == leave_out.end() ? std::nullopt : std::optional(*named);
}

void CalibrationJob::checkLeftOut(const std::set<std::string>& left_out) const {
  for (const std::string& name : leave_out)
    if (!left_out.contains(name)) throw usage("--leave-out '" + name + "': no photograph has that name");
}

std::vector<ShootPhoto> CalibrationJob::photographs(const fs::path& folder, const std::string& of_pattern,
                                                    std::set<std::string>& left_out) const {
  std::vector<ShootPhoto> all;
  for (const std::string& camera : cameras) {
    const std::size_t equals = camera.find('=');
    if (equals == std::string::npos || equals == 0)
      throw usage("--camera '" + camera + "': expected NAME=PATTERN, e.g. left=left{view}.jpg");
    for (ShootPhoto& photo : findPhotos(folder, camera.substr(equals + 1))) {
      photo.camera = camera.substr(0, equals);
      all.push_back(std::move(photo));
    }
  }
  if (cameras.empty()) all = findPhotos(folder, of_pattern.empty() ? defaultPattern(folder) : of_pattern);
  std::vector<ShootPhoto> kept;
  for (ShootPhoto& photo : all) {
    if (photo.camera.empty()) photo.camera = "camera";
    if (const auto name = leavesOut(folder, photo.file))
      left_out.insert(*name);
    else
      kept.push_back(std::move(photo));
  }
  if (kept.empty()) throw badInput(folder.string(), "every photograph is left out; name fewer with --leave-out");
  return kept;
}

double unitInMillimetres(const std::string& unit) {
  if (unit == "m") return 1000;
  if (unit == "cm") return 10;
  if (unit == "mm") return 1;
  throw usage("--units '" + unit + "': expected m, cm or mm");
}

}  // namespace srf
