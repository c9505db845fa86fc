#include "tests/support/test_support.h"

#include <stdlib.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <random>
#include <stdexcept>
#include <vector>

#include "base/error.h"

namespace srf::test {

TemporaryFolder::TemporaryFolder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "srf-test-XXXXXX").string();
  if (!::mkdtemp(pattern.data())) throw std::runtime_error("no temporary folder");
  path_ = pattern;
}
TemporaryFolder::~TemporaryFolder() {
  std::error_code code;
  std::filesystem::remove_all(path_, code);
}

std::string messageOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& e) {
    return e.what();
  }
  return "";
}

void scatterHeap(unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::unique_ptr<char[]>> blocks;
  for (int i = 0; i < 20000; ++i) blocks.push_back(std::make_unique<char[]>(16 * (1 + random() % 24)));
  std::shuffle(blocks.begin(), blocks.end(), random);
}

std::filesystem::path sourceFolder() {
  return SRF_SOURCE_DIR;
}

std::optional<std::filesystem::path> sharedData(const std::string& name) {
  const char* set = std::getenv("SRF_DATA");
  const std::filesystem::path root = set ? std::filesystem::path(set) : sourceFolder() / ".." / "shared" / "data";
  std::error_code code;
  const auto path = std::filesystem::weakly_canonical(root / name, code);
  if (code || !std::filesystem::exists(path)) return std::nullopt;
  return path;
}

}  // namespace srf::test
