#include "base/json.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <unordered_set>

#include "base/files.h"

namespace srf {
namespace {

std::string inQuotes(std::string_view word) {
  return "'" + std::string(word) + "'";
}

// A short form of a value for messages.
std::string shown(const Json& value) {
  std::string text = value.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (text.size() > 60) text = text.substr(0, 57) + "...";
  return text;
}

// What reads values recurses, so nesting has a bound; no file of ours goes beyond ten.
constexpr int kDeepest = 100;

// A key as a token of a JSON pointer (RFC 6901).
std::string token(std::string_view key) {
  std::string out;
  for (const char c : key) out += c == '~' ? "~0" : c == '/' ? "~1" : std::string(1, c);
  return out;
}

// Watches a text being parsed: how deep it goes, and that no key stands twice in an object, of which the parser would
// keep the last without a word.
class ParseWatch {
 public:
  explicit ParseWatch(std::string name) : name_(std::move(name)) {}

  bool operator()(int depth, Json::parse_event_t event, const Json& value) {
    using Event = Json::parse_event_t;
    if (depth > kDeepest)
      throw badInput(name_, "is nested deeper than " + std::to_string(kDeepest) + " levels; mend it");
    switch (event) {
      case Event::object_start:
      case Event::array_start:
        if (open_.size() == used_) open_.emplace_back();
        open_[used_].is_object = event == Event::object_start;
        open_[used_].keys.clear();
        open_[used_++].entry = 0;
        break;
      case Event::key:
        addKey(value.get_ref<const std::string&>());
        break;
      case Event::object_end:
      case Event::array_end:
        --used_;
        [[fallthrough]];
      case Event::value:
        if (used_ > 0) ++open_[used_ - 1].entry;
    }
    return true;
  }

 private:
  struct Container {
    bool is_object = false;
    std::size_t entry = 0;  // of an array
    std::string key;        // of an object, the one that is being read
    std::unordered_set<std::string> keys;
  };

  void addKey(const std::string& key) {
    Container& object = open_[used_ - 1];
    object.key = key;
    if (object.keys.insert(key).second) return;
    std::string pointer;
    for (std::size_t i = 0; i < used_; ++i)
      pointer += "/" + (open_[i].is_object ? token(open_[i].key) : std::to_string(open_[i].entry));
    throw badInput(name_ + ": " + pointer, "the key " + inQuotes(key) + " stands twice; keep one of the two");
  }

  std::string name_;
  std::vector<Container> open_;  // the first `used_` of them: the containers that are open, the outermost first
  std::size_t used_ = 0;
};

Json parsed(const std::string& text, const std::string& name) {
  ParseWatch watch(name);
  return Json::parse(text,
                     [&](int depth, Json::parse_event_t event, Json& value) { return watch(depth, event, value); });
}

JsonNode rootOf(const std::string& text, const std::string& name) {
  try {
    auto document = std::make_shared<const Json>(parsed(text, name));
    return {document, document.get(), name, ""};
  } catch (const Json::out_of_range& e) {
    throw badInput(name,
                   std::string("holds a number beyond the range of double precision (") + e.what() + "); mend it");
  } catch (const Json::parse_error& e) {
    const std::size_t end = std::min(e.byte > 0 ? e.byte - 1 : 0, text.size());
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(end), '\n');
    const std::size_t line_start = end == 0 ? 0 : text.rfind('\n', end - 1) + 1;
    const std::string place = "line " + std::to_string(line) + ", column " + std::to_string(end - line_start + 1);
    if (std::string_view(e.what()).find("UTF-8") != std::string_view::npos)
      throw badInput(name, place + " is not UTF-8 text; save the file as UTF-8 (names of files too)");
    throw badInput(name, place + " is not valid JSON; check commas, quotes and brackets there");
  }
}

}  // namespace

JsonNode::JsonNode(std::shared_ptr<const Json> document, const Json* value, std::string file, std::string pointer)
    : document_(std::move(document)), value_(value), file_(std::move(file)), pointer_(std::move(pointer)) {}

std::string JsonNode::where() const {
  return file_ + ": " + (pointer_.empty() ? "/" : pointer_);
}
bool JsonNode::isObject() const {
  return value_->is_object();
}
bool JsonNode::isArray() const {
  return value_->is_array();
}
bool JsonNode::isNumber() const {
  return value_->is_number();
}
bool JsonNode::isString() const {
  return value_->is_string();
}
std::string JsonNode::typeName() const {
  return value_->type_name();
}

const JsonNode& JsonNode::onlyKeys(std::initializer_list<std::string_view> known) const {
  if (!isObject()) throw error("found " + shown(*value_) + ", expected an object {...}");
  for (const auto& [key, unused] : value_->items()) {
    if (std::find(known.begin(), known.end(), key) != known.end()) continue;
    const std::vector<std::string> words(known.begin(), known.end());
    const std::string near = nearestWord(key, words);
    std::string list;
    for (const auto& w : words) list += (list.empty() ? "" : ", ") + w;
    throw badInput(file_ + ": " + pointer_ + "/" + token(key),
                   "unknown key " + inQuotes(key) +
                       (near.empty() ? "; known here: " + list : "; did you mean " + inQuotes(near) + "?"));
  }
  return *this;
}

bool JsonNode::has(std::string_view key) const {
  return isObject() && value_->contains(std::string(key));
}

std::optional<JsonNode> JsonNode::find(std::string_view key) const {
  if (!isObject()) throw error("found " + shown(*value_) + ", expected an object {...}");
  const auto it = value_->find(std::string(key));
  if (it == value_->end()) return std::nullopt;
  return JsonNode(document_, &*it, file_, pointer_ + "/" + token(key));
}

JsonNode JsonNode::operator[](std::string_view key) const {
  auto node = find(key);
  if (!node) throw error("the key " + inQuotes(key) + " is missing; add it");
  return *node;
}

std::size_t JsonNode::size() const {
  if (!isArray()) throw error("found " + shown(*value_) + ", expected an array [...]");
  return value_->size();
}

JsonNode JsonNode::at(std::size_t index) const {
  if (index >= size())
    throw error("has " + std::to_string(size()) + " entries, expected more than " + std::to_string(index));
  return {document_, &(*value_)[index], file_, pointer_ + "/" + std::to_string(index)};
}

double JsonNode::number() const {
  if (!isNumber()) throw error("found " + shown(*value_) + ", expected a number");
  const double x = value_->get<double>();
  if (!std::isfinite(x)) throw error("found " + shown(*value_) + ", expected a finite number");
  return x;
}

double JsonNode::positiveNumber() const {
  const double x = number();
  if (!(x > 0)) throw error("found " + shown(*value_) + ", expected a number above 0");
  return x;
}

double JsonNode::amount() const {
  const double x = number();
  if (!(x >= 0)) throw error("found " + shown(*value_) + ", expected a number of at least 0");
  return x;
}

long JsonNode::integer(long least, long most) const {
  const double x = number();
  if (x != std::floor(x) || x < static_cast<double>(least) || x > static_cast<double>(most))
    throw error("found " + shown(*value_) + ", expected a whole number from " + std::to_string(least) + " to " +
                std::to_string(most));
  return static_cast<long>(x);
}

std::string JsonNode::string() const {
  if (!isString()) throw error("found " + shown(*value_) + ", expected a string");
  return value_->get<std::string>();
}

bool JsonNode::boolean() const {
  if (!value_->is_boolean()) throw error("found " + shown(*value_) + ", expected true or false");
  return value_->get<bool>();
}

Vec3 JsonNode::vec3() const {
  const auto v = numbers(3);
  return {v[0], v[1], v[2]};
}

std::vector<double> JsonNode::numbers(std::size_t count) const {
  if (!isArray() || value_->size() != count)
    throw error("found " + shown(*value_) + ", expected an array of " + std::to_string(count) + " numbers");
  std::vector<double> v(count);
  for (std::size_t i = 0; i < count; ++i) v[i] = at(i).number();
  return v;
}

std::size_t JsonNode::choice(std::initializer_list<std::string_view> words) const {
  return choice(std::span(words.begin(), words.size()));
}

std::size_t JsonNode::choice(std::span<const std::string_view> words) const {
  const std::string found = string();
  std::string list;
  std::size_t i = 0;
  for (const auto& word : words) {
    if (word == found) return i;
    list += (list.empty() ? "" : ", ") + inQuotes(word);
    ++i;
  }
  throw error("found " + inQuotes(found) + ", expected one of " + list);
}

JsonNode parseJson(const std::string& text, const std::string& name) {
  return rootOf(text, name);
}
JsonNode readJsonFile(const std::filesystem::path& file) {
  return rootOf(readTextFile(file), file.string());
}

std::filesystem::path existingFile(const JsonNode& node, const std::filesystem::path& folder) {
  std::filesystem::path file = folder / node.string();
  if (!std::filesystem::is_regular_file(file))
    throw node.error("the file '" + file.string() + "' does not exist; the path is relative to " +
                     std::filesystem::path(node.file()).filename().string());
  return file;
}

JsonNode withOverride(const JsonNode& root, const std::string& assignment) {
  const auto equals = assignment.find('=');
  if (equals == std::string::npos || assignment.empty() || assignment[0] != '/')
    throw Error(ErrorKind::usage, "found '" + assignment + "', expected /json/pointer=value", "--set");
  const std::string pointer = assignment.substr(0, equals), text = assignment.substr(equals + 1);
  Json document = root.raw();
  Json value = text;
  try {
    value = parsed(text, "--set " + pointer);
  } catch (const Json::exception&) {  // a string
  }
  try {
    // nlohmann would fill an array with nulls up to any index.
    for (Json::json_pointer p(pointer); !p.empty(); p.pop_back()) {
      const Json::json_pointer parent = p.parent_pointer();
      if (!document.contains(parent) || !document.at(parent).is_array() || p.back() == "-") continue;
      const std::size_t size = document.at(parent).size();
      if (p.back().size() > 9 || std::strtoul(p.back().c_str(), nullptr, 10) > size)
        throw Error(ErrorKind::usage,
                    "the pointer '" + pointer + "' goes beyond the " + std::to_string(size) + " entries of '" +
                        parent.to_string() + "'",
                    "--set");
    }
    document[Json::json_pointer(pointer)] = value;
  } catch (const Json::exception& e) {
    throw Error(ErrorKind::usage, "the pointer '" + pointer + "' does not fit " + root.file() + " (" + e.what() + ")",
                "--set");
  }
  auto shared = std::make_shared<const Json>(std::move(document));
  return {shared, shared.get(), root.file(), ""};
}

void writeJsonFile(const std::filesystem::path& file, const Json& value) {
  writeTextFile(file, value.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

std::string nearestWord(std::string_view word, const std::vector<std::string>& known) {
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, word.size() / 3) + 1;
  for (const std::string& k : known) {
    std::vector<std::size_t> row(k.size() + 1);
    for (std::size_t j = 0; j <= k.size(); ++j) row[j] = j;
    for (std::size_t i = 1; i <= word.size(); ++i) {
      std::size_t diagonal = row[0];
      row[0] = i;
      for (std::size_t j = 1; j <= k.size(); ++j) {
        const std::size_t next = std::min({row[j] + 1, row[j - 1] + 1, diagonal + (word[i - 1] != k[j - 1])});
        diagonal = row[j];
        row[j] = next;
      }
    }
    if (row[k.size()] < best_distance) best_distance = row[k.size()], best = k;
  }
  return best;
}

}  // namespace srf
