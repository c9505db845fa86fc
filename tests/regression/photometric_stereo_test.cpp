// Real photographs of one view under twelve lights (University of Washington): each light in turn is left out and
// foretold from the others, plainly, guided, and by Lambert's law fitted to the pixel.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <fstream>
#include <functional>

#include "acquire/acquire_field.h"
#include "acquire/camera_import.h"
#include "apps/make_model.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/mesh_io.h"
#include "base/numeric.h"
#include "render/animation.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

namespace fs = std::filesystem;

constexpr double kPixelsPerUnit = 100;

// Uncompressed 24-bit TGA, rows from the bottom.
Image8 readTga(const fs::path& file) {
  const std::vector<std::byte> bytes = readBinaryFile(file);
  const auto at = [&](std::size_t i) { return std::to_integer<int>(bytes.at(i)); };
  EXPECT_EQ(at(2), 2) << file;
  EXPECT_EQ(at(16), 24) << file;
  const int width = at(12) + 256 * at(13), height = at(14) + 256 * at(15);
  Image8 image(width, height, 3);
  std::size_t from = 18 + static_cast<std::size_t>(at(0));
  for (int y = height - 1; y >= 0; --y)
    for (int x = 0; x < width; ++x, from += 3)
      for (int c = 0; c < 3; ++c) image.at(x, y, c) = static_cast<std::uint8_t>(at(from + 2 - c));
  return image;
}

struct Photographs {
  std::vector<Image8> images;
  std::vector<Vec3> lights;
  Image8 mask;
  double cx = 0, cy = 0, radius = 0;  ///< of the disc of the mask's area

  Photographs(const fs::path& data, const std::string& name) {
    std::ifstream in(data / "lights.txt");
    int count = 0;
    in >> count;
    for (int k = 0; k < count; ++k) {
      Vec3 l;
      in >> l.x >> l.y >> l.z;
      lights.push_back(l / length(l));
      images.push_back(readTga(data / name / (name + "." + std::to_string(k) + ".tga")));
    }
    const Image8 color = readTga(data / name / (name + ".mask.tga"));
    mask = Image8(color.width(), color.height(), 1);
    double area = 0;
    for (int y = 0; y < mask.height(); ++y)
      for (int x = 0; x < mask.width(); ++x)
        if (color.at(x, y) > 127) mask.at(x, y) = 255, cx += x + 0.5, cy += y + 0.5, ++area;
    cx /= area, cy /= area, radius = std::sqrt(area / kPi);
  }
  double grey(int light, int x, int y) const {
    const Image8& image = images[light];
    return (image.at(x, y, 0) + image.at(x, y, 1) + image.at(x, y, 2)) / (3 * 255.0);
  }

  /// Albedo times normal of a grey Lambertian pixel, from all lights but one.
  Vec3 lambert(int x, int y, int without) const {
    Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    for (int k = 0; k < static_cast<int>(lights.size()); ++k) {
      if (k == without) continue;
      const Eigen::Vector3d l(lights[k].x, lights[k].y, lights[k].z);
      a += l * l.transpose();
      b += l * grey(k, x, y);
    }
    const Eigen::Vector3d g = a.ldlt().solve(b);
    return {g.x(), g.y(), g.z()};
  }

  /// A vertex at every pixel of the mask and next to it: on the sphere of the disc, or flat with Lambert's normals.
  AcquisitionMesh surface(bool sphere, int without) const {
    AcquisitionMesh mesh;
    Image<std::int32_t> vertex(mask.width(), mask.height(), 1, -1);
    const auto inside = [&](int x, int y) { return mask.at(x, y) > 0; };
    for (int y = 1; y + 1 < mask.height(); ++y)
      for (int x = 1; x + 1 < mask.width(); ++x) {
        bool near = false;
        for (int d = 0; d < 9; ++d) near = near || inside(x + d % 3 - 1, y + d / 3 - 1);
        if (!near) continue;
        vertex.at(x, y) = static_cast<std::int32_t>(mesh.positions.size());
        Vec3 n{0, 0, 1};
        double z = 0;
        if (sphere) {
          n = {(x + 0.5 - cx) / radius, (cy - y - 0.5) / radius, 0};
          n.z = std::sqrt(std::max(1e-4, 1 - dot(n, n)));
          z = n.z * radius / kPixelsPerUnit;
        } else if (inside(x, y)) {
          n = lambert(x, y, without);
        }
        mesh.positions.emplace_back((x + 0.5 - 0.5 * mask.width()) / kPixelsPerUnit,
                                    (0.5 * mask.height() - y - 0.5) / kPixelsPerUnit, z);
        mesh.normals.push_back(
            normalize(Vector<AcquisitionSpace>(n)).value_or(Direction<AcquisitionSpace>::fromUnit({0, 0, 1})));
      }
    for (int y = 0; y + 1 < mask.height(); ++y)
      for (int x = 0; x + 1 < mask.width(); ++x) {
        const std::int32_t a = vertex.at(x, y), b = vertex.at(x + 1, y), c = vertex.at(x, y + 1),
                           d = vertex.at(x + 1, y + 1);
        if (std::min({a, b, c, d}) < 0) continue;
        const auto u = [](std::int32_t i) { return static_cast<std::uint32_t>(i); };
        mesh.triangles.push_back({u(a), u(c), u(b)});
        mesh.triangles.push_back({u(b), u(c), u(d)});
      }
    return mesh;
  }
};

std::string cameraText(const Photographs& photographs) {
  const std::string w = std::to_string(photographs.mask.width()), h = std::to_string(photographs.mask.height());
  const std::string f = std::to_string(kPixelsPerUnit);
  return R"("camera_model":"ORTHOGRAPHIC","w":)" + w + R"(,"h":)" + h + R"(,"fl_x":)" + f + R"(,"fl_y":)" + f +
         R"(,"cx":)" + std::to_string(0.5 * photographs.mask.width()) + R"(,"cy":)" +
         std::to_string(0.5 * photographs.mask.height());
}
constexpr const char* kPose = R"("transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,5],[0,0,0,1]])";

std::string triple(const Vec3& v) {
  return "[" + std::to_string(v.x) + "," + std::to_string(v.y) + "," + std::to_string(v.z) + "]";
}

/// Relative error of the grey values of one light, mean over the lights, as the data's SOURCE.md counts: root of the
/// squared errors over that of the squared photographs.
struct Errors {
  double lambert = 0, plain = 0, guided = 0;
};

Errors leaveOneLightOut(const fs::path& data, const std::string& name, bool sphere) {
  const Photographs photographs(data, name);
  const test::TemporaryFolder folder;
  const int count = static_cast<int>(photographs.lights.size());
  for (int k = 0; k < count; ++k) writePng(folder / ("L" + std::to_string(k) + ".png"), photographs.images[k]);
  writePng(folder / "mask.png", photographs.mask);
  Errors errors;
  for (int without = 0; without < count; ++without) {
    std::string lights, frames;
    for (int k = 0; k < count; ++k) {
      if (k == without) continue;
      const std::string light = "L" + std::to_string(k), comma = lights.empty() ? "" : ",";
      lights += comma + R"({"name":")" + light + R"(","type":"directional","direction":)" +
                triple(photographs.lights[k]) + R"(,"irradiance":[1,1,1]})";
      frames += comma + R"({"file_path":")" + light + R"(.png","mask_path":"mask.png","view":"v","light":")" + light +
                "\"," + kPose + "}";
    }
    writeTextFile(folder / "transforms.json", "{" + cameraText(photographs) +
                                                  R"(,"color_space":"lin_rec709","lights":[)" + lights +
                                                  R"(],"frames":[)" + frames + "]}");
    AcquireOptions options;
    options.make_hull = false;
    acquireField(openCapture(folder.path(), Reporter::silent()), folder / "x.srf", options, Reporter::silent());
    writePly(folder / "surface.ply", photographs.surface(sphere, without));
    makeModel(folder / "x.srf", (folder / "surface.ply").string(), {}, FitOptions(), Reporter::silent());
    writeTextFile(folder / "scene.json", R"({"camera":{)" + cameraText(photographs) + "," + kPose +
                                             R"(},"lights":[{"type":"directional","direction":)" +
                                             triple(photographs.lights[without]) + R"(,"irradiance":[1,1,1]}]})");
    const auto relativeError = [&](const std::function<double(int, int)>& foretold) {
      double error = 0, square = 0;
      for (int y = 0; y < photographs.mask.height(); ++y)
        for (int x = 0; x < photographs.mask.width(); ++x) {
          if (photographs.mask.at(x, y) == 0) continue;
          const double truth = photographs.grey(without, x, y);
          error += srf::square(foretold(x, y) - truth);
          square += srf::square(truth);
        }
      return std::sqrt(error / square) / count;
    };
    for (const bool guided : {false, true}) {
      const std::string way = guided ? "guided" : "plain";
      AnimationOptions animation;
      animation.srf = folder / "x.srf";
      animation.output = (folder / (way + ".####.exr")).string();
      const Scene scene = readScene(folder / "scene.json", {"/interpolation=" + way}, Reporter::silent());
      const ImageF frame = readImage(renderAnimation(scene, animation, Reporter::silent()).at(0).file).pixels;
      (guided ? errors.guided : errors.plain) += relativeError([&](int x, int y) {
        return (double{frame.at(x, y, 0)} + double{frame.at(x, y, 1)} + double{frame.at(x, y, 2)}) / 3;
      });
    }
    errors.lambert += relativeError([&](int x, int y) {
      return std::max(0.0, dot(photographs.lambert(x, y, without), photographs.lights[without]));
    });
  }
  std::printf("%s: relative error of a light left out: Lambert %.4f, plain %.4f, guided %.4f\n", name.c_str(),
              errors.lambert, errors.plain, errors.guided);
  return errors;
}

// The data's SOURCE.md has 0.044 for a Lambertian fit of the grey ball and 0.095 for the cat's: ours are the same.
TEST(PhotometricStereo, GreyBallOnItsSphereIsForetoldBetterThanByLambertsLaw) {
  SRF_REQUIRE_DATA(data, "uw-psm");
  const Errors errors = leaveOneLightOut(data, "gray", true);
  EXPECT_NEAR(errors.lambert, 0.044, 0.0005);
  EXPECT_LE(errors.guided, 0.044);
  EXPECT_LT(errors.guided, errors.plain);
}

TEST(PhotometricStereo, CatOnAFlatModelWithPhotometricNormalsIsForetoldBetterThanPlainAndByLambertsLaw) {
  SRF_REQUIRE_DATA(data, "uw-psm");
  const Errors errors = leaveOneLightOut(data, "cat", false);
  EXPECT_NEAR(errors.lambert, 0.095, 0.0005);
  EXPECT_LE(errors.guided, 0.095);
  EXPECT_LT(errors.guided, errors.lambert);
  EXPECT_LT(errors.guided, errors.plain);
}

}  // namespace
}  // namespace srf
