#include "apps/video.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "base/check.h"
#include "base/error.h"

extern char** environ;

namespace srf {

VideoWriter::VideoWriter(const std::filesystem::path& file, int width, int height, double fps) : part_(file) {
  char rate[32];
  std::snprintf(rate, sizeof rate, "%.6g", fps);
  std::vector<std::string> words{
      "ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s",
      std::to_string(width) + "x" + std::to_string(height), "-r", rate, "-i", "-",
      // 4:2:0 needs even sides
      "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix=bt709:out_range=tv,format=yuv420p", "-c:v",
      "libx264", "-crf", "16", "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1",
      "-color_range", "tv", "-movflags", "+faststart", "-f", "mp4", part_.path().string()};
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);

  ::signal(SIGPIPE, SIG_IGN);  // an ffmpeg that ends early is told by write()
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) throw Error(ErrorKind::failed, std::string("no pipe: ") + std::strerror(errno));
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, ends[0], 0);
  const int code = ::posix_spawnp(&ffmpeg_, "ffmpeg", &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  ::close(ends[0]);
  pipe_ = ends[1];
  if (code != 0) {
    ::close(pipe_);
    ffmpeg_ = pipe_ = -1;
    throw Error(ErrorKind::failed, std::string("ffmpeg could not be started (") + std::strerror(code) +
                                       "); install it and run this again");
  }
}

VideoWriter::~VideoWriter() {
  endFfmpeg();
}

void VideoWriter::write(const Image8& rgb) {
  SRF_CHECK(rgb.channels() == 3);
  for (std::size_t done = 0; done < rgb.data().size();) {
    const ssize_t n = ::write(pipe_, rgb.data().data() + done, rgb.data().size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) throw Error(ErrorKind::failed, "ffmpeg ended before the video was whole");
    done += static_cast<std::size_t>(n);
  }
}

void VideoWriter::commit() {
  const int status = endFfmpeg();
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) throw Error(ErrorKind::failed, "ffmpeg did not finish the video");
  part_.commit();
}

int VideoWriter::endFfmpeg() {
  int status = 0;
  if (pipe_ >= 0) ::close(pipe_);
  if (ffmpeg_ > 0)
    while (::waitpid(ffmpeg_, &status, 0) < 0 && errno == EINTR) {}
  ffmpeg_ = pipe_ = -1;
  return status;
}

}  // namespace srf
