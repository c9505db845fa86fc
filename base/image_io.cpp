#include "base/image_io.h"

#include <Imath/half.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfFramesPerSecond.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/files.h"

namespace srf {
namespace {

constexpr float kLargestHalf = 65504.f;

// What an EXR shows is its display window; the file may hold less of it (the rest is black) or more.
bool isCropped(const OIIO::ImageInput& input) {
  const OIIO::ImageSpec& s = input.spec();
  return std::string_view(input.format_name()) == "openexr" &&
         (s.x != s.full_x || s.y != s.full_y || s.width != s.full_width || s.height != s.full_height);
}

ImageSize shownSize(const OIIO::ImageInput& input) {
  const OIIO::ImageSpec& s = input.spec();
  return isCropped(input) ? ImageSize{s.full_width, s.full_height} : ImageSize{s.width, s.height};
}

// Of an EXR of several parts the first that has colours, else the first that is grey, else the first: renderers put
// depth or identifiers into parts of their own, before the picture too.
void seekPicture(OIIO::ImageInput& input) {
  if (std::string_view(input.format_name()) != "openexr") return;
  int grey = 0;
  for (int part = 0; input.seek_subimage(part, 0); ++part) {
    const OIIO::ImageSpec& spec = input.spec();
    if (spec.channelindex("R") >= 0 && spec.channelindex("G") >= 0 && spec.channelindex("B") >= 0) return;
    if (grey == 0 && spec.channelindex("Y") >= 0) grey = part;
  }
  input.geterror();  // there is no further part
  input.seek_subimage(grey, 0);
}

std::unique_ptr<OIIO::ImageInput> openInput(const std::filesystem::path& file,
                                            OIIO::ImageSpec as_stored = OIIO::ImageSpec()) {
  if (!std::filesystem::exists(file)) throw badInput(file.string(), "does not exist; check the path");
  // Alpha is associated in linear light by readImage; OpenImageIO would do it on the encoded values.
  as_stored.attribute("oiio:UnassociatedAlpha", 1);
  auto input = OIIO::ImageInput::open(file.string(), &as_stored);
  if (!input)
    throw badInput(file.string(), "could not be read as an image (" + OIIO::geterror() +
                                      "); expected EXR, HDR, PNG, TIFF or JPEG that is whole");
  seekPicture(*input);
  const OIIO::ImageSpec& spec = input->spec();
  for (const auto& [width, height] : {ImageSize{spec.width, spec.height}, shownSize(*input)})
    if (width < 1 || height < 1 || width > 65536 || height > 65536 || spec.depth > 1)
      throw badInput(file.string(), "has a size of " + std::to_string(width) + " x " + std::to_string(height) +
                                        ", expected 1 to 65536 each way");
  return input;
}

// The display window of what was stored.
ImageF shown(ImageF stored, const OIIO::ImageInput& input) {
  if (!isCropped(input)) return stored;
  const OIIO::ImageSpec& s = input.spec();
  ImageF out(s.full_width, s.full_height, stored.channels());
  const int first = std::max(s.x, s.full_x), end = std::min(s.x + s.width, s.full_x + s.full_width);
  for (int y = std::max(s.y, s.full_y); y < std::min(s.y + s.height, s.full_y + s.full_height) && first < end; ++y)
    std::copy_n(&stored.at(first - s.x, y - s.y), static_cast<std::ptrdiff_t>(end - first) * stored.channels(),
                &out.at(first - s.full_x, y - s.full_y));
  return out;
}

// Without plain R G B, red of two layers leaves open which of them is the picture.
void refuseSeveralLayers(const std::filesystem::path& file, const OIIO::ImageSpec& spec) {
  std::string layers;
  int count = 0;
  for (int c = 0; c < spec.nchannels; ++c) {
    const std::string name = spec.channel_name(c);
    if (name.ends_with(".R")) layers += (count++ > 0 ? ", " : "") + name.substr(0, name.size() - 2);
  }
  if (count > 1)
    throw badInput(file.string(), "holds the layers " + layers +
                                      " and no channels R, G, B; expected one picture: save that layer alone");
}

// The file's channels that make grey, RGB or RGBA, in that order.
std::vector<int> colourChannels(const std::filesystem::path& file, const OIIO::ImageSpec& spec) {
  const auto find = [&](const char* name) {
    for (int c = 0; c < spec.nchannels; ++c)
      if (spec.channel_name(c) == name) return c;
    return -1;
  };
  const int r = find("R"), g = find("G"), b = find("B"), a = find("A"), y = find("Y");
  std::vector<int> order;
  if (r >= 0 && g >= 0 && b >= 0)
    order = {r, g, b};
  else if (y >= 0 && a >= 0)
    order = {y, y, y};
  else if (y >= 0)
    order = {y};
  else if (spec.nchannels >= 3)
    refuseSeveralLayers(file, spec), order = {0, 1, 2};
  else if (spec.nchannels == 2)
    throw badInput(file.string(), "holds the channels " + std::string(spec.channel_name(0)) + " and " +
                                      std::string(spec.channel_name(1)) +
                                      "; expected R, G, B, or Y for grey, with or without A");
  else
    order = {0};
  if (a >= 0 && order.size() == 3) order.push_back(a);
  for (const int c : order)
    if (spec.channelformat(c) == OIIO::TypeDesc::UINT)
      throw badInput(file.string(), "holds whole numbers of 32 bits in " + std::string(spec.channel_name(c)) +
                                        ", which have no scale; expected half or float, or integers of 8 or 16 bits");
  return order;
}

std::size_t clampToHalf(float& value) {
  if (std::isnan(value)) return value = 0.f, 1;
  if (value > kLargestHalf) return value = kLargestHalf, 1;
  if (value < -kLargestHalf) return value = -kLargestHalf, 1;
  return 0;
}

// The libraries tell the cause in words alone.
Error writeError(const std::filesystem::path& file, const std::string& text) {
  const bool full = text.find("No space") != std::string::npos || text.find("too large") != std::string::npos;
  return {full ? ErrorKind::out_of_budget : ErrorKind::failed,
          "could not be written: " + text + (full ? "; make room or choose another place" : ""), file.string()};
}

void writeWithOiio(const std::filesystem::path& file, const OIIO::ImageSpec& spec, const OIIO::TypeDesc& type,
                   const void* data) {
  // Encoded in memory: the library's own writer does not notice a full disk.
  OIIO::Filesystem::IOVecOutput encoded;
  auto output = OIIO::ImageOutput::create("png");
  if (!output || !output->set_ioproxy(&encoded) || !output->open("memory.png", spec) ||
      !output->write_image(type, data) || !output->close())
    throw writeError(file, output ? output->geterror() : OIIO::geterror());
  writeBinaryFile(file, encoded.buffer().data(), encoded.buffer().size());
}

}  // namespace

LoadedImage readImage(const std::filesystem::path& file, Transfer integer_transfer) {
  const auto input = openInput(file);
  const OIIO::ImageSpec spec = input->spec();
  const std::vector<int> order = colourChannels(file, spec);
  LoadedImage image;
  image.is_float = spec.format.is_floating_point();
  image.bits = static_cast<int>(spec.format.size() * 8);
  image.has_alpha = order.size() == 4;
  const int channels = static_cast<int>(order.size());
  image.pixels = ImageF(spec.width, spec.height, channels);
  const bool decode = !image.is_float && integer_transfer == Transfer::srgb;
  const bool straight = image.has_alpha && spec.get_int_attribute("oiio:UnassociatedAlpha") != 0;
  const auto readInto = [&](std::vector<float>& to, int first, int end) {
    if (!input->read_image(input->current_subimage(), 0, first, end, OIIO::TypeDesc::FLOAT, to.data()))
      throw badInput(file.string(), "ends early or is damaged (" + input->geterror() + "); copy it again");
  };
  bool in_order = true;
  for (int c = 0; c < channels; ++c) in_order = in_order && order[c] == order[0] + c;
  if (image.is_float && in_order && !straight) {  // as they stand in the file
    readInto(image.pixels.data(), order[0], order[0] + channels);
    image.pixels = shown(std::move(image.pixels), *input);
    return image;
  }
  std::vector<float> all(static_cast<std::size_t>(spec.width) * spec.height * spec.nchannels);
  readInto(all, 0, spec.nchannels);
  float* to = image.pixels.data().data();
  for (std::size_t p = 0; p < static_cast<std::size_t>(spec.width) * spec.height; ++p)
    for (int c = 0; c < channels; ++c) {
      const float value = all[p * spec.nchannels + order[c]];
      *to++ = decode && c < 3 ? linearFromSrgb(value) : value;
      if (straight && c == 3)
        for (int k = 2; k <= 4; ++k) to[-k] *= value;
    }
  image.pixels = shown(std::move(image.pixels), *input);
  return image;
}

ImageF uprightImage(const ImageF& image, int orientation) {
  if (orientation < 2 || orientation > 8) return image;
  const int w = image.width(), h = image.height();
  const bool turned = orientation >= 5;
  ImageF out(turned ? h : w, turned ? w : h, image.channels());
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      // Where the upright pixel is stored. 2 mirrored; 3 upside down; 4 both; 5 to 8 with rows and columns exchanged.
      int u = turned ? y : x, v = turned ? x : y;
      if (orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8) u = w - 1 - u;
      if (orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7) v = h - 1 - v;
      std::copy_n(&image.at(u, v), image.channels(), &out.at(x, y));
    }
  return out;
}

Photograph readPhotograph(const std::filesystem::path& file, const std::optional<std::array<float, 4>>& white_balance) {
  auto input = openInput(file);
  Photograph photo;
  photo.is_raw = std::string(input->format_name()) == "raw";
  if (photo.is_raw) {
    std::array<float, 4> multipliers{1, 1, 1, 1};
    if (white_balance) {
      multipliers = *white_balance;
    } else if (const auto* own = input->spec().find_attribute("raw:cam_mul"); own && own->type().numelements() == 4) {
      for (int c = 0; c < 4; ++c) multipliers[c] = own->get_float_indexed(c);
      if (!(multipliers[3] > 0)) multipliers[3] = multipliers[1];
      if (!(multipliers[0] > 0 && multipliers[1] > 0 && multipliers[2] > 0)) multipliers = {1, 1, 1, 1};
      for (int c : {0, 2, 3, 1}) multipliers[c] /= multipliers[1];
    }
    photo.white_balance = multipliers;
    OIIO::ImageSpec config;
    config.attribute("raw:ColorSpace", "linear");
    config.attribute("raw:auto_bright", 0);
    config.attribute("raw:adjust_maximum_thr", 0.f);
    config.attribute("raw:use_camera_wb", 0);
    config.attribute("raw:user_mul", OIIO::TypeDesc(OIIO::TypeDesc::FLOAT, 4), multipliers.data());
    input = openInput(file, config);
  }
  const OIIO::ImageSpec spec = input->spec();
  std::vector<int> order = colourChannels(file, spec);
  if (order.size() == 4) order.pop_back();
  std::vector<float> all(static_cast<std::size_t>(spec.width) * spec.height * spec.nchannels);
  if (!input->read_image(input->current_subimage(), 0, 0, spec.nchannels, OIIO::TypeDesc::FLOAT, all.data()))
    throw badInput(file.string(), "ends early or is damaged (" + input->geterror() + "); copy it again");
  photo.bits = static_cast<int>(spec.format.size() * 8);
  photo.is_linear = photo.is_raw || spec.format.is_floating_point();
  ImageF stored(spec.width, spec.height, static_cast<int>(order.size()));
  float* to = stored.data().data();
  for (std::size_t p = 0; p < static_cast<std::size_t>(spec.width) * spec.height; ++p)
    for (const int c : order) *to++ = all[p * spec.nchannels + c];
  // RAW comes upright already.
  photo.pixels =
      uprightImage(shown(std::move(stored), *input), photo.is_raw ? 1 : spec.get_int_attribute("Orientation", 1));
  const auto positive = [&](const char* name) -> std::optional<double> {
    const double value = spec.get_float_attribute(name, 0);
    return value > 0 && std::isfinite(value) ? std::optional<double>(value) : std::nullopt;
  };
  photo.seconds = positive("ExposureTime");
  photo.f_number = positive("FNumber");
  photo.iso = positive("Exif:PhotographicSensitivity");
  if (!photo.iso) photo.iso = positive("Exif:ISOSpeedRatings");
  return photo;
}

ImageSize readImageSize(const std::filesystem::path& file) {
  const auto input = openInput(file);
  return shownSize(*input);
}

Image8 readMask(const std::filesystem::path& file) {
  const LoadedImage image = readImage(file, Transfer::linear);
  const ImageF& p = image.pixels;
  Image8 mask(p.width(), p.height(), 1);
  for (int y = 0; y < p.height(); ++y)
    for (int x = 0; x < p.width(); ++x) {
      float value = p.at(x, y, 0);
      if (image.has_alpha)
        value = p.at(x, y, 3);
      else if (p.channels() == 3)
        value = (p.at(x, y, 0) + p.at(x, y, 1) + p.at(x, y, 2)) / 3;
      mask.at(x, y) =
          static_cast<std::uint8_t>(std::lround(255 * std::clamp(std::isnan(value) ? 0.f : value, 0.f, 1.f)));
    }
  return mask;
}

std::size_t writeExr(const std::filesystem::path& file, int width, int height, const std::vector<ExrChannel>& channels,
                     const Attributes& attributes) {
  std::size_t clamped = 0;
  Imf::Header header(width, height);
  header.compression() = Imf::ZIP_COMPRESSION;
  for (const auto& [key, value] : attributes)
    if (key == "framesPerSecond")  // a standard attribute of its own type, which players read
      Imf::addFramesPerSecond(header, Imf::guessExactFps(std::stod(value)));
    else
      header.insert(key, Imf::StringAttribute(value));
  Imf::FrameBuffer buffer;
  const std::size_t pixels = static_cast<std::size_t>(width) * height;
  std::vector<std::vector<half>> halves(channels.size());
  std::vector<std::vector<float>> floats(channels.size());
  for (std::size_t c = 0; c < channels.size(); ++c) {
    const ExrChannel& channel = channels[c];
    header.channels().insert(channel.name, Imf::Channel(channel.full_float ? Imf::FLOAT : Imf::HALF));
    if (channel.full_float) {
      floats[c].resize(pixels);
      for (std::size_t i = 0; i < pixels; ++i) {
        float v = channel.data[static_cast<std::ptrdiff_t>(i) * channel.stride];
        if (!std::isfinite(v)) v = 0, ++clamped;
        floats[c][i] = v;
      }
      buffer.insert(channel.name, Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(floats[c].data()), sizeof(float),
                                             sizeof(float) * width));
    } else {
      halves[c].resize(pixels);
      for (std::size_t i = 0; i < pixels; ++i) {
        float v = channel.data[static_cast<std::ptrdiff_t>(i) * channel.stride];
        if (!(channel.masked && std::isnan(v))) clamped += clampToHalf(v);
        halves[c][i] = half(v);
      }
      buffer.insert(channel.name, Imf::Slice(Imf::HALF, reinterpret_cast<char*>(halves[c].data()), sizeof(half),
                                             sizeof(half) * width));
    }
  }
  PartialFile part(file);
  try {
    Imf::OutputFile output(part.path().c_str(), header, 0);
    output.setFrameBuffer(buffer);
    output.writePixels(height);
  } catch (const std::exception& e) {
    throw writeError(file, e.what());
  }
  part.commit();
  return clamped;
}

namespace {
std::size_t writeHalf(const std::filesystem::path& file, const ImageF& image, const Attributes& attributes,
                      bool masked) {
  static constexpr const char* kNames[] = {"R", "G", "B", "A"};
  std::vector<ExrChannel> channels;
  for (int c = 0; c < image.channels(); ++c)
    channels.push_back(
        {image.channels() == 1 ? "Y" : kNames[c], image.data().data() + c, image.channels(), false, masked});
  return writeExr(file, image.width(), image.height(), channels, attributes);
}
}  // namespace

std::size_t writeExr(const std::filesystem::path& file, const ImageF& image, const Attributes& attributes) {
  return writeHalf(file, image, attributes, false);
}

std::size_t writeMaskedExr(const std::filesystem::path& file, const ImageF& image, const Attributes& attributes) {
  return writeHalf(file, image, attributes, true);
}

void writePng(const std::filesystem::path& file, const Image8& image) {
  writeWithOiio(file, OIIO::ImageSpec(image.width(), image.height(), image.channels(), OIIO::TypeDesc::UINT8),
                OIIO::TypeDesc::UINT8, image.data().data());
}

void writePng16(const std::filesystem::path& file, const ImageF& image) {
  writeWithOiio(file, OIIO::ImageSpec(image.width(), image.height(), image.channels(), OIIO::TypeDesc::UINT16),
                OIIO::TypeDesc::FLOAT, image.data().data());
}

float srgbFromLinear(float linear) {
  return linear <= 0.0031308f ? 12.92f * linear : 1.055f * std::pow(linear, 1 / 2.4f) - 0.055f;
}
float linearFromSrgb(float encoded) {
  return encoded <= 0.04045f ? encoded / 12.92f : std::pow((encoded + 0.055f) / 1.055f, 2.4f);
}

Image8 displayImage(const ImageF& linear, double exposure) {
  Image8 out(linear.width(), linear.height(), linear.channels());
  for (std::size_t i = 0; i < linear.data().size(); ++i) {
    const bool alpha = linear.channels() == 4 && i % 4 == 3;
    float v = linear.data()[i];
    if (!(v > 0)) v = 0;
    v = alpha ? v : srgbFromLinear(std::min(1.f, static_cast<float>(v * exposure)));
    out.data()[i] = static_cast<std::uint8_t>(std::lround(255 * std::min(v, 1.f)));
  }
  return out;
}

std::map<std::string, ImageF> readExrChannels(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) throw badInput(file.string(), "does not exist; check the path");
  try {
    Imf::InputFile input(file.c_str(), 0);
    const Imath::Box2i window = input.header().dataWindow();
    const int width = window.max.x - window.min.x + 1, height = window.max.y - window.min.y + 1;
    std::map<std::string, ImageF> images;
    Imf::FrameBuffer buffer;
    for (auto c = input.header().channels().begin(); c != input.header().channels().end(); ++c) {
      ImageF& image = images[c.name()] = ImageF(width, height, 1);
      char* base = reinterpret_cast<char*>(image.data().data()) -
                   (window.min.x + static_cast<std::ptrdiff_t>(window.min.y) * width) *
                       static_cast<std::ptrdiff_t>(sizeof(float));
      buffer.insert(c.name(), Imf::Slice(Imf::FLOAT, base, sizeof(float), sizeof(float) * width));
    }
    input.setFrameBuffer(buffer);
    input.readPixels(window.min.y, window.max.y);
    return images;
  } catch (const std::exception& e) {
    throw badInput(file.string(), std::string("could not be read as EXR: ") + e.what());
  }
}

Attributes readExrAttributes(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) throw badInput(file.string(), "does not exist; check the path");
  try {
    Imf::InputFile input(file.c_str(), 0);
    Attributes out;
    for (auto a = input.header().begin(); a != input.header().end(); ++a)
      if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&a.attribute())) out[a.name()] = text->value();
    return out;
  } catch (const std::exception& e) {
    throw badInput(file.string(), std::string("could not be read as EXR: ") + e.what());
  }
}

std::uint16_t halfFromFloat(float value) {
  if (value > kLargestHalf) value = kLargestHalf;
  if (value < -kLargestHalf) value = -kLargestHalf;
  return half(value).bits();
}
float floatFromHalf(std::uint16_t bits) {
  half h;
  h.setBits(bits);
  return h;
}

}  // namespace srf
