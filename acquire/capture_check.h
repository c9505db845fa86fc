// What is wrong with a capture, where, and how to mend it (`srf check`).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

enum class Verdict { ok, warning, fault };
std::string verdictName(Verdict verdict);  ///< "ok", "warning", "fault"

/// One row of the report.
struct CheckItem {
  Verdict verdict = Verdict::ok;
  std::string item;   ///< what was looked at: "photographs", "masks", "lights" ..
  std::string file;   ///< the file or view it is about; empty: the capture as a whole
  std::string found;  ///< what was found
  std::string mend;   ///< what to do about it; empty where nothing needs doing
};

/// A picture of the report: 8-bit display values, 3 channels.
struct CheckPicture {
  std::string caption;
  Image8 pixels;
};

/// The capture with what can be mended without touching a photograph.
struct MendedCapture {
  Capture capture;
  std::vector<std::pair<std::size_t, Image8>> masks;  ///< of views: masks to be written anew, inverted
  std::vector<std::string> what;                      ///< what was mended, a sentence each; empty: nothing
};

struct CheckReport {
  std::vector<CheckItem> items;
  std::vector<CheckPicture> pictures;                   ///< where asked
  std::string drawing;                                  ///< SVG: captureDrawing; where asked
  std::vector<Vec3> view_directions, light_directions;  ///< from the object's centre
  std::vector<double> view_iou;                         ///< of each view with the hull of all; -1: it has none
  std::vector<double> view_gain;                        ///< of each view against the others; empty: not known
  MendedCapture mended;                                 ///< empty capture where the capture could not be read
  double seconds_reading = 0;  ///< what reading and looking at the photographs took, by the clock
  std::size_t count(Verdict verdict) const;
};

struct CheckOptions {
  std::filesystem::path out = ".";            ///< where an SRF of it would be written, for the forecast of disk space
  std::size_t memory = std::size_t{1} << 30;  ///< bytes that may be held at once
  bool pictures = false;                      ///< draw CheckReport::pictures
};

/// Reads every photograph once (one without masks twice: its silhouette needs it first), also after faults: each
/// becomes an item, in the order of the views. Throws only where it is interrupted.
CheckReport checkCapture(const std::filesystem::path& capture, const CheckOptions& options, Reporter& reporter);

/// Writes `folder`/transforms.json, and masks/NAME.png of those that were mended. Photographs are named where they lie.
void writeMended(const std::filesystem::path& folder, const MendedCapture& mended);

}  // namespace srf
