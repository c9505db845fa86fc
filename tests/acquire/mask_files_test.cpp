#include "acquire/mask_files.h"

#include <gtest/gtest.h>

#include "base/error.h"
#include "base/image_io.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

/// A capture of two views, images/a.jpg and images/b.jpg, with masks that the tests put somewhere.
struct Folder {
  test::TemporaryFolder root;
  Capture capture;
  explicit Folder(const std::string& images = "images") {
    capture.folder = root.path();
    for (const char* name : {"a", "b"}) {
      CaptureView view;
      view.name = name;
      view.photos.push_back({root / (images.empty() ? "" : images) / (std::string(name) + ".jpg"), LightId{0}});
      capture.views.push_back(view);
    }
    Image8 black(4, 4, 3);
    for (const CaptureView& view : capture.views) {
      fs::create_directories(view.photos[0].file.parent_path());
      writePng(view.photos[0].file, black);
    }
  }
  void put(const std::string& file) const {
    fs::create_directories((root / file).parent_path());
    writePng(root / file, Image8(4, 4, 1));
  }
  std::string found(Reporter& reporter = Reporter::silent()) {
    findMaskFiles(capture, reporter);
    std::string out;
    for (const CaptureView& view : capture.views)
      out += (out.empty() ? "" : " ") +
             (view.mask_file.empty() ? "-" : view.mask_file.lexically_relative(root.path()).generic_string());
    return out;
  }
};

TEST(MaskFiles, EveryCommonNamingIsFound) {
  const std::pair<const char*, const char*> cases[] = {{"images/a.jpg.png", "images/b.jpg.png"},
                                                       {"images/a_mask.png", "images/b_mask.png"},
                                                       {"images/a-mask.PNG", "images/b-mask.PNG"},
                                                       {"images/a.mask.png", "images/b.mask.png"},
                                                       {"images/mask_a.png", "images/mask_b.png"},
                                                       {"images/a_matte.tif", "images/b_matte.tif"},
                                                       {"masks/a.png", "masks/b.png"},
                                                       {"masks/a.jpg.png", "masks/b.jpg.png"},
                                                       {"masks/a_mask.png", "masks/b_mask.png"},
                                                       {"mask/a.png", "mask/b.png"},
                                                       {"images/masks/a.png", "images/masks/b.png"},
                                                       {"silhouettes/a.bmp", "silhouettes/b.bmp"},
                                                       {"segmentation/a.png", "segmentation/b.png"},
                                                       {"obj_masks/a.png", "obj_masks/b.png"},
                                                       {"com_masks/a.png", "com_masks/b.png"}};
  for (const auto& [a, b] : cases) {
    Folder folder;
    folder.put(a);
    folder.put(b);
    Reporter reporter(ProgressMode::none, LogLevel::error);
    EXPECT_EQ(folder.found(reporter), std::string(a) + " " + b);
    EXPECT_EQ(reporter.counters()["masks.found"], 2u);
    EXPECT_TRUE(reporter.warnings().empty()) << a;
  }
}

TEST(MaskFiles, APhotographIsNoMaskAndOneFileForAllNeither) {
  Folder folder("masks");  // the photographs themselves lie in a folder of that name
  EXPECT_EQ(folder.found(), "- -");
  Folder one;
  one.put("images/mask.png");
  EXPECT_EQ(one.found(), "- -");
}

TEST(MaskFiles, TheObjectsMasksGoBeforeThoseWithItsStandAndThatIsSaid) {
  Folder folder;
  for (const char* file : {"com_masks/a.png", "com_masks/b.png", "obj_masks/a.png", "obj_masks/b.png"})
    folder.put(file);
  Reporter reporter(ProgressMode::none, LogLevel::error);
  EXPECT_EQ(folder.found(reporter), "obj_masks/a.png obj_masks/b.png");
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("com_masks"), std::string::npos);
}

TEST(MaskFiles, ViewsWithoutOneAreCountedAndNamedMasksAreKept) {
  Folder folder;
  folder.put("masks/b.png");
  Reporter reporter(ProgressMode::none, LogLevel::error);
  EXPECT_EQ(folder.found(reporter), "- masks/b.png");
  ASSERT_EQ(reporter.warnings().size(), 1u);
  EXPECT_NE(reporter.warnings()[0].find("1 of 2 views"), std::string::npos);

  Folder named;
  named.put("masks/a.png");
  named.put("masks/b.png");
  named.capture.views[0].mask_file = named.root / "own.png";
  EXPECT_EQ(named.found(), "own.png -");
}

TEST(MaskFiles, AViewOfManyPhotographsHasOneMask) {
  for (const bool inside : {false, true}) {
    Folder folder;
    for (CaptureView& view : folder.capture.views) {
      view.photos.clear();
      for (const char* light : {"l0.exr", "l1.exr"})
        view.photos.push_back({folder.root / ("images/view_" + view.name) / light, LightId{0}});
      folder.put(inside ? "images/view_" + view.name + "/mask.png" : "masks/view_" + view.name + ".png");
    }
    EXPECT_EQ(folder.found(),
              inside ? "images/view_a/mask.png images/view_b/mask.png" : "masks/view_a.png masks/view_b.png");
  }
}

TEST(MaskFiles, PolarityAndLabelsAreFoundAndSaid) {
  const test::TemporaryFolder folder;
  Image8 white(20, 20, 1);
  for (int y = 6; y < 14; ++y)
    for (int x = 6; x < 14; ++x) white.at(x, y) = 255;
  Image8 black = white, labels = white, colour(20, 20, 4, 255);
  for (auto& v : black.data()) v = 255 - v;
  for (auto& v : labels.data()) v = v ? 1 : 0;
  for (int y = 0; y < 20; ++y)
    for (int x = 0; x < 20; ++x)
      for (int c = 0; c < 3; ++c) colour.at(x, y, c) = white.at(x, y);  // alpha is 255 everywhere and says nothing
  const struct {
    const char* name;
    const Image8* image;
    const char* said;
  } cases[] = {{"white.png", &white, ""},
               {"black.png", &black, "inverted"},
               {"labels.png", &labels, "labels"},
               {"colour.png", &colour, ""}};
  for (const auto& [name, image, said] : cases) {
    writePng(folder / name, *image);
    std::string note;
    EXPECT_EQ(readMaskFile(folder / name, MaskPolarity::automatic, note).data(), white.data()) << name;
    EXPECT_EQ(note.empty(), std::string(said).empty()) << note;
    EXPECT_NE(note.find(said), std::string::npos) << note;
  }
  std::string note;
  EXPECT_EQ(readMaskFile(folder / "black.png", MaskPolarity::white_is_object, note).data(), black.data());
  EXPECT_EQ(readMaskFile(folder / "white.png", MaskPolarity::black_is_object, note).data(), black.data());
  EXPECT_TRUE(note.empty());
}

}  // namespace
}  // namespace srf
