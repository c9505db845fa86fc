#include "apps/calibrate_lights.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "base/error.h"
#include "base/numeric.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

Error usage(const std::string& option, const std::string& what) {
  return {ErrorKind::usage, what, option};
}

std::vector<double> numbersOf(const std::string& option, const std::string& text, std::size_t count) {
  std::vector<double> out;
  std::size_t at = 0;
  while (at <= text.size()) {
    const std::size_t comma = std::min(text.find(',', at), text.size());
    char* end = nullptr;
    const std::string part = text.substr(at, comma - at);
    out.push_back(std::strtod(part.c_str(), &end));
    if (part.empty() || *end || !std::isfinite(out.back())) out.clear(), at = text.size();
    at = comma + 1;
  }
  if (out.size() != count)
    throw usage(option, "'" + text + "': expected " + std::to_string(count) + " numbers with commas between them");
  return out;
}

const PlacedCamera& cameraOf(const ShootPhoto& photo, const std::vector<PlacedCamera>& cameras) {
  for (const PlacedCamera& c : cameras)
    if ((photo.camera.empty() || c.camera == photo.camera) &&
        (photo.view.empty() || c.view.empty() || c.view == photo.view))
      return c;
  throw badInput(photo.file.string(),
                 "belongs to no calibrated camera (camera '" + photo.camera + "', view '" + photo.view + "')");
}

bool samePicture(const ShootPhoto& a, const ShootPhoto& b) {
  return a.camera == b.camera && a.view == b.view && a.light == b.light;
}

// Photographs of one picture stand together, whatever order the shoot lists them in.
std::vector<std::vector<ShootPhoto>> pictures(const std::vector<ShootPhoto>& photos) {
  std::vector<std::vector<ShootPhoto>> out;
  for (const ShootPhoto& photo : photos) {
    const auto at = std::find_if(out.begin(), out.end(), [&](const auto& b) { return samePicture(b[0], photo); });
    if (at == out.end())
      out.push_back({photo});
    else
      at->push_back(photo);
  }
  return out;
}

std::string line(const char* format, auto... values) {
  char text[400];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

}  // namespace

void LightsAndImages::addOptions(CLI::App& app) {
  const auto add = [&](const char* name, auto& value, const char* help) { return app.add_option(name, value, help); };
  const char* kImages = "Images";
  app.add_flag("--develop", develop_, "write linear EXR images into the capture: response undone, exposures merged")
      ->group(kImages);
  add("--encoding", encoding_,
      "what 8/16-bit values mean: srgb, linear, measure (the response, from the first bracket), or a response.csv")
      ->capture_default_str()
      ->group(kImages);
  add("--exposures", exposures_, "table 'name,seconds' by {exposure} or file name; default: the files' EXIF")
      ->group(kImages);
  add("--dark", dark_, "dark frames, subtracted by their mean")->group(kImages);
  add("--flat", flat_, "photographs of an even white surface: vignetting is divided out")->group(kImages);
  add("--saturated", saturated_, "values at this or above, as encoded from 0 to 1, are masked")
      ->check(CLI::Range(0.5, 1.0))
      ->capture_default_str()
      ->group(kImages);
  add("--ignore-color", ignored_, "r,g,b from 0 to 255: pixels of just this colour are no photograph (a border)")
      ->delimiter(',')
      ->expected(3)
      ->group(kImages);
  add("--input-space", input_space_,
      "linear colour space of the photographs: lin_rec709, ACEScg, ACES2065-1, or one of $OCIO; made lin_rec709")
      ->capture_default_str()
      ->group(kImages);
  app.add_flag("--undistort", undistort_, "with --develop: resample to pinhole cameras, by area")->group(kImages);
  add("--one-view", one_view_,
      "one camera without calibration: 'orthographic', or its vertical field of view in degrees")
      ->group(kImages);

  const char* kLights = "Lights";
  add("--spheres", spheres_, "pattern of photographs of mirror balls under each {light}, below PHOTOS")->group(kLights);
  add("--sphere", circles_, "x,y,radius in pixels of a ball, roughly; once for each ball")->group(kLights);
  add("--sphere-mask", sphere_mask_, "mask of the one ball, in place of --sphere")->group(kLights);
  app.add_flag("--keep-spheres", keep_spheres_,
               "the circles of --sphere or --sphere-mask are right: no outline is fitted to the photographs")
      ->group(kLights);
  add("--sphere-radius", sphere_radius_, "true radius of the balls, units: two balls or more then place near lights")
      ->check(CLI::PositiveNumber)
      ->group(kLights);
  app.add_flag("--matt-sphere", matt_, "the ball is matt white: directions from its shading")->group(kLights);
  add("--lp", lp_, ".lp file of directions, in the frame of the one view or of the first")->group(kLights);
  add("--dome", dome_, ".dome file of directions in that frame, or JSON with \"lights\"")->group(kLights);
  add("--strengths", strengths_, "table 'light,r,g,b' or 'light,value' of irradiances or intensities")->group(kLights);
  add("--white", white_, "pattern of photographs of a white matt target under each {light}; needs --develop")
      ->group(kLights);
  add("--white-rectangle", white_rectangle_, "x,y,width,height in pixels of the target")
      ->delimiter(',')
      ->expected(4)
      ->group(kLights);
  add("--white-reflectance", white_reflectance_, "of the target")
      ->check(CLI::Range(0.01, 1.0))
      ->capture_default_str()
      ->group(kLights);
  add("--white-normal", white_normal_, "x,y,z of the target; default: it faces the camera")
      ->delimiter(',')
      ->expected(3)
      ->group(kLights);
  add("--white-position", white_position_, "x,y,z of the target's middle, for near lights; default: the origin")
      ->delimiter(',')
      ->expected(3)
      ->group(kLights);
}

void LightsAndImages::validate() const {
  for (const auto& [option, given] :
       std::initializer_list<std::pair<const char*, bool>>{{"--undistort", undistort_},
                                                           {"--exposures", !exposures_.empty()},
                                                           {"--dark", !dark_.empty()},
                                                           {"--flat", !flat_.empty()},
                                                           {"--ignore-color", !ignored_.empty()},
                                                           {"--input-space", input_space_ != "lin_rec709"}})
    if (given && !develop_) throw usage(option, "needs --develop");
  if (encoding_ != "srgb" && encoding_ != "linear") {
    if (!develop_) throw usage("--encoding", "needs --develop, but for srgb and linear");
    if (std::error_code code; encoding_ != "measure" && !fs::is_regular_file(encoding_, code))
      throw usage("--encoding", "'" + encoding_ +
                                    "': expected srgb, linear, measure, or a file that --encoding "
                                    "measure wrote (response.csv)");
  }
  if (white_.empty() && (!white_rectangle_.empty() || !white_normal_.empty() || !white_position_.empty()))
    throw usage("--white-rectangle, --white-normal and --white-position", "need --white");
  if ((!circles_.empty() || !sphere_mask_.empty() || sphere_radius_ > 0 || matt_ || keep_spheres_) && spheres_.empty())
    throw usage("--sphere", "needs --spheres, the pattern of the photographs that show the balls");
  if (!spheres_.empty() && circles_.empty() == sphere_mask_.empty())
    throw usage("--spheres", "needs the balls: --sphere x,y,radius for each, or --sphere-mask FILE");
  if ((!spheres_.empty()) + (!lp_.empty()) + (!dome_.empty()) > 1)
    throw usage("--spheres", "and --lp and --dome exclude each other: lights come from one of them");
  if (!white_.empty() && (!develop_ || white_rectangle_.empty()))
    throw usage("--white", "needs --develop, on whose scale the strengths are, and --white-rectangle");
  if (!white_.empty() && !strengths_.empty()) throw usage("--white", "and --strengths exclude each other");
  if (matt_ && circles_.size() > 1) throw usage("--matt-sphere", "takes one ball");
  if (oneView() && one_view_ != "orthographic") {
    const double fov = numbersOf("--one-view", one_view_, 1)[0];
    if (!(fov > 0.1 && fov < 170)) throw usage("--one-view", "expected 'orthographic' or degrees from 0.1 to 170");
  }
}

Camera<AcquisitionSpace> LightsAndImages::oneViewCamera(const ImageSize& size) const {
  Camera<AcquisitionSpace> camera;
  if (one_view_ == "orthographic") {
    Intrinsics& lens = camera.lens;
    lens.model = CameraModel::orthographic;
    lens.width = size.width, lens.height = size.height;
    lens.fl_x = lens.fl_y = 0.5 * std::max(size.width, size.height);  // the longer side spans -1 to 1
    lens.cx = 0.5 * size.width, lens.cy = 0.5 * size.height;
  } else {
    camera.lens = pinholeFromFov(size.width, size.height, numbersOf("--one-view", one_view_, 1)[0]);
  }
  camera.pose = Rigid<AcquisitionSpace, CameraSpace>(
      Orthogonal<AcquisitionSpace, CameraSpace>(Mat3{{Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}}),
      Point<AcquisitionSpace>(0, 0, 4));
  return camera;
}

Exposure LightsAndImages::exposureOf(const ShootPhoto& photo, bool bracketed, Prepared& prepared) const {
  Photograph p = readPhotograph(photo.file, prepared.white_balance);
  // The first RAW file's balance is every file's: a camera on automatic must not colour the lights.
  if (p.is_raw && !prepared.white_balance) prepared.white_balance = p.white_balance;
  Exposure e{std::move(p.pixels), 1, p.is_linear || encoding_ == "linear"};
  if (!exposures_.empty()) {
    auto row = prepared.seconds.find(photo.exposure);
    if (row == prepared.seconds.end()) row = prepared.seconds.find(photo.file.filename().string());
    if (row == prepared.seconds.end())
      throw badInput(exposures_.string(),
                     "has no row for '" + photo.exposure + "' nor for '" + photo.file.filename().string() + "'");
    e.amount = row->second[0];
  } else {
    // An unknown exposure cannot be set against another.
    if (!p.seconds && (bracketed || prepared.timed.value_or(false)))
      throw badInput(photo.file.string(),
                     std::string("its EXIF tells no exposure time, ") +
                         (bracketed ? "and it is one of several exposures of a picture" : "which others' does") +
                         "; give the times with --exposures");
    if (p.seconds && !prepared.timed.value_or(true))
      throw badInput(photo.file.string(),
                     "its EXIF tells an exposure time, which others' does not; give the times with --exposures");
    prepared.timed = p.seconds.has_value();
    if (p.seconds) e.amount = *p.seconds * p.iso.value_or(100) / 100 / square(p.f_number.value_or(1));
  }
  if (!(e.amount > 0)) throw badInput(exposures_.string(), "gives " + photo.file.string() + " no time above 0");
  return e;
}

LightsAndImages::Prepared& LightsAndImages::prepare(const std::vector<ShootPhoto>& photos, Reporter& reporter) {
  if (prepared_) return *prepared_;
  Prepared& prepared = prepared_.emplace();
  if (!exposures_.empty()) prepared.seconds = readNamedTable(exposures_, 1);
  prepared.color.emplace(input_space_, "lin_rec709");
  if (encoding_ == "srgb")
    prepared.response = CameraResponse::srgb();
  else if (encoding_ != "linear" && encoding_ != "measure")
    prepared.response = CameraResponse::read(encoding_);
  const auto groups = pictures(photos);
  // The scale of all: the longest exposure's values stay as they are.
  prepared.largest_amount = 0;
  for (const ShootPhoto& photo : groups.front())
    prepared.largest_amount =
        std::max(prepared.largest_amount, exposureOf(photo, groups.front().size() > 1, prepared).amount);
  if (encoding_ == "measure") {
    const auto longest = std::max_element(groups.begin(), groups.end(),
                                          [](const auto& a, const auto& b) { return a.size() < b.size(); });
    std::vector<Exposure> bracket;
    for (const ShootPhoto& photo : *longest) bracket.push_back(exposureOf(photo, longest->size() > 1, prepared));
    IgnoredColour ignored;
    if (!ignored_.empty())
      ignored = {{static_cast<float>(ignored_[0] / 255), static_cast<float>(ignored_[1] / 255),
                  static_cast<float>(ignored_[2] / 255)}};
    prepared.response = measureResponse(bracket, ignored);
    reporter.result(line("response measured from %zu exposures", bracket.size()));
  }
  const auto meanOf = [&](const std::vector<fs::path>& files) {
    std::vector<ImageF> images;
    for (const fs::path& file : files) {
      const Photograph p = readPhotograph(file, prepared.white_balance);
      images.push_back(linearImage({p.pixels, 1, p.is_linear || encoding_ == "linear"}, prepared.response));
    }
    return meanImage(images);
  };
  if (!dark_.empty()) prepared.dark = meanOf(dark_);
  if (!flat_.empty()) {
    ImageF white = meanOf(flat_);
    if (!prepared.dark.empty())
      for (std::size_t i = 0; i < white.data().size() && white.data().size() == prepared.dark.data().size(); ++i)
        white.data()[i] -= prepared.dark.data()[i];
    prepared.flat = flatField(white);
  }
  return prepared;
}

Merged LightsAndImages::picture(const std::vector<ShootPhoto>& bracket, Prepared& prepared) const {
  std::vector<Exposure> exposures;
  for (const ShootPhoto& photo : bracket) exposures.push_back(exposureOf(photo, bracket.size() > 1, prepared));
  MergeOptions options;
  options.saturated = saturated_;
  if (!ignored_.empty())
    options.ignored = {{static_cast<float>(ignored_[0] / 255), static_cast<float>(ignored_[1] / 255),
                        static_cast<float>(ignored_[2] / 255)}};
  std::vector<ImageF> dark;
  if (!prepared.dark.empty()) dark.push_back(prepared.dark);
  Merged merged = mergeExposures(exposures, prepared.response, options, dark);
  if (!prepared.flat.empty()) divideByFlat(merged.radiance, prepared.flat);
  for (float& v : merged.radiance.data()) v = static_cast<float>(v * prepared.largest_amount);
  prepared.color->apply(merged.radiance);
  return merged;
}

std::vector<ShootPhoto> LightsAndImages::developed(const std::vector<ShootPhoto>& photos,
                                                   const std::vector<PlacedCamera>& cameras, const fs::path& output,
                                                   Reporter& reporter) {
  Prepared& prepared = prepare(photos, reporter);
  const auto groups = pictures(photos);
  std::vector<std::pair<Intrinsics, Undistortion>> lenses;
  std::vector<ShootPhoto> out;
  Reporter::Stage stage(reporter, "images", groups.size());
  std::size_t saturated = 0, dark = 0, clamped = 0;
  for (const auto& group : groups) {
    ShootPhoto photo = group.front();
    Merged merged = picture(group, prepared);
    if (undistort_) {
      const Intrinsics& lens = cameraOf(photo, cameras).at.lens;
      auto at = std::find_if(lenses.begin(), lenses.end(), [&](const auto& l) { return l.first == lens; });
      if (at == lenses.end()) at = lenses.insert(at, {lens, Undistortion(lens)});
      merged.radiance = at->second.apply(merged.radiance);
    }
    const auto part = [](const std::string& name, const char* otherwise) {
      return name.empty() ? std::string(otherwise) : name;
    };
    photo.file = output / "images" / part(photo.camera, "camera") / part(photo.view, "view") /
                 (part(photo.light, "light") + ".exr");
    photo.exposure.clear();
    Attributes attributes{{"srf.exposures", std::to_string(group.size())},
                          {"srf.colorConversion", prepared.color->means()}};
    if (prepared.white_balance)
      attributes["srf.whiteBalance"] = line("%g %g %g %g", (*prepared.white_balance)[0], (*prepared.white_balance)[1],
                                            (*prepared.white_balance)[2], (*prepared.white_balance)[3]);
    clamped += writeMaskedExr(photo.file, merged.radiance, attributes);
    saturated += merged.saturated_pixels, dark += merged.dark_pixels;
    out.push_back(photo);
    stage.advance();
  }
  if (encoding_ == "measure") prepared.response.write(output / "response.csv");
  reporter.count("pixels.saturated", saturated);
  reporter.count("pixels.dark", dark);
  reporter.count("pixels.clamped", clamped);
  reporter.result(
      line("%zu linear images from %zu photographs: %zu pixels saturated and masked, %zu under 1 %% in "
           "their longest exposure and kept, %zu values clamped to half",
           groups.size(), photos.size(), saturated, dark, clamped));
  return out;
}

std::vector<CaptureLight> LightsAndImages::fromSpheres(const fs::path& folder, const std::vector<PlacedCamera>& cameras,
                                                       Prepared& prepared, Reporter& reporter) const {
  // One exposure of each is enough for outlines and highlights: the first.
  const auto groups = pictures(findPhotos(folder, spheres_));
  std::vector<ShootPhoto> photos;
  for (const auto& group : groups) photos.push_back(group.front());
  if (photos.front().light.empty()) throw usage("--spheres", "needs {light} in its pattern");
  const PlacedCamera& camera = cameraOf(photos.front(), cameras);
  const Intrinsics& lens = camera.at.lens;
  std::vector<ImageF> images;
  ImageF mean(lens.width, lens.height, 1);
  for (const ShootPhoto& photo : photos) {
    if (&cameraOf(photo, cameras) != &camera)
      throw usage("--spheres", "takes photographs of one camera and view; give a pattern that names it");
    const Photograph p = readPhotograph(photo.file);
    ImageF grey(p.pixels.width(), p.pixels.height(), 1);
    if (grey.width() != lens.width || grey.height() != lens.height)
      throw badInput(photo.file.string(), "has another size than its camera's photographs");
    const int channels = p.pixels.channels();
    for (std::size_t i = 0; i < grey.data().size(); ++i) {
      for (int c = 0; c < channels; ++c)
        grey.data()[i] += p.pixels.data()[i * channels + c] / static_cast<float>(channels);
      if (std::isfinite(grey.data()[i])) mean.data()[i] += grey.data()[i] / static_cast<float>(photos.size());
    }
    images.push_back(matt_ ? ImageF() : std::move(grey));
  }
  std::vector<ImageCircle> circles;
  for (const std::string& text : circles_) {
    const auto n = numbersOf("--sphere", text, 3);
    circles.push_back({{n[0], n[1]}, n[2]});
  }
  if (!sphere_mask_.empty()) circles.push_back(circleOfMask(readMask(sphere_mask_)));
  std::vector<FittedOutline> outlines;
  for (const ImageCircle& circle : circles) {
    if (keep_spheres_) {
      outlines.push_back(givenOutline(lens, circle));
      continue;
    }
    outlines.push_back(fitOutline(mean, lens, outlineFromCircle(lens, circle)));
    double x = 0, y = 0, r = 0;
    const auto pixels = outlinePixels(lens, outlines.back().outline, 64);
    const auto count = static_cast<double>(pixels.size());
    for (const Vec2& p : pixels) x += p.x / count, y += p.y / count;
    for (const Vec2& p : pixels) r += std::hypot(p.x - x, p.y - y) / count;
    reporter.result(line("ball at %.2f, %.2f with a radius of %.2f pixels; its edge seen along %.0f %%, rms %.2f px", x,
                         y, r, 100 * outlines.back().covered, outlines.back().rms));
  }
  std::vector<CaptureLight> lights;
  std::vector<std::string> without;
  for (std::size_t i = 0; i < photos.size(); ++i) {
    CaptureLight light;
    light.name = photos[i].light;
    if (matt_) {
      // Shading is measured as the object's pictures are: what is saturated is masked in them.
      const auto fit = fitLambertBall(picture(groups[i], prepared).radiance, lens, outlines[0].outline);
      if (!fit) {
        without.push_back(light.name);
        continue;
      }
      light.direction = camera.at.pose * fit->direction;
      reporter.result(line("light %s: direction %.4f, %.4f, %.4f +- %.2g degrees", light.name.c_str(),
                           light.direction.raw().x, light.direction.raw().y, light.direction.raw().z,
                           degrees(fit->sigma)));
      lights.push_back(light);
      continue;
    }
    std::vector<MirrorSighting> sightings;
    for (const FittedOutline& outline : outlines)
      if (const auto highlight = findHighlight(images[i], lens, outline.outline))
        sightings.push_back({camera.at, outline, sphere_radius_ > 0 ? sphere_radius_ : 1, *highlight});
    const auto distant = estimateDistant(sightings);
    if (!distant) {
      without.push_back(light.name);
      continue;
    }
    light.direction = distant->direction;
    const auto near = sphere_radius_ > 0 ? estimateNear(sightings) : std::nullopt;
    if (near) {
      light.kind = LightKind::point;
      light.position = near->position;
      const Mat3& c = near->covariance;
      reporter.result(line("light %s: at %.4g, %.4g, %.4g +- %.2g", light.name.c_str(), near->position.raw().x,
                           near->position.raw().y, near->position.raw().z,
                           std::sqrt(c.row[0].x + c.row[1].y + c.row[2].z)));
      if (near->miss > 3)
        reporter.warn(
            line("light %s: the balls disagree by %.1f times what is to be expected; look whether each "
                 "shows one highlight, and whether --sphere-radius is right",
                 light.name.c_str(), near->miss));
    } else {
      reporter.result(line("light %s: direction %.4f, %.4f, %.4f +- %.2g degrees", light.name.c_str(),
                           distant->direction.raw().x, distant->direction.raw().y, distant->direction.raw().z,
                           degrees(distant->sigma)));
    }
    lights.push_back(light);
  }
  if (!without.empty())
    reporter.warn(std::to_string(without.size()) +
                  " lights show no highlight on a ball and are left out, the first is '" + without.front() + "'");
  if (lights.empty())
    throw badInput(folder.string(), "no light shows on the balls; look at the photographs of --spheres");
  return lights;
}

std::vector<CaptureLight> LightsAndImages::fromLp(const std::vector<ShootPhoto>& photos,
                                                  const std::vector<PlacedCamera>& cameras, Reporter& reporter) const {
  std::vector<CaptureLight> lights;
  std::size_t missing = 0, rescaled = 0;
  for (const LpLight& lp : readLp(lp_)) {
    std::string name = lp.file;
    std::replace(name.begin(), name.end(), '\\', '/');
    name = fs::path(name).filename().string();
    const auto photo = std::find_if(photos.begin(), photos.end(), [&](const ShootPhoto& p) {
      return p.file.filename() == name || p.file.stem() == fs::path(name).stem();
    });
    rescaled += lp.normalised_here;
    if (photo == photos.end()) {
      ++missing;
      continue;
    }
    CaptureLight light;
    light.name = photo->light;
    light.direction = cameras.front().at.pose * fromLpFrame(lp.direction);
    lights.push_back(light);
  }
  if (missing > 0)
    reporter.warn(std::to_string(missing) + " lines of " + lp_.string() + " name photographs that are not there");
  if (rescaled > 0)
    reporter.warn(std::to_string(rescaled) + " directions of " + lp_.string() + " were not of length 1");
  if (lights.empty()) throw badInput(lp_.string(), "names no photograph of this shoot; check --photos and the files");
  return lights;
}

std::vector<CaptureLight> LightsAndImages::lights(const fs::path& folder, const std::vector<ShootPhoto>& photos,
                                                  const std::vector<PlacedCamera>& cameras, Reporter& reporter) {
  if (std::any_of(photos.begin(), photos.end(), [](const ShootPhoto& p) { return p.light.empty(); }))
    throw usage("--photos", "needs {light}: which light a photograph was taken under is told by its name");
  return !spheres_.empty() ? fromSpheres(folder, cameras, prepare(photos, reporter), reporter)
         : !lp_.empty()    ? fromLp(photos, cameras, reporter)
                           : readDome(dome_, cameras.front().at);
}

void LightsAndImages::setStrengthsOf(std::vector<CaptureLight>& lights, const fs::path& folder,
                                     const std::vector<PlacedCamera>& cameras, Reporter& reporter) {
  if (!strengths_.empty()) {
    setStrengths(lights, strengths_);
  } else if (!white_.empty()) {
    const auto groups = pictures(findPhotos(folder, white_));
    for (CaptureLight& light : lights) {
      const auto group =
          std::find_if(groups.begin(), groups.end(), [&](const auto& g) { return g[0].light == light.name; });
      if (group == groups.end())
        throw badInput(folder.string(), "has no photograph of the white target under light '" + light.name + "'");
      const ImageF radiance = picture(*group, *prepared_).radiance;
      if (const auto& r = white_rectangle_; !(r[0] >= 0 && r[1] >= 0 && r[2] >= 1 && r[3] >= 1 &&
                                              r[0] + r[2] <= radiance.width() && r[1] + r[3] <= radiance.height()))
        throw usage("--white-rectangle", line("x,y,width,height of %g,%g,%g,%g do not lie in the photographs' %d x %d "
                                              "pixels",
                                              r[0], r[1], r[2], r[3], radiance.width(), radiance.height()));
      Image8 region(radiance.width(), radiance.height(), 1);
      const int x0 = static_cast<int>(white_rectangle_[0]), y0 = static_cast<int>(white_rectangle_[1]);
      for (int y = std::max(0, y0); y < std::min<double>(region.height(), y0 + white_rectangle_[3]); ++y)
        for (int x = std::max(0, x0); x < std::min<double>(region.width(), x0 + white_rectangle_[2]); ++x)
          region.at(x, y) = 255;
      WhiteTarget target;
      target.reflectance = white_reflectance_ * Vec3{1, 1, 1};
      target.normal = -cameraOf(group->front(), cameras).at.forward();
      if (!white_normal_.empty()) {
        const auto n = normalize(Vector<AcquisitionSpace>(white_normal_[0], white_normal_[1], white_normal_[2]));
        if (!n) throw usage("--white-normal", "has no length");
        target.normal = *n;
      }
      if (!white_position_.empty())
        target.position = Point<AcquisitionSpace>(white_position_[0], white_position_[1], white_position_[2]);
      light.strength = strengthFromWhite(light, meanRadiance(radiance, region), target);
    }
  } else if (findsLights() && dome_.empty()) {
    reporter.warn("nothing tells how strong the lights are: each is taken as 1; give --white or --strengths");
  }
}

}  // namespace srf
