#include "base/reporter.h"

#include <signal.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>

#include "base/error.h"

namespace srf {
namespace {

volatile sig_atomic_t interrupted = 0;

void onInterrupt(int signal) {
  if (interrupted) ::_exit(128 + signal);
  interrupted = 1;
}

double secondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

std::string jsonText(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    if (static_cast<unsigned char>(c) < 0x20)
      out += ' ';
    else
      out += c;
  }
  return out + "\"";
}

}  // namespace

std::string clockText(double seconds) {
  char text[32];
  const long s = std::lround(seconds);
  if (s < 3600)
    std::snprintf(text, sizeof text, "%ld:%02ld", s / 60, s % 60);
  else
    std::snprintf(text, sizeof text, "%ld:%02ld:%02ld", s / 3600, s / 60 % 60, s % 60);
  return text;
}

Reporter::Reporter(ProgressMode progress, LogLevel level) : progress_(progress), level_(level) {
  if (progress_ == ProgressMode::automatic) progress_ = ::isatty(2) ? ProgressMode::tty : ProgressMode::none;
}
Reporter::~Reporter() = default;

Reporter& Reporter::silent() {
  static Reporter reporter(ProgressMode::none, LogLevel::error);
  return reporter;
}

Reporter::Stage::Stage(Reporter& reporter, const std::string& name, std::uint64_t steps)
    : reporter_(reporter), name_(name), steps_(steps), start_(std::chrono::steady_clock::now()) {
  reporter_.show(name_, 0, steps_, 0, false);
}

Reporter::Stage::~Stage() {
  const double seconds = secondsSince(start_);
  reporter_.show(name_, done_, steps_, seconds, true);
  const std::lock_guard lock(reporter_.mutex_);
  for (auto& s : reporter_.stages_)
    if (s.name == name_) {
      s.seconds += seconds;
      s.steps += done_;
      return;
    }
  reporter_.stages_.push_back({name_, seconds, done_});
}

void Reporter::Stage::advance(std::uint64_t steps) {
  const std::uint64_t done = done_ += steps;
  throwIfInterrupted();
  reporter_.show(name_, done, steps_, secondsSince(start_), false);
}

void Reporter::show(const std::string& stage, std::uint64_t done, std::uint64_t steps, double seconds, bool last) {
  if (progress_ == ProgressMode::none) return;
  const std::lock_guard lock(mutex_);
  const double now = std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  if (!last && now - last_shown_ < 0.1) return;  // ten lines a second at most
  last_shown_ = now;
  const double share = steps > 0 ? static_cast<double>(done) / static_cast<double>(steps) : 0;
  const double eta = done > 0 && done < steps ? seconds * (1 / share - 1) : 0;
  switch (progress_) {
    case ProgressMode::tty:
      std::fprintf(stderr, "\r\033[K%-24s %3.0f %%  %s", stage.c_str(), 100 * share, clockText(seconds).c_str());
      if (!last && eta > 0) std::fprintf(stderr, "  ETA %s", clockText(eta).c_str());
      if (last) std::fputc('\n', stderr);
      line_open_ = !last;
      break;
    case ProgressMode::json:
      std::fprintf(stderr, "{\"stage\": %s, \"done\": %llu, \"steps\": %llu, \"seconds\": %.3f, \"eta\": %.3f}\n",
                   jsonText(stage).c_str(), static_cast<unsigned long long>(done),
                   static_cast<unsigned long long>(steps), seconds, eta);
      break;
    case ProgressMode::openjd:
      std::fprintf(stderr, "openjd_status: %s\nopenjd_progress: %.1f\n", stage.c_str(), 100 * share);
      break;
    default:
      break;
  }
  std::fflush(stderr);
}

void Reporter::clearLine() {
  if (line_open_) std::fputs("\r\033[K", stderr);
  line_open_ = false;
}

void Reporter::result(const std::string& text) {
  const std::lock_guard lock(mutex_);
  clearLine();
  std::fprintf(stdout, "%s\n", text.c_str());
  std::fflush(stdout);
}

void Reporter::log(LogLevel level, const std::string& text) {
  if (level > level_) return;
  clearLine();
  static constexpr const char* kNames[] = {"error", "warning", "info", "debug"};
  std::fprintf(stderr, "%s: %s\n", kNames[static_cast<int>(level)], text.c_str());
}

void Reporter::warn(const std::string& text) {
  const std::lock_guard lock(mutex_);
  warnings_.push_back(text);
  log(LogLevel::warning, text);
}
void Reporter::info(const std::string& text) {
  const std::lock_guard lock(mutex_);
  log(LogLevel::info, text);
}
void Reporter::debug(const std::string& text) {
  const std::lock_guard lock(mutex_);
  log(LogLevel::debug, text);
}
void Reporter::count(const std::string& name, std::uint64_t amount) {
  const std::lock_guard lock(mutex_);
  counters_[name] += amount;
}
void Reporter::figure(const std::string& name, double value) {
  const std::lock_guard lock(mutex_);
  figures_[name] = value;
}
std::vector<Reporter::StageTime> Reporter::stageTimes() const {
  const std::lock_guard lock(mutex_);
  return stages_;
}
std::vector<std::string> Reporter::warnings() const {
  const std::lock_guard lock(mutex_);
  return warnings_;
}
std::map<std::string, std::uint64_t> Reporter::counters() const {
  const std::lock_guard lock(mutex_);
  return counters_;
}
std::map<std::string, double> Reporter::figures() const {
  const std::lock_guard lock(mutex_);
  return figures_;
}

void installInterruptHandler() {
  struct sigaction action {};
  action.sa_handler = onInterrupt;
  ::sigaction(SIGINT, &action, nullptr);
  ::sigaction(SIGTERM, &action, nullptr);
}
bool interruptRequested() {
  return interrupted != 0;
}
void throwIfInterrupted() {
  if (interrupted) throw Error(ErrorKind::interrupted, "interrupted");
}
void setInterruptRequested(bool requested) {
  interrupted = requested;
}

}  // namespace srf
