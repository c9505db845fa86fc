#include "apps/program.h"

#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "base/error.h"
#include "base/json.h"
#include "base/memory.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr std::size_t kLeastMemory = std::size_t{8} << 20;

std::size_t machineMemory() {
  return static_cast<std::size_t>(::sysconf(_SC_PHYS_PAGES)) * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

void requireProcessor() {
#if defined(__AVX2__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma"))
    throw Error(ErrorKind::failed, "this build needs a processor with AVX2 and FMA; build with -DSRF_MARCH=x86-64");
#endif
}

// The option nearest to an unknown one, from CLI11's own list.
std::string unknownOption(const CLI::App& app, const std::string& word) {
  std::vector<std::string> known;
  for (const CLI::Option* o : app.get_options())
    for (const std::string& name : o->get_lnames()) known.push_back("--" + name);
  const std::string near = nearestWord(word.substr(0, word.find('=')), known);
  return "unknown option '" + word + "'" + (near.empty() ? "; see --help" : "; did you mean '" + near + "'?");
}

}  // namespace

Program::Program(const std::string& command, const std::string& description, const std::string& licence)
    : app_(description, "srf " + command), command_(command) {
  app_.set_version_flag("--version", std::string("srf ") + command + " " + projectVersion() + ", " + licence);
  app_.add_option("--threads", threads_, "most threads to use; 0: all cores")->check(CLI::Range(0, 1024));
  app_.add_option("--memory", memory_text_, "memory budget, e.g. 512M or 4G; default: a quarter of the machine");
  app_.add_option("--log-level", log_level_, "error, warning, info or debug")
      ->check(CLI::IsMember({"error", "warning", "info", "debug"}))
      ->capture_default_str();
  app_.add_option("--progress", progress_, "auto, tty, json, openjd or none")
      ->check(CLI::IsMember({"auto", "tty", "json", "openjd", "none"}))
      ->capture_default_str();
  app_.add_option("--stats", stats_file_, "write times, counters and warnings to this JSON file");
  app_.get_formatter()->column_width(34);
}

int Program::run(int argc, char** argv, const std::function<void(Reporter&)>& body) {
  for (int i = 0; i < argc; ++i) command_line_ += (i ? " " : "") + std::string(i ? argv[i] : "srf " + command_);
  const auto fail = [&](const std::string& text) {
    std::fprintf(stderr, "srf %s: %s\n", command_.c_str(), text.c_str());
  };
  try {
    app_.parse(argc, argv);
    memory_bytes_ = memory_text_.empty() ? machineMemory() / 4 : parseByteSize(memory_text_);
  } catch (const CLI::CallForHelp& e) {
    return app_.exit(e);
  } catch (const CLI::CallForVersion& e) {
    return app_.exit(e);
  } catch (const CLI::ExtrasError&) {
    const auto extras = app_.remaining();
    const std::string word = extras.empty() ? "" : extras.front();
    fail(word.starts_with("-") ? unknownOption(app_, word) : "unexpected argument '" + word + "'; see --help");
    return static_cast<int>(ErrorKind::usage);
  } catch (const CLI::ParseError& e) {
    fail(std::string(e.what()) + "; see --help");
    return static_cast<int>(ErrorKind::usage);
  } catch (const Error& e) {
    fail(e.what());
    return static_cast<int>(e.kind());
  }

  static const std::map<std::string, ProgressMode> kProgress{{"auto", ProgressMode::automatic},
                                                             {"tty", ProgressMode::tty},
                                                             {"json", ProgressMode::json},
                                                             {"openjd", ProgressMode::openjd},
                                                             {"none", ProgressMode::none}};
  static const std::map<std::string, LogLevel> kLevels{
      {"error", LogLevel::error}, {"warning", LogLevel::warning}, {"info", LogLevel::info}, {"debug", LogLevel::debug}};
  Reporter reporter(kProgress.at(progress_), kLevels.at(log_level_));
  installInterruptHandler();
  setThreadCount(threads_);
  const auto start = std::chrono::steady_clock::now();
  int code = 0;
  try {
    requireProcessor();
    requireMemory(reporter);
    body(reporter);
  } catch (const Error& e) {
    code = static_cast<int>(e.kind());
    fail(e.what());
  } catch (const std::bad_alloc&) {
    code = static_cast<int>(ErrorKind::out_of_budget);
    fail("out of memory; give less with --memory, or use a machine with more");
  } catch (const std::exception& e) {
    code = static_cast<int>(ErrorKind::failed);
    fail(e.what());
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  try {
    if (!stats_file_.empty()) writeStats(reporter, seconds, code);
  } catch (const Error& e) {
    fail(e.what());
    if (code == 0) code = static_cast<int>(e.kind());
  }
  return code;
}

// The program with its libraries counts too: a smaller budget cannot be kept, yet it keeps small what comes besides.
void Program::requireMemory(Reporter& reporter) const {
  if (memory_text_.empty()) return;
  if (memory_bytes_ < kLeastMemory)
    throw Error(ErrorKind::out_of_budget,
                "found '" + memory_text_ + "', expected at least " + std::to_string(kLeastMemory >> 20) +
                    "M: a few blocks of photographs must have room",
                "--memory");
  if (const std::size_t held = residentBytes(); memory_bytes_ < held)
    reporter.warn("--memory " + memory_text_ + " cannot be kept: the program holds " +
                  std::to_string((held >> 20) + 1) + " MiB with its libraries before any work; the rest is kept small");
}

void Program::writeStats(const Reporter& reporter, double seconds, int exit_code) const {
  Json stats;
  stats["command"] = command_line_;
  stats["version"] = projectVersion();
  stats["exit_code"] = exit_code;
  stats["seconds"] = seconds;
  struct rusage usage {};
  ::getrusage(RUSAGE_SELF, &usage);
  stats["peak_memory_bytes"] = static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
  stats["threads"] = threadCount();
  stats["stages"] = Json::array();
  for (const auto& s : reporter.stageTimes())
    stats["stages"].push_back({{"name", s.name}, {"seconds", s.seconds}, {"steps", s.steps}});
  stats["counters"] = reporter.counters();
  stats["figures"] = reporter.figures();
  stats["warnings"] = reporter.warnings();
  writeJsonFile(stats_file_, stats);
}

std::size_t parseByteSize(const std::string& text) {
  std::size_t used = 0;
  double value = 0;
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  const std::string unit = text.substr(used);
  static const std::map<std::string, double> kUnits{{"", 1},
                                                    {"B", 1},
                                                    {"K", 1024.},
                                                    {"M", 1048576.},
                                                    {"G", 1073741824.},
                                                    {"T", 1099511627776.},
                                                    {"KiB", 1024.},
                                                    {"MiB", 1048576.},
                                                    {"GiB", 1073741824.},
                                                    {"TiB", 1099511627776.}};
  const auto it = kUnits.find(unit);
  if (used == 0 || it == kUnits.end() || !(value > 0) || !(value * it->second < 9e18))
    throw Error(ErrorKind::usage, "found '" + text + "', expected a size such as 512M or 4G");
  return static_cast<std::size_t>(value * it->second);
}

const char* projectVersion() {
  return SRF_VERSION;
}

}  // namespace srf
