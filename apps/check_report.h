// The page that `srf check --report` writes.
#pragma once

#include <string>

#include "acquire/capture_check.h"

namespace srf {

/// A self-contained HTML page: verdicts, pictures, agreement and gain of each view, coverage by views and lights.
std::string checkPage(const std::string& capture, const CheckReport& report);

}  // namespace srf
