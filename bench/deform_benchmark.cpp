// What it costs to deform a model of a million triangles and to refit its ray scene, beside a bare loop of the same run
// that skins as many vertices by four bones, makes their normals and refits Embree's tree.
#include <embree3/rtcore.h>

#include <cmath>
#include <cstdio>

#include "apps/program.h"
#include "base/numeric.h"
#include "base/parallel.h"
#include "bench/timing.h"
#include "model/deformed_model.h"
#include "tests/model/test_shapes.h"

namespace srf {
namespace {

/// Skinning as a game does it: float, four bones a vertex, normals of the faces around, Embree's tree refitted.
class BareLoop {
 public:
  explicit BareLoop(const AcquisitionMesh& mesh)
      : rest_(3 * mesh.positions.size()),
        moved_(rest_.size() + 4),
        normals_(rest_.size()),
        weights_(4 * mesh.positions.size()),
        bones_(4 * mesh.positions.size()),
        triangles_(mesh.triangles) {
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      for (int k = 0; k < 3; ++k) rest_[3 * i + k] = static_cast<float>(mesh.positions[i].raw()[k]);
      for (int b = 0; b < 4; ++b) {
        weights_[4 * i + b] = 0.25f;
        bones_[4 * i + b] = static_cast<std::uint8_t>((i / 1000 + b) % kBones);
      }
    }
    const VertexCorners corners(mesh);
    first_.push_back(0);
    for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
      for (const std::uint32_t corner : corners.at(v)) faces_.push_back(corner / 3);
      first_.push_back(static_cast<std::uint32_t>(faces_.size()));
    }
    std::copy(rest_.begin(), rest_.end(), moved_.begin());
    device_ = rtcNewDevice("start_threads=0");
    scene_ = rtcNewScene(device_);
    rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_DYNAMIC));
    rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_LOW);
    geometry_ = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(geometry_, RTC_BUILD_QUALITY_REFIT);
    rtcSetSharedGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, moved_.data(), 0, 12,
                               rest_.size() / 3);
    rtcSetSharedGeometryBuffer(geometry_, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, triangles_.data(), 0, 12,
                               triangles_.size());
    rtcCommitGeometry(geometry_);
    rtcAttachGeometry(scene_, geometry_);
    rtcCommitScene(scene_);
  }
  ~BareLoop() {
    rtcReleaseGeometry(geometry_);
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  BareLoop(const BareLoop&) = delete;
  BareLoop& operator=(const BareLoop&) = delete;

  void run(int frame) {
    float bone[kBones][12];
    for (int b = 0; b < kBones; ++b) {
      const float angle = 0.01f * static_cast<float>(frame + b), c = std::cos(angle), s = std::sin(angle);
      const float matrix[12] = {c, -s, 0, 0, s, c, 0, 0, 0, 0, 1, 0};
      std::copy(matrix, matrix + 12, bone[b]);
    }
    const std::size_t vertices = rest_.size() / 3;
    parallelFor(vertices, 1 << 13, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        float m[12] = {};
        for (int b = 0; b < 4; ++b)
          for (int k = 0; k < 12; ++k) m[k] += weights_[4 * i + b] * bone[bones_[4 * i + b]][k];
        const float* p = &rest_[3 * i];
        for (int r = 0; r < 3; ++r)
          moved_[3 * i + r] = m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3];
      }
    });
    parallelFor(vertices, 1 << 13, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        float n[3] = {};
        for (std::uint32_t f = first_[i]; f < first_[i + 1]; ++f) {
          const Triangle& t = triangles_[faces_[f]];
          const float *a = &moved_[3 * t[0]], *b = &moved_[3 * t[1]], *c = &moved_[3 * t[2]];
          const float e[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, g[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
          n[0] += e[1] * g[2] - e[2] * g[1], n[1] += e[2] * g[0] - e[0] * g[2], n[2] += e[0] * g[1] - e[1] * g[0];
        }
        const float scale = 1 / std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int k = 0; k < 3; ++k) normals_[3 * i + k] = scale * n[k];
      }
    });
    rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(geometry_);
    rtcCommitScene(scene_);
  }

 private:
  static constexpr int kBones = 32;
  std::vector<float> rest_, moved_, normals_, weights_;
  std::vector<std::uint8_t> bones_;
  std::vector<Triangle> triangles_;
  std::vector<std::uint32_t> faces_, first_;
  RTCDevice device_ = nullptr;
  RTCScene scene_ = nullptr;
  RTCGeometry geometry_ = nullptr;
};

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("deform-benchmark", "times deforming and refitting a million triangles beside a bare loop");
  int repeats = 15, around = 1000;
  program.app().add_option("--repeats", repeats, "timed frames");
  program.app().add_option("--around", around, "quads around the torus; half as many across");
  return program.run(argc, argv, [&](Reporter& reporter) {
    ModelOptions options;
    const DeformableModel model =
        buildModel(test::torus(around, around / 2), "torus", 0, test::fieldAround(1), options, reporter);
    const AcquisitionMesh mesh = model.restMesh();
    DeformedModel deformed(model);
    BareLoop bare(mesh);
    const std::pair<const char*, std::string> kinds[] = {
        {"turned", R"({"type": "affine", "matrix": [[0.8,-0.6,0,A],[0.6,0.8,0,0],[0,0,1,0],[0,0,0,1]]})"},
        {"twisted", R"({"type": "twist", "axis": [0,0,1], "degrees_per_unit": A})"},
        {"bent and twisted", R"({"type": "bend", "axis": [1,0,0], "toward": [0,0,1], "degrees_per_unit": A},
                               {"type": "twist", "axis": [0,0,1], "degrees_per_unit": A})"}};
    const auto psi = [](std::string list, int frame) {
      for (std::size_t at; (at = list.find('A')) != list.npos;) list.replace(at, 1, std::to_string(10 + 0.5 * frame));
      return AnimatedDeformation::parse(parseJson("[" + list + "]", "benchmark"), ".", Reporter::silent()).at(0);
    };
    std::printf("%s, %d threads; %zu vertices, %zu triangles; %d frames; milliseconds as median (least .. most).\n\n",
                bench::processorName().c_str(), threadCount(), model.size(), model.triangles.size(), repeats);
    std::printf("| deformation | ms | bare skinning, normals and refit, same run | ratio |\n|---|---|---|---|\n");
    for (const auto& [name, list] : kinds) {
      bench::Series ours, theirs;
      for (int frame = 0; frame <= repeats; ++frame) {
        const Deformation now = psi(list, frame);
        const double a = bench::milliseconds([&] { deformed.deform(now); });
        const double b = bench::milliseconds([&] { bare.run(frame); });
        if (frame > 0) ours.add(a), theirs.add(b);  // the first one warms up
      }
      std::printf("| %s | %s | %s | %.2f |\n", name, bench::shown(ours).c_str(), bench::shown(theirs).c_str(),
                  ours.median() / theirs.median());
    }
  });
}
