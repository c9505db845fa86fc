#include "acquire/shoot.h"

#include <gtest/gtest.h>

#include <functional>

#include "base/error.h"
#include "base/files.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

TEST(Shoot, PathsSayViewLightAndExposureInNaturalOrder) {
  const test::TemporaryFolder folder;
  for (const char* name : {"v1/l10_a.jpg", "v1/l2_b.jpg", "v1/l2_a.jpg", "v0/l2_a.jpg", "notes.txt", "v1/other.jpg",
                           "v1/l3_a.txt", "v1/l3_mask.png", "v1/l4_a.mask.jpg"})
    writeTextFile(folder / name, "x");
  const auto photos = findPhotos(folder.path(), "v{view}/l{light}_{exposure}.*");
  ASSERT_EQ(photos.size(), 4u);
  std::string order;
  for (const ShootPhoto& p : photos) order += p.view + "," + p.light + "," + p.exposure + " ";
  EXPECT_EQ(order, "0,2,a 1,2,a 1,2,b 1,10,a ");
  EXPECT_EQ(photos[0].file, folder / "v0/l2_a.jpg");
}

TEST(Shoot, ADotInThePatternIsADotAndAFieldStaysInItsFolder) {
  const test::TemporaryFolder folder;
  for (const char* name : {"gray/gray.10.tga", "gray/gray.2.tga", "gray/gray.mask/2.tga", "gray/grayX7.tga"})
    writeTextFile(folder / name, "x");
  const auto photos = findPhotos(folder.path(), "gray/gray.{light}.tga");
  ASSERT_EQ(photos.size(), 2u);
  EXPECT_EQ(photos[0].light, "2");
  EXPECT_EQ(photos[1].light, "10");
}

TEST(Shoot, WhatCannotBeMeantIsRefusedBySentence) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "a/1.jpg", "x");
  writeTextFile(folder / "b/1.jpg", "x");
  const auto with = [&](const std::string& pattern) {
    return test::messageOf([&] { findPhotos(folder.path(), pattern); });
  };
  EXPECT_NE(with("{veiw}.jpg").find("unknown field {veiw}"), std::string::npos);
  EXPECT_NE(with("{view}/{view}.jpg").find("{view} twice"), std::string::npos);
  EXPECT_NE(with("{view").find("without its"), std::string::npos);
  EXPECT_NE(with("{view}.png").find("for example 'a/1.jpg'"), std::string::npos);
  EXPECT_NE(with("*/{light}.jpg").find("tells them apart"), std::string::npos);
  EXPECT_NE(test::messageOf([&] { findPhotos(folder / "c", "*"); }).find("is no folder"), std::string::npos);
}

TEST(Shoot, TablesAreReadByNameWithFractionsAndErrorsNameTheLine) {
  const test::TemporaryFolder folder;
  writeTextFile(folder / "t.csv", "exposure, seconds\n# bracket\na, 1/4\nb,32 # long\n\n");
  const auto rows = readNamedTable(folder / "t.csv", 1);
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows.at("a")[0], 0.25);
  EXPECT_EQ(rows.at("b")[0], 32);
  writeTextFile(folder / "u.csv", "a,1\nb,x\n");
  EXPECT_NE(test::messageOf([&] { readNamedTable(folder / "u.csv", 1); }).find("line 2: has 'x'"), std::string::npos);
  writeTextFile(folder / "w.csv", "a,1\na,2\n");
  EXPECT_NE(test::messageOf([&] { readNamedTable(folder / "w.csv", 1); }).find("second time"), std::string::npos);
  EXPECT_NE(test::messageOf([&] { readNamedTable(folder / "w.csv", 3); }).find("has 2 cells"), std::string::npos);
}

}  // namespace
}  // namespace srf
