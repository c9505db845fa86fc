#include <OpenEXR/ImfArray.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfMultiPartOutputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfOutputPart.h>
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfRgbaFile.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

/// A DNG file of one even patch: 16-bit Bayer RGGB, white level 60000, as-shot neutral (0.5, 1, 0.8).
class TinyDng {
 public:
  int width = 96, height = 64, orientation = 1;
  double r = 0, g = 0, b = 0;  ///< sensor values as a share of the white level

  void write(const std::filesystem::path& file) const {
    std::vector<unsigned char> data;
    std::vector<std::array<unsigned char, 12>> entries;
    constexpr int kEntries = 25;
    const std::size_t data_start = 8 + 2 + 12 * kEntries + 4;
    const auto put = [&](std::vector<unsigned char>& to, std::uint64_t value, int bytes) {
      for (int i = 0; i < bytes; ++i) to.push_back(static_cast<unsigned char>(value >> (8 * i)));
    };
    const auto entry = [&](int tag, int type, std::size_t count, const std::vector<unsigned char>& value) {
      std::vector<unsigned char> e;
      put(e, tag, 2), put(e, type, 2), put(e, count, 4);
      if (value.size() <= 4) {
        e.insert(e.end(), value.begin(), value.end());
        e.resize(12);
      } else {
        put(e, data_start + data.size(), 4);
        data.insert(data.end(), value.begin(), value.end());
        if (data.size() % 2) data.push_back(0);
      }
      std::array<unsigned char, 12> out{};
      std::copy(e.begin(), e.end(), out.begin());
      entries.push_back(out);
    };
    const auto numbers = [&](int bytes, std::initializer_list<std::uint64_t> values) {
      std::vector<unsigned char> out;
      for (const std::uint64_t v : values) put(out, v, bytes);
      return out;
    };
    const auto text = [](const std::string& s) {
      return std::vector<unsigned char>(s.c_str(), s.c_str() + s.size() + 1);
    };
    const std::size_t pixel_bytes = static_cast<std::size_t>(width) * height * 2;
    entry(254, 4, 1, numbers(4, {0}));
    entry(256, 4, 1, numbers(4, {static_cast<std::uint64_t>(width)}));
    entry(257, 4, 1, numbers(4, {static_cast<std::uint64_t>(height)}));
    entry(258, 3, 1, numbers(2, {16}));
    entry(259, 3, 1, numbers(2, {1}));
    entry(262, 3, 1, numbers(2, {32803}));
    entry(271, 2, 6, text("Bench"));
    entry(272, 2, 6, text("Bayer"));
    entry(273, 4, 1, numbers(4, {0}));  // filled below
    entry(274, 3, 1, numbers(2, {static_cast<std::uint64_t>(orientation)}));
    entry(277, 3, 1, numbers(2, {1}));
    entry(278, 4, 1, numbers(4, {static_cast<std::uint64_t>(height)}));
    entry(279, 4, 1, numbers(4, {pixel_bytes}));
    entry(284, 3, 1, numbers(2, {1}));
    entry(33421, 3, 2, numbers(2, {2, 2}));
    entry(33422, 1, 4, numbers(1, {0, 1, 1, 2}));
    entry(33434, 5, 1, numbers(4, {1, 8}));
    entry(50706, 1, 4, numbers(1, {1, 4, 0, 0}));
    entry(50707, 1, 4, numbers(1, {1, 1, 0, 0}));
    entry(50708, 2, 12, text("Bench Bayer"));
    entry(50714, 3, 1, numbers(2, {0}));
    entry(50717, 4, 1, numbers(4, {60000}));
    // Linear Rec.709 from XYZ (D65): the sensor sees Rec.709.
    std::vector<unsigned char> matrix;
    for (const double m : {3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570}) {
      put(matrix, static_cast<std::uint32_t>(static_cast<std::int32_t>(std::lround(m * 10000))), 4);
      put(matrix, 10000, 4);
    }
    entry(50721, 10, 9, matrix);
    entry(50728, 5, 3, numbers(4, {5, 10, 10, 10, 8, 10}));
    entry(50778, 3, 1, numbers(2, {21}));
    ASSERT_EQ(entries.size(), static_cast<std::size_t>(kEntries));
    std::vector<unsigned char> out{'I', 'I', 42, 0};
    put(out, 8, 4);
    put(out, kEntries, 2);
    for (auto& e : entries) {
      if (e[0] + 256 * e[1] == 273) {
        const std::size_t at = data_start + data.size();
        for (int i = 0; i < 4; ++i) e[8 + i] = static_cast<unsigned char>(at >> (8 * i));
      }
      out.insert(out.end(), e.begin(), e.end());
    }
    put(out, 0, 4);
    out.insert(out.end(), data.begin(), data.end());
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        // The upper left quarter is black, so that turning shows.
        const bool black = x < width / 2 && y < height / 2;
        const double v = black ? 0 : y % 2 == 0 ? (x % 2 == 0 ? r : g) : (x % 2 == 0 ? g : b);
        put(out, static_cast<std::uint64_t>(std::lround(std::min(1.0, v) * 60000)), 2);
      }
    writeBinaryFile(file, out.data(), out.size());
  }
};

TEST(Photograph, RawIsLinearWithAFixedWhiteBalance) {
  const test::TemporaryFolder folder;
  TinyDng dng;
  const auto at_level = [&](double level) {
    dng.r = 0.5 * level, dng.g = level, dng.b = 0.8 * level;
    dng.write(folder / "x.dng");
    return readPhotograph(folder / "x.dng");
  };
  const Photograph low = at_level(0.1), high = at_level(0.4);
  EXPECT_TRUE(low.is_raw);
  EXPECT_TRUE(low.is_linear);
  ASSERT_TRUE(low.white_balance);
  EXPECT_NEAR((*low.white_balance)[0], 2, 1e-3);
  EXPECT_NEAR((*low.white_balance)[2], 1.25, 1e-3);
  ASSERT_TRUE(low.seconds);
  EXPECT_NEAR(*low.seconds, 0.125, 1e-6);
  for (int c = 0; c < 3; ++c) {
    // Grey where the sensor saw its neutral; four times the light is four times the value.
    EXPECT_NEAR(low.pixels.at(80, 50, c), 0.1, 0.002) << c;
    EXPECT_NEAR(high.pixels.at(80, 50, c) / low.pixels.at(80, 50, c), 4, 0.01) << c;
  }
  // Another balance asked for holds, whatever the file says.
  const Photograph fixed = readPhotograph(folder / "x.dng", {{1, 1, 1, 1}});
  EXPECT_EQ((*fixed.white_balance)[0], 1);
  EXPECT_NEAR(fixed.pixels.at(80, 50, 0) / fixed.pixels.at(80, 50, 1), 0.5, 0.02);
  EXPECT_EQ(fixed.pixels.width(), 96);
}

TEST(Photograph, RawIsTurnedUprightOnce) {
  const test::TemporaryFolder folder;
  TinyDng dng;
  dng.r = 0.2, dng.g = 0.4, dng.b = 0.32;
  dng.orientation = 6;  // the camera stood on its side: the stored top is the right
  dng.write(folder / "x.dng");
  const ImageF turned = readPhotograph(folder / "x.dng").pixels;
  ASSERT_EQ(turned.width(), 64);
  ASSERT_EQ(turned.height(), 96);
  EXPECT_LT(turned.at(50, 20, 1), 0.01f) << "the black quarter is at the upper right now";
  EXPECT_GT(turned.at(10, 20, 1), 0.3f);
  EXPECT_GT(turned.at(50, 80, 1), 0.3f);
}

TEST(Photograph, OrientationsAreThoseOfExif) {
  // Stored 3 x 2: 1 2 3 / 4 5 6.
  ImageF stored(3, 2, 1);
  for (int i = 0; i < 6; ++i) stored.data()[i] = static_cast<float>(i + 1);
  const std::vector<std::vector<float>> upright{{1, 2, 3, 4, 5, 6}, {3, 2, 1, 6, 5, 4}, {6, 5, 4, 3, 2, 1},
                                                {4, 5, 6, 1, 2, 3}, {1, 4, 2, 5, 3, 6}, {4, 1, 5, 2, 6, 3},
                                                {6, 3, 5, 2, 4, 1}, {3, 6, 2, 5, 1, 4}};
  for (int o = 1; o <= 8; ++o) {
    const ImageF out = uprightImage(stored, o);
    EXPECT_EQ(out.width(), o >= 5 ? 2 : 3) << o;
    EXPECT_EQ(out.data(), upright[o - 1]) << o;
  }
}

TEST(Photograph, MaskedPixelsStayAndOverflowsAreClampedAndCounted) {
  const test::TemporaryFolder folder;
  ImageF image(4, 2, 3, 0.5f);
  image.at(0, 0, 0) = NAN;
  image.at(1, 0, 1) = 1e6f;
  image.at(2, 0, 2) = INFINITY;
  image.at(3, 0, 0) = -1e9f;
  EXPECT_EQ(writeMaskedExr(folder / "x.exr", image), 3u);
  const ImageF back = readImage(folder / "x.exr").pixels;
  EXPECT_TRUE(std::isnan(back.at(0, 0, 0)));
  EXPECT_EQ(back.at(1, 0, 1), 65504.f);
  EXPECT_EQ(back.at(2, 0, 2), 65504.f);
  EXPECT_EQ(back.at(3, 0, 0), -65504.f);
  for (const float v : back.data()) EXPECT_FALSE(std::isinf(v));
  EXPECT_EQ(writeExr(folder / "y.exr", image), 4u) << "a frame holds no NaN";
}

TEST(Photograph, AnExrIsItsDisplayWindow) {
  const test::TemporaryFolder folder;
  const auto write = [&](const char* name, const Imath::Box2i& display, const Imath::Box2i& data) {
    Imf::Array2D<Imf::Rgba> pixels(data.size().y + 1, data.size().x + 1);
    for (int y = 0; y <= data.size().y; ++y)
      for (int x = 0; x <= data.size().x; ++x)
        pixels[y][x] = Imf::Rgba(static_cast<float>(data.min.x + x), static_cast<float>(data.min.y + y), 1);
    Imf::RgbaOutputFile file((folder / name).c_str(), display, data, Imf::WRITE_RGB);
    file.setFrameBuffer(&pixels[0][0] - data.min.x - static_cast<std::ptrdiff_t>(data.min.y) * (data.size().x + 1), 1,
                        data.size().x + 1);
    file.writePixels(data.size().y + 1);
    return folder / name;
  };
  const auto cropped = write("crop.exr", {{0, 0}, {7, 5}}, {{2, 3}, {4, 4}});
  const auto wider = write("wide.exr", {{10, 20}, {17, 25}}, {{8, 19}, {16, 30}});
  for (const auto& file : {cropped, wider}) {
    EXPECT_EQ(readImageSize(file).width, 8);
    EXPECT_EQ(readImageSize(file).height, 6);
    ASSERT_EQ(readImage(file).pixels.width(), 8);
    EXPECT_EQ(readPhotograph(file).pixels.height(), 6);
  }
  const ImageF crop = readImage(cropped).pixels, wide = readImage(wider).pixels;
  for (int y = 0; y < 6; ++y)
    for (int x = 0; x < 8; ++x) {
      const bool held = x >= 2 && x <= 4 && y >= 3 && y <= 4;
      EXPECT_EQ(crop.at(x, y, 0), held ? static_cast<float>(x) : 0.f);
      EXPECT_EQ(crop.at(x, y, 2), held ? 1.f : 0.f);
      EXPECT_EQ(wide.at(x, y, 0), x < 7 ? static_cast<float>(10 + x) : 0.f);
      EXPECT_EQ(wide.at(x, y, 1), x < 7 ? static_cast<float>(20 + y) : 0.f);
    }
}

TEST(Photograph, OfSeveralLayersTheUnnamedOneIsThePicture) {
  const test::TemporaryFolder folder;
  const float values[] = {0.1f, 0.2f, 0.3f, 0.4f, 0.5f, 0.6f};
  const auto write = [&](const std::vector<const char*>& names) {
    std::vector<ExrChannel> channels;
    for (std::size_t i = 0; i < names.size(); ++i) channels.push_back({names[i], &values[i], 1, true});
    writeExr(folder / "x.exr", 1, 1, channels);
    return folder / "x.exr";
  };
  EXPECT_EQ(readImage(write({"AO.R", "AO.G", "AO.B", "R", "G", "B"})).pixels.data(),
            (std::vector<float>{0.4f, 0.5f, 0.6f}));
  EXPECT_EQ(readImage(write({"View.R", "View.G", "View.B"})).pixels.data(), (std::vector<float>{0.1f, 0.2f, 0.3f}));
  try {
    readImage(write({"AO.R", "AO.G", "AO.B", "Combined.R", "Combined.G", "Combined.B"}));
    FAIL() << "which one?";
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("AO, Combined"), std::string::npos) << e.what();
  }
}

TEST(Photograph, OfSeveralPartsTheOneWithColoursIsThePicture) {
  const test::TemporaryFolder folder;
  using Names = std::vector<std::string>;
  const auto write = [&](const std::vector<Names>& parts) {
    std::vector<Imf::Header> headers;
    for (std::size_t p = 0; p < parts.size(); ++p) {
      headers.emplace_back(1, 1);
      headers.back().setName("part" + std::to_string(p));
      headers.back().setType(Imf::SCANLINEIMAGE);
      for (const std::string& name : parts[p]) headers.back().channels().insert(name, Imf::Channel(Imf::FLOAT));
    }
    Imf::MultiPartOutputFile file((folder / "parts.exr").c_str(), headers.data(), static_cast<int>(headers.size()));
    for (std::size_t p = 0; p < parts.size(); ++p) {
      std::vector<float> values;
      for (std::size_t c = 0; c < parts[p].size(); ++c) values.push_back(static_cast<float>(10 * p + c));
      Imf::FrameBuffer buffer;
      for (std::size_t c = 0; c < parts[p].size(); ++c)
        buffer.insert(parts[p][c], Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(&values[c]), 4, 4));
      Imf::OutputPart part(file, static_cast<int>(p));
      part.setFrameBuffer(buffer);
      part.writePixels(1);
    }
    return folder / "parts.exr";
  };
  const auto colour = write({{"Z"}, {"Y"}, {"B", "G", "R"}, {"B", "G", "R"}});
  EXPECT_EQ(readImage(colour).pixels.data(), (std::vector<float>{22, 21, 20}));
  EXPECT_EQ(readPhotograph(colour).pixels.data(), (std::vector<float>{22, 21, 20}));
  EXPECT_EQ(readImage(write({{"Z"}, {"Y"}})).pixels.data(), std::vector<float>{10});
  EXPECT_EQ(readImage(write({{"B", "G", "R"}, {"Y"}})).pixels.data(), (std::vector<float>{2, 1, 0}));
}

TEST(Photograph, ChannelsThatAreNoPictureAreRefused) {
  const test::TemporaryFolder folder;
  const float values[] = {0.1f, 0.2f};
  writeExr(folder / "rg.exr", 1, 1, {{"R", &values[0], 1, true}, {"G", &values[1], 1, true}});
  EXPECT_THROW(readImage(folder / "rg.exr"), Error);
  writeExr(folder / "ya.exr", 1, 1, {{"Y", &values[0], 1, true}, {"A", &values[1], 1, true}});
  EXPECT_EQ(readImage(folder / "ya.exr").pixels.data(), (std::vector<float>{0.1f, 0.1f, 0.1f, 0.2f}));
  Imf::Header header(1, 1);
  const std::uint32_t one = 1;
  Imf::FrameBuffer buffer;
  for (const char* name : {"R", "G", "B"}) {
    header.channels().insert(name, Imf::Channel(Imf::UINT));
    buffer.insert(name, Imf::Slice(Imf::UINT, reinterpret_cast<char*>(const_cast<std::uint32_t*>(&one)), 4, 4));
  }
  {
    Imf::OutputFile file((folder / "whole.exr").c_str(), header);
    file.setFrameBuffer(buffer);
    file.writePixels(1);
  }
  EXPECT_THROW(readImage(folder / "whole.exr"), Error);
}

TEST(Photograph, IntegerFilesComeAsTheyAreEncoded) {
  const test::TemporaryFolder folder;
  Image8 image(2, 1, 3, 128);
  writePng(folder / "x.png", image);
  const Photograph photo = readPhotograph(folder / "x.png");
  EXPECT_FALSE(photo.is_linear);
  EXPECT_EQ(photo.bits, 8);
  EXPECT_NEAR(photo.pixels.at(0, 0, 0), 128 / 255.0, 1e-6);
  EXPECT_FALSE(photo.seconds);
  writeTextFile(folder / "broken.dng", "II*");
  EXPECT_THROW(readPhotograph(folder / "broken.dng"), Error);
}

}  // namespace
}  // namespace srf
