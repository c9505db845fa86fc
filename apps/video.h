// A video from display pictures, encoded by the ffmpeg program.
#pragma once

#include <sys/types.h>

#include <filesystem>

#include "base/files.h"
#include "base/image.h"

namespace srf {

/// H.264 in MP4, 4:2:0, tagged BT.709 primaries with the sRGB curve, so that players show the values they are given.
class VideoWriter {
 public:
  VideoWriter(const std::filesystem::path& file, int width, int height, double fps);
  ~VideoWriter();
  VideoWriter(const VideoWriter&) = delete;
  VideoWriter& operator=(const VideoWriter&) = delete;
  /// `rgb`: width x height x 3 display values.
  void write(const Image8& rgb);
  /// Ends the stream, waits for ffmpeg and renames the video into place.
  void commit();

 private:
  int endFfmpeg();

  PartialFile part_;
  int pipe_ = -1;
  pid_t ffmpeg_ = -1;
};

}  // namespace srf
