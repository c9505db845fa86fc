#include "tests/support/npz.h"

#include <zlib.h>

#include <cstring>
#include <stdexcept>

#include "base/files.h"

namespace srf::test {
namespace {

template <class T>
T get(const std::vector<std::byte>& bytes, std::size_t at) {
  T value;
  if (at + sizeof value > bytes.size()) throw std::runtime_error("npz: truncated");
  std::memcpy(&value, bytes.data() + at, sizeof value);
  return value;
}

std::vector<char> inflateRaw(const std::byte* from, std::size_t packed, std::size_t size) {
  std::vector<char> out(size);
  z_stream stream{};
  inflateInit2(&stream, -MAX_WBITS);
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<std::byte*>(from));
  stream.avail_in = static_cast<uInt>(packed);
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(size);
  const int code = inflate(&stream, Z_FINISH);
  inflateEnd(&stream);
  if (code != Z_STREAM_END) throw std::runtime_error("npz: damaged");
  return out;
}

}  // namespace

std::map<std::string, std::vector<float>> readNpz(const std::filesystem::path& file) {
  const std::vector<std::byte> bytes = readBinaryFile(file);
  std::map<std::string, std::vector<float>> arrays;
  std::size_t end = bytes.size() - 22;  // the end-of-directory record; numpy writes no comment behind it
  if (get<std::uint32_t>(bytes, end) != 0x06054b50) throw std::runtime_error("npz: no directory");
  std::size_t at = get<std::uint32_t>(bytes, end + 16);
  for (int i = get<std::uint16_t>(bytes, end + 10); i > 0; --i) {
    const auto packed = get<std::uint32_t>(bytes, at + 20), size = get<std::uint32_t>(bytes, at + 24);
    const auto name_length = get<std::uint16_t>(bytes, at + 28), extra = get<std::uint16_t>(bytes, at + 30);
    const auto comment = get<std::uint16_t>(bytes, at + 32);
    const auto local = get<std::uint32_t>(bytes, at + 42);
    const std::string name(reinterpret_cast<const char*>(bytes.data()) + at + 46, name_length);
    at += 46u + name_length + extra + comment;
    const std::size_t data =
        local + 30u + get<std::uint16_t>(bytes, local + 26) + get<std::uint16_t>(bytes, local + 28);
    const std::vector<char> npy = inflateRaw(bytes.data() + data, packed, size);
    const std::size_t header = 10u + static_cast<unsigned char>(npy[8]) + 256u * static_cast<unsigned char>(npy[9]);
    const std::string description(npy.data() + 10, header - 10);
    std::vector<float>& values = arrays[name.substr(0, name.rfind(".npy"))];
    if (description.find("'|b1'") != std::string::npos) {
      values.assign(npy.begin() + static_cast<std::ptrdiff_t>(header), npy.end());
    } else if (description.find("'<f4'") != std::string::npos) {
      values.resize((npy.size() - header) / 4);
      std::memcpy(values.data(), npy.data() + header, values.size() * 4);
    } else {
      throw std::runtime_error("npz: unexpected type in " + name);
    }
  }
  return arrays;
}

}  // namespace srf::test
