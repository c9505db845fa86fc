// The page of `srf study --capture`: self-contained HTML.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "apps/capture_study.h"

namespace srf {

std::string capturePage(const CaptureStudy& study, std::span<const ShownPrediction> shown);
/// What was measured, and what more photographs would bring, as sentences: for the page and the terminal.
std::vector<std::string> captureSentences(const CaptureStudy& study);

}  // namespace srf
