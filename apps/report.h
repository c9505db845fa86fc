// report.html of `srf pipeline`: one file that needs no other, for a person who wants to know how well it went.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "base/mesh.h"
#include "base/reporter.h"
#include "field/srf_folder.h"
#include "render/animation.h"

namespace srf {

struct PipelineReport {
  std::string command;  ///< the command line
  std::filesystem::path scene;
  SrfManifest field;
  std::optional<AcquisitionMesh> hull;
  std::string model;             ///< one line on the model
  Box<AcquisitionSpace> bounds;  ///< of the model
  std::vector<RenderedFrame> frames;
  std::filesystem::path contact_sheet;  ///< PNG
  std::vector<int> sheet_frames;        ///< its frames, row by row
  double exposure = 1;                  ///< of the display pictures
  std::filesystem::path video;          ///< empty: there is none
  std::vector<Reporter::StageTime> stages;
  std::vector<std::string> warnings;
  std::map<std::string, std::uint64_t> counters;
  std::map<std::string, double> figures;
};

/// The page as text.
std::string reportPage(const PipelineReport& report);

}  // namespace srf
