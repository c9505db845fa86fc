#include "acquire/iso_surface.h"

#include <algorithm>
#include <bit>
#include <unordered_map>

#include "base/check.h"
#include "base/parallel.h"

namespace srf {
namespace {

// Corner c of a cell lies at (c & 1, c >> 1 & 1, c >> 2 & 1). Edge e runs along axis e / 4 from its lower corner; e % 4
// tells the position across: bit 0 along the next axis, bit 1 along the one after (cyclic).
constexpr int edgeLowerCorner(int e) {
  const int axis = e / 4, across = e % 4;
  return (across & 1) << (axis + 1) % 3 | (across >> 1) << (axis + 2) % 3;
}
constexpr int edgeUpperCorner(int e) {
  return edgeLowerCorner(e) | 1 << e / 4;
}
constexpr int edgeBetween(int a, int b) {
  const int axis = std::countr_zero(static_cast<unsigned>(a ^ b)), lower = a & b;
  return 4 * axis + (lower >> (axis + 1) % 3 & 1) + 2 * (lower >> (axis + 2) % 3 & 1);
}

// The polygons of a cell whose corners are inside where the bits of `inside` are set: loops of crossed edges,
// counter-clockwise seen from outside.
struct CellCase {
  struct Loop {
    int size = 0;
    int apex = -1;  // fan from this entry; -1: from a vertex in the middle
    std::array<std::uint8_t, 12> edges{};
  };
  int loops = 0;
  std::array<Loop, 4> loop;
};

bool shareFace(int edge_a, int edge_b) {
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      const auto lies = [&](int e) { return e / 4 != axis && (edgeLowerCorner(e) >> axis & 1) == side; };
      if (lies(edge_a) && lies(edge_b)) return true;
    }
  return false;
}

// On every face each run of inside corners is cut off by itself: one rule, the same from both sides of a face. Walking
// around the face counter-clockwise seen from outside the cell, the cut runs from the edge that enters the run to the
// one that leaves it. Each crossed edge so has one link on each of its two faces of the cell, one in and one out:
// loops.
CellCase makeCase(int inside) {
  std::array<int, 12> next;
  next.fill(-1);
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      const int b = (axis + 1) % 3, c = (axis + 2) % 3, base = side << axis;
      std::array<int, 4> ring{base, base | 1 << b, base | 1 << b | 1 << c,
                              base | 1 << c};  // counter-clockwise from +axis
      if (side == 0) std::reverse(ring.begin(), ring.end());
      for (int i = 0; i < 4; ++i) {
        const auto isInside = [&](int k) { return inside >> ring[k & 3] & 1; };
        if (!isInside(i) || isInside(i + 1)) continue;
        int first = i;  // the run of inside corners that ends at i
        while (isInside(first + 3)) first = (first + 3) & 3;
        const int leaves = edgeBetween(ring[i], ring[(i + 1) & 3]),
                  enters = edgeBetween(ring[(first + 3) & 3], ring[first]);
        next[enters] = leaves;
      }
    }
  CellCase result;
  for (int e = 0; e < 12; ++e) {
    if (next[e] < 0) continue;
    CellCase::Loop& loop = result.loop[result.loops++];
    for (int at = e; next[at] >= 0;) {
      loop.edges[loop.size++] = static_cast<std::uint8_t>(at);
      const int to = next[at];
      next[at] = -1;
      at = to;
    }
    // A chord that lay in a face of the cell could meet a chord of the neighbour there.
    const auto chordsAreInside = [&](int apex) {
      for (int k = 2; k + 1 < loop.size; ++k)
        if (shareFace(loop.edges[apex], loop.edges[(apex + k) % loop.size])) return false;
      return true;
    };
    if (loop.size <= 5)
      for (int apex = loop.size - 1; apex >= 0; --apex)
        if (chordsAreInside(apex)) loop.apex = apex;
  }
  return result;
}

const std::array<CellCase, 256>& cellCases() {
  static const std::array<CellCase, 256> cases = [] {
    std::array<CellCase, 256> all;
    for (int i = 0; i < 256; ++i) all[i] = makeCase(i);
    return all;
  }();
  return cases;
}

std::uint64_t placeKey(std::uint32_t x, std::uint32_t y, std::uint32_t z) {
  return std::uint64_t{x} | std::uint64_t{y} << 21 | std::uint64_t{z} << 42;
}

// What a run of bricks adds to the mesh. Corners from kMiddle on are middle vertices of this part.
struct Part {
  std::vector<Triangle> triangles;
  std::vector<Point<AcquisitionSpace>> middles;
  bool disagree = false;
};
constexpr std::uint32_t kMiddle = 0x80000000u;

}  // namespace

std::optional<AcquisitionMesh> joinIsoBricks(const std::vector<IsoBrick>& bricks,
                                             std::vector<Point<AcquisitionSpace>> vertices) {
  SRF_CHECK(vertices.size() < kMiddle);
  std::unordered_map<std::uint64_t, std::uint32_t> brick_at;
  brick_at.reserve(bricks.size());
  for (std::uint32_t i = 0; i < bricks.size(); ++i)
    brick_at.emplace(placeKey(bricks[i].place[0], bricks[i].place[1], bricks[i].place[2]), i);

  constexpr std::size_t kGrain = 256;
  std::vector<Part> parts((bricks.size() + kGrain - 1) / kGrain);
  parallelFor(bricks.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    Part& part = parts[begin / kGrain];
    for (std::size_t index = begin; index < end; ++index) {
      const IsoBrick& brick = bricks[index];
      // The brick itself and its neighbours in the positive directions, which own the edges on the far faces.
      std::array<const IsoBrick*, 8> around{};
      for (int n = 0; n < 8; ++n) {
        const auto found =
            brick_at.find(placeKey(brick.place[0] + (n & 1), brick.place[1] + (n >> 1 & 1), brick.place[2] + (n >> 2)));
        if (found != brick_at.end()) around[n] = &bricks[found->second];
      }
      const auto vertexOn = [&](int edge, int x, int y, int z) -> std::uint32_t {
        const int corner = edgeLowerCorner(edge), axis = edge / 4;
        const int cx = x + (corner & 1), cy = y + (corner >> 1 & 1), cz = z + (corner >> 2);
        const IsoBrick* owner = around[cx / kBrick | cy / kBrick << 1 | cz / kBrick << 2];
        const int bit = ((cz % kBrick) * kBrick + cy % kBrick) * kBrick + cx % kBrick;
        if (!owner || !(owner->crossed[axis] >> bit & 1)) {
          part.disagree = true;
          return 0;
        }
        std::uint32_t vertex = owner->first_vertex;
        for (int a = 0; a < axis; ++a) vertex += std::popcount(owner->crossed[a]);
        return vertex + std::popcount(owner->crossed[axis] & ((std::uint64_t{1} << bit) - 1));
      };
      for (int z = 0; z < kBrick; ++z)
        for (int y = 0; y < kBrick; ++y)
          for (int x = 0; x < kBrick; ++x) {
            int inside = 0;
            for (int c = 0; c < 8; ++c)
              inside |= brick.isInside(brickCorner(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2))) << c;
            const CellCase& cell = cellCases()[inside];
            for (int l = 0; l < cell.loops; ++l) {
              const CellCase::Loop& loop = cell.loop[l];
              std::array<std::uint32_t, 12> corner;
              for (int k = 0; k < loop.size; ++k) corner[k] = vertexOn(loop.edges[k], x, y, z);
              if (part.disagree) return;
              if (loop.apex < 0) {
                Vec3 sum;
                for (int k = 0; k < loop.size; ++k) sum += vertices[corner[k]].raw();
                const auto middle = kMiddle + static_cast<std::uint32_t>(part.middles.size());
                part.middles.emplace_back(sum / loop.size);
                for (int k = 0; k < loop.size; ++k)
                  part.triangles.push_back({middle, corner[k], corner[(k + 1) % loop.size]});
                continue;
              }
              int apex = loop.apex;
              // Either diagonal of a quadrangle may do: the shorter one makes the better triangles.
              if (loop.size == 4 &&
                  distance(vertices[corner[(apex + 1) % 4]], vertices[corner[(apex + 3) % 4]]) <
                      distance(vertices[corner[apex]], vertices[corner[(apex + 2) % 4]]) &&
                  !shareFace(loop.edges[(apex + 1) % 4], loop.edges[(apex + 3) % 4]))
                ++apex;
              for (int k = 1; k + 1 < loop.size; ++k)
                part.triangles.push_back(
                    {corner[apex % loop.size], corner[(apex + k) % loop.size], corner[(apex + k + 1) % loop.size]});
            }
          }
    }
  });

  AcquisitionMesh mesh;
  mesh.positions = std::move(vertices);
  std::size_t triangle_count = 0;
  for (const Part& part : parts) {
    if (part.disagree) return std::nullopt;
    triangle_count += part.triangles.size();
  }
  mesh.triangles.reserve(triangle_count);
  for (const Part& part : parts) {
    const auto offset = static_cast<std::uint32_t>(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), part.middles.begin(), part.middles.end());
    for (Triangle t : part.triangles) {
      for (std::uint32_t& v : t)
        if (v >= kMiddle) v = v - kMiddle + offset;
      mesh.triangles.push_back(t);
    }
  }
  return mesh;
}

}  // namespace srf
