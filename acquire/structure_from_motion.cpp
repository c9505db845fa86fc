#include "acquire/structure_from_motion.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "acquire/camera_import.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/json.h"
#include "base/parallel.h"

extern char** environ;

namespace srf {
namespace {

namespace fs = std::filesystem;

/// COLMAP's last lines that say something, for errors.
class Tail {
 public:
  void add(const std::string& line) {
    if (line.find_first_not_of(" =*\t\r") == std::string::npos) return;
    lines_.push_back(line);
    if (lines_.size() > 4) lines_.erase(lines_.begin());
  }
  std::string text() const {
    std::string all;
    for (const std::string& line : lines_)
      all += (all.empty() ? "" : " | ") + line.substr(line.find_first_not_of(" \t"));
    return all;
  }

 private:
  std::vector<std::string> lines_;
};

/// Runs COLMAP; `line` is called with each line that it prints. Ends it and throws interrupted after Ctrl-C.
class ColmapProcess {
 public:
  ColmapProcess(const std::string& program, std::vector<std::string> words) {
    words.insert(words.begin(), program);
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0) throw Error(ErrorKind::failed, std::string("no pipe: ") + std::strerror(errno));
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 1);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 2);
    const int code = ::posix_spawnp(&process_, program.c_str(), &actions, nullptr, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    pipe_ = ends[0];
    if (code == 0) return;
    ::close(pipe_);
    throw Error(ErrorKind::failed,
                std::string("could not be started (") + std::strerror(code) +
                    "); install COLMAP (Debian: colmap), or calibrate with --board, which needs none",
                program);
  }
  ~ColmapProcess() {
    if (process_ > 0) {
      ::kill(process_, SIGTERM);
      if (!endsWithin(5000)) ::kill(process_, SIGKILL);
      wait();
    }
    ::close(pipe_);
  }
  ColmapProcess(const ColmapProcess&) = delete;
  ColmapProcess& operator=(const ColmapProcess&) = delete;

  /// The exit code, 128 + signal where one ended it.
  int run(const std::function<void(const std::string&)>& line) {
    std::string text;
    char buffer[4096];
    while (true) {
      throwIfInterrupted();
      pollfd ready{pipe_, POLLIN, 0};
      if (::poll(&ready, 1, 200) <= 0) continue;
      const ssize_t n = ::read(pipe_, buffer, sizeof buffer);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) break;
      text.append(buffer, static_cast<std::size_t>(n));
      for (std::size_t end; (end = text.find_first_of("\r\n")) != std::string::npos; text.erase(0, end + 1))
        line(text.substr(0, end));
    }
    if (!text.empty()) line(text);
    throwIfInterrupted();  // Ctrl-C ends COLMAP too, which is no failure of it
    return wait();
  }

 private:
  int wait() {
    int status = 0;
    while (::waitpid(process_, &status, 0) < 0 && errno == EINTR) {}
    process_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  bool endsWithin(int milliseconds) const {
    for (int waited = 0; waited < milliseconds; waited += 20) {
      siginfo_t info{};
      if (::waitid(P_PID, static_cast<id_t>(process_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid != 0)
        return true;
      ::usleep(20000);
    }
    return false;
  }
  pid_t process_ = -1;
  int pipe_ = -1;
};

/// Runs a stage of COLMAP; `steps_in` reads from a line how many steps are done by now.
void runStage(const StructureFromMotionOptions& options, const std::string& stage, std::vector<std::string> words,
              std::uint64_t steps, const std::function<std::optional<std::uint64_t>(const std::string&)>& steps_in,
              Reporter& reporter) {
  words.insert(words.begin(), stage);
  Reporter::Stage progress(reporter, "colmap " + stage, steps);
  std::uint64_t done = 0;
  Tail tail;
  ColmapProcess process(options.program, words);
  const int code = process.run([&](const std::string& line) {
    reporter.debug("colmap: " + line);
    tail.add(line);
    const auto now = steps_in(line);
    if (!now || *now <= done || *now > steps) return;
    progress.advance(*now - done);
    done = *now;
  });
  if (code != 0) throw Error(ErrorKind::failed, colmapFailure(stage, code, tail.text()));
}

std::optional<std::uint64_t> numberAfter(const std::string& line, const std::string& words) {
  const std::size_t at = line.find(words);
  if (at == std::string::npos) return std::nullopt;
  try {
    return std::stoull(line.substr(at + words.size()));
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

const char* colmapModelName(CameraModel lens) {
  return lens == CameraModel::pinhole         ? "PINHOLE"
         : lens == CameraModel::simple_radial ? "SIMPLE_RADIAL"
         : lens == CameraModel::opencv        ? "OPENCV"
                                              : "OPENCV_FISHEYE";
}

std::string number(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", x);
  return text;
}

/// COLMAP wants every mask as masks/name.jpg.png.
void writeMasks(const StructureFromMotionOptions& options, const std::vector<ImageSize>& sizes, Reporter& reporter) {
  std::size_t without = 0;
  std::string first;
  for (std::size_t i = 0; i < options.names.size(); ++i) {
    throwIfInterrupted();
    const fs::path file = maskFileOf(options.masks, options.names[i]);
    if (file.empty()) {
      if (without++ == 0) first = options.names[i];
      continue;
    }
    Image8 mask = readMask(file);
    if (mask.width() != sizes[i].width || mask.height() != sizes[i].height)
      throw badInput(file.string(), "is " + std::to_string(mask.width()) + " x " + std::to_string(mask.height()) +
                                        ", its photograph " + std::to_string(sizes[i].width) + " x " +
                                        std::to_string(sizes[i].height) + "; make masks of the photograph's size");
    for (std::uint8_t& v : mask.data()) v = v >= 128 ? 255 : 0;
    writePng(options.workspace / "masks" / (options.names[i] + ".png"), mask);
  }
  if (without == options.names.size())
    throw badInput(options.masks.string(), "holds no mask of any photograph: expected " + options.names[0] +
                                               ".png or " +
                                               fs::path(options.names[0]).replace_extension(".png").string());
  if (without > 0)
    reporter.warn(options.masks.string() + ": " + std::to_string(without) +
                  " photographs have no mask and are searched whole, the first is " + first);
}

}  // namespace

fs::path maskFileOf(const fs::path& masks, const std::string& name) {
  for (const fs::path& file : {masks / (name + ".png"), (masks / name).replace_extension(".png"), masks / name})
    if (std::error_code code; fs::is_regular_file(file, code)) return file;
  return {};
}

std::string colmapFailure(const std::string& stage, int exit_code, const std::string& last_lines) {
  std::string why;
  const auto says = [&](const char* words) { return last_lines.find(words) != std::string::npos; };
  if (says("failed to create sparse model") || says("No images with matches"))
    why =
        "no two photographs share enough features to begin with: overlap neighbouring photographs by two thirds or "
        "more, give the object or the table texture, keep the light; on a turntable calibrate with --board "
        "--turntable, which needs no features";
  else if (says("no space") || says("disk is full") || says("No space"))
    why = "the disk is full";
  else if (exit_code == 134)
    why =
        "it gave up: its database or a photograph is damaged, or it looked for a display or a graphics card, which a "
        "COLMAP without CUDA must not be asked for (srf asks for neither); remove the folder colmap/ in the output and "
        "run this again";
  else if (exit_code == 137)
    why = "it was killed, most likely for lack of memory: lower --features or --largest-side";
  else
    why = "see its own words";
  return "COLMAP's " + stage + " ended with exit code " + std::to_string(exit_code) + ": " + why +
         (last_lines.empty() ? "" : " (" + last_lines + ")");
}

fs::path runStructureFromMotion(const StructureFromMotionOptions& options, Reporter& reporter) {
  const fs::path work = options.workspace, database = work / "database.db", settings_file = work / "settings.json",
                 sparse = work / "sparse", done = work / "done.json";
  if (options.names.size() < 3)
    throw badInput(options.photos.string(),
                   "structure from motion needs 3 photographs or more, found " + std::to_string(options.names.size()));
  std::vector<ImageSize> sizes;
  Json settings;
  settings["lens"] = colmapModelName(options.lens);
  settings["features"] = options.most_features;
  settings["largest_side"] = options.largest_side;
  if (options.known_lens)
    settings["known_lens"] = {options.known_lens->fl_x, options.known_lens->fl_y, options.known_lens->cx,
                              options.known_lens->cy,   options.known_lens->k1,   options.known_lens->k2,
                              options.known_lens->p1,   options.known_lens->p2};
  const auto identity = [](const fs::path& file) {
    std::error_code code;
    return Json{file.string(), fs::file_size(file, code), fs::last_write_time(file, code).time_since_epoch().count()};
  };
  for (std::size_t i = 0; i < options.names.size(); ++i) {
    sizes.push_back(readImageSize(options.photos / options.names[i]));
    settings["photographs"].push_back(
        {identity(options.photos / options.names[i]), options.cameras[i],
         options.masks.empty() ? Json() : identity(maskFileOf(options.masks, options.names[i]))});
  }
  std::error_code code;
  fs::create_directories(work, code);
  bool same = false;
  if (fs::exists(settings_file, code)) same = readJsonFile(settings_file).raw() == settings;
  if (!same) {
    for (const fs::path& old : {database, done, settings_file, sparse, work / "masks"}) fs::remove_all(old, code);
    if (!options.masks.empty()) writeMasks(options, sizes, reporter);
    writeJsonFile(settings_file, settings);
  } else if (!fs::exists(done, code)) {
    reporter.warn("COLMAP goes on from the database in " + work.string());
  }

  const std::string threads = std::to_string(threadCount());
  if (!fs::exists(done, code)) {
    // Photographs of one camera and size share a lens: COLMAP refuses to share one between sizes.
    std::map<std::pair<std::string, std::pair<int, int>>, std::string> lists;
    for (std::size_t i = 0; i < options.names.size(); ++i)
      lists[{options.cameras[i], {sizes[i].width, sizes[i].height}}] += options.names[i] + "\n";
    std::uint64_t before = 0;
    for (const auto& [group, list] : lists) {
      writeTextFile(work / "list.txt", list);
      std::vector<std::string> words{"--database_path",
                                     database,
                                     "--image_path",
                                     options.photos,
                                     "--image_list_path",
                                     work / "list.txt",
                                     "--ImageReader.single_camera",
                                     "1",
                                     "--ImageReader.camera_model",
                                     colmapModelName(options.lens),
                                     "--SiftExtraction.use_gpu",
                                     "0",
                                     "--SiftExtraction.num_threads",
                                     threads,
                                     "--SiftExtraction.max_num_features",
                                     std::to_string(options.most_features),
                                     "--SiftExtraction.max_image_size",
                                     std::to_string(options.largest_side)};
      if (!options.masks.empty()) words.insert(words.end(), {"--ImageReader.mask_path", work / "masks"});
      if (options.known_lens) {
        const Intrinsics& l = *options.known_lens;
        if (l.width != group.second.first || l.height != group.second.second)
          throw badInput(options.photos.string(), "the given lens is for " + std::to_string(l.width) + " x " +
                                                      std::to_string(l.height) + " pixels, a photograph has " +
                                                      std::to_string(group.second.first) + " x " +
                                                      std::to_string(group.second.second));
        if (l.k3 != 0)
          reporter.warn(
              "COLMAP's OPENCV lens has no k3: the lens is handed over without it, fit one with --lens "
              "simple_radial for an exact hand-over");
        words[9] = "OPENCV";
        std::string parameters;
        for (const double p : {l.fl_x, l.fl_y, l.cx, l.cy, l.k1, l.k2, l.p1, l.p2})
          parameters += (parameters.empty() ? "" : ",") + number(p);
        words.insert(words.end(), {"--ImageReader.camera_params", parameters});
      }
      const auto count = static_cast<std::uint64_t>(std::count(list.begin(), list.end(), '\n'));
      runStage(
          options, "feature_extractor", words, count,
          [](const std::string& line) { return numberAfter(line, "Processed file ["); }, reporter);
      before += count;
      reporter.info("features of " + std::to_string(before) + " of " + std::to_string(options.names.size()) +
                    " photographs");
    }
    // Blocks of 50 x 50 photographs.
    const std::uint64_t side = (options.names.size() + 49) / 50;
    std::uint64_t blocks = 0;
    runStage(
        options, "exhaustive_matcher",
        {"--database_path", database, "--SiftMatching.use_gpu", "0", "--SiftMatching.num_threads", threads},
        side * side,
        [&](const std::string& line) -> std::optional<std::uint64_t> {
          if (line.find("Matching block") == std::string::npos) return std::nullopt;
          return blocks++;  // told when a block begins: those before it are done
        },
        reporter);
    fs::remove_all(sparse, code);
    fs::create_directories(sparse, code);
    std::vector<std::string> words{"--database_path", database, "--image_path",         options.photos,
                                   "--output_path",   sparse,   "--Mapper.num_threads", threads};
    if (options.known_lens)
      words.insert(words.end(), {"--Mapper.ba_refine_focal_length", "0", "--Mapper.ba_refine_extra_params", "0"});
    runStage(
        options, "mapper", words, options.names.size(),
        [](const std::string& line) -> std::optional<std::uint64_t> {
          const std::size_t at = line.find("Registering image #");
          return at == std::string::npos ? std::nullopt : numberAfter(line.substr(at), "(");
        },
        reporter);
  }

  // COLMAP may write several models that it could not join.
  fs::path best;
  std::size_t most = 0;
  int models = 0;
  std::set<std::string> registered;
  for (const auto& entry : fs::directory_iterator(sparse, code)) {
    if (!fs::exists(entry.path() / "images.bin", code)) continue;
    ++models;
    Reporter quiet(ProgressMode::none, LogLevel::error);
    const Capture model = readColmap(entry.path(), options.photos, quiet);
    if (model.views.size() < most || (model.views.size() == most && entry.path() > best)) continue;
    best = entry.path();
    most = model.views.size();
    registered.clear();
    for (const CaptureView& view : model.views)
      registered.insert(view.photos[0].file.lexically_relative(options.photos).generic_string());
  }
  if (best.empty()) throw Error(ErrorKind::failed, colmapFailure("mapper", 0, "no model was written"));
  writeJsonFile(done, Json{{"model", best.filename().string()}, {"photographs", most}});
  std::string missing;
  for (const std::string& name : options.names)
    if (!registered.contains(name)) missing += (missing.empty() ? "" : ", ") + name;
  if (!missing.empty())
    reporter.warn("COLMAP registered " + std::to_string(most) + " of " + std::to_string(options.names.size()) +
                  " photographs, without " + missing +
                  (models > 1 ? "; others are in models that it could not join: photograph what lies between" : ""));
  return best;
}

std::optional<Similarity> fitSimilarity(const std::vector<Vec3>& from, const std::vector<Vec3>& to) {
  const auto n = static_cast<Eigen::Index>(from.size());
  if (n < 3 || from.size() != to.size()) return std::nullopt;
  Eigen::MatrixXd a(3, n), b(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    a.col(i) << from[i].x, from[i].y, from[i].z;
    b.col(i) << to[i].x, to[i].y, to[i].z;
  }
  for (const Eigen::MatrixXd& m : {a, b}) {
    const Eigen::MatrixXd middle = m.colwise() - m.rowwise().mean();
    const Eigen::VectorXd size = Eigen::JacobiSVD<Eigen::MatrixXd>(middle).singularValues();
    if (!(size[1] > 1e-9 * size[0])) return std::nullopt;
  }
  const Eigen::MatrixXd t = Eigen::umeyama(a, b, true);
  Similarity out;
  out.scale = std::cbrt(t.topLeftCorner(3, 3).determinant());
  for (int i = 0; i < 3; ++i) {
    out.rotation.row[i] = {t(i, 0) / out.scale, t(i, 1) / out.scale, t(i, 2) / out.scale};
    out.shift[i] = t(i, 3);
  }
  return out;
}

void applySimilarity(Capture& capture, const Similarity& s) {
  for (CaptureView& view : capture.views) {
    const Mat3 rotation = s.rotation * view.camera.pose.rotation().raw();
    view.camera.pose = {
        Orthogonal<AcquisitionSpace, CameraSpace>(rotationFromQuaternion(quaternionFromRotation(rotation))),
        Point<AcquisitionSpace>(s * view.camera.center().raw())};
  }
  for (CaptureLight& light : capture.lights) {
    light.direction = Direction<AcquisitionSpace>::fromUnit(s.rotation * light.direction.raw());
    light.position = Point<AcquisitionSpace>(s * light.position.raw());
    if (light.kind == LightKind::point) light.strength = (s.scale * s.scale) * light.strength;
  }
  if (!capture.bounds) return;
  Box<AcquisitionSpace> box;
  for (int corner = 0; corner < 8; ++corner)
    box.extend(Point<AcquisitionSpace>(s * Vec3{corner & 1 ? capture.bounds->max.x : capture.bounds->min.x,
                                                corner & 2 ? capture.bounds->max.y : capture.bounds->min.y,
                                                corner & 4 ? capture.bounds->max.z : capture.bounds->min.z}));
  capture.bounds = box;
}

std::optional<Triangulated> triangulate(const std::vector<Ray<AcquisitionSpace>>& rays) {
  if (rays.size() < 2) return std::nullopt;
  // The sum of the projections across each ray.
  Mat3 sum{{Vec3{}, Vec3{}, Vec3{}}};
  Vec3 side;
  for (const auto& ray : rays) {
    const Mat3 k = crossMatrix(ray.direction.raw()), across = -1.0 * (k * k);
    sum = sum + across;
    side += across * ray.origin.raw();
  }
  // Two rays at an angle t: 2 t^2 to first order; 1e-4 is about half a degree.
  if (!(determinant(sum) > 1e-4)) return std::nullopt;
  Triangulated out{Point<AcquisitionSpace>(inverse(sum) * side)};
  double squares = 0;
  for (const auto& ray : rays) {
    const Vec3 away = cross(out.point.raw() - ray.origin.raw(), ray.direction.raw());
    squares += dot(away, away);
  }
  out.distance = std::sqrt(squares / static_cast<double>(rays.size()));
  return out;
}

BoardAlignment alignWithBoard(const Capture& capture, const Board& board, double millimetre,
                              const std::vector<std::optional<BoardCorners>>& seen) {
  std::map<int, std::vector<Ray<AcquisitionSpace>>> rays;
  for (std::size_t v = 0; v < seen.size(); ++v) {
    if (!seen[v]) continue;
    for (std::size_t i = 0; i < seen[v]->ids.size(); ++i)
      if (const auto ray = capture.views[v].camera.ray(seen[v]->pixels[i])) rays[seen[v]->ids[i]].push_back(*ray);
  }
  std::vector<Vec3> from, to;
  for (const auto& [id, of_corner] : rays)
    if (const auto point = triangulate(of_corner)) {
      from.push_back(point->point.raw());
      to.push_back(board.corner(id, millimetre).raw());
    }
  const auto similarity = fitSimilarity(from, to);
  if (from.size() < 4 || !similarity)
    throw badInput("board " + board.text(), "only " + std::to_string(from.size()) +
                                                " of its corners are seen by two registered photographs or more; let "
                                                "the board lie in sight of more of them, or give --distance");
  BoardAlignment out{*similarity, 0, from.size()};
  for (std::size_t i = 0; i < from.size(); ++i) {
    const Vec3 away = out.similarity * from[i] - to[i];
    out.residual += dot(away, away);
  }
  out.residual = std::sqrt(out.residual / static_cast<double>(from.size()));
  return out;
}

}  // namespace srf
