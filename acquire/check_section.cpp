#include "acquire/check_section.h"

#include <algorithm>

namespace srf {
namespace {

constexpr std::size_t kShown = 8;   // rows of one kind before the rest is summed up
constexpr std::size_t kNamed = 60;  // files of one kind that are named at all

}  // namespace

std::string counted(std::size_t n, const std::string& noun) {
  return std::to_string(n) + " " + noun + (n == 1 ? "" : "s");
}

std::string wordsWithout(const std::string& file, const Error& error) {
  const std::string words = error.what();
  return words.starts_with(file + ": ") ? words.substr(file.size() + 2) : words;
}

std::string withPlace(const std::string& fault, const std::string& place) {
  return place.empty() ? fault : fault + " (" + place + ")";
}

void Section::add(Verdict verdict, const std::string& file, const std::string& found, const std::string& mend) {
  clean_ = false;
  std::vector<std::string>& rows = rows_[{verdict, mend}];
  rows.push_back(file);
  if (rows.size() <= kShown) report_.items.push_back({verdict, item_, file, found, mend});
}

void Section::finish(const std::string& good) {
  for (const auto& [kind, rows] : rows_) {
    if (rows.size() <= kShown) continue;
    std::string names;
    for (std::size_t i = kShown; i < std::min(rows.size(), kNamed); ++i)
      if (!rows[i].empty()) names += (names.empty() ? ": " : ", ") + rows[i];
    if (rows.size() > kNamed) names += " ..";
    report_.items.push_back(
        {kind.first, item_, "", std::to_string(rows.size() - kShown) + " more of the same" + names, kind.second});
  }
  if (clean_) report_.items.push_back({Verdict::ok, item_, "", good, ""});
}

}  // namespace srf
