// Layouts: docs.nerf.studio data conventions; NRHints (Zeng et al. 2023); Agisoft Metashape's cameras.xml; RTI .lp
// (Mudge et al. 2006); DiLiGenT (Shi et al. 2016) and DiLiGenT-MV (Li et al. 2020); OpenIllumination (Liu et al. 2023).
#include "acquire/import_capture.h"

#include <matio.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <pugixml.hpp>
#include <set>
#include <sstream>

#include "acquire/camera_import.h"
#include "acquire/light_calibration.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/json.h"
#include "field/capture_file.h"
#include "field/capture_json.h"

namespace srf {
namespace {

namespace fs = std::filesystem;
using Pose = Rigid<AcquisitionSpace, CameraSpace>;

bool isThere(const fs::path& file) {
  std::error_code code;
  return fs::exists(file, code);
}
std::string counted(std::size_t n, const std::string& noun) {
  return std::to_string(n) + " " + noun + (n == 1 ? "" : "s");
}
std::string padded(std::size_t n, int digits) {
  std::string text = std::to_string(n);
  return std::string(static_cast<std::size_t>(std::max(0, digits - static_cast<int>(text.size()))), '0') + text;
}
CaptureLight capturedLight() {
  CaptureLight light;
  light.name = "captured";
  light.kind = LightKind::captured;
  return light;
}

/// The file of that name, with or without its extension.
std::optional<fs::path> photoNamed(const fs::path& folder, const std::string& name) {
  if (std::error_code code; fs::is_regular_file(folder / name, code)) return folder / name;
  for (const char* extension : {".exr", ".png", ".jpg", ".JPG", ".jpeg", ".JPEG", ".tif", ".TIF", ".tiff", ".PNG"})
    if (fs::path with = folder / (name + extension); isThere(with)) return with;
  return std::nullopt;
}

/// The numbers of a text file, line by line; lines without one are left out.
std::vector<std::vector<double>> numberRows(const fs::path& file) {
  std::istringstream text(readTextFile(file));
  std::vector<std::vector<double>> rows;
  std::string line;
  for (std::size_t n = 1; std::getline(text, line); ++n) {
    std::istringstream words(line);
    words.imbue(std::locale::classic());
    std::vector<double> row;
    std::string word;
    while (words >> word) {
      char* end = nullptr;
      const double value = std::strtod(word.c_str(), &end);
      if (*end != 0 || !std::isfinite(value))
        throw badInput(file.string() + ": line " + std::to_string(n),
                       "found '" + word.substr(0, 40) + "', expected finite numbers");
      row.push_back(value);
    }
    if (!row.empty()) rows.push_back(std::move(row));
  }
  return rows;
}
std::vector<Vec3> vectorRows(const fs::path& file) {
  std::vector<Vec3> out;
  for (const auto& row : numberRows(file)) {
    if (row.size() != 3)
      throw badInput(file.string(), "row " + std::to_string(out.size() + 1) + " has " + std::to_string(row.size()) +
                                        " numbers, expected 3");
    out.push_back({row[0], row[1], row[2]});
  }
  return out;
}

Pose poseFromWorldToCamera(Mat3 r, const Vec3& t, const std::string& where) {
  double off = 0;
  const Mat3 product = r * r.transposed();
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) off = std::max(off, std::fabs(product.row[i][j] - (i == j)));
  if (!(off < 1e-3) || !(determinant(r) > 0) || !isFinite(t))
    throw badInput(where, "the rotation is not a proper rotation (off by " + std::to_string(off) +
                              "); write it anew from the calibration");
  for (int i = 0; i < 8; ++i) r = 0.5 * (r + inverse(r).transposed());  // nearest rotation
  const Mat3 to_world = r.transposed();
  return {Orthogonal<AcquisitionSpace, CameraSpace>(to_world), Point<AcquisitionSpace>(-(to_world * t))};
}

// ---- transforms.json and its relatives

/// The transform that nerfstudio says it applied to the poses it writes: kept, and told.
void tellOfTransform(const Capture& capture, const fs::path& file, Reporter& reporter) {
  if (capture.applied_transform)
    reporter.warn(file.string() +
                  ": its poses were moved by the program that wrote it (applied_transform); they are kept as they are, "
                  "and so is the record");
}

/// Puts the views of `more` to those of `capture`; lights of one name but another place get names of their own.
void join(Capture& capture, Capture more, const std::string& part) {
  const bool unknown = more.unknownIllumination();
  std::vector<LightId> light_of;
  for (CaptureLight light : more.lights) {
    const auto same = std::find_if(capture.lights.begin(), capture.lights.end(), [&](const CaptureLight& l) {
      return l.kind == light.kind && l.position == light.position && l.strength == light.strength &&
             (l.kind != LightKind::directional || l.direction == light.direction);
    });
    light_of.push_back(LightId{static_cast<std::uint32_t>(same - capture.lights.begin())});
    if (same != capture.lights.end()) continue;
    if (!unknown) light.name = part + "_" + light.name;
    capture.lights.push_back(light);
  }
  std::set<std::string> names;
  for (const CaptureView& view : capture.views) names.insert(view.name);
  for (CaptureView& view : more.views) {
    for (Photo& photo : view.photos)
      if (photo.light) photo.light = light_of[photo.light->value];
    if (!names.insert(view.name).second) names.insert(view.name = part + "_" + view.name);
    capture.views.push_back(std::move(view));
  }
}

Capture readParts(const fs::path& folder, Reporter& reporter) {
  Capture capture;
  std::string parts;
  for (const char* part : {"train", "test", "valid", "val"}) {
    const fs::path file = folder / ("transforms_" + std::string(part) + ".json");
    if (!isThere(file)) continue;
    Capture more = readCapture(file);
    tellOfTransform(more, file, reporter);
    parts += std::string(parts.empty() ? "" : ", ") + part;
    if (capture.views.empty()) {
      capture.folder = more.folder;
      capture.integer_transfer = more.integer_transfer;
    }
    join(capture, std::move(more), part);
  }
  if (capture.views.empty())
    throw badInput(folder.string(), "holds no transforms_train.json, transforms_test.json or transforms_valid.json");
  reporter.info(folder.string() + ": the parts " + parts + " are one capture now");
  return capture;
}

// ---- Projection matrices

Capture readProjections(const fs::path& source, const ImportOptions& options, Reporter& reporter) {
  // A file of lines `name p11 .. p34`, or a folder with one matrix of three rows for each photograph.
  struct Entry {
    std::string name, where;
    std::vector<double> p;
  };
  std::vector<Entry> entries;
  const bool folder = fs::is_directory(source);
  const fs::path images = !options.images.empty() ? options.images : folder ? source : source.parent_path();
  if (folder) {
    for (const auto& file : fs::directory_iterator(source)) {
      if (file.path().extension() != ".txt") continue;
      std::string text = readTextFile(file.path());
      if (text.starts_with("CONTOUR")) text.erase(0, 7);  // as multi-view stereo data sets have it
      std::istringstream words(text);
      Entry entry{file.path().stem().string(), file.path().string(), {}};
      for (double v = 0; words >> v;) entry.p.push_back(v);
      if (entry.p.size() != 12 || !words.eof()) continue;  // another text file
      entries.push_back(std::move(entry));
    }
    std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.name < b.name; });
  } else {
    std::istringstream text(readTextFile(source));
    std::string line;
    for (std::size_t n = 1; std::getline(text, line); ++n) {
      if (line.find_first_not_of(" \t\r") == std::string::npos || line[0] == '#') continue;
      std::istringstream words(line);
      Entry entry{"", source.string() + ": line " + std::to_string(n), {}};
      words >> entry.name;
      for (double v = 0; words >> v;) entry.p.push_back(v);
      if (entry.p.size() != 12)
        throw badInput(entry.where, "holds " + counted(entry.p.size(), "number") +
                                        " after the name, expected the 12 of a 3 x 4 matrix, row by row");
      entries.push_back(std::move(entry));
    }
  }
  if (entries.empty()) throw badInput(source.string(), "holds no 3 x 4 projection matrix");
  Capture capture;
  capture.folder = images;
  capture.lights = {capturedLight()};
  std::size_t absent = 0;
  for (const Entry& e : entries) {
    const auto photo = photoNamed(images, e.name);
    if (!photo) {
      ++absent;
      continue;
    }
    CaptureView view;
    view.name = fs::path(e.name).stem().string();
    view.camera = cameraFromProjection(
        {{Vec3{e.p[0], e.p[1], e.p[2]}, Vec3{e.p[4], e.p[5], e.p[6]}, Vec3{e.p[8], e.p[9], e.p[10]}}},
        {e.p[3], e.p[7], e.p[11]}, options.pixel_center, e.where);
    const ImageSize size = readImageSize(*photo);
    view.camera.lens.width = size.width;
    view.camera.lens.height = size.height;
    view.photos.push_back({*photo, LightId{0}});
    capture.views.push_back(std::move(view));
  }
  if (absent > 0)
    reporter.warn(source.string() + ": " + counted(absent, "matrix") + " without a photograph in " + images.string() +
                  " left out");
  if (capture.views.empty())
    throw badInput(source.string(), "no photograph of its matrices lies in " + images.string());
  std::ostringstream center;
  center << options.pixel_center;
  reporter.info(source.string() + ": the first pixel's centre is taken to be at " + center.str() + " (--pixel-center)");
  return capture;
}

// ---- Metashape

std::vector<double> numbersOf(const pugi::xml_node& node, std::size_t count, const std::string& where) {
  std::istringstream words(node.text().as_string());
  std::vector<double> out;
  for (double v = 0; words >> v;) out.push_back(v);
  if (out.size() != count)
    throw badInput(where, "<" + std::string(node.name()) + "> holds " + counted(out.size(), "number") + ", expected " +
                              std::to_string(count));
  return out;
}

/// A similarity x -> scale R x + t as <transform> has it in a chunk or a component.
struct Similarity {
  double scale = 1;
  Mat3 r;
  Vec3 t;
  bool isIdentity() const { return scale == 1 && r == Mat3{} && t == Vec3{}; }
  Similarity operator*(const Similarity& b) const { return {scale * b.scale, r * b.r, scale * (r * b.t) + t}; }
};
Similarity similarityOf(const pugi::xml_node& node, const std::string& where) {
  Similarity s;
  if (const auto rotation = node.child("rotation")) {
    const auto n = numbersOf(rotation, 9, where);
    for (int i = 0; i < 9; ++i) s.r.row[i / 3][i % 3] = n[static_cast<std::size_t>(i)];
  }
  if (const auto translation = node.child("translation")) {
    const auto n = numbersOf(translation, 3, where);
    s.t = {n[0], n[1], n[2]};
  }
  if (const auto scale = node.child("scale")) s.scale = numbersOf(scale, 1, where)[0];
  if (!(s.scale > 0)) throw badInput(where, "has a scale that is not above 0; export the cameras again");
  return s;
}

/// The lens of a sensor; nothing for a dummy without calibration.
std::optional<Intrinsics> sensorLens(const pugi::xml_node& sensor, const std::string& where) {
  pugi::xml_node calibration;
  for (const auto& c : sensor.children("calibration"))
    if (!calibration || std::string(c.attribute("class").value()) == "adjusted") calibration = c;
  if (!calibration) return std::nullopt;
  pugi::xml_node resolution = calibration.child("resolution");
  if (!resolution) resolution = sensor.child("resolution");
  const auto value = [&](const char* name) { return calibration.child(name).text().as_double(0); };
  Intrinsics lens;
  lens.width = resolution.attribute("width").as_int();
  lens.height = resolution.attribute("height").as_int();
  const double f = value("f");
  if (!(f > 0) || lens.width < 1 || lens.height < 1) return std::nullopt;
  const std::string type = calibration.attribute("type").as_string("frame");
  if (type != "frame" && type != "fisheye")
    throw badInput(where, "has a lens of type '" + type + "', expected frame or fisheye; undistort the photographs");
  lens.fl_x = f + value("b1");
  lens.fl_y = f;
  lens.skew = value("b2");
  // Offsets from the middle of the picture; older programs wrote coordinates.
  lens.cx = 0.5 * lens.width + value("cx");
  lens.cy = 0.5 * lens.height + value("cy");
  if (std::fabs(value("cx")) > 0.25 * lens.width || std::fabs(value("cy")) > 0.25 * lens.height)
    throw badInput(where,
                   "has cx, cy a quarter of the picture off its middle: they are read as offsets from there, as "
                   "the format has them since 1.5; export the cameras again");
  lens.k1 = value("k1"), lens.k2 = value("k2"), lens.k3 = value("k3"), lens.k4 = value("k4");
  lens.p1 = value("p2"), lens.p2 = value("p1");  // their p1 goes with x, OpenCV's with y
  if (type == "fisheye") {
    lens.model = CameraModel::opencv_fisheye;
    if (lens.p1 != 0 || lens.p2 != 0)
      throw badInput(where, "has p1 or p2 in a fisheye lens, which OPENCV_FISHEYE lacks; calibrate without them");
  } else if (lens.k4 != 0) {
    throw badInput(where, "has k4, which the OPENCV lens lacks; calibrate without it, or undistort the photographs");
  } else if (lens.k1 != 0 || lens.k2 != 0 || lens.k3 != 0 || lens.p1 != 0 || lens.p2 != 0) {
    lens.model = CameraModel::opencv;
  }
  return lens;
}

Capture readMetashape(const fs::path& file, const ImportOptions& options, Reporter& reporter) {
  const std::string text = readTextFile(file);
  pugi::xml_document document;
  if (const auto result = document.load_buffer(text.data(), text.size()); !result)
    throw badInput(file.string(), "byte " + std::to_string(result.offset) + " is not valid XML (" +
                                      result.description() + "); export the cameras again");
  std::vector<pugi::xml_node> chunks;
  for (const auto& found : document.select_nodes("//chunk"))
    if (found.node().select_node(".//camera/transform")) chunks.push_back(found.node());
  if (chunks.empty()) throw badInput(file.string(), "holds no aligned camera; align the photographs and export again");
  if (chunks.size() > 1)
    reporter.warn(file.string() + ": " + std::to_string(chunks.size()) + " chunks; the first, '" +
                  chunks[0].attribute("label").value() + "', is taken");
  const pugi::xml_node chunk = chunks[0];
  std::map<std::string, std::optional<Intrinsics>> lenses;
  for (const auto& sensor : chunk.select_nodes(".//sensor")) {
    const std::string id = sensor.node().attribute("id").value();
    lenses[id] = sensorLens(sensor.node(), file.string() + ": sensor " + id);
  }
  const Similarity world = similarityOf(chunk.child("transform"), file.string() + ": the chunk's transform");
  std::map<std::string, Similarity> components;
  for (const auto& c : chunk.select_nodes(".//component")) {
    const std::string id = c.node().attribute("id").value();
    components[id] = similarityOf(c.node().child("transform"), file.string() + ": component " + id);
  }
  Capture capture;
  capture.folder = file.parent_path();
  const fs::path images = !options.images.empty()              ? options.images
                          : isThere(capture.folder / "images") ? capture.folder / "images"
                                                               : capture.folder;
  capture.lights = {capturedLight()};
  std::size_t unaligned = 0, dummy = 0, absent = 0;
  std::string example;
  std::set<std::string> names;
  for (const auto& found : chunk.select_nodes(".//camera")) {
    const pugi::xml_node camera = found.node();
    const std::string label = camera.attribute("label").value();
    const std::string where = file.string() + ": camera '" + label + "'";
    if (!camera.child("transform")) {
      ++unaligned;
      continue;
    }
    const auto lens = lenses.find(camera.attribute("sensor_id").value());
    if (lens == lenses.end() || !lens->second) {
      ++dummy;
      continue;
    }
    const auto photo = photoNamed(images, label);
    if (!photo) {
      ++absent;
      example = label;
      continue;
    }
    const auto n = numbersOf(camera.child("transform"), 16, where);
    Mat3 r;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) r.row[i][j] = n[static_cast<std::size_t>(4 * i + j)];
    const auto part = components.find(camera.attribute("component_id").value());
    const Similarity to_world = part == components.end() ? world : world * part->second;
    const Vec3 center = to_world.scale * (to_world.r * Vec3{n[3], n[7], n[11]}) + to_world.t;
    const Mat3 from_world = (to_world.r * r).transposed();
    CaptureView view;
    view.name = label;
    while (!names.insert(view.name).second) view.name += "_";
    view.camera = {*lens->second, poseFromWorldToCamera(from_world, -(from_world * center), where)};
    view.camera.pose = {view.camera.pose.rotation(), Point<AcquisitionSpace>(center)};
    view.photos.push_back({*photo, LightId{0}});
    capture.views.push_back(std::move(view));
  }
  const auto tell = [&](std::size_t count, const std::string& what) {
    if (count > 0) reporter.warn(file.string() + ": " + counted(count, "camera") + " left out: " + what);
  };
  tell(unaligned, "not aligned");
  tell(dummy, "their sensor has no calibration");
  tell(absent, "no photograph, e.g. '" + example + "', in " + images.string());
  if (capture.views.empty()) throw badInput(file.string(), "no camera is left; see the warnings");
  if (!world.isIdentity()) {
    std::array<double, 12> m{};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j)
        m[4 * i + j] = world.scale * world.r.row[static_cast<int>(i)][static_cast<int>(j)];
      m[4 * i + 3] = world.t[static_cast<int>(i)];
    }
    capture.applied_transform = m;
    reporter.warn(file.string() + ": the chunk's transform (scale " + std::to_string(world.scale) +
                  ") is applied, as the program that wrote it does; it is recorded as applied_transform");
  }
  return capture;
}

// ---- Photometric stereo: one view each

/// These have no camera: an orthographic one a picture's width wide stands in, looking along -z with y up, so that the
/// lights' own frame (x right, y up, z to the camera) is acquisition space.
Camera<AcquisitionSpace> standInCamera(const ImageSize& size) {
  Camera<AcquisitionSpace> camera;
  camera.lens = {CameraModel::orthographic, size.width, size.height};
  camera.lens.fl_x = camera.lens.fl_y = size.width;
  camera.lens.cx = 0.5 * size.width, camera.lens.cy = 0.5 * size.height;
  camera.pose = {Orthogonal<AcquisitionSpace, CameraSpace>(Mat3{{Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}}),
                 Point<AcquisitionSpace>(0, 0, 1)};
  return camera;
}
void tellOfStandIn(const fs::path& file, Reporter& reporter) {
  reporter.warn(file.string() +
                ": it says nothing of the camera: an orthographic one stands in, and lengths are in "
                "widths of the picture");
}

Capture readRti(const fs::path& file, const ImportOptions& options, Reporter& reporter) {
  Capture capture;
  capture.folder = options.images.empty() ? file.parent_path() : options.images;
  capture.units = "picture width";
  CaptureView view;
  view.name = file.stem().string();
  std::string missing;
  std::size_t absent = 0;
  for (const LpLight& light : readLp(file)) {
    std::string name = light.file;
    std::replace(name.begin(), name.end(), '\\', '/');
    auto photo = photoNamed(capture.folder, name);
    if (!photo) photo = photoNamed(capture.folder, fs::path(name).filename().string());
    if (!photo) {
      ++absent;
      missing = light.file;
      continue;
    }
    if (view.photos.empty()) view.camera = standInCamera(readImageSize(*photo));
    CaptureLight made;
    made.name = "L" + padded(capture.lights.size(), 3);
    made.direction = Direction<AcquisitionSpace>::fromUnit(light.direction);
    view.photos.push_back({*photo, LightId{static_cast<std::uint32_t>(capture.lights.size())}});
    capture.lights.push_back(made);
  }
  if (absent > 0)
    reporter.warn(file.string() + ": " + counted(absent, "photograph") + " missing, e.g. " + missing + ": left out");
  if (view.photos.empty()) throw badInput(file.string(), "none of its photographs lies in " + capture.folder.string());
  capture.views.push_back(std::move(view));
  tellOfStandIn(file, reporter);
  return capture;
}

/// The lights of a DiLiGenT folder go to `capture`, its photographs to `view`; `world_from_light` turns the lights'
/// frame (x right, y up, z to the camera).
void readDiligentFolder(const fs::path& folder, const Mat3& world_from_light, const std::string& prefix,
                        Capture& capture, CaptureView& view) {
  const auto directions = vectorRows(folder / "light_directions.txt");
  const auto intensities = vectorRows(folder / "light_intensities.txt");
  std::vector<std::string> files;
  if (isThere(folder / "filenames.txt")) {
    std::istringstream text(readTextFile(folder / "filenames.txt"));
    for (std::string line; std::getline(text, line);) {
      line.erase(line.find_last_not_of(" \t\r") + 1);
      if (!line.empty()) files.push_back(line);
    }
  } else {
    for (std::size_t i = 0; i < directions.size(); ++i) files.push_back(padded(i + 1, 3) + ".png");
  }
  if (directions.size() != intensities.size() || directions.size() != files.size())
    throw badInput(folder.string(), "holds " + counted(directions.size(), "direction") + ", " +
                                        std::to_string(intensities.size()) + " intensities and " +
                                        counted(files.size(), "file name") + "; expected as many of each");
  for (std::size_t i = 0; i < files.size(); ++i) {
    const auto unit = normalize(Vector<AcquisitionSpace>(world_from_light * directions[i]));
    if (!unit)
      throw badInput((folder / "light_directions.txt").string(), "row " + std::to_string(i + 1) + " has no length");
    CaptureLight light;
    light.name = prefix + fs::path(files[i]).stem().string();
    light.direction = *unit;
    light.strength = intensities[i];
    view.photos.push_back({folder / files[i], LightId{static_cast<std::uint32_t>(capture.lights.size())}});
    capture.lights.push_back(light);
  }
  if (isThere(folder / "mask.png")) view.mask_file = folder / "mask.png";
}

Capture readDiligent(const fs::path& folder, Reporter& reporter) {
  Capture capture;
  capture.folder = folder;
  capture.units = "picture width";
  capture.integer_transfer = Transfer::linear;  // 16-bit files of raw values
  CaptureView view;
  view.name = fs::absolute(folder).lexically_normal().filename().string();
  if (view.name.empty()) view.name = "view";
  readDiligentFolder(folder, Mat3{}, "", capture, view);
  view.camera = standInCamera(readImageSize(view.photos[0].file));
  capture.views.push_back(std::move(view));
  tellOfStandIn(folder, reporter);
  return capture;
}

/// A matrix of a MATLAB file, by name.
class MatFile {
 public:
  explicit MatFile(const fs::path& file)
      : file_(file.string()), mat_(Mat_Open(file.c_str(), MAT_ACC_RDONLY), Mat_Close) {
    if (!mat_) throw badInput(file_, isThere(file) ? "is no MATLAB file" : "does not exist");
  }
  bool has(const std::string& name) const { return variable(name) != nullptr; }
  /// Values row by row.
  std::vector<double> matrix(const std::string& name, std::size_t rows, std::size_t columns) const {
    const auto v = variable(name);
    if (!v) throw badInput(file_, "lacks the variable " + name);
    if (v->rank != 2 || v->dims[0] != rows || v->dims[1] != columns || v->class_type != MAT_C_DOUBLE || !v->data)
      throw badInput(file_, "its " + name + " is not a matrix of " + std::to_string(rows) + " x " +
                                std::to_string(columns) + " numbers");
    std::vector<double> out(rows * columns);
    for (std::size_t i = 0; i < rows; ++i)
      for (std::size_t j = 0; j < columns; ++j)
        out[i * columns + j] = static_cast<const double*>(v->data)[j * rows + i];
    return out;
  }

 private:
  std::unique_ptr<matvar_t, void (*)(matvar_t*)> variable(const std::string& name) const {
    return {Mat_VarRead(mat_.get(), name.c_str()), Mat_VarFree};
  }
  std::string file_;
  std::unique_ptr<mat_t, int (*)(mat_t*)> mat_;
};

Capture readDiligentMv(const fs::path& folder, Reporter& reporter) {
  const fs::path file = folder / "Calib_Results.mat";
  const MatFile calibration(file);
  const auto k = calibration.matrix("KK", 3, 3);
  Capture capture;
  capture.folder = folder;
  capture.units = "mm";
  capture.integer_transfer = Transfer::linear;
  for (std::size_t i = 1; calibration.has("Rc_" + std::to_string(i)); ++i) {
    const fs::path of = folder / ("view_" + padded(i, 2));
    if (!isThere(of)) {
      reporter.warn(of.string() + ": calibrated, but without photographs: left out");
      continue;
    }
    const std::string where = file.string() + ": Rc_" + std::to_string(i);
    const auto r = calibration.matrix("Rc_" + std::to_string(i), 3, 3);
    const auto t = calibration.matrix("Tc_" + std::to_string(i), 3, 1);
    CaptureView view;
    view.name = "view_" + padded(i, 2);
    view.camera.pose = poseFromWorldToCamera({{Vec3{r[0], r[1], r[2]}, Vec3{r[3], r[4], r[5]}, Vec3{r[6], r[7], r[8]}}},
                                             {t[0], t[1], t[2]}, where);
    const Mat3 flip{{Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{0, 0, -1}}};
    readDiligentFolder(of, view.camera.pose.rotation().raw() * flip, view.name + "_", capture, view);
    const ImageSize size = readImageSize(view.photos[0].file);
    Intrinsics& lens = view.camera.lens;
    lens.width = size.width, lens.height = size.height;
    lens.fl_x = k[0], lens.skew = k[1], lens.fl_y = k[4];
    lens.cx = k[2] + 0.5, lens.cy = k[5] + 0.5;  // the calibration toolbox counts from the first pixel's centre
    capture.views.push_back(std::move(view));
  }
  if (capture.views.empty()) throw badInput(folder.string(), "holds no view_01 .. of its calibration");
  return capture;
}

// ---- OpenIllumination

/// Rows of three numbers from a NumPy file of float32 or float64, in C order.
std::vector<Vec3> npyRows(const fs::path& file) {
  const auto bytes = readBinaryFile(file);
  const auto bad = [&](const std::string& what) {
    return badInput(file.string(), what + "; expected a NumPy array of N x 3 floats in C order");
  };
  if (bytes.size() < 10 || std::memcmp(bytes.data(), "\x93NUMPY", 6) != 0) throw bad("is no .npy file");
  const auto byte = [&](std::size_t i) { return std::to_integer<std::size_t>(bytes[i]); };
  const bool wide = byte(6) >= 2;
  const std::size_t start = wide ? 12 : 10;
  if (bytes.size() < start) throw bad("ends early");
  const std::size_t length = byte(8) | byte(9) << 8 | (wide ? byte(10) << 16 | byte(11) << 24 : 0);
  if (length > bytes.size() - start) throw bad("ends early");
  const std::string header(reinterpret_cast<const char*>(bytes.data()) + start, length);
  const bool f8 = header.find("'<f8'") != std::string::npos, f4 = header.find("'<f4'") != std::string::npos;
  if ((!f8 && !f4) || header.find("'fortran_order': False") == std::string::npos) throw bad("holds " + header);
  const std::size_t size = f8 ? 8 : 4, data = bytes.size() - start - length;
  if (data % (3 * size) != 0 || header.find(", 3)") == std::string::npos) throw bad("holds " + header);
  std::vector<Vec3> rows(data / (3 * size));
  for (std::size_t i = 0; i < rows.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const std::byte* at = bytes.data() + start + length + (3 * i + static_cast<std::size_t>(c)) * size;
      double d = 0;
      float f = 0;
      if (f8)
        std::memcpy(&d, at, 8);
      else
        std::memcpy(&f, at, 4), d = f;
      if (!std::isfinite(d)) throw bad("row " + std::to_string(i) + " is not finite");
      rows[i][c] = d;
    }
  return rows;
}

Capture readOpenIllumination(const fs::path& folder, const ImportOptions& options, Reporter& reporter) {
  const fs::path output = isThere(folder / "output") ? folder / "output" : folder;
  fs::path lights_file = options.lights;
  for (const fs::path& place : {folder, output, folder.parent_path(), folder.parent_path().parent_path()})
    if (lights_file.empty() && isThere(place / "light_pos.npy")) lights_file = place / "light_pos.npy";
  if (lights_file.empty()) throw badInput(folder.string(), "holds no light_pos.npy; name it with --lights");
  const auto positions = npyRows(lights_file);
  const fs::path lights_folder = folder / "Lights";
  std::vector<std::pair<std::size_t, fs::path>> lit;  // index of the light, folder of its photographs
  if (isThere(lights_folder))
    for (const auto& entry : fs::directory_iterator(lights_folder)) {
      const std::string name = entry.path().filename().string();
      if (name.find_first_not_of("0123456789") != std::string::npos || name.size() > 9) continue;
      const fs::path photos = entry.path() / "raw_undistorted";
      lit.emplace_back(std::stoul(name), isThere(photos) ? photos : entry.path());
    }
  std::sort(lit.begin(), lit.end());
  if (lit.empty()) throw badInput(lights_folder.string(), "holds no folders 0, 1, .. with photographs of each light");
  Capture capture;
  capture.folder = folder;
  for (const auto& [index, unused] : lit) {
    if (index >= positions.size())
      throw badInput(
          (lights_folder / std::to_string(index)).string(),
          "is a light that " + lights_file.string() + " lacks (it holds " + std::to_string(positions.size()) + ")");
    CaptureLight light;
    light.name = padded(index, 3);
    light.kind = LightKind::point;
    light.position = Point<AcquisitionSpace>(positions[index]);
    capture.lights.push_back(light);
  }
  std::set<std::string> seen;
  for (const char* part : {"train", "test", "val", "valid"}) {
    const fs::path file = output / ("transforms_" + std::string(part) + ".json");
    if (!isThere(file)) continue;
    const JsonNode root = readJsonFile(file);
    const JsonNode frames = root["frames"];
    std::vector<std::pair<std::string, JsonNode>> list;  // keyed by the camera's name, or a plain list
    if (frames.isObject())
      for (const auto& [key, unused] : frames.raw().items()) list.emplace_back(key, frames[key]);
    else
      for (std::size_t i = 0; i < frames.size(); ++i) {
        const JsonNode frame = frames.at(i);
        list.emplace_back(fs::path(frame["file_path"].string()).stem().string(), frame);
      }
    for (const auto& [name, frame] : list) {
      if (!seen.insert(name).second) continue;
      CaptureView view;
      view.name = name;
      for (std::size_t l = 0; l < lit.size(); ++l)
        if (const auto photo = photoNamed(lit[l].second, name))
          view.photos.push_back({*photo, LightId{static_cast<std::uint32_t>(l)}});
      if (view.photos.empty()) {
        reporter.warn(frame.where() + ": camera '" + name + "' has no photograph: left out");
        continue;
      }
      const ImageSize size = readImageSize(view.photos[0].file);
      view.camera.pose = readPose(frame["transform_matrix"]);
      view.camera.lens = readLens({frame, root}, [&] { return size; });
      // A focal length is in pixels of that picture; an angle is of any.
      const auto width = frame.has("calib_imgw") ? frame.find("calib_imgw") : root.find("calib_imgw");
      if (width && (frame.has("fl_x") || root.has("fl_x"))) {
        const double scale = size.width / static_cast<double>(width->integer(1, 65536));
        Intrinsics& lens = view.camera.lens;
        lens.width = size.width, lens.height = size.height;
        for (double* v : {&lens.fl_x, &lens.fl_y, &lens.cx, &lens.cy}) *v *= scale;
      }
      for (const char* masks : {"obj_masks", "com_masks"})
        if (const auto mask = photoNamed(output / masks, name); mask && view.mask_file.empty()) view.mask_file = *mask;
      capture.views.push_back(std::move(view));
    }
  }
  if (capture.views.empty()) throw badInput(output.string(), "holds no transforms_train.json .. with photographs");
  reporter.warn(lights_file.string() + ": says nothing of how strong the lights are: each gets the intensity 1");
  return capture;
}

}  // namespace

Camera<AcquisitionSpace> cameraFromProjection(const Mat3& m, const Vec3& last_column, double pixel_center,
                                              const std::string& where) {
  const double det = determinant(m);
  const double size = length(m.row[0]) * length(m.row[1]) * length(m.row[2]);
  if (!isFinite(last_column) || !(std::fabs(det) > 1e-12 * size))
    throw badInput(where,
                   "is a projection without a finite centre (its left 3 x 3 is singular), which no photograph of "
                   "a pinhole has; mend the matrix");
  // P and -P are the same projection; of positive determinant, K has a positive diagonal and R is a rotation.
  const double sign = det > 0 ? 1 : -1;
  const Vec3 a = sign * m.row[0], b = sign * m.row[1], c = sign * m.row[2];
  const double k33 = length(c);
  const Vec3 r3 = c / k33;
  const double k23 = dot(b, r3);
  const Vec3 b2 = b - k23 * r3;
  const double k22 = length(b2);
  const Vec3 r2 = b2 / k22, r1 = cross(r2, r3);
  Camera<AcquisitionSpace> camera;
  camera.lens.fl_x = dot(a, r1) / k33;
  camera.lens.skew = dot(a, r2) / k33;
  camera.lens.cx = dot(a, r3) / k33 + 0.5 - pixel_center;
  camera.lens.fl_y = k22 / k33;
  camera.lens.cy = k23 / k33 + 0.5 - pixel_center;
  const Mat3 to_world = Mat3::fromColumns(r1, r2, r3);
  camera.pose = {Orthogonal<AcquisitionSpace, CameraSpace>(to_world),
                 Point<AcquisitionSpace>(-(inverse(m) * last_column))};
  return camera;
}

const std::vector<std::string>& importFormats() {
  static const std::vector<std::string> kFormats{"transforms",  "nrhints",         "colmap", "middlebury",
                                                 "projections", "metashape",       "lp",     "diligent",
                                                 "diligent-mv", "openillumination"};
  return kFormats;
}

std::string guessFormat(const fs::path& source) {
  if (!isThere(source)) throw badInput(source.string(), "does not exist; check the path");
  if (!fs::is_directory(source)) {
    const std::string name = source.filename().string(), extension = source.extension().string();
    if (name.ends_with("_par.txt")) return "middlebury";
    if (extension == ".json") return "transforms";
    if (extension == ".xml") return "metashape";
    if (extension == ".lp") return "lp";
    throw badInput(source.string(), "is of no format that its name tells; say which with --format");
  }
  if (isThere(source / "transforms.json")) return "transforms";
  if (isThere(source / "Calib_Results.mat")) return "diligent-mv";
  if (isThere(source / "light_directions.txt")) return "diligent";
  if (isThere(source / "Lights")) return "openillumination";
  if (isThere(source / "transforms_train.json")) return "nrhints";
  for (const char* sub : {"", "sparse", "sparse/0"})
    if (isThere(source / sub / "images.bin") || isThere(source / sub / "images.txt")) return "colmap";
  for (const auto& entry : fs::directory_iterator(source)) {
    const fs::path& file = entry.path();
    if (file.filename().string().ends_with("_par.txt")) return "middlebury";
    if (file.extension() == ".lp") return "lp";
  }
  throw badInput(source.string(), "is of no format that is known by its files; say which with --format");
}

Capture importCapture(const std::string& format, const fs::path& source, const ImportOptions& options,
                      Reporter& reporter) {
  const auto onlyFile = [&](const std::string& extension) {
    if (!fs::is_directory(source)) return source;
    std::vector<fs::path> found;
    for (const auto& entry : fs::directory_iterator(source))
      if (entry.path().extension() == extension) found.push_back(entry.path());
    if (found.size() != 1)
      throw badInput(source.string(),
                     "holds " + counted(found.size(), extension + " file") + "; name the one that is meant");
    return found[0];
  };
  if (format == "transforms") {
    Capture capture = readCapture(source);
    tellOfTransform(capture, source, reporter);
    return capture;
  }
  if (format == "nrhints") return readParts(source, reporter);
  if (format == "colmap" && !options.images.empty()) {
    for (const char* sub : {"sparse/0", "sparse"})
      if (isThere(source / sub / "images.bin") || isThere(source / sub / "images.txt"))
        return readColmap(source / sub, options.images, reporter);
    return readColmap(source, options.images, reporter);
  }
  if (format == "colmap" || format == "middlebury") return openCapture(source, reporter);
  if (format == "projections") return readProjections(source, options, reporter);
  if (format == "metashape") return readMetashape(onlyFile(".xml"), options, reporter);
  if (format == "lp") return readRti(onlyFile(".lp"), options, reporter);
  if (format == "diligent") return readDiligent(source, reporter);
  if (format == "diligent-mv") return readDiligentMv(source, reporter);
  if (format == "openillumination") return readOpenIllumination(source, options, reporter);
  throw Error(ErrorKind::usage, "unknown format '" + format + "'", "--format");
}

}  // namespace srf
