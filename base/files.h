// Whole files, and outputs that appear only when whole.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace srf {

std::string readTextFile(const std::filesystem::path& file);
std::vector<std::byte> readBinaryFile(const std::filesystem::path& file);

/// A file under construction: written as `<file>.part-<pid>` in the same folder and renamed by commit(); removed by the
/// destructor otherwise. Errors name the file and the cause (no space, no permission, missing folder).
class PartialFile {
 public:
  /// Makes missing parent folders.
  explicit PartialFile(const std::filesystem::path& file);
  ~PartialFile();
  PartialFile(const PartialFile&) = delete;
  PartialFile& operator=(const PartialFile&) = delete;
  /// Where to write meanwhile (for libraries that open files themselves).
  const std::filesystem::path& path() const { return part_; }
  void write(const void* data, std::size_t bytes);
  /// Overwrites bytes written before (for headers whose content is known last).
  void writeAt(std::uint64_t offset, const void* data, std::size_t bytes);
  std::uint64_t size() const { return size_; }
  /// Flushes to the disk and renames into place.
  void commit();

 private:
  std::filesystem::path file_, part_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0;
  bool committed_ = false;
};

void writeTextFile(const std::filesystem::path& file, std::string_view text);
void writeBinaryFile(const std::filesystem::path& file, const void* data, std::size_t bytes);
/// Puts a file under another name, in place of what is there: a hard link where the disk allows one, else a copy. Makes
/// missing parent folders.
void linkOrCopy(const std::filesystem::path& from, const std::filesystem::path& to);
/// Of all files in the folder and below.
std::uint64_t bytesInFolder(const std::filesystem::path& folder);
/// 64-bit XXH3 of the bytes, as stored in manifests and headers.
std::uint64_t contentHash(const void* data, std::size_t bytes, std::uint64_t seed = 0);
/// As 16 hexadecimal digits.
std::string hexHash(std::uint64_t hash);

}  // namespace srf
