// What every command shares: common options, progress, --stats, one place that catches errors and turns them into one
// line and an exit code (doc: formats, Command line).
#pragma once

#include <CLI/CLI.hpp>
#include <cstddef>
#include <functional>
#include <optional>
#include <string>

#include "base/reporter.h"

namespace srf {

class Program {
 public:
  /// `command` as in `srf COMMAND`; `licence` as printed by --version ("Apache-2.0", or "GPL-3.0-or-later (links
  /// CGAL)").
  Program(const std::string& command, const std::string& description, const std::string& licence = "Apache-2.0");

  CLI::App& app() { return app_; }
  /// Parses, runs `body` and returns the exit code: 0 done, 1 failed, 2 usage, 3 bad input, 4 out of a budget,
  /// 130 interrupted. --stats is written whether or not the body fails.
  int run(int argc, char** argv, const std::function<void(Reporter&)>& body);

  bool statsWanted() const { return !stats_file_.empty(); }   ///< --stats
  std::size_t memoryBudget() const { return memory_bytes_; }  ///< bytes; default a quarter of the machine
  const std::string& commandLine() const { return command_line_; }

 private:
  void requireMemory(Reporter& reporter) const;
  void writeStats(const Reporter& reporter, double seconds, int exit_code) const;

  CLI::App app_;
  std::string command_, command_line_, memory_text_, progress_ = "auto", log_level_ = "warning", stats_file_;
  int threads_ = 0;
  std::size_t memory_bytes_ = 0;
};

/// "512M", "2G", "1.5GiB", "1000000" to bytes; throws usage.
std::size_t parseByteSize(const std::string& text);
/// The version of the project ("0.1.0").
const char* projectVersion();

}  // namespace srf
