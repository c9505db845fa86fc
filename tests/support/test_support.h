// What tests of every folder share.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

namespace srf::test {

/// A fresh folder, removed at the end of the test.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// What the srf::Error says that `action` throws; "" where it throws none.
std::string messageOf(const std::function<void()>& action);
/// Leaves the heap so that things made in one order come to lie in another.
void scatterHeap(unsigned seed);
/// The checkout that the tests were built from.
std::filesystem::path sourceFolder();
/// `SRF_DATA`/name, or shared/data/name beside the checkout; nothing where it is absent: the test then says 'skipped'.
std::optional<std::filesystem::path> sharedData(const std::string& name);

}  // namespace srf::test

/// Ends the test as skipped where the shared data is absent.
#define SRF_REQUIRE_DATA(variable, name)                                  \
  const auto variable##_found = srf::test::sharedData(name);              \
  if (!variable##_found) GTEST_SKIP() << "skipped: no shared data " name; \
  const std::filesystem::path variable = *variable##_found
