#include "base/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <system_error>

#define XXH_INLINE_ALL
#include <xxhash.h>

#include "base/error.h"

namespace srf {
namespace {

Error systemError(const std::filesystem::path& file, const std::string& action, int code) {
  const std::string text = "could not " + action + ": " + std::strerror(code);
  if (code == ENOSPC || code == EDQUOT || code == EFBIG)
    return {ErrorKind::out_of_budget, text + "; make room or choose another place", file.string()};
  if (code == EACCES || code == EPERM || code == EROFS)
    return {ErrorKind::failed, text + "; choose a place where you may write", file.string()};
  return {ErrorKind::failed, text, file.string()};
}

void writeAll(int descriptor, const std::filesystem::path& file, const void* data, std::size_t bytes,
              std::int64_t offset) {
  const char* from = static_cast<const char*>(data);
  while (bytes > 0) {
    const ssize_t n = offset < 0 ? ::write(descriptor, from, bytes) : ::pwrite(descriptor, from, bytes, offset);
    if (n < 0) {
      if (errno == EINTR) continue;
      throw systemError(file, "write", errno);
    }
    from += n;
    bytes -= static_cast<std::size_t>(n);
    if (offset >= 0) offset += n;
  }
}

template <class Buffer>
Buffer readWhole(const std::filesystem::path& file) {
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) {
    const int code = errno;
    throw badInput(file.string(), std::string("could not be opened: ") + std::strerror(code) +
                                      (code == ENOENT ? "; check the path" : ""));
  }
  struct stat info {};
  if (::fstat(descriptor, &info) != 0 || S_ISDIR(info.st_mode)) {
    ::close(descriptor);
    throw badInput(file.string(), "is a folder, expected a file");
  }
  Buffer buffer;
  constexpr std::size_t kChunk = std::size_t{1} << 20;
  std::size_t used = 0;
  for (;;) {
    const std::size_t want = used < static_cast<std::size_t>(info.st_size) ? info.st_size - used + 1 : kChunk;
    buffer.resize(used + want);
    const ssize_t n = ::read(descriptor, buffer.data() + used, want);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      const int code = errno;
      ::close(descriptor);
      throw badInput(file.string(), std::string("could not be read: ") + std::strerror(code));
    }
    used += static_cast<std::size_t>(n);
    if (n == 0) break;
  }
  ::close(descriptor);
  buffer.resize(used);
  return buffer;
}

}  // namespace

std::string readTextFile(const std::filesystem::path& file) {
  return readWhole<std::string>(file);
}
std::vector<std::byte> readBinaryFile(const std::filesystem::path& file) {
  return readWhole<std::vector<std::byte>>(file);
}

PartialFile::PartialFile(const std::filesystem::path& file) : file_(file), part_(file) {
  part_ += ".part-" + std::to_string(::getpid());
  if (file.has_parent_path()) {
    std::error_code code;
    std::filesystem::create_directories(file.parent_path(), code);
    if (code) throw systemError(file.parent_path(), "make the folder", code.value());
  }
  descriptor_ = ::open(part_.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (descriptor_ < 0) throw systemError(file_, "write", errno);
}

PartialFile::~PartialFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!committed_) ::unlink(part_.c_str());
}

void PartialFile::write(const void* data, std::size_t bytes) {
  writeAll(descriptor_, file_, data, bytes, -1);
  size_ += bytes;
}

void PartialFile::writeAt(std::uint64_t offset, const void* data, std::size_t bytes) {
  writeAll(descriptor_, file_, data, bytes, static_cast<std::int64_t>(offset));
}

void PartialFile::commit() {
  // A library may have replaced the file under its name, so the flush goes by name.
  const int again = ::open(part_.c_str(), O_RDONLY | O_CLOEXEC);
  if (again < 0 || ::fsync(again) != 0) {
    const int code = errno;
    if (again >= 0) ::close(again);
    throw systemError(file_, "flush", code);
  }
  ::close(again);
  const int closed = ::close(descriptor_);
  descriptor_ = -1;
  if (closed != 0) throw systemError(file_, "close", errno);
  if (::rename(part_.c_str(), file_.c_str()) != 0) throw systemError(file_, "rename into place", errno);
  committed_ = true;
}

void writeBinaryFile(const std::filesystem::path& file, const void* data, std::size_t bytes) {
  PartialFile part(file);
  part.write(data, bytes);
  part.commit();
}

void writeTextFile(const std::filesystem::path& file, std::string_view text) {
  writeBinaryFile(file, text.data(), text.size());
}

void linkOrCopy(const std::filesystem::path& from, const std::filesystem::path& to) {
  namespace fs = std::filesystem;
  std::error_code code;
  if (fs::equivalent(from, to, code)) return;
  fs::create_directories(to.parent_path(), code);
  fs::remove(to, code);
  fs::create_hard_link(from, to, code);
  if (!code) return;
  fs::copy_file(from, to, fs::copy_options::overwrite_existing, code);
  if (code)
    throw Error(ErrorKind::failed, "could not be copied to " + to.string() + ": " + code.message(), from.string());
}

std::uint64_t bytesInFolder(const std::filesystem::path& folder) {
  std::uint64_t bytes = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder))
    if (entry.is_regular_file()) bytes += entry.file_size();
  return bytes;
}

std::uint64_t contentHash(const void* data, std::size_t bytes, std::uint64_t seed) {
  return XXH3_64bits_withSeed(data, bytes, seed);
}

std::string hexHash(std::uint64_t hash) {
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

}  // namespace srf
