#include "acquire/mesh_coverage.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "base/numeric.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr std::size_t kPatch = 512;  // triangles: their vertices stay in the nearest cache for all pictures

// Some triangles with the vertices that they use, coordinate by coordinate.
struct Patch {
  int count = 0;
  std::array<double, 3 * kPatch> x, y, z;
  std::vector<std::array<std::uint16_t, 3>> triangles;
  Box<AcquisitionSpace> box;

  Patch(const AcquisitionMesh& mesh, std::size_t begin, std::size_t end) {
    // The vertices met so far, in a table with open places.
    constexpr std::uint32_t kPlaces = 8 * kPatch, kFree = 0xffffffffu;
    std::array<std::uint32_t, kPlaces> vertex;
    std::array<std::uint16_t, kPlaces> number;
    vertex.fill(kFree);
    triangles.reserve(end - begin);
    for (std::size_t t = begin; t < end; ++t) {
      std::array<std::uint16_t, 3> corners;
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t v = mesh.triangles[t][k];
        std::uint32_t place = v * 0x9e3779b1u >> 20;
        static_assert(kPlaces == 1u << 12);
        while (vertex[place] != v && vertex[place] != kFree) place = (place + 1) % kPlaces;
        if (vertex[place] == kFree) {
          vertex[place] = v, number[place] = static_cast<std::uint16_t>(count);
          const Vec3 p = mesh.positions[v].raw();
          x[count] = p.x, y[count] = p.y, z[count] = p.z, ++count;
          box.extend(mesh.positions[v]);
        }
        corners[k] = number[place];
      }
      triangles.push_back(corners);
    }
  }
};

// Where the corners of a patch lie in a picture.
struct Places {
  std::array<float, 3 * kPatch> x, y;  // in samples; NaN where the camera does not see it
  // The first sample at or after a place, 0 to the number of samples; x in the lower half, y in the upper. Most
  // triangles of a fine hull lie between two columns or two rows, which their corners' samples tell at once.
  std::array<std::int32_t, 3 * kPatch> sample;
};

bool isPlain(const Intrinsics& lens) {
  return lens.isOrthographic() || lens.model == CameraModel::pinhole;
}

// Loops without branches, so that they become vector instructions.
void place(const Patch& patch, const SampledPicture& picture, Places& out) {
  const Intrinsics& lens = picture.camera.lens;
  const double origin = picture.step / 2 + 0.5, scale = 1.0 / picture.step;
  const auto toSample = [&](double pixel) { return static_cast<float>((pixel - origin) * scale); };
  const int count = patch.count;
  if (isPlain(lens)) {
    const Mat3 turn = picture.camera.pose.rotation().raw().transposed();
    const Vec3 a = turn.row[0], b = turn.row[1], c = turn.row[2], eye = picture.camera.center().raw();
    const double fl_x = lens.fl_x, fl_y = lens.fl_y, skew = lens.skew, cx = lens.cx, cy = lens.cy;
    std::array<double, 3 * kPatch> depth;
    for (int i = 0; i < count; ++i)
      depth[i] = c.x * (patch.x[i] - eye.x) + c.y * (patch.y[i] - eye.y) + c.z * (patch.z[i] - eye.z);
    if (lens.isOrthographic()) depth.fill(1);
    for (int i = 0; i < count; ++i) {
      const double x = patch.x[i] - eye.x, y = patch.y[i] - eye.y, z = patch.z[i] - eye.z;
      const double u = (a.x * x + a.y * y + a.z * z) / depth[i], v = (b.x * x + b.y * y + b.z * z) / depth[i];
      out.x[i] = toSample(fl_x * u + skew * v + cx), out.y[i] = toSample(fl_y * v + cy);
    }
    for (int i = 0; i < count; ++i)
      if (!(depth[i] > 0)) out.x[i] = out.y[i] = NAN;
  } else {
    for (int i = 0; i < count; ++i) {
      const auto seen = picture.camera.project(Point<AcquisitionSpace>(patch.x[i], patch.y[i], patch.z[i]));
      out.x[i] = seen ? toSample(seen->pixel.x) : NAN, out.y[i] = seen ? toSample(seen->pixel.y) : NAN;
    }
  }
  const float columns = picture.columns, rows = picture.rows;
  const auto firstFrom = [](float place, float samples) {  // 0 where there is no place
    float from = place > 0.f ? place : 0.f;
    from = from < samples ? from : samples;
    const auto whole = static_cast<std::int32_t>(from);
    return whole + (static_cast<float>(whole) < from ? 1 : 0);
  };
  for (int i = 0; i < count; ++i) out.sample[i] = firstFrom(out.x[i], columns) | firstFrom(out.y[i], rows) << 16;
}

class Coverage {
 public:
  Coverage(const SampledPicture& picture, std::vector<std::uint8_t>& covered) : picture_(picture), covered_(covered) {}

  // From several threads at once: samples are only ever set, so that the order does not matter.
  void add(const Patch& patch, Places& places) const {
    if (isCoveredAlready(patch)) return;
    place(patch, picture_, places);
    for (const auto& [i, j, k] : patch.triangles) {
      const std::uint32_t a = places.sample[i], b = places.sample[j], c = places.sample[k];
      const std::uint32_t differs = (a ^ b) | (a ^ c);
      if ((differs & 0xffffu) == 0 || differs >> 16 == 0) continue;
      addTriangle({places.x[i], places.y[i]}, {places.x[j], places.y[j]}, {places.x[k], places.y[k]},
                  {a & 0xffffu, b & 0xffffu, c & 0xffffu}, {a >> 16, b >> 16, c >> 16});
    }
  }

 private:
  struct Place {
    float x, y;
  };

  std::atomic_ref<std::uint8_t> at(std::size_t x, std::size_t y) const {
    return std::atomic_ref(covered_[y * picture_.columns + x]);
  }

  void addTriangle(const Place& a, const Place& b, const Place& c, const std::array<std::uint32_t, 3>& x_samples,
                   const std::array<std::uint32_t, 3>& y_samples) const {
    const auto [left, right] = std::minmax({x_samples[0], x_samples[1], x_samples[2]});
    const auto [top, bottom] = std::minmax({y_samples[0], y_samples[1], y_samples[2]});
    for (std::uint32_t y = top; y < bottom; ++y)
      for (std::uint32_t x = left; x < right; ++x) {
        if (at(x, y).load(std::memory_order_relaxed)) continue;
        const auto side = [&](const Place& p, const Place& q) {
          return (double(q.x) - p.x) * (y - double(p.y)) - (double(q.y) - p.y) * (x - double(p.x));
        };
        const double ab = side(a, b), bc = side(b, c), ca = side(c, a);
        if ((ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0))
          at(x, y).store(1, std::memory_order_relaxed);
      }
  }

  // Whether the patch can add nothing: all samples that its box may reach are covered. Half of a closed mesh lies
  // behind the other.
  bool isCoveredAlready(const Patch& patch) const {
    const Intrinsics& lens = picture_.camera.lens;
    if (!isPlain(lens)) return false;
    const auto& box = patch.box;
    Vec2 low{INFINITY, INFINITY}, high{-INFINITY, -INFINITY};
    for (int i = 0; i < 8; ++i) {
      const auto seen = picture_.camera.project(Point<AcquisitionSpace>(
          i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y, i & 4 ? box.max.z : box.min.z));
      if (!seen) return false;
      low = {std::min(low.x, seen->pixel.x), std::min(low.y, seen->pixel.y)};
      high = {std::max(high.x, seen->pixel.x), std::max(high.y, seen->pixel.y)};
    }
    // A sample more on every side than the box reaches: against rounding.
    const auto sample = [&](double pixel, int more, int count) {
      const double origin = picture_.step / 2 + 0.5;
      return static_cast<std::uint32_t>(
          std::clamp<double>(std::floor((pixel - origin) / picture_.step) + more, 0, count));
    };
    const std::uint32_t right = sample(high.x, 2, picture_.columns), bottom = sample(high.y, 2, picture_.rows);
    for (std::uint32_t y = sample(low.y, 0, picture_.rows); y < bottom; ++y)
      for (std::uint32_t x = sample(low.x, 0, picture_.columns); x < right; ++x)
        if (!at(x, y).load(std::memory_order_relaxed)) return false;
    return true;
  }

  const SampledPicture& picture_;
  std::vector<std::uint8_t>& covered_;
};

}  // namespace

SampledPicture SampledPicture::of(const Camera<AcquisitionSpace>& camera, int samples) {
  const int width = camera.lens.width, height = camera.lens.height;
  const int step = std::max(1, std::max(width, height) / samples);
  return {camera, step, (width - step / 2 + step - 1) / step, (height - step / 2 + step - 1) / step};
}

std::vector<std::vector<std::uint8_t>> coveredSamples(const AcquisitionMesh& mesh,
                                                      std::span<const SampledPicture> pictures) {
  std::vector<std::vector<std::uint8_t>> covered;
  for (const SampledPicture& p : pictures) covered.emplace_back(static_cast<std::size_t>(p.columns) * p.rows, 0);
  parallelFor(mesh.triangles.size(), kPatch, [&](std::size_t begin, std::size_t end) {
    const Patch patch(mesh, begin, end);
    Places places;
    for (std::size_t i = 0; i < pictures.size(); ++i) Coverage(pictures[i], covered[i]).add(patch, places);
  });
  return covered;
}

}  // namespace srf
