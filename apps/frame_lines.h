// The line that a program prints of each frame as it is finished, with the time that the others will take.
#pragma once

#include <cstdio>

#include "base/reporter.h"
#include "render/animation.h"

namespace srf {

class FrameLines {
 public:
  explicit FrameLines(Reporter& reporter) : reporter_(reporter) {}
  void operator()(const RenderedFrame& frame, std::size_t left) {
    std::string line = frame.file.string() + "  kept";
    if (!frame.kept) {
      seconds_ += frame.seconds, ++rendered_;
      char text[32];
      std::snprintf(text, sizeof text, "  %.3f s", frame.seconds);
      line = frame.file.string() + text;
      if (left > 0)
        line += "  " + std::to_string(left) + " to go, ETA " +
                clockText(seconds_ / static_cast<double>(rendered_) * static_cast<double>(left));
    }
    reporter_.result(line);
  }

 private:
  Reporter& reporter_;
  double seconds_ = 0;
  std::size_t rendered_ = 0;
};

}  // namespace srf
