#include "acquire/shoot.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <optional>
#include <regex>

#include "base/error.h"
#include "base/files.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

struct Pattern {
  std::regex expression;
  std::vector<std::string ShootPhoto::*> fields;  ///< of the groups, in order
};

Pattern parsePattern(const std::string& text) {
  const auto wrong = [&](const std::string& what) {
    return Error(ErrorKind::usage,
                 what +
                     "; expected a path like \"v{view}/l{light}_{exposure}.jpg\" with {camera}, {view}, "
                     "{light} and {exposure} at most once each",
                 "pattern \"" + text + "\"");
  };
  if (text.empty()) throw wrong("is empty");
  static const std::map<std::string, std::string ShootPhoto::*> kFields{{"view", &ShootPhoto::view},
                                                                        {"light", &ShootPhoto::light},
                                                                        {"exposure", &ShootPhoto::exposure},
                                                                        {"camera", &ShootPhoto::camera}};
  Pattern pattern;
  std::string expression;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '{') {
      const std::size_t end = text.find('}', i);
      if (end == std::string::npos) throw wrong("has a '{' without its '}'");
      const auto field = kFields.find(text.substr(i + 1, end - i - 1));
      if (field == kFields.end()) throw wrong("has the unknown field " + text.substr(i, end - i + 1));
      if (std::find(pattern.fields.begin(), pattern.fields.end(), field->second) != pattern.fields.end())
        throw wrong("has {" + field->first + "} twice");
      pattern.fields.push_back(field->second);
      expression += "([^/]+?)";
      i = end;
    } else if (c == '*') {
      // The format after the last dot: what stands before it may hold dots, as times of day do.
      expression += i + 1 == text.size() && i > 0 && text[i - 1] == '.' ? "[^/.]*" : "[^/]*";
    } else {
      if (!std::isalnum(static_cast<unsigned char>(c)) && static_cast<unsigned char>(c) < 0x80) expression += '\\';
      expression += c;
    }
  }
  pattern.expression = std::regex(expression);
  return pattern;
}

bool looksLikeAnImage(const fs::path& file) {
  static const std::vector<std::string> kNot{".txt", ".json", ".csv", ".md",  ".xml", ".yml", ".yaml", ".lp",
                                             ".npy", ".mat",  ".ply", ".obj", ".zip", ".xmp", ".html", ".dome"};
  std::string extension = file.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  // Masks beside the photographs, as cat.mask.tga or v3_mask.png, are none of them.
  std::string stem = file.stem().string();
  for (char& c : stem) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  for (const char* ending : {".mask", "_mask", "-mask"})
    if (stem == "mask" || stem.ends_with(ending)) return false;
  return !extension.empty() && std::find(kNot.begin(), kNot.end(), extension) == kNot.end();
}

std::string trimmed(const std::string& text) {
  const auto begin = text.find_first_not_of(" \t\r"), end = text.find_last_not_of(" \t\r");
  return begin == std::string::npos ? "" : text.substr(begin, end - begin + 1);
}

std::optional<double> plainNumber(const std::string& text) {
  double value = 0;
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (code != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

std::optional<double> numberOrFraction(const std::string& text) {
  const std::size_t slash = text.find('/');
  if (slash == std::string::npos) return plainNumber(text);
  const auto above = plainNumber(text.substr(0, slash)), below = plainNumber(text.substr(slash + 1));
  if (!above || !below || *below == 0) return std::nullopt;
  return *above / *below;
}

}  // namespace

bool naturallyBefore(const std::string& a, const std::string& b) {
  std::size_t i = 0, j = 0;
  const auto digit = [](const std::string& s, std::size_t k) {
    return k < s.size() && std::isdigit(static_cast<unsigned char>(s[k]));
  };
  while (i < a.size() && j < b.size()) {
    if (digit(a, i) && digit(b, j)) {
      while (i < a.size() && a[i] == '0') ++i;
      while (j < b.size() && b[j] == '0') ++j;
      std::size_t m = i, n = j;
      while (digit(a, m)) ++m;
      while (digit(b, n)) ++n;
      if (m - i != n - j) return m - i < n - j;
      const int order = a.compare(i, m - i, b, j, n - j);
      if (order != 0) return order < 0;
      i = m, j = n;
    } else {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
      ++i, ++j;
    }
  }
  if ((i < a.size()) != (j < b.size())) return j < b.size();
  return a < b;  // "01" and "1"
}

std::vector<ShootPhoto> findPhotos(const fs::path& folder, const std::string& pattern_text) {
  const Pattern pattern = parsePattern(pattern_text);
  std::error_code code;
  if (!fs::is_directory(folder, code)) throw badInput(folder.string(), "is no folder of photographs; check the path");
  std::vector<std::string> names;
  for (auto entry = fs::recursive_directory_iterator(folder, fs::directory_options::follow_directory_symlink, code);
       entry != fs::recursive_directory_iterator(); entry.increment(code)) {
    if (code) throw badInput(folder.string(), "could not be listed: " + code.message());
    std::error_code no_matter;
    if (entry->is_regular_file(no_matter) && looksLikeAnImage(entry->path()))
      names.push_back(entry->path().lexically_relative(folder).generic_string());
  }
  if (code) throw badInput(folder.string(), "could not be listed: " + code.message());
  std::sort(names.begin(), names.end(), naturallyBefore);

  std::vector<ShootPhoto> photos;
  std::string unlike;
  for (const std::string& name : names) {
    std::smatch match;
    if (!std::regex_match(name, match, pattern.expression)) {
      if (unlike.empty()) unlike = name;
      continue;
    }
    ShootPhoto photo{folder / name, "", "", "", ""};
    for (std::size_t k = 0; k < pattern.fields.size(); ++k) photo.*pattern.fields[k] = match[k + 1];
    photos.push_back(photo);
  }
  if (photos.empty())
    throw badInput(folder.string(),
                   "has no photograph that fits \"" + pattern_text + "\"" +
                       (unlike.empty() ? "; it holds no image at all" : "; it holds for example '" + unlike + "'"));
  const auto before = [](const ShootPhoto& a, const ShootPhoto& b) {
    if (a.camera != b.camera) return naturallyBefore(a.camera, b.camera);
    if (a.view != b.view) return naturallyBefore(a.view, b.view);
    if (a.light != b.light) return naturallyBefore(a.light, b.light);
    return naturallyBefore(a.exposure, b.exposure);
  };
  std::stable_sort(photos.begin(), photos.end(), before);
  for (std::size_t i = 1; i < photos.size(); ++i) {
    const ShootPhoto &a = photos[i - 1], &b = photos[i];
    if (a.camera == b.camera && a.view == b.view && a.light == b.light && a.exposure == b.exposure)
      throw badInput(b.file.string(), "is the same view '" + b.view + "', light '" + b.light + "' and exposure '" +
                                          b.exposure + "' as " + a.file.string() + "; give \"" + pattern_text +
                                          "\" the field that tells them apart");
  }
  return photos;
}

std::map<std::string, std::vector<double>> readNamedTable(const fs::path& file, std::size_t columns) {
  const std::string text = readTextFile(file);
  std::map<std::string, std::vector<double>> rows;
  int line_number = 0;
  bool first = true;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    std::string line = text.substr(at, end - at);
    at = end + 1;
    ++line_number;
    line = trimmed(line.substr(0, line.find('#')));
    if (line.empty()) continue;
    std::vector<std::string> cells;
    for (std::size_t from = 0; from <= line.size();) {
      const std::size_t comma = std::min(line.find(',', from), line.size());
      cells.push_back(trimmed(line.substr(from, comma - from)));
      from = comma + 1;
    }
    std::vector<double> values;
    std::string odd;
    for (std::size_t i = 1; i < cells.size(); ++i) {
      const auto value = numberOrFraction(cells[i]);
      if (value)
        values.push_back(*value);
      else
        odd = cells[i];
    }
    const bool header = first && values.empty();
    first = false;
    if (header && cells.size() > 1) continue;
    const auto wrong = [&](const std::string& what) {
      return badInput(file.string() + ", line " + std::to_string(line_number), what);
    };
    if (cells.size() != columns + 1)
      throw wrong("has " + std::to_string(cells.size()) + " cells, expected a name and " + std::to_string(columns) +
                  (columns == 1 ? " number" : " numbers") + " with commas between them");
    if (values.size() != columns) throw wrong("has '" + odd + "' where a number was expected");
    if (!rows.emplace(cells[0], values).second) throw wrong("names '" + cells[0] + "' a second time");
  }
  if (rows.empty()) throw badInput(file.string(), "has no rows");
  return rows;
}

}  // namespace srf
