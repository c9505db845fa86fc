#include "acquire/export_capture.h"

#include <matio.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <pugixml.hpp>
#include <set>
#include <sstream>

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

std::string exact(double v) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", v);
  return text;
}
std::string exact(std::initializer_list<double> values) {
  std::string out;
  for (const double v : values) out += (out.empty() ? "" : " ") + exact(v);
  return out;
}

/// World-to-camera.
struct Extrinsics {
  Mat3 r;
  Vec3 t;
};
Extrinsics extrinsicsOf(const Camera<AcquisitionSpace>& camera) {
  const Mat3 r = camera.pose.rotation().raw().transposed();
  return {r, -(r * camera.center().raw())};
}

/// Puts a mask there as the PNG file that its new name promises.
void placeMask(const fs::path& from, const fs::path& to) {
  if (from.extension() == ".png" || from.extension() == ".PNG") return linkOrCopy(from, to);
  std::error_code code;
  fs::create_directories(to.parent_path(), code);
  writePng(to, readMask(from));
}

/// A name of a photograph that no other has: its path below the capture's folder where it lies there.
class Names {
 public:
  explicit Names(bool blanks_allowed) : blanks_(blanks_allowed) {}
  std::string of(const Capture& capture, const fs::path& file) {
    const fs::path below = fs::absolute(file).lexically_normal().lexically_relative(
        fs::absolute(capture.folder.empty() ? "." : capture.folder).lexically_normal());
    std::string name = below.empty() || below.native().starts_with("..") ? file.filename().string() : below.string();
    std::replace(name.begin(), name.end(), '/', '_');
    if (!blanks_)
      std::replace_if(
          name.begin(), name.end(), [](char c) { return c == ' ' || c == '\t'; }, '_');
    return unique(name);
  }
  std::string unique(const std::string& name) {
    std::string free = name;
    for (int i = 2; !taken_.insert(free).second; ++i) free = std::to_string(i) + "_" + name;
    return free;
  }

 private:
  bool blanks_;
  std::set<std::string> taken_;
};

Error cannotHold(const std::string& format, const CaptureView& view, const std::string& what) {
  return badInput("view '" + view.name + "'", what + ", which the format " + format + " cannot hold");
}

void refuse(const std::string& format, const Capture& capture, std::initializer_list<CameraModel> models,
            bool skew_allowed) {
  for (const CaptureView& view : capture.views) {
    const Intrinsics& lens = view.camera.lens;
    if (std::find(models.begin(), models.end(), lens.model) == models.end())
      throw cannotHold(format, view, "its lens is " + cameraModelName(lens.model));
    if (!skew_allowed && lens.skew != 0) throw cannotHold(format, view, "its lens has a skew");
  }
}

void warnOfLights(const std::string& format, const Capture& capture, Reporter& reporter) {
  if (!capture.unknownIllumination()) reporter.warn("the lights are lost: " + format + " has none");
}
void warnOfMasks(const std::string& format, const Capture& capture, Reporter& reporter) {
  if (std::any_of(capture.views.begin(), capture.views.end(), [](const auto& v) { return !v.mask_file.empty(); }))
    reporter.warn("the masks are lost: " + format + " names none");
}
void warnOfPhotos(const std::string& format, const Capture& capture, Reporter& reporter) {
  if (std::any_of(capture.views.begin(), capture.views.end(), [](const auto& v) { return v.photos.size() > 1; }))
    reporter.warn("all but the first photograph of each view are lost: " + format + " has one a camera");
}

void exportNrhints(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  for (const CaptureLight& light : capture.lights)
    if (light.kind != LightKind::point)
      throw badInput("light '" + light.name + "'", "is no point light; the format nrhints holds these alone");
  warnOfMasks("nrhints", capture, reporter);
  reporter.warn("the names of views and lights are lost: nrhints has poses and positions alone");
  Json root;
  root["frames"] = Json::array();
  for (const CaptureView& view : capture.views)
    for (const Photo& photo : view.photos) {
      if (!photo.light) {
        reporter.warn(photo.file.string() + ": is left out: nrhints has no photograph without a light");
        continue;
      }
      const CaptureLight& light = capture.lights[photo.light->value];
      Json frame;
      frame["file_path"] = fs::absolute(photo.file)
                               .lexically_normal()
                               .lexically_relative(fs::absolute(folder).lexically_normal())
                               .generic_string();
      writeLens(frame, view.camera.lens);
      frame["pl_pos"] = vec3Json(light.position.raw());
      frame["pl_intensity"] = vec3Json(light.strength);
      frame["transform_matrix"] = poseJson(view.camera.pose);
      root["frames"].push_back(std::move(frame));
    }
  writeJsonFile(folder / "transforms_train.json", root);
}

// ---- COLMAP

struct ColmapLens {
  int id;
  const char* model;
  std::vector<double> parameters;
};
ColmapLens colmapLens(const Intrinsics& l) {
  switch (l.model) {
    case CameraModel::simple_radial:
      if (l.fl_x == l.fl_y) return {2, "SIMPLE_RADIAL", {l.fl_x, l.cx, l.cy, l.k1}};
      return {4, "OPENCV", {l.fl_x, l.fl_y, l.cx, l.cy, l.k1, 0, 0, 0}};
    case CameraModel::opencv:
      if (l.k3 != 0) return {6, "FULL_OPENCV", {l.fl_x, l.fl_y, l.cx, l.cy, l.k1, l.k2, l.p1, l.p2, l.k3, 0, 0, 0}};
      return {4, "OPENCV", {l.fl_x, l.fl_y, l.cx, l.cy, l.k1, l.k2, l.p1, l.p2}};
    case CameraModel::opencv_fisheye:
      return {5, "OPENCV_FISHEYE", {l.fl_x, l.fl_y, l.cx, l.cy, l.k1, l.k2, l.k3, l.k4}};
    default:
      return {1, "PINHOLE", {l.fl_x, l.fl_y, l.cx, l.cy}};
  }
}

class BinaryFile {
 public:
  template <class T>
  void put(T value) {
    const char* at = reinterpret_cast<const char*>(&value);
    bytes_.insert(bytes_.end(), at, at + sizeof value);
  }
  void put(const std::string& text) { bytes_ += text + '\0'; }
  void write(const fs::path& file) const { writeTextFile(file, bytes_); }

 private:
  std::string bytes_;
};

void exportColmap(const std::string& format, const Capture& capture, const fs::path& folder, Reporter& reporter) {
  refuse(format, capture,
         {CameraModel::pinhole, CameraModel::simple_radial, CameraModel::opencv, CameraModel::opencv_fisheye}, false);
  warnOfLights(format, capture, reporter);
  if (std::any_of(capture.views.begin(), capture.views.end(), [](const auto& v) { return v.photos.size() > 1; }))
    reporter.warn("the views come apart: each photograph becomes an image of its own");
  const bool binary = format == "colmap-binary";
  const fs::path model = folder / "sparse" / "0";
  std::vector<Intrinsics> lenses;
  std::string cameras = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
  std::string images = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n";
  BinaryFile cameras_bin, images_bin, points_bin;
  std::uint64_t image_count = 0;
  for (const CaptureView& view : capture.views) {
    if (std::find(lenses.begin(), lenses.end(), view.camera.lens) == lenses.end()) lenses.push_back(view.camera.lens);
    image_count += view.photos.size();
  }
  cameras_bin.put(static_cast<std::uint64_t>(lenses.size()));
  for (std::size_t i = 0; i < lenses.size(); ++i) {
    const ColmapLens lens = colmapLens(lenses[i]);
    cameras += std::to_string(i + 1) + " " + lens.model + " " + std::to_string(lenses[i].width) + " " +
               std::to_string(lenses[i].height);
    cameras_bin.put(static_cast<std::uint32_t>(i + 1));
    cameras_bin.put(static_cast<std::int32_t>(lens.id));
    cameras_bin.put(static_cast<std::uint64_t>(lenses[i].width));
    cameras_bin.put(static_cast<std::uint64_t>(lenses[i].height));
    for (const double p : lens.parameters) {
      cameras += " " + exact(p);
      cameras_bin.put(p);
    }
    cameras += "\n";
  }
  images_bin.put(image_count);
  points_bin.put(std::uint64_t{0});
  Names names(/*blanks_allowed=*/false);
  std::uint32_t id = 0;
  for (const CaptureView& view : capture.views) {
    const auto lens =
        static_cast<std::uint32_t>(std::find(lenses.begin(), lenses.end(), view.camera.lens) - lenses.begin() + 1);
    const Extrinsics e = extrinsicsOf(view.camera);
    const Quaternion q = quaternionFromRotation(e.r);
    for (const Photo& photo : view.photos) {
      const std::string name = names.of(capture, photo.file);
      images += std::to_string(++id) + " " + exact({q.w, q.x, q.y, q.z, e.t.x, e.t.y, e.t.z}) + " " +
                std::to_string(lens) + " " + name + "\n\n";
      images_bin.put(id);
      for (const double v : {q.w, q.x, q.y, q.z, e.t.x, e.t.y, e.t.z}) images_bin.put(v);
      images_bin.put(lens);
      images_bin.put(name);
      images_bin.put(std::uint64_t{0});  // key points
      linkOrCopy(photo.file, folder / "images" / name);
      if (!view.mask_file.empty()) placeMask(view.mask_file, folder / "masks" / (name + ".png"));
    }
  }
  if (binary) {
    cameras_bin.write(model / "cameras.bin");
    images_bin.write(model / "images.bin");
    points_bin.write(model / "points3D.bin");
  } else {
    writeTextFile(model / "cameras.txt", cameras);
    writeTextFile(model / "images.txt", images);
    writeTextFile(model / "points3D.txt", "# no points\n");
  }
}

// ---- Matrices

void exportMiddlebury(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  refuse("middlebury", capture, {CameraModel::pinhole}, true);
  warnOfLights("middlebury", capture, reporter);
  warnOfMasks("middlebury", capture, reporter);
  warnOfPhotos("middlebury", capture, reporter);
  Names names(/*blanks_allowed=*/false);
  std::string lines;
  for (const CaptureView& view : capture.views) {
    const Intrinsics& l = view.camera.lens;
    const Extrinsics e = extrinsicsOf(view.camera);
    const std::string name = names.of(capture, view.photos[0].file);
    linkOrCopy(view.photos[0].file, folder / name);
    lines += name + " " + exact({l.fl_x, l.skew, l.cx - 0.5, 0, l.fl_y, l.cy - 0.5, 0, 0, 1}) + " ";
    for (const Vec3& row : e.r.row) lines += exact({row.x, row.y, row.z}) + " ";
    lines += exact({e.t.x, e.t.y, e.t.z}) + "\n";
  }
  writeTextFile(folder / "capture_par.txt", std::to_string(capture.views.size()) + "\n" + lines);
  if (const auto& box = capture.bounds)
    writeTextFile(folder / "README.txt", "The bounding box of the object is (" +
                                             exact({box->min.x, box->min.y, box->min.z}) + ") (" +
                                             exact({box->max.x, box->max.y, box->max.z}) + ")\n");
}

void exportProjections(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  refuse("projections", capture, {CameraModel::pinhole}, true);
  warnOfLights("projections", capture, reporter);
  warnOfMasks("projections", capture, reporter);
  warnOfPhotos("projections", capture, reporter);
  Names names(/*blanks_allowed=*/false);
  std::string lines = "# photograph, P = K [R t] row by row; the first pixel's centre is at 0\n";
  for (const CaptureView& view : capture.views) {
    const Intrinsics& l = view.camera.lens;
    const Extrinsics e = extrinsicsOf(view.camera);
    const Mat3 k{{Vec3{l.fl_x, l.skew, l.cx - 0.5}, Vec3{0, l.fl_y, l.cy - 0.5}, Vec3{0, 0, 1}}};
    const Mat3 m = k * e.r;
    const Vec3 last = k * e.t;
    const std::string name = names.of(capture, view.photos[0].file);
    linkOrCopy(view.photos[0].file, folder / name);
    lines += name;
    for (int i = 0; i < 3; ++i) lines += " " + exact({m.row[i].x, m.row[i].y, m.row[i].z, last[i]});
    lines += "\n";
  }
  writeTextFile(folder / "projections.txt", lines);
}

// ---- Metashape

void exportMetashape(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  refuse("metashape", capture,
         {CameraModel::pinhole, CameraModel::simple_radial, CameraModel::opencv, CameraModel::opencv_fisheye}, true);
  warnOfLights("metashape", capture, reporter);
  warnOfMasks("metashape", capture, reporter);
  warnOfPhotos("metashape", capture, reporter);
  pugi::xml_document document;
  auto root = document.append_child("document");
  root.append_attribute("version") = "1.5.0";
  auto chunk = root.append_child("chunk");
  chunk.append_attribute("label") = "capture";
  auto sensors = chunk.append_child("sensors"), cameras = chunk.append_child("cameras");
  std::vector<Intrinsics> lenses;
  Names names(true);
  for (std::size_t v = 0; v < capture.views.size(); ++v) {
    const CaptureView& view = capture.views[v];
    const Intrinsics& l = view.camera.lens;
    auto known = std::find(lenses.begin(), lenses.end(), l);
    const std::size_t id = static_cast<std::size_t>(known - lenses.begin());
    if (known == lenses.end()) {
      lenses.push_back(l);
      const bool fisheye = l.model == CameraModel::opencv_fisheye;
      auto sensor = sensors.append_child("sensor");
      sensor.append_attribute("id") = static_cast<unsigned long long>(id);
      sensor.append_attribute("type") = fisheye ? "fisheye" : "frame";
      auto calibration = sensor.append_child("calibration");
      calibration.append_attribute("type") = fisheye ? "fisheye" : "frame";
      calibration.append_attribute("class") = "adjusted";
      auto resolution = calibration.append_child("resolution");
      resolution.append_attribute("width") = l.width;
      resolution.append_attribute("height") = l.height;
      const std::pair<const char*, double> values[] = {{"f", l.fl_y},
                                                       {"cx", l.cx - 0.5 * l.width},
                                                       {"cy", l.cy - 0.5 * l.height},
                                                       {"b1", l.fl_x - l.fl_y},
                                                       {"b2", l.skew},
                                                       {"k1", l.k1},
                                                       {"k2", l.k2},
                                                       {"k3", l.k3},
                                                       {"k4", l.k4},
                                                       {"p1", l.p2},
                                                       {"p2", l.p1}};  // their p1 goes with x, OpenCV's with y
      for (const auto& [name, value] : values)
        if (value != 0) calibration.append_child(name).text() = exact(value).c_str();
    }
    const std::string name = names.of(capture, view.photos[0].file);
    linkOrCopy(view.photos[0].file, folder / "images" / name);
    auto camera = cameras.append_child("camera");
    camera.append_attribute("id") = static_cast<unsigned long long>(v);
    camera.append_attribute("sensor_id") = static_cast<unsigned long long>(id);
    camera.append_attribute("label") = name.c_str();
    const Mat3& r = view.camera.pose.rotation().raw();
    const Vec3& c = view.camera.center().raw();
    std::string matrix;
    for (int i = 0; i < 3; ++i) matrix += exact({r.row[i].x, r.row[i].y, r.row[i].z, c[i]}) + " ";
    camera.append_child("transform").text() = (matrix + "0 0 0 1").c_str();
  }
  std::ostringstream text;
  document.save(text, "  ");
  writeTextFile(folder / "cameras.xml", text.str());
}

// ---- Views under many lights

/// Each photograph of these formats shows a directional light.
void refuseOtherLights(const std::string& format, const Capture& capture, const CaptureView& view) {
  for (const Photo& photo : view.photos)
    if (!photo.light || capture.lights[photo.light->value].kind != LightKind::directional)
      throw badInput(photo.file.string(), "has no directional light; the format " + format + " holds these alone");
}
/// How integer photographs count where the format leaves no choice.
void warnOfTransfer(const std::string& format, const Capture& capture, Transfer taken, Reporter& reporter) {
  if (capture.integer_transfer == taken) return;
  const auto is_integer = [](const Photo& p) { return p.file.extension() != ".exr"; };
  const auto name = [](Transfer t) { return std::string(t == Transfer::srgb ? "sRGB" : "linear"); };
  for (const CaptureView& view : capture.views)
    if (std::any_of(view.photos.begin(), view.photos.end(), is_integer)) {
      reporter.warn("integer photographs count as " + name(capture.integer_transfer) + " here and as " + name(taken) +
                    " in " + format + ": write them " + name(taken));
      return;
    }
}

const CaptureView& onlyView(const std::string& format, const Capture& capture, Reporter& reporter) {
  if (capture.views.size() != 1)
    throw badInput(capture.folder.string(),
                   "holds " + std::to_string(capture.views.size()) + " views; the format " + format + " holds one");
  const CaptureView& view = capture.views[0];
  refuseOtherLights(format, capture, view);
  reporter.warn("the camera and the lights' names are lost: " + format + " has directions in the camera's frame alone");
  return view;
}

void exportRti(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  const CaptureView& view = onlyView("lp", capture, reporter);
  warnOfMasks("lp", capture, reporter);
  Names names(true);
  std::vector<LpLight> lights;
  std::set<std::array<double, 3>> strengths;
  for (const Photo& photo : view.photos) {
    const CaptureLight& light = capture.lights[photo.light->value];
    const std::string name = names.of(capture, photo.file);
    linkOrCopy(photo.file, folder / name);
    strengths.insert({light.strength.x, light.strength.y, light.strength.z});
    lights.push_back({name, toLpFrame(view.camera.pose.rotation().inverse() * light.direction), false});
  }
  if (strengths.size() > 1 || *strengths.begin() != std::array<double, 3>{1, 1, 1})
    reporter.warn("the strengths of the lights are lost: lp has none");
  writeLp(folder / "capture.lp", lights);
}

/// The photographs of one view with its lights in the camera's frame (x right, y up, z to the camera).
void writeDiligentFolder(const Capture& capture, const CaptureView& view, const fs::path& folder) {
  Names names(true);
  std::string files, directions, intensities;
  for (const Photo& photo : view.photos) {
    const CaptureLight& light = capture.lights[photo.light->value];
    const std::string name = names.of(capture, photo.file);
    linkOrCopy(photo.file, folder / name);
    const Vec3 d = toLpFrame(view.camera.pose.rotation().inverse() * light.direction);
    files += name + "\n";
    directions += exact({d.x, d.y, d.z}) + "\n";
    intensities += exact({light.strength.x, light.strength.y, light.strength.z}) + "\n";
  }
  if (!view.mask_file.empty()) placeMask(view.mask_file, folder / "mask.png");
  writeTextFile(folder / "filenames.txt", files);
  writeTextFile(folder / "light_directions.txt", directions);
  writeTextFile(folder / "light_intensities.txt", intensities);
}

void exportDiligent(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  const CaptureView& view = onlyView("diligent", capture, reporter);
  warnOfTransfer("diligent", capture, Transfer::linear, reporter);
  writeDiligentFolder(capture, view, folder);
}

void exportDiligentMv(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  const std::string format = "diligent-mv";
  refuse(format, capture, {CameraModel::pinhole}, true);
  const Intrinsics& lens = capture.views[0].camera.lens;
  for (const CaptureView& view : capture.views) {
    if (!(view.camera.lens == lens))
      throw cannotHold(format, view, "its lens is not that of view '" + capture.views[0].name + "'");
    refuseOtherLights(format, capture, view);
  }
  warnOfTransfer(format, capture, Transfer::linear, reporter);
  reporter.warn("the names of views and lights are lost: " + format + " counts them, and each view has its own lights");

  fs::create_directories(folder);
  const fs::path file = folder / "Calib_Results.mat";
  const std::unique_ptr<mat_t, int (*)(mat_t*)> mat(Mat_CreateVer(file.c_str(), nullptr, MAT_FT_MAT5), Mat_Close);
  if (!mat) throw Error(ErrorKind::failed, "cannot be written", file.string());
  // `values` column by column, as MATLAB has them.
  const auto write = [&](const std::string& name, std::vector<double> values, std::size_t columns) {
    std::size_t size[2] = {values.size() / columns, columns};
    const std::unique_ptr<matvar_t, void (*)(matvar_t*)> v(
        Mat_VarCreate(name.c_str(), MAT_C_DOUBLE, MAT_T_DOUBLE, 2, size, values.data(), 0), Mat_VarFree);
    if (!v || Mat_VarWrite(mat.get(), v.get(), MAT_COMPRESSION_NONE) != 0)
      throw Error(ErrorKind::failed, name + " cannot be written", file.string());
  };
  write("KK", {lens.fl_x, 0, 0, lens.skew, lens.fl_y, 0, lens.cx - 0.5, lens.cy - 0.5, 1}, 3);
  write("kc", {0, 0, 0, 0, 0}, 1);
  write("nx", {static_cast<double>(lens.width)}, 1);
  write("ny", {static_cast<double>(lens.height)}, 1);
  for (std::size_t i = 0; i < capture.views.size(); ++i) {
    const Extrinsics e = extrinsicsOf(capture.views[i].camera);
    const std::string number = std::to_string(i + 1);
    const Mat3 c = e.r.transposed();
    write("Rc_" + number,
          {c.row[0].x, c.row[0].y, c.row[0].z, c.row[1].x, c.row[1].y, c.row[1].z, c.row[2].x, c.row[2].y, c.row[2].z},
          3);
    write("Tc_" + number, {e.t.x, e.t.y, e.t.z}, 1);
    writeDiligentFolder(capture, capture.views[i], folder / ("view_" + (i < 9 ? "0" + number : number)));
  }
}

/// A NumPy file of N x 3 float64.
void writeNpy(const fs::path& file, const std::vector<Vec3>& rows) {
  std::string header = "{'descr': '<f8', 'fortran_order': False, 'shape': (" + std::to_string(rows.size()) + ", 3), }";
  header.resize(118 - 1, ' ');
  std::string bytes("\x93NUMPY\x01\x00", 8);
  bytes += std::string{static_cast<char>(118), '\0'} + header + "\n";
  for (const Vec3& row : rows)
    for (int c = 0; c < 3; ++c) {
      const double value = row[c];
      bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
    }
  writeTextFile(file, bytes);
}

void exportOpenIllumination(const Capture& capture, const fs::path& folder, Reporter& reporter) {
  const std::string format = "openillumination";
  refuse(format, capture, {CameraModel::pinhole}, false);  // its photographs are undistorted ones
  std::vector<Vec3> positions;
  for (const CaptureLight& light : capture.lights) {
    if (light.kind != LightKind::point)
      throw badInput("light '" + light.name + "'", "is no point light; the format " + format + " holds these alone");
    positions.push_back(light.position.raw());
  }
  if (std::any_of(capture.lights.begin(), capture.lights.end(), [](const CaptureLight& l) {
        return l.strength != Vec3{1, 1, 1};
      }))
    reporter.warn("the strengths of the lights are lost: " + format + " has none");
  reporter.warn("the names of the lights are lost: " + format + " counts them");
  warnOfTransfer(format, capture, Transfer::srgb, reporter);

  Names names(/*blanks_allowed=*/true);
  Json frames = Json::object();
  bool other_lens = false;
  for (const CaptureView& view : capture.views) {
    std::string camera = view.name;
    std::replace(camera.begin(), camera.end(), '/', '_');
    camera = names.unique(camera);
    const Intrinsics& lens = view.camera.lens;
    Json frame;
    frame["file_path"] = "./images/" + camera;
    frame["transform_matrix"] = poseJson(view.camera.pose);
    frame["camera_angle_x"] = 2 * std::atan(0.5 * lens.width / lens.fl_x);
    frame["calib_imgw"] = lens.width;
    frame["light_idx"] = 0;
    if (lens.fl_x != lens.fl_y || lens.cx != 0.5 * lens.width || lens.cy != 0.5 * lens.height) {
      other_lens = true;
      frame["fl_x"] = lens.fl_x, frame["fl_y"] = lens.fl_y, frame["cx"] = lens.cx, frame["cy"] = lens.cy;
    }
    frames[camera] = std::move(frame);
    std::set<LightId> taken;
    for (const Photo& photo : view.photos) {
      if (!photo.light || !taken.insert(*photo.light).second) {
        reporter.warn(photo.file.string() + ": is left out: " + format +
                      " has one photograph for each light of a view");
        continue;
      }
      std::string light = std::to_string(photo.light->value);
      if (light.size() < 3) light.insert(0, 3 - light.size(), '0');
      linkOrCopy(photo.file,
                 folder / "Lights" / light / "raw_undistorted" / (camera + photo.file.extension().string()));
    }
    if (taken.empty()) throw cannotHold(format, view, "it has no photograph under a light");
    if (!view.mask_file.empty()) placeMask(view.mask_file, folder / "output" / "obj_masks" / (camera + ".png"));
  }
  if (other_lens)
    reporter.warn(
        "pixels that are not square, or a principal point off the middle, stand in fl_x, fl_y, cx, cy beside "
        "camera_angle_x: programs that read the angle alone miss them");
  writeNpy(folder / "light_pos.npy", positions);
  Json root;
  root["frames"] = std::move(frames);
  writeJsonFile(folder / "output" / "transforms_train.json", root);
}

}  // namespace

const std::vector<std::string>& exportFormats() {
  static const std::vector<std::string> kFormats{"transforms", "nrhints",     "colmap",          "colmap-binary",
                                                 "middlebury", "projections", "metashape",       "lp",
                                                 "diligent",   "diligent-mv", "openillumination"};
  return kFormats;
}

void exportCapture(const std::string& format, const Capture& capture, const fs::path& folder, Reporter& reporter) {
  for (const CaptureView& view : capture.views)
    if (view.photos.empty()) throw badInput("view '" + view.name + "'", "has no photograph");
  if (capture.views.empty()) throw badInput(capture.folder.string(), "holds no view");
  if (format == "diligent-mv") {
    if (capture.units != "mm")
      reporter.warn("lengths are in " + capture.units + " here and in mm in diligent-mv: numbers stay as they are");
  } else if (format != "transforms" && capture.units != "m") {
    reporter.warn("the units, " + capture.units + ", are lost: numbers stay as they are");
  }
  if (format != "transforms") {
    if (capture.applied_transform)
      reporter.warn("the record of a transform applied before (applied_transform) is lost: poses stay as they are");
    if (capture.bounds && format != "middlebury") reporter.warn("the bounding box is lost: " + format + " has none");
    if (capture.color_space != "lin_rec709")
      reporter.warn("the colour space, " + capture.color_space + ", is lost: " + format + " names none");
  }
  if (format == "transforms") return writeCapture(folder, capture);
  for (const CaptureView& view : capture.views) requireFiles(view);
  if (format == "nrhints") return exportNrhints(capture, folder, reporter);
  if (format == "colmap" || format == "colmap-binary") return exportColmap(format, capture, folder, reporter);
  if (format == "middlebury") return exportMiddlebury(capture, folder, reporter);
  if (format == "projections") return exportProjections(capture, folder, reporter);
  if (format == "metashape") return exportMetashape(capture, folder, reporter);
  if (format == "lp") return exportRti(capture, folder, reporter);
  if (format == "diligent") return exportDiligent(capture, folder, reporter);
  if (format == "diligent-mv") return exportDiligentMv(capture, folder, reporter);
  if (format == "openillumination") return exportOpenIllumination(capture, folder, reporter);
  throw Error(ErrorKind::usage, "unknown format '" + format + "'", "--format");
}

}  // namespace srf
