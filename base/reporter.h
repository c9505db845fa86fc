// What a long run tells its user: stages with progress and ETA, warnings, counters and times. One Reporter is made by
// the program and passed down; libraries never print.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace srf {

enum class ProgressMode { automatic, tty, json, openjd, none };
enum class LogLevel { error, warning, info, debug };

/// Thread-safe. Warnings, counters and stage times are kept for --stats and reports.
class Reporter {
 public:
  /// Prints progress and logs to stderr.
  Reporter(ProgressMode progress, LogLevel level);
  /// Says nothing and remembers everything: for tests and libraries used alone.
  static Reporter& silent();
  ~Reporter();
  Reporter(const Reporter&) = delete;
  Reporter& operator=(const Reporter&) = delete;

  /// A stage of work with a known number of steps; the destructor ends it and records its time. Stages may nest: the
  /// innermost is shown.
  class Stage {
   public:
    Stage(Reporter& reporter, const std::string& name, std::uint64_t steps);
    ~Stage();
    Stage(const Stage&) = delete;
    Stage& operator=(const Stage&) = delete;
    /// From any thread. Throws interrupted after Ctrl-C.
    void advance(std::uint64_t steps = 1);

   private:
    Reporter& reporter_;
    std::string name_;
    std::uint64_t steps_;
    std::atomic<std::uint64_t> done_{0};
    std::chrono::steady_clock::time_point start_;
  };

  /// A line of the program's result, on stdout at once; a line of progress on the terminal makes room for it.
  void result(const std::string& text);
  void warn(const std::string& text);
  void info(const std::string& text);
  void debug(const std::string& text);
  /// Adds to a named counter ("pixels.nan", "frame.collapsed"); shown by --stats.
  void count(const std::string& name, std::uint64_t amount = 1);
  /// Records a number or text for --stats, e.g. "hull.volume".
  void figure(const std::string& name, double value);

  struct StageTime {
    std::string name;
    double seconds;
    std::uint64_t steps;
  };
  std::vector<StageTime> stageTimes() const;
  std::vector<std::string> warnings() const;
  std::map<std::string, std::uint64_t> counters() const;
  std::map<std::string, double> figures() const;

 private:
  void show(const std::string& stage, std::uint64_t done, std::uint64_t steps, double seconds, bool last);
  void log(LogLevel level, const std::string& text);
  void clearLine();

  ProgressMode progress_;
  LogLevel level_;
  mutable std::mutex mutex_;
  double last_shown_ = -1;
  bool line_open_ = false;
  std::vector<StageTime> stages_;
  std::vector<std::string> warnings_;
  std::map<std::string, std::uint64_t> counters_;
  std::map<std::string, double> figures_;
};

std::string clockText(double seconds);  ///< "m:ss" or "h:mm:ss"

/// Ctrl-C: the first sets a flag that long loops look at (Stage::advance, throwIfInterrupted); the second ends the
/// program at once.
void installInterruptHandler();
bool interruptRequested();
void throwIfInterrupted();
/// For tests: as if Ctrl-C had been pressed, or taken back.
void setInterruptRequested(bool requested);

}  // namespace srf
