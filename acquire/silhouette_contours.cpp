#include "acquire/silhouette_contours.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>

namespace srf {

std::vector<std::vector<Vec2>> silhouetteContours(const Image8& mask, bool of_background) {
  constexpr double kHalf = 127.5;  // between two steps: no pixel lies on the contour
  const auto value = [&](int x, int y) -> double {
    if (x < 0 || y < 0 || x >= mask.width() || y >= mask.height()) return 0;
    return of_background ? 255 - mask.at(x, y) : mask.at(x, y);
  };
  // An edge of the grid: from a pixel to its right or lower neighbour.
  using Edge = std::uint64_t;
  const auto edgeOf = [&](int x, int y, bool down) -> Edge {
    return (static_cast<Edge>(y + 1) << 32 | static_cast<Edge>(x + 1)) * 2 + down;
  };
  const auto pointOf = [&](Edge edge) -> Vec2 {
    const bool down = edge & 1;
    const int x = static_cast<int>(edge >> 1 & 0x7fffffff) - 1, y = static_cast<int>(edge >> 33) - 1;
    const double from = value(x, y), to = value(x + !down, y + down);
    const double share = (kHalf - from) / (to - from);
    return {x + 0.5 + (down ? 0 : share), y + 0.5 + (down ? share : 0)};
  };

  // In each cell of four pixels the contour comes in where a walk around the cell enters the object and leaves at the
  // walk's next way out. The neighbour walks the common edge the other way round, so the pieces join head to tail.
  std::map<Edge, Edge> next;
  for (int y = -1; y < mask.height(); ++y)
    for (int x = -1; x < mask.width(); ++x) {
      const bool inside[4] = {value(x, y) > kHalf, value(x + 1, y) > kHalf, value(x + 1, y + 1) > kHalf,
                              value(x, y + 1) > kHalf};
      if (inside[0] == inside[1] && inside[1] == inside[2] && inside[2] == inside[3]) continue;
      const Edge edges[4] = {edgeOf(x, y, false), edgeOf(x + 1, y, true), edgeOf(x, y + 1, false), edgeOf(x, y, true)};
      for (int k = 0; k < 4; ++k) {
        if (inside[k] || !inside[(k + 1) % 4]) continue;
        int out = (k + 1) % 4;
        while (inside[(out + 1) % 4]) out = (out + 1) % 4;
        next[edges[k]] = edges[out];
      }
    }

  std::vector<std::vector<Vec2>> loops;
  while (!next.empty()) {
    std::vector<Vec2> loop;
    for (auto at = next.begin(); at != next.end();) {
      loop.push_back(pointOf(at->first));
      const Edge to = at->second;
      next.erase(at);
      at = next.find(to);
    }
    loops.push_back(std::move(loop));
  }
  return loops;
}

Image8 coverageOf(const std::vector<std::vector<Vec2>>& loops, int width, int height) {
  constexpr int kRows = 16;
  Image8 mask(width, height, 1);
  std::vector<double> crossings, covered(width);
  for (int y = 0; y < height; ++y) {
    std::fill(covered.begin(), covered.end(), 0.0);
    for (int r = 0; r < kRows; ++r) {
      const double at = y + (r + 0.5) / kRows;
      crossings.clear();
      for (const auto& loop : loops)
        for (std::size_t i = 0; i < loop.size(); ++i) {
          const Vec2 &a = loop[i], &b = loop[(i + 1) % loop.size()];
          if ((a.y <= at) != (b.y <= at)) crossings.push_back(a.x + (at - a.y) / (b.y - a.y) * (b.x - a.x));
        }
      std::sort(crossings.begin(), crossings.end());
      for (std::size_t i = 0; i + 1 < crossings.size(); i += 2) {
        const double from = std::max(0.0, crossings[i]), to = std::min(double(width), crossings[i + 1]);
        for (int x = static_cast<int>(from); x < to; ++x)
          covered[x] += std::max(0.0, std::min(to, x + 1.0) - std::max(from, double(x))) / kRows;
      }
    }
    for (int x = 0; x < width; ++x)
      mask.at(x, y) = static_cast<std::uint8_t>(std::lround(255 * std::clamp(covered[x], 0.0, 1.0)));
  }
  return mask;
}

bool reachesBorder(const Image8& mask) {
  for (int y = 0; y < mask.height(); ++y)
    for (int x = 0; x < mask.width(); x += (y == 0 || y == mask.height() - 1) ? 1 : std::max(1, mask.width() - 1))
      if (mask.at(x, y) >= 128) return true;
  return false;
}

}  // namespace srf
