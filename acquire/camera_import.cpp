// Middlebury: K [R t] a line (Seitz et al., CVPR 2006). COLMAP: colmap.github.io/format.html, the text and the binary
// form.
#include "acquire/camera_import.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <map>
#include <set>
#include <sstream>

#include "acquire/mask_files.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "field/capture_file.h"

namespace srf {
namespace {

namespace fs = std::filesystem;
using CapturePose = Rigid<AcquisitionSpace, CameraSpace>;

constexpr int kLargestSide = 65536;  // pixels, as image_io has it

// std::filesystem::exists throws for names that no file can have.
bool isThere(const fs::path& file) {
  std::error_code code;
  return fs::exists(file, code);
}

CaptureLight capturedLight() {
  CaptureLight light;
  light.name = "captured";
  light.kind = LightKind::captured;
  return light;
}

/// Files give the world-to-camera map x_c = R x + t; `where` names the place for errors.
CapturePose poseFromWorldToCamera(const Mat3& rotation, const Vec3& t, const std::string& where) {
  double off = 0;
  const Mat3 product = rotation * rotation.transposed();
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) off = std::max(off, std::fabs(product.row[i][j] - (i == j)));
  if (!(off < 1e-3) || !(determinant(rotation) > 0) || !isFinite(t))
    throw badInput(where, "the rotation is not a proper rotation (off by " + std::to_string(off) + ", determinant " +
                              std::to_string(determinant(rotation)) + "); write it anew from the calibration");
  // Files print few digits; the nearest unit quaternion makes the rows orthonormal again.
  const Mat3 to_world = rotationFromQuaternion(quaternionFromRotation(rotation)).transposed();
  return {Orthogonal<AcquisitionSpace, CameraSpace>(to_world), Point<AcquisitionSpace>(-(to_world * t))};
}

/// The words of one line, with errors that name the place.
class Words {
 public:
  Words(std::string_view line, std::string where) : rest_(line), where_(std::move(where)) {}
  bool empty() {
    rest_.remove_prefix(std::min(rest_.find_first_not_of(" \t\r"), rest_.size()));
    return rest_.empty();
  }
  std::string word(const char* what) {
    if (empty()) throw badInput(where_, std::string("ends before ") + what + "; copy the file again");
    const std::size_t length = std::min(rest_.find_first_of(" \t\r"), rest_.size());
    const std::string word(rest_.substr(0, length));
    rest_.remove_prefix(length);
    return word;
  }
  /// What is left of the line, without blanks at its ends.
  std::string remainder(const char* what) {
    if (empty()) throw badInput(where_, std::string("ends before ") + what + "; copy the file again");
    return std::string(rest_.substr(0, rest_.find_last_not_of(" \t\r") + 1));
  }
  double number(const char* what) { return parse<double>(what, "a finite number"); }
  long integer(const char* what) { return parse<long>(what, "a whole number"); }
  const std::string& where() const { return where_; }

 private:
  template <class T>
  T parse(const char* what, const char* expected) {
    const std::string text = word(what);
    T value{};
    const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (code != std::errc{} || end != text.data() + text.size() || !std::isfinite(static_cast<double>(value)))
      throw badInput(where_, "found '" + text.substr(0, 40) + "' for " + what + ", expected " + expected);
    return value;
  }
  std::string_view rest_;
  std::string where_;
};

std::string lineOf(const fs::path& file, std::size_t line) {
  return file.string() + ": line " + std::to_string(line);
}

/// The two corners "(x y z)" that a Middlebury README gives after the words 'bounding box'; other brackets are passed
/// by.
std::optional<Box<AcquisitionSpace>> readmeBounds(const fs::path& readme) {
  if (!isThere(readme)) return std::nullopt;
  const std::string text = readTextFile(readme);
  Box<AcquisitionSpace> box;
  int corners = 0;
  for (std::size_t at = text.find("bounding box"); corners < 2; ++at) {
    at = std::min(at, text.size());
    at = text.find('(', at);
    const std::size_t end = text.find(')', std::min(at, text.size()));
    if (end == std::string::npos) return std::nullopt;
    try {
      Words words(std::string_view(text).substr(at + 1, end - at - 1), readme.string());
      const double x = words.number("x"), y = words.number("y"), z = words.number("z");
      box.extend(Point<AcquisitionSpace>(x, y, z));
      ++corners;
    } catch (const Error&) {}
  }
  return box;
}

// ---- COLMAP

struct ColmapModel {
  const char* name;
  CameraModel model;
  int parameters;
};
// In the order of COLMAP's model ids.
constexpr ColmapModel kColmapModels[] = {
    {"SIMPLE_PINHOLE", CameraModel::pinhole, 3},
    {"PINHOLE", CameraModel::pinhole, 4},
    {"SIMPLE_RADIAL", CameraModel::simple_radial, 4},
    {"RADIAL", CameraModel::opencv, 5},
    {"OPENCV", CameraModel::opencv, 8},
    {"OPENCV_FISHEYE", CameraModel::opencv_fisheye, 8},
    {"FULL_OPENCV", CameraModel::opencv, 12},
};

Error unknownModel(const std::string& where, const std::string& found) {
  std::string list;
  for (const auto& m : kColmapModels) list += std::string(list.empty() ? "" : ", ") + m.name;
  return badInput(
      where, "the camera model " + found + " is not known; undistort the images with COLMAP, or use one of " + list);
}

Intrinsics colmapLens(const ColmapModel& model, double width, double height, const std::vector<double>& p,
                      const std::string& where) {
  if (!(width >= 1 && height >= 1 && width <= kLargestSide && height <= kLargestSide))
    throw badInput(where, "the camera's size is " + std::to_string(width) + " x " + std::to_string(height) +
                              ", expected 1 to 65536 each way");
  Intrinsics lens;
  lens.model = model.model;
  lens.width = static_cast<int>(width);
  lens.height = static_cast<int>(height);
  const bool one_focal_length = model.parameters <= 5 && std::string_view(model.name) != "PINHOLE";
  std::size_t i = 0;
  lens.fl_x = p[i++];
  lens.fl_y = one_focal_length ? lens.fl_x : p[i++];
  lens.cx = p[i++];
  lens.cy = p[i++];
  const auto next = [&] { return i < p.size() ? p[i++] : 0.0; };
  lens.k1 = next();
  lens.k2 = next();
  if (model.model == CameraModel::opencv_fisheye) {
    lens.k3 = next();
    lens.k4 = next();
  } else {
    lens.p1 = next();
    lens.p2 = next();
    lens.k3 = next();
    for (int k = 4; k <= 6; ++k)
      if (next() != 0)
        throw badInput(where,
                       "FULL_OPENCV with k4, k5 or k6 other than 0 is not known; undistort the images with COLMAP");
  }
  for (const double v : p)
    if (!std::isfinite(v)) throw badInput(where, "a camera parameter is not finite; export the model again");
  if (!(lens.fl_x > 0 && lens.fl_y > 0))
    throw badInput(where, "the focal length is not above 0; export the model again");
  return lens;
}

struct ColmapImage {
  std::string name;
  std::string where;  // for errors
  long camera = 0;
  CapturePose pose;
};

CapturePose colmapPose(const double (&q)[4], const Vec3& t, const std::string& where) {
  const double norm = std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
  if (!(norm > 1e-9) || !std::isfinite(norm))
    throw badInput(where, "the rotation's quaternion has no length; export the model again");
  return poseFromWorldToCamera(rotationFromQuaternion({q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm}), t, where);
}

/// Little-endian values of a file in memory; never reads beyond its end.
class Bytes {
 public:
  explicit Bytes(const fs::path& file) : file_(file.string()), bytes_(readBinaryFile(file)) {}
  template <class T>
  T value() {
    T value;
    std::memcpy(&value, take(sizeof value), sizeof value);
    return value;
  }
  std::string zeroEnded() {
    const auto begin = bytes_.begin() + static_cast<std::ptrdiff_t>(at_);
    const auto end = std::find(begin, bytes_.end(), std::byte{0});
    const auto length = static_cast<std::size_t>(end - begin);
    const char* text = reinterpret_cast<const char*>(take(length + 1));
    return {text, length};
  }
  /// A count of records of at least `record` bytes each, checked against what is left of the file.
  std::uint64_t count(std::size_t record) {
    const auto n = value<std::uint64_t>();
    if (n > (bytes_.size() - at_) / record)
      throw badInput(where(),
                     "counts " + std::to_string(n) + " records, more than the file holds; export the model again");
    return n;
  }
  const std::byte* take(std::size_t n) {
    if (n > bytes_.size() - at_)
      throw badInput(file_, "ends early, after " + std::to_string(bytes_.size()) + " bytes; export the model again");
    at_ += n;
    return bytes_.data() + at_ - n;
  }
  std::string where() const { return file_ + ": byte " + std::to_string(at_); }

 private:
  std::string file_;
  std::vector<std::byte> bytes_;
  std::size_t at_ = 0;
};

std::map<long, Intrinsics> colmapCamerasBinary(const fs::path& file) {
  Bytes bytes(file);
  std::map<long, Intrinsics> cameras;
  for (std::uint64_t n = bytes.count(24); n > 0; --n) {
    const std::string where = bytes.where();
    const auto id = bytes.value<std::uint32_t>();
    const auto model = bytes.value<std::int32_t>();
    const auto width = bytes.value<std::uint64_t>(), height = bytes.value<std::uint64_t>();
    if (model < 0 || model >= static_cast<int>(std::size(kColmapModels)))
      throw unknownModel(where, "number " + std::to_string(model));
    std::vector<double> parameters(kColmapModels[model].parameters);
    for (double& p : parameters) p = bytes.value<double>();
    cameras[id] =
        colmapLens(kColmapModels[model], static_cast<double>(width), static_cast<double>(height), parameters, where);
  }
  return cameras;
}

std::map<long, Intrinsics> colmapCamerasText(const fs::path& file) {
  std::istringstream text(readTextFile(file));
  std::map<long, Intrinsics> cameras;
  std::string line;
  for (std::size_t n = 1; std::getline(text, line); ++n) {
    Words words(line, lineOf(file, n));
    if (words.empty() || line[0] == '#') continue;
    const long id = words.integer("the camera's number");
    const std::string name = words.word("the camera model");
    const auto* model =
        std::find_if(std::begin(kColmapModels), std::end(kColmapModels), [&](const auto& m) { return m.name == name; });
    if (model == std::end(kColmapModels)) throw unknownModel(words.where(), name);
    const double width = words.number("the width"), height = words.number("the height");
    std::vector<double> parameters(model->parameters);
    for (double& p : parameters) p = words.number("the camera's parameters");
    cameras[id] = colmapLens(*model, width, height, parameters, words.where());
  }
  return cameras;
}

std::vector<ColmapImage> colmapImagesBinary(const fs::path& file) {
  Bytes bytes(file);
  std::vector<ColmapImage> images;
  for (std::uint64_t n = bytes.count(73); n > 0; --n) {
    ColmapImage image;
    image.where = bytes.where();
    bytes.take(4);  // the image's number, which nothing here refers to
    double q[4];
    for (double& v : q) v = bytes.value<double>();
    Vec3 t;
    for (int i = 0; i < 3; ++i) t[i] = bytes.value<double>();
    image.camera = bytes.value<std::uint32_t>();
    image.name = bytes.zeroEnded();
    image.pose = colmapPose(q, t, image.where);
    bytes.take(24 * bytes.count(24));  // key points
    images.push_back(std::move(image));
  }
  return images;
}

std::vector<ColmapImage> colmapImagesText(const fs::path& file) {
  std::istringstream text(readTextFile(file));
  std::vector<ColmapImage> images;
  std::string line;
  for (std::size_t n = 1; std::getline(text, line); ++n) {
    Words words(line, lineOf(file, n));
    if (words.empty() || line[0] == '#') continue;
    ColmapImage image;
    image.where = words.where();
    words.integer("the image's number");
    double q[4];
    for (double& v : q) v = words.number("the quaternion");
    Vec3 t;
    for (int i = 0; i < 3; ++i) t[i] = words.number("the translation");
    image.camera = words.integer("the camera's number");
    image.name = words.remainder("the image's name");
    image.pose = colmapPose(q, t, image.where);
    images.push_back(std::move(image));
    std::getline(text, line);  // key points: may be empty
    ++n;
  }
  return images;
}

/// Finds the photographs that a model names; some models were made of files that were renamed since.
class PhotoFinder {
 public:
  explicit PhotoFinder(fs::path folder) : folder_(std::move(folder)) {}

  fs::path find(const ColmapImage& image) {
    if (std::error_code code; fs::is_regular_file(folder_ / image.name, code)) return folder_ / image.name;
    if (files_.empty()) list();
    std::vector<std::string> matches;
    for (const std::string& file : files_)
      if (image.name.ends_with(file)) matches.push_back(file);
    if (matches.size() != 1)
      throw badInput(
          (folder_ / image.name).string(),
          (matches.empty() ? "does not exist"
                           : "does not exist, and both '" + matches[0] + "' and '" + matches[1] + "' end like it") +
              std::string("; put the photograph there, or name it as ") + image.where + " does");
    ++by_suffix_;
    example_ = "'" + image.name + "' is taken to be '" + matches[0] + "'";
    return folder_ / matches[0];
  }
  void warn(Reporter& reporter) const {
    if (by_suffix_ > 0)
      reporter.warn(folder_.string() + ": " + std::to_string(by_suffix_) +
                    " names in the model carry a prefix that the files lack: " + example_);
  }

 private:
  void list() {
    std::error_code code;
    for (auto it = fs::recursive_directory_iterator(folder_, code); !code && it != fs::recursive_directory_iterator();
         it.increment(code))
      if (it->is_regular_file(code)) files_.push_back(it->path().lexically_relative(folder_).string());
    std::sort(files_.begin(), files_.end());
  }
  fs::path folder_;
  std::vector<std::string> files_;
  std::size_t by_suffix_ = 0;
  std::string example_;
};

/// Nothing for a damaged photograph: the stage that wants its pixels tells of it, and the others are still read.
std::optional<ImageSize> sizeIfReadable(const fs::path& photo) {
  try {
    return readImageSize(photo);
  } catch (const Error&) {
    return std::nullopt;
  }
}

/// Fits intrinsics to photographs that were scaled after the calibration.
Intrinsics scaledTo(const Intrinsics& lens, const ImageSize& size, const fs::path& photo) {
  const double sx = static_cast<double>(size.width) / lens.width, sy = static_cast<double>(size.height) / lens.height;
  if (std::fabs(sx / sy - 1) > 0.02)
    throw badInput(photo.string(), "is " + std::to_string(size.width) + " x " + std::to_string(size.height) +
                                       ", the model's camera " + std::to_string(lens.width) + " x " +
                                       std::to_string(lens.height) +
                                       ": another shape; use the photographs that were calibrated");
  Intrinsics out = lens;
  out.width = size.width;
  out.height = size.height;
  out.fl_x *= sx;
  out.cx *= sx;
  out.skew *= sx;
  out.fl_y *= sy;
  out.cy *= sy;
  return out;
}

bool holdsColmapModel(const fs::path& folder) {
  return isThere(folder / "images.bin") || isThere(folder / "images.txt");
}

}  // namespace

Capture readMiddlebury(const fs::path& par_file, Reporter& reporter) {
  Capture capture;
  capture.folder = par_file.parent_path();
  capture.lights = {capturedLight()};
  capture.bounds = readmeBounds(capture.folder / "README.txt");
  std::istringstream text(readTextFile(par_file));
  std::string line;
  std::getline(text, line);
  const long count = Words(line, lineOf(par_file, 1)).integer("the number of views");
  long found = 0, absent = 0;
  ImageSize common;
  for (std::size_t n = 2; std::getline(text, line); ++n) {
    Words words(line, lineOf(par_file, n));
    if (words.empty()) continue;
    ++found;
    const std::string name = words.word("the image's name");
    Mat3 k, r;
    Vec3 t;
    for (Vec3& row : k.row)
      for (int i = 0; i < 3; ++i) row[i] = words.number("K");
    for (Vec3& row : r.row)
      for (int i = 0; i < 3; ++i) row[i] = words.number("R");
    for (int i = 0; i < 3; ++i) t[i] = words.number("t");
    if (!(k.row[2].z > 0) || !(k.row[0].x > 0) || !(k.row[1].y > 0) || k.row[1].x != 0 || k.row[2].x != 0 ||
        k.row[2].y != 0)
      throw badInput(words.where(),
                     "K is not upper triangular with a positive diagonal; write the line anew from the calibration");
    CaptureView view;
    view.name = fs::path(name).stem().string();
    view.camera.pose = poseFromWorldToCamera(r, t, words.where());
    const double scale = 1 / k.row[2].z;
    Intrinsics& lens = view.camera.lens;
    lens.fl_x = k.row[0].x * scale;
    lens.skew = k.row[0].y * scale;
    // These K have the first pixel's centre at 0, ours at 0.5: the files do not say, but the hulls of dinoSparseRing,
    // templeSparseRing and templeRing fit their silhouettes better so (IoU 0.9799, 0.9749, 0.9543 to 0.9764, 0.9733,
    // 0.9542).
    lens.cx = k.row[0].z * scale + 0.5;
    lens.fl_y = k.row[1].y * scale;
    lens.cy = k.row[1].z * scale + 0.5;
    const fs::path photo = capture.folder / name;
    if (!isThere(photo)) {
      ++absent;
      continue;
    }
    if (const auto size = sizeIfReadable(photo)) {
      lens.width = size->width;
      lens.height = size->height;
      common = *size;
    }
    view.photos.push_back({photo, LightId{0}});
    capture.views.push_back(std::move(view));
  }
  if (found != count)
    throw badInput(par_file.string(), "says " + std::to_string(count) + " views and describes " +
                                          std::to_string(found) + "; copy the file again");
  if (capture.views.empty())
    throw badInput(par_file.string(), "none of its " + std::to_string(count) +
                                          " photographs lies beside it; put them into " + capture.folder.string());
  if (common.width == 0) readImageSize(capture.views[0].photos[0].file);  // throws: no photograph can be read
  for (CaptureView& view : capture.views) {
    Intrinsics& lens = view.camera.lens;
    if (lens.width == 0) lens.width = common.width, lens.height = common.height;
  }
  if (absent > 0)
    reporter.info(par_file.string() + ": " + std::to_string(absent) + " of " + std::to_string(count) +
                  " calibrated views have no photograph and are left out");
  if (!capture.bounds)
    reporter.warn(par_file.string() + ": no bounding box in a README.txt beside it; silhouettes use the whole picture");
  return capture;
}

Capture readColmap(const fs::path& model_folder, const fs::path& image_folder, Reporter& reporter) {
  // The binary form wins: COLMAP writes it, people edit the other.
  const bool binary = isThere(model_folder / "images.bin") && isThere(model_folder / "cameras.bin");
  const fs::path cameras_file = model_folder / (binary ? "cameras.bin" : "cameras.txt");
  const fs::path images_file = model_folder / (binary ? "images.bin" : "images.txt");
  const auto cameras = binary ? colmapCamerasBinary(cameras_file) : colmapCamerasText(cameras_file);
  auto images = binary ? colmapImagesBinary(images_file) : colmapImagesText(images_file);
  if (images.empty())
    throw badInput(images_file.string(), "holds no images; export a model with registered photographs");
  // COLMAP's own order is that of a hash table.
  std::sort(images.begin(), images.end(), [](const auto& a, const auto& b) { return a.name < b.name; });

  Capture capture;
  capture.folder = image_folder;
  capture.lights = {capturedLight()};
  PhotoFinder finder(image_folder);
  std::map<fs::path, std::string> taken;  // photograph -> name in the model
  std::set<std::string> names;
  std::size_t scaled = 0;
  std::string example;
  for (const ColmapImage& image : images) {
    const auto camera = cameras.find(image.camera);
    if (camera == cameras.end())
      throw badInput(image.where,
                     "names camera " + std::to_string(image.camera) + ", which " + cameras_file.string() + " lacks");
    const fs::path photo = finder.find(image);
    if (const auto [it, fresh] = taken.try_emplace(photo, image.name); !fresh)
      throw badInput(image.where, "'" + it->second + "' and '" + image.name + "' are the same photograph " +
                                      photo.string() + "; name the files as the model does");
    CaptureView view;
    view.camera = {camera->second, image.pose};
    view.name = photo.lexically_relative(image_folder).replace_extension().string();
    std::replace(view.name.begin(), view.name.end(), '/', '_');
    while (!names.insert(view.name).second) view.name += photo.extension().string() + "_";
    const ImageSize size = sizeIfReadable(photo).value_or(ImageSize{camera->second.width, camera->second.height});
    if (size.width != camera->second.width || size.height != camera->second.height) {
      view.camera.lens = scaledTo(camera->second, size, photo);
      ++scaled;
      example = photo.string() + " is " + std::to_string(size.width) + " x " + std::to_string(size.height) +
                ", its camera " + std::to_string(camera->second.width) + " x " + std::to_string(camera->second.height);
    }
    // COLMAP's own convention for masks: the photograph's name with .png added.
    fs::path mask = image_folder.parent_path() / "masks" / photo.lexically_relative(image_folder);
    mask += ".png";
    if (isThere(mask)) view.mask_file = mask;
    view.photos.push_back({photo, LightId{0}});
    capture.views.push_back(std::move(view));
  }
  finder.warn(reporter);
  if (scaled > 0)
    reporter.warn(std::to_string(scaled) + " photographs differ in size from their cameras (" + example +
                  "); the intrinsics are scaled to the photographs");
  return capture;
}

namespace {

Capture openAnyCapture(const fs::path& folder, Reporter& reporter) {
  if (!isThere(folder)) throw badInput(folder.string(), "does not exist; check the path");
  if (!fs::is_directory(folder))
    return folder.filename().string().ends_with("_par.txt") ? readMiddlebury(folder, reporter) : readCapture(folder);
  if (isThere(folder / "transforms.json")) return readCapture(folder);
  std::vector<fs::path> par_files;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.path().filename().string().ends_with("_par.txt")) par_files.push_back(entry.path());
  std::sort(par_files.begin(), par_files.end());
  if (par_files.size() > 1)
    throw badInput(folder.string(), "holds " + par_files[0].filename().string() + " and " +
                                        par_files[1].filename().string() + "; name the one that is meant");
  if (par_files.size() == 1) return readMiddlebury(par_files[0], reporter);
  for (const char* sub : {"", "sparse/0", "sparse"}) {
    const fs::path model = *sub ? folder / sub : folder;
    if (!holdsColmapModel(model)) continue;
    return readColmap(model, fs::is_directory(folder / "images") ? folder / "images" : folder, reporter);
  }
  throw badInput(folder.string(),
                 "is no capture: it holds neither transforms.json, nor a Middlebury *_par.txt, nor a COLMAP "
                 "model (cameras and images, .bin or .txt, here, in sparse/ or in sparse/0)");
}

}  // namespace

Capture openCapture(const fs::path& folder, Reporter& reporter) {
  Capture capture = openAnyCapture(folder, reporter);
  findMaskFiles(capture, reporter);
  return capture;
}

}  // namespace srf
