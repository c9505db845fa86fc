// srf check: what is wrong with a capture, where, and how to mend it.
#include <cstdio>
#include <nlohmann/json.hpp>

#include "acquire/capture_check.h"
#include "apps/check_report.h"
#include "apps/program.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json.h"

namespace {

void printReport(const srf::CheckReport& report) {
  for (const srf::CheckItem& i : report.items) {
    const std::string about = i.file.empty() ? "" : i.file + ": ";
    std::printf("%-8s %-19s %s%s\n", srf::verdictName(i.verdict).c_str(), i.item.c_str(), about.c_str(),
                i.found.c_str());
    if (!i.mend.empty()) std::printf("%-8s %-19s   mend: %s\n", "", "", i.mend.c_str());
  }
  std::printf("faults: %zu, warnings: %zu\n", report.count(srf::Verdict::fault), report.count(srf::Verdict::warning));
}

void writeJson(const std::string& file, const srf::CheckReport& report) {
  srf::Json json;
  json["faults"] = report.count(srf::Verdict::fault);
  json["warnings"] = report.count(srf::Verdict::warning);
  json["items"] = srf::Json::array();
  for (const srf::CheckItem& i : report.items)
    json["items"].push_back({{"verdict", srf::verdictName(i.verdict)},
                             {"item", i.item},
                             {"file", i.file},
                             {"found", i.found},
                             {"mend", i.mend}});
  json["view_iou"] = report.view_iou;
  json["view_gain"] = report.view_gain;
  srf::writeJsonFile(file, json);
}

void writeFixed(const std::string& folder, const srf::CheckReport& report, srf::Reporter& reporter) {
  if (report.mended.capture.views.empty()) {
    reporter.warn(folder + ": not written: the capture could not be read, or nothing of it can be used");
    return;
  }
  srf::writeMended(folder, report.mended);
  for (const std::string& what : report.mended.what) std::printf("mended   %s\n", what.c_str());
  std::printf("%s: %zu mended; no photograph was touched\n", folder.c_str(), report.mended.what.size());
}

}  // namespace

int main(int argc, char** argv) {
  srf::Program program("check", "Examines a capture and says what is wrong, where, and how to mend it.");
  std::string capture, out = ".", json, html, fixed;
  program.app()
      .add_option("capture", capture, "folder with transforms.json, a Middlebury *_par.txt or a COLMAP model")
      ->required();
  program.app().add_option("-o,--output", out, "where the SRF is to be written, for the forecast of disk space");
  program.app().add_option("--report", html, "write a page with pictures to this file, e.g. check.html");
  program.app().add_option("--json", json, "write the report to this file as well");
  program.app().add_option("--fix", fixed,
                           "folder for a mended copy of transforms.json and of inverted masks; never a photograph");
  return program.run(argc, argv, [&](srf::Reporter& reporter) {
    std::error_code code;
    if (!fixed.empty() && std::filesystem::equivalent(fixed, capture, code))
      throw srf::Error(srf::ErrorKind::usage, "names the capture itself; name another folder", "--fix");
    const srf::CheckReport report = srf::checkCapture(capture, {out, program.memoryBudget(), !html.empty()}, reporter);
    printReport(report);
    if (!json.empty()) writeJson(json, report);
    if (!html.empty()) srf::writeTextFile(html, srf::checkPage(capture, report));
    if (!fixed.empty()) writeFixed(fixed, report, reporter);
    if (const auto faults = report.count(srf::Verdict::fault); faults > 0)
      throw srf::badInput(capture, std::to_string(faults) + (faults == 1 ? " fault" : " faults") +
                                       "; the report tells how to mend them");
  });
}
