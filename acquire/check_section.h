// How the groups of `srf check` write their rows.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "acquire/capture_check.h"
#include "base/error.h"

namespace srf {

std::string counted(std::size_t n, const std::string& noun);  ///< "1 view", "3 views"

/// The words of an error that names `file`, without the name.
std::string wordsWithout(const std::string& file, const Error& error);
/// What is wrong with a file, and which place of transforms.json names it.
std::string withPlace(const std::string& fault, const std::string& place);

/// The rows of one thing that was looked at; says "ok" where nothing was found.
class Section {
 public:
  Section(CheckReport& report, std::string item) : report_(report), item_(std::move(item)) {}
  void add(Verdict verdict, const std::string& file, const std::string& found, const std::string& mend);
  void fault(const std::string& file, const std::string& found, const std::string& mend) {
    add(Verdict::fault, file, found, mend);
  }
  void warn(const std::string& file, const std::string& found, const std::string& mend) {
    add(Verdict::warning, file, found, mend);
  }
  void fault(const Error& error) { fault("", error.what(), ""); }
  /// Ends the section with what is well about it, and with what was too much to list.
  void finish(const std::string& good);

 private:
  CheckReport& report_;
  std::string item_;
  bool clean_ = true;
  std::map<std::pair<Verdict, std::string>, std::vector<std::string>> rows_;  // files of each verdict and mend
};

}  // namespace srf
