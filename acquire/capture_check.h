// What is wrong with a capture, where, and how to mend it (`srf check`).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "base/reporter.h"

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

struct CheckReport {
  std::vector<CheckItem> items;
  std::size_t count(Verdict verdict) const;
};

/// Reads everything in the capture, also after faults: each becomes an item, in the order of the views. Throws only
/// where it is interrupted. `out` is the folder that an SRF of it would be written into, for the forecast of disk
/// space.
CheckReport checkCapture(const std::filesystem::path& capture, const std::filesystem::path& out, Reporter& reporter);

}  // namespace srf
