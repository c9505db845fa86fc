// JSON files with errors that name file, key (as a JSON pointer), what was found and what was expected.
#pragma once

#include <filesystem>
#include <initializer_list>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "base/vec.h"

namespace srf {

using Json = nlohmann::ordered_json;

/// A place in a parsed file: the value and how it was reached. Cheap to copy; keeps the document alive.
class JsonNode {
 public:
  JsonNode(std::shared_ptr<const Json> document, const Json* value, std::string file, std::string pointer);

  const std::string& file() const { return file_; }
  const std::string& pointer() const { return pointer_; }
  /// "scene.json: /lights/0/type"
  std::string where() const;
  const Json& raw() const { return *value_; }
  Error error(const std::string& what) const { return badInput(where(), what); }

  bool isObject() const;
  bool isArray() const;
  bool isNumber() const;
  bool isString() const;
  std::string typeName() const;

  /// Throws unless this is an object whose keys are all among `known`; names the nearest known key.
  const JsonNode& onlyKeys(std::initializer_list<std::string_view> known) const;
  bool has(std::string_view key) const;
  JsonNode operator[](std::string_view key) const;  ///< throws where the key is missing
  std::optional<JsonNode> find(std::string_view key) const;
  std::size_t size() const;  ///< of an array; throws on anything else
  JsonNode at(std::size_t index) const;

  double number() const;          ///< finite
  double positiveNumber() const;  ///< finite and > 0
  double amount() const;          ///< finite and >= 0
  long integer(long least, long most) const;
  std::string string() const;
  bool boolean() const;
  Vec3 vec3() const;  ///< [x, y, z], finite
  std::vector<double> numbers(std::size_t count) const;
  /// One of the words, as an index; the error lists them.
  std::size_t choice(std::span<const std::string_view> words) const;
  std::size_t choice(std::initializer_list<std::string_view> words) const;

 private:
  std::shared_ptr<const Json> document_;
  const Json* value_;
  std::string file_, pointer_;
};

/// Parses a file; throws bad_input with line and column on a syntax error, with its place where a key stands twice in
/// an object, or where the file is missing or unreadable.
JsonNode readJsonFile(const std::filesystem::path& file);
/// The file that a node names, relative to the folder of the file it stands in; throws bad_input where there is none.
std::filesystem::path existingFile(const JsonNode& node, const std::filesystem::path& folder);
/// Parses a string; `name` stands for the file in errors.
JsonNode parseJson(const std::string& text, const std::string& name);
/// Sets the value at a JSON pointer (for --set /json/pointer=value); the value is parsed as JSON, else taken as a
/// string.
JsonNode withOverride(const JsonNode& root, const std::string& assignment);
/// Writes beside and renames; numbers keep all their digits.
void writeJsonFile(const std::filesystem::path& file, const Json& value);

/// The word among `known` nearest to `word` by edit distance, or "" where none is near.
std::string nearestWord(std::string_view word, const std::vector<std::string>& known);

}  // namespace srf
