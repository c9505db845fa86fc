#include "acquire/hull_components.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "acquire/mesh_coverage.h"

namespace srf {
namespace {

constexpr double kDust = 1e-6;     // of the volume
constexpr double kPhantom = 0.05;  // of the volume, at most
constexpr int kSamples = 256;      // along a picture's longer side

// Signed volume of each component about the mesh's own centre.
std::vector<double> volumes(const AcquisitionMesh& mesh, const std::vector<std::uint32_t>& component) {
  std::vector<double> volume(*std::max_element(component.begin(), component.end()) + 1, 0);
  const Vec3 center = mesh.bounds().center().raw();
  for (const Triangle& t : mesh.triangles) {
    const Vec3 a = mesh.positions[t[0]].raw() - center, b = mesh.positions[t[1]].raw() - center,
               c = mesh.positions[t[2]].raw() - center;
    volume[component[t[0]]] += dot(a, cross(b, c)) / 6;
  }
  return volume;
}

// How many components cover each sample of each picture.
class Covers {
 public:
  Covers(std::span<const Camera<AcquisitionSpace>> cameras) {
    for (const auto& camera : cameras) {
      pictures_.push_back(SampledPicture::of(camera, kSamples));
      count_.emplace_back(static_cast<std::size_t>(pictures_.back().columns) * pictures_.back().rows, 0);
    }
  }
  void add(const AcquisitionMesh& piece) { count(coveredSamples(piece, pictures_), 1); }
  // Takes a piece that was added away again if others cover it wherever a picture sees it, or lie a sample beside.
  bool removeIfCoveredByOthers(const AcquisitionMesh& piece) {
    const auto covered = coveredSamples(piece, pictures_);
    if (!coveredByOthers(covered)) return false;
    count(covered, -1);
    return true;
  }

 private:
  using Samples = std::vector<std::vector<std::uint8_t>>;  // as coveredSamples has them

  void count(const Samples& covered, int times) {
    for (std::size_t i = 0; i < count_.size(); ++i)
      for (std::size_t s = 0; s < count_[i].size(); ++s) count_[i][s] += times * covered[i][s];
  }
  bool coveredByOthers(const Samples& covered) const {
    int seen = 0;
    for (std::size_t i = 0; i < pictures_.size(); ++i) {
      const SampledPicture& picture = pictures_[i];
      bool here = false;
      const auto others = [&](int x, int y) {
        const std::size_t s = static_cast<std::size_t>(y) * picture.columns + x;
        return count_[i][s] - covered[i][s] > 0;
      };
      for (int y = 0; y < picture.rows; ++y)
        for (int x = 0; x < picture.columns; ++x) {
          if (!covered[i][static_cast<std::size_t>(y) * picture.columns + x]) continue;
          here = true;
          bool found = false;
          for (int v = std::max(0, y - 1); v <= std::min(picture.rows - 1, y + 1) && !found; ++v)
            for (int u = std::max(0, x - 1); u <= std::min(picture.columns - 1, x + 1) && !found; ++u)
              found = others(u, v);
          if (!found) return false;
        }
      seen += here;
    }
    return seen >= 2;
  }

  std::vector<SampledPicture> pictures_;
  std::vector<std::vector<int>> count_;
};

}  // namespace

void dropUnneededComponents(AcquisitionMesh& mesh, std::span<const Camera<AcquisitionSpace>> cameras,
                            Reporter& reporter) {
  const auto component = vertexComponents(mesh);
  if (component.empty()) return;
  const std::vector<double> volume = volumes(mesh, component);
  if (volume.size() == 1) return;
  const double whole = std::accumulate(volume.begin(), volume.end(), 0.0);
  std::vector<std::vector<Triangle>> pieces(volume.size());
  for (const Triangle& t : mesh.triangles) pieces[component[t[0]]].push_back(t);

  std::vector<bool> dropped(volume.size());
  std::vector<std::uint32_t> order;  // the others, the smallest first
  for (std::uint32_t c = 0; c < volume.size(); ++c) {
    dropped[c] = std::fabs(volume[c]) < kDust * whole;
    if (dropped[c])
      reporter.count("hull.dust");
    else
      order.push_back(c);
  }
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return volume[a] < volume[b]; });
  if (order.size() > 1 && !(volume[order.front()] > kPhantom * whole)) {
    Covers covers(cameras);
    AcquisitionMesh piece{mesh.positions, {}, {}};
    for (const std::uint32_t c : order) {
      piece.triangles = pieces[c];
      covers.add(piece);
    }
    for (const std::uint32_t c : order) {
      if (volume[c] > kPhantom * whole) break;
      piece.triangles = pieces[c];
      if (!covers.removeIfCoveredByOthers(piece)) continue;
      dropped[c] = true;
      reporter.count("hull.phantoms");
    }
  }
  if (std::find(dropped.begin(), dropped.end(), true) == dropped.end()) return;
  std::erase_if(mesh.triangles, [&](const Triangle& t) { return dropped[component[t[0]]]; });
  cleanMesh(mesh);
}

}  // namespace srf
