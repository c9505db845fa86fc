#include "model/deformation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include "base/check.h"
#include "base/numeric.h"
#include "base/sin_cos.h"
#include "model/skinning.h"

// Twist, taper and bend: Barr, Global and Local Deformations of Solid Primitives, 1984. Lattice: Sederberg and Parry,
// Free-Form Deformation of Solid Geometric Models, 1986. Every map works on p - origin, so that an object far from the
// world's origin keeps its digits.

namespace srf {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Eq. 6: the step is this part of the length over which the map changes. Truncation and rounding then both stay
// near 1e-11 of a tangent in double.
constexpr double kStepOfLength = 0x1p-17;
constexpr double kRigidTolerance = 1e-12;
// Shortest part of `toward` across the axis, of its own length, that still gives it a direction.
constexpr double kParallelSine = 1e-6;
constexpr int kMostLatticePoints = 64;  // along one axis

// Without the fused operations of `cross`, which not every build has in wide form. What it loses by cancellation is
// small beside the terms that it is added to.
Vec3 plainCross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
double reciprocalLength(double per_unit) {
  return per_unit == 0 ? kInfinity : 1 / std::fabs(per_unit);
}

constexpr std::size_t kMost = CarriedPoints::kMost;

/// A map whose formulas stand in `carry` alone.
class WideMap : public SpaceMap {
 public:
  Vec3 map(const Vec3& p) const final {
    CarriedPoints one;
    one.count = 1;
    CarriedPoints::put(p, one.p, 0);
    one.handedness[0] = 1;
    carry(one);
    return CarriedPoints::get(one.p, 0);
  }
  Mat3 jacobian(const Vec3& p) const final {
    CarriedPoints one;
    one.count = 1;
    one.vectors = 3;
    CarriedPoints::put(p, one.p, 0);
    for (int v = 0; v < 3; ++v) CarriedPoints::put(Mat3{}.row[v], one.vector[v], 0);
    one.handedness[0] = 1;
    carry(one);
    return Mat3::fromColumns(CarriedPoints::get(one.vector[0], 0), CarriedPoints::get(one.vector[1], 0),
                             CarriedPoints::get(one.vector[2], 0));
  }
};

class AffineMap final : public WideMap {
 public:
  AffineMap(const Mat3& linear, const Vec3& translation) : linear_(linear), translation_(translation) {}
  void carry(CarriedPoints& points) const override {
    const Vec3 t = translation_;
    times(points.p, points.count);
    for (std::size_t i = 0; i < points.count; ++i) points.p[0][i] += t.x, points.p[1][i] += t.y, points.p[2][i] += t.z;
    for (std::size_t v = 0; v < points.vectors; ++v) times(points.vector[v], points.count);
    if (determinant(linear_) < 0)
      for (std::size_t i = 0; i < points.count; ++i) points.handedness[i] = -points.handedness[i];
  }
  double lengthScale() const override { return kInfinity; }
  bool rigid() const override {
    const Mat3 gram = linear_ * linear_.transposed();
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        if (!(std::fabs(gram.row[i][j] - (i == j)) <= kRigidTolerance)) return false;
    return determinant(linear_) > 0;
  }

 private:
  void times(CarriedPoints::Coordinates& a, std::size_t count) const {
    const Mat3 m = linear_;
    for (std::size_t i = 0; i < count; ++i) CarriedPoints::put(m * CarriedPoints::get(a, i), a, i);
  }
  Mat3 linear_;
  Vec3 translation_;
};

class TwistMap final : public WideMap {
 public:
  TwistMap(const Vec3& origin, const Vec3& axis, double k) : origin_(origin), axis_(axis), k_(k) {}
  void carry(CarriedPoints& points) const override {
    const Vec3 o = origin_, a = axis_;
    const double k = k_;
    const std::size_t count = points.count;
    double angle[kMost] = {}, sine[kMost], cosine[kMost], twirl[3][kMost];
    for (std::size_t i = 0; i < count; ++i) angle[i] = k * dot(CarriedPoints::get(points.p, i) - o, a);
    sinCos(angle, sine, cosine, count);
    // Turned by the angle of its place (Rodrigues' formula).
    const auto turned = [&](const Vec3& x, std::size_t i) {
      return cosine[i] * x + sine[i] * plainCross(a, x) + ((1 - cosine[i]) * dot(a, x)) * a;
    };
    for (std::size_t i = 0; i < count; ++i) {
      const Vec3 q = turned(CarriedPoints::get(points.p, i) - o, i);
      CarriedPoints::put(o + q, points.p, i);
      CarriedPoints::put(k * plainCross(a, q), twirl, i);
    }
    for (std::size_t v = 0; v < points.vectors; ++v) {
      auto& vector = points.vector[v];
      for (std::size_t i = 0; i < count; ++i) {
        const Vec3 x = CarriedPoints::get(vector, i);
        CarriedPoints::put(turned(x, i) + dot(a, x) * CarriedPoints::get(twirl, i), vector, i);
      }
    }
  }
  double lengthScale() const override { return reciprocalLength(k_); }

 private:
  Vec3 origin_, axis_;
  double k_;  // radians per unit
};

class TaperMap final : public WideMap {
 public:
  TaperMap(const Vec3& origin, const Vec3& axis, double k) : origin_(origin), axis_(axis), k_(k) {}
  // det = (1 + k s)^2: never mirrors.
  void carry(CarriedPoints& points) const override {
    const Vec3 o = origin_, a = axis_;
    const double k = k_;
    double growth[kMost], slope[3][kMost];  // 1 + k s, and what it grows by along the axis
    for (std::size_t i = 0; i < points.count; ++i) {
      const Vec3 p = CarriedPoints::get(points.p, i), q = p - o;
      const double s = dot(q, a);
      const Vec3 across = q - s * a;
      CarriedPoints::put(p + (k * s) * across, points.p, i);  // o + s a + (1 + k s)(q - s a)
      CarriedPoints::put(k * across, slope, i);
      growth[i] = 1 + k * s;
    }
    for (std::size_t v = 0; v < points.vectors; ++v) {
      auto& vector = points.vector[v];
      for (std::size_t i = 0; i < points.count; ++i) {
        const Vec3 x = CarriedPoints::get(vector, i), along = dot(a, x) * a;
        CarriedPoints::put(along + growth[i] * (x - along) + dot(a, x) * CarriedPoints::get(slope, i), vector, i);
      }
    }
  }
  double lengthScale() const override { return reciprocalLength(k_); }

 private:
  Vec3 origin_, axis_;
  double k_;  // per unit
};

class BendMap final : public WideMap {
 public:
  BendMap(const Vec3& origin, const Vec3& axis, const Vec3& toward, double k, double low, double high)
      : origin_(origin), axis_(axis), toward_(toward), side_(cross(axis, toward)), k_(k), low_(low), high_(high) {}
  void carry(CarriedPoints& points) const override {
    const Vec3 o = origin_, a = axis_, t = toward_, across = side_;
    const double k = k_, low = low_, high = high_;
    const std::size_t count = points.count;
    double clamped[kMost], half[kMost] = {}, half_sine[kMost], half_cosine[kMost], sine[kMost], cosine[kMost],
                           stretch[kMost];
    for (std::size_t i = 0; i < count; ++i) {
      const double s = dot(CarriedPoints::get(points.p, i) - o, a);
      clamped[i] = s < low ? low : s > high ? high : s;
      half[i] = 0.5 * k * clamped[i];
    }
    sinCos(half, half_sine, half_cosine, count);
    for (std::size_t i = 0; i < count; ++i) {
      const Vec3 q = CarriedPoints::get(points.p, i) - o;
      const double x = dot(q, t), y = dot(q, across), r = dot(q, a) - clamped[i];
      const double c = 1 - 2 * half_sine[i] * half_sine[i], d = 2 * half_sine[i] * half_cosine[i];
      // sin(th) / k and (1 - cos(th)) / k without dividing by a small k.
      const double sinc_of_half = half[i] == 0 ? 1 : half_sine[i] / half[i];
      const double along = clamped[i] * sinc_of_half * half_cosine[i] - d * x + c * r;
      const double over = clamped[i] * half_sine[i] * sinc_of_half + c * x + d * r;
      CarriedPoints::put(o + y * across + along * a + over * t, points.p, i);
      sine[i] = d, cosine[i] = c;
      stretch[i] = r == 0 ? 1 - k * x : 1;  // beyond the range the object goes on rigidly
    }
    for (std::size_t v = 0; v < points.vectors; ++v) {
      auto& vector = points.vector[v];
      for (std::size_t i = 0; i < count; ++i) {
        const Vec3 x = CarriedPoints::get(vector, i);
        const double along = stretch[i] * dot(x, a), over = dot(x, t);
        CarriedPoints::put(dot(x, across) * across + (cosine[i] * along - sine[i] * over) * a +
                               (sine[i] * along + cosine[i] * over) * t,
                           vector, i);
      }
    }
    for (std::size_t i = 0; i < count; ++i) points.handedness[i] *= stretch[i] < 0 ? -1 : 1;  // det = stretch
  }
  double lengthScale() const override { return reciprocalLength(k_); }

 private:
  Vec3 origin_, axis_, toward_, side_;
  double k_;  // radians per unit
  double low_, high_;
};

class WaveMap final : public WideMap {
 public:
  WaveMap(const Vec3& origin, const Vec3& axis, const Vec3& direction, double amplitude, double wavelength,
          double phase)
      : origin_(origin),
        axis_(axis),
        direction_(direction),
        amplitude_(amplitude),
        k_(2 * kPi / wavelength),
        phase_(phase) {}
  void carry(CarriedPoints& points) const override {
    const Vec3 o = origin_, a = axis_, d = direction_;
    const double amplitude = amplitude_, k = k_, phase = phase_, along = dot(d, a);
    const std::size_t count = points.count;
    double angle[kMost] = {}, sine[kMost], cosine[kMost];
    for (std::size_t i = 0; i < count; ++i) angle[i] = k * dot(CarriedPoints::get(points.p, i) - o, a) + phase;
    sinCos(angle, sine, cosine, count);
    for (std::size_t i = 0; i < count; ++i)
      CarriedPoints::put(CarriedPoints::get(points.p, i) + (amplitude * sine[i]) * d, points.p, i);
    for (std::size_t v = 0; v < points.vectors; ++v) {
      auto& vector = points.vector[v];
      for (std::size_t i = 0; i < count; ++i) {
        const Vec3 x = CarriedPoints::get(vector, i);
        CarriedPoints::put(x + (amplitude * k * cosine[i] * dot(a, x)) * d, vector, i);
      }
    }
    for (std::size_t i = 0; i < count; ++i)
      points.handedness[i] *= 1 + amplitude * k * cosine[i] * along < 0 ? -1 : 1;  // det
  }
  double lengthScale() const override { return 1 / k_; }

 private:
  Vec3 origin_, axis_, direction_;
  double amplitude_, k_, phase_;  // units, radians per unit, radians
};

// p' = p + the Bernstein sum of the control points' displacements: the same as the sum of the control points, since the
// lattice at rest reproduces p, but exact where nothing moved.
class LatticeMap final : public SpaceMap {
 public:
  LatticeMap(const Vec3& min, const Vec3& max, const std::array<int, 3>& resolution, const std::vector<Vec3>& points)
      : min_(min), max_(max), resolution_(resolution), moved_(points.size()) {
    std::size_t index = 0;
    for (int k = 0; k < resolution[2]; ++k)
      for (int j = 0; j < resolution[1]; ++j)
        for (int i = 0; i < resolution[0]; ++i, ++index) {
          moved_[index] = points[index] - restPoint({i, j, k});
          const bool wall =
              i == 0 || i == resolution[0] - 1 || j == 0 || j == resolution[1] - 1 || k == 0 || k == resolution[2] - 1;
          if (wall) wall_motion_ = std::max(wall_motion_, length(moved_[index]));
        }
  }
  Vec3 map(const Vec3& p) const override {
    Basis basis[3];
    if (!bases(p, basis)) return p;
    return p + sum(basis[0].value, basis[1].value, basis[2].value);
  }
  Mat3 jacobian(const Vec3& p) const override {
    Basis basis[3];
    if (!bases(p, basis)) return Mat3{};
    return Mat3{} + Mat3::fromColumns(sum(basis[0].slope, basis[1].value, basis[2].value),
                                      sum(basis[0].value, basis[1].slope, basis[2].value),
                                      sum(basis[0].value, basis[1].value, basis[2].slope));
  }
  double lengthScale() const override {
    double least = kInfinity;
    for (int a = 0; a < 3; ++a) least = std::min(least, (max_[a] - min_[a]) / (resolution_[a] - 1));
    return least;
  }
  double wallMotion() const { return wall_motion_; }

 private:
  using Values = std::array<double, kMostLatticePoints>;
  struct Basis {
    Values value, slope;  ///< Bernstein polynomials and their derivatives per unit
  };
  Vec3 restPoint(const std::array<int, 3>& index) const {
    Vec3 p;
    for (int a = 0; a < 3; ++a) p[a] = min_[a] + (max_[a] - min_[a]) * index[a] / (resolution_[a] - 1);
    return p;
  }
  // False outside the box.
  bool bases(const Vec3& p, Basis basis[3]) const {
    for (int a = 0; a < 3; ++a) {
      const double extent = max_[a] - min_[a], t = (p[a] - min_[a]) / extent;
      if (!(t >= 0 && t <= 1)) return false;
      const int degree = resolution_[a] - 1;
      // Degree by degree, by convex combinations alone; the last step but one gives the slopes.
      Values& b = basis[a].value;
      b[0] = 1;
      for (int n = 1; n <= degree; ++n) {
        if (n == degree)
          for (int i = 0; i <= degree; ++i)
            basis[a].slope[i] = degree * ((i > 0 ? b[i - 1] : 0) - (i < degree ? b[i] : 0)) / extent;
        b[n] = t * b[n - 1];
        for (int i = n - 1; i > 0; --i) b[i] = (1 - t) * b[i] + t * b[i - 1];
        b[0] *= 1 - t;
      }
    }
    return true;
  }
  Vec3 sum(const Values& x, const Values& y, const Values& z) const {
    Vec3 total;
    std::size_t index = 0;
    for (int k = 0; k < resolution_[2]; ++k)
      for (int j = 0; j < resolution_[1]; ++j)
        for (int i = 0; i < resolution_[0]; ++i, ++index) total += (x[i] * y[j] * z[k]) * moved_[index];
    return total;
  }
  Vec3 min_, max_;
  std::array<int, 3> resolution_;
  std::vector<Vec3> moved_;
  double wall_motion_ = 0;
};

// Reads the parameters of one entry of the list and remembers the frames of their keys.
class Parameters {
 public:
  Parameters(const JsonNode& node, std::vector<double>& key_frames) : node_(node), key_frames_(key_frames) {}

  Animated<double> number(const JsonNode& node) { return remember(readAnimatedNumber(node)); }
  Animated<Vec3> vec3(const JsonNode& node) { return remember(readAnimatedVec3(node)); }
  Animated<double> number(const char* key) { return number(node_[key]); }
  Animated<Vec3> vec3(const char* key) { return vec3(node_[key]); }
  /// The parts of a list: each may be animated, or the list as a whole. `nodes_of` takes a list without keys to the
  /// nodes of its parts, `part` reads one.
  template <class T, class NodesOf, class Part>
  std::vector<Animated<T>> list(const JsonNode& node, const NodesOf& nodes_of, const Part& part) {
    std::vector<Animated<T>> parts;
    if (!node.isObject()) {
      for (const JsonNode& one : nodes_of(node)) parts.push_back(remember(readAnimated<T>(one, part)));
      return parts;
    }
    const auto whole = readAnimated<std::vector<T>>(node, [&](const JsonNode& value) {
      std::vector<T> values;
      for (const JsonNode& one : nodes_of(value)) values.push_back(part(one));
      return values;
    });
    remember(whole);
    for (std::size_t i = 0; i < whole.keys().front().second.size(); ++i) {
      std::vector<std::pair<double, T>> keys;
      for (const auto& [frame, values] : whole.keys()) keys.emplace_back(frame, values[i]);
      parts.emplace_back(std::move(keys), whole.interpolation());
    }
    return parts;
  }
  Animated<Vec3> origin() { return node_.has("origin") ? vec3("origin") : Animated<Vec3>(Vec3{}); }
  const JsonNode& node() const { return node_; }

 private:
  template <class T>
  Animated<T> remember(Animated<T> value) {
    if (!value.constant())
      for (const auto& key : value.keys()) key_frames_.push_back(key.first);
    return value;
  }
  const JsonNode& node_;
  std::vector<double>& key_frames_;
};

using MapPointer = std::shared_ptr<const SpaceMap>;
using MakeMap = std::function<MapPointer(double frame)>;  ///< throws bad_input where the frame's parameters make no map

std::string atFrame(double frame) {
  std::string text = std::to_string(frame);
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
  return " at frame " + text;
}

// The direction of a vector parameter.
Vec3 unit(const Animated<Vec3>& value, double frame, const JsonNode& node, const char* key) {
  const auto direction = normalize(Vector<AcquisitionSpace>(value.at(frame)));
  if (!direction) throw node[key].error("has no direction" + atFrame(frame) + "; expected a vector of non-zero length");
  return direction->raw();
}

double readNumber(const JsonNode& node) {
  return node.number();
}

MakeMap parseAffine(Parameters& in) {
  const JsonNode node = in.node();
  node.onlyKeys({"type", "matrix"});
  const JsonNode matrix = node["matrix"];
  const auto entriesOf = [](const JsonNode& rows) {
    if (rows.size() != 4) throw rows.error("has " + std::to_string(rows.size()) + " rows, expected 4");
    std::vector<JsonNode> entries;
    for (std::size_t i = 0; i < 4; ++i) {
      const JsonNode row = rows.at(i);
      if (row.size() != 4) throw row.error("has " + std::to_string(row.size()) + " numbers, expected 4");
      for (std::size_t j = 0; j < 4; ++j)
        if (i < 3)
          entries.push_back(row.at(j));
        else if (row.at(j).number() != (j == 3))
          throw row.error("expected the last row 0 0 0 1");
    }
    return entries;
  };
  return [entries = in.list<double>(matrix, entriesOf, readNumber), matrix](double frame) -> MapPointer {
    Mat3 linear;
    Vec3 translation;
    double rows = 1;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) linear.row[i][j] = entries[4 * i + j].at(frame);
      translation[i] = entries[4 * i + 3].at(frame);
      rows *= length(linear.row[i]);
    }
    // Against the product of the rows' lengths a strong squeeze stays legal, while dependent rows leave rounding alone.
    if (!(std::fabs(determinant(linear)) > 1e-14 * rows))
      throw matrix.error("is singular" + atFrame(frame) + ": it flattens space; expected an invertible matrix");
    return std::make_shared<AffineMap>(linear, translation);
  };
}

MakeMap parseTwist(Parameters& in) {
  const JsonNode node = in.node();
  node.onlyKeys({"type", "origin", "axis", "degrees_per_unit"});
  return [node, origin = in.origin(), axis = in.vec3("axis"), k = in.number("degrees_per_unit")](double frame) {
    return std::make_shared<TwistMap>(origin.at(frame), unit(axis, frame, node, "axis"), radians(k.at(frame)));
  };
}

MakeMap parseTaper(Parameters& in) {
  const JsonNode node = in.node();
  node.onlyKeys({"type", "origin", "axis", "per_unit"});
  return [node, origin = in.origin(), axis = in.vec3("axis"), k = in.number("per_unit")](double frame) {
    return std::make_shared<TaperMap>(origin.at(frame), unit(axis, frame, node, "axis"), k.at(frame));
  };
}

MakeMap parseBend(Parameters& in) {
  const JsonNode node = in.node();
  node.onlyKeys({"type", "origin", "axis", "toward", "degrees_per_unit", "range"});
  Animated<double> low(-kInfinity), high(kInfinity);
  if (const auto range = node.find("range")) {
    const auto ends = in.list<double>(
        *range,
        [](const JsonNode& pair) {
          if (pair.size() != 2) throw pair.error("has " + std::to_string(pair.size()) + " numbers, expected [lo, hi]");
          return std::vector{pair.at(0), pair.at(1)};
        },
        readNumber);
    low = ends[0], high = ends[1];
  }
  return [node, low, high, origin = in.origin(), axis = in.vec3("axis"), toward = in.vec3("toward"),
          k = in.number("degrees_per_unit")](double frame) {
    const Vec3 a = unit(axis, frame, node, "axis"), t = unit(toward, frame, node, "toward");
    const Vec3 across = cross(cross(a, t), a);
    if (!(length(across) > kParallelSine))
      throw node["toward"].error("is parallel to the axis" + atFrame(frame) + "; expected a vector across it");
    if (!(low.at(frame) <= high.at(frame)))
      throw node["range"].error("has lo above hi" + atFrame(frame) + "; expected [lo, hi]");
    return std::make_shared<BendMap>(origin.at(frame), a, across / length(across), radians(k.at(frame)), low.at(frame),
                                     high.at(frame));
  };
}

MakeMap parseWave(Parameters& in) {
  const JsonNode node = in.node();
  node.onlyKeys({"type", "origin", "axis", "direction", "amplitude", "wavelength", "phase"});
  const Animated<double> phase = node.has("phase") ? in.number("phase") : Animated<double>(0.0);
  return [node, phase, origin = in.origin(), axis = in.vec3("axis"), direction = in.vec3("direction"),
          amplitude = in.number("amplitude"), wavelength = in.number("wavelength")](double frame) {
    if (!(wavelength.at(frame) > 0))
      throw node["wavelength"].error("is not positive" + atFrame(frame) + "; expected a length in units");
    return std::make_shared<WaveMap>(origin.at(frame), unit(axis, frame, node, "axis"),
                                     unit(direction, frame, node, "direction"), amplitude.at(frame),
                                     wavelength.at(frame), radians(phase.at(frame)));
  };
}

MakeMap parseFfd(Parameters& in) {
  const JsonNode node = in.node();
  node.onlyKeys({"type", "min", "max", "resolution", "points"});
  const JsonNode counts = node["resolution"];
  if (counts.size() != 3) throw counts.error("has " + std::to_string(counts.size()) + " numbers, expected [l, m, n]");
  std::array<int, 3> resolution;
  std::size_t expected = 1;
  for (int a = 0; a < 3; ++a) expected *= resolution[a] = static_cast<int>(counts.at(a).integer(2, kMostLatticePoints));
  const auto pointsOf = [expected](const JsonNode& list) {
    if (list.size() != expected)
      throw list.error("has " + std::to_string(list.size()) + " points, expected the " + std::to_string(expected) +
                       " of the resolution (x fastest)");
    std::vector<JsonNode> points;
    for (std::size_t i = 0; i < expected; ++i) points.push_back(list.at(i));
    return points;
  };
  const auto points = in.list<Vec3>(node["points"], pointsOf, [](const JsonNode& point) { return point.vec3(); });
  return [node, resolution, points, low = in.vec3("min"), high = in.vec3("max")](double frame) {
    const Vec3 min = low.at(frame), max = high.at(frame);
    for (int a = 0; a < 3; ++a)
      if (!(min[a] < max[a])) throw node["max"].error("is not above min on every axis" + atFrame(frame));
    std::vector<Vec3> now(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) now[i] = points[i].at(frame);
    return std::make_shared<LatticeMap>(min, max, resolution, now);
  };
}

}  // namespace

void SpaceMap::carry(CarriedPoints& points) const {
  for (std::size_t i = 0; i < points.count; ++i) {
    const Vec3 p = CarriedPoints::get(points.p, i);
    const Mat3 j = jacobian(p);
    CarriedPoints::put(map(p), points.p, i);
    for (std::size_t v = 0; v < points.vectors; ++v)
      CarriedPoints::put(j * CarriedPoints::get(points.vector[v], i), points.vector[v], i);
    if (determinant(j) < 0) points.handedness[i] = -points.handedness[i];
  }
}

bool Deformation::rigid() const {
  return std::all_of(steps_.begin(), steps_.end(), [](const auto& step) { return step->rigid(); });
}

bool Deformation::affine() const {
  return std::all_of(steps_.begin(), steps_.end(), [](const auto& step) { return std::isinf(step->lengthScale()); });
}

Point<ObjectSpace> Deformation::map(const Point<AcquisitionSpace>& p0) const {
  Vec3 p = p0.raw();
  for (const auto& step : steps_) p = step->map(p);
  return Point<ObjectSpace>(p);
}

Linear<ObjectSpace, AcquisitionSpace> Deformation::jacobian(const Point<AcquisitionSpace>& p0) const {
  Vec3 p = p0.raw();
  Mat3 total;
  for (std::size_t i = 0; i < steps_.size(); ++i) {
    const Mat3 own = steps_[i]->jacobian(p);
    total = i == 0 ? own : own * total;
    p = steps_[i]->map(p);
  }
  return Linear<ObjectSpace, AcquisitionSpace>(total);
}

Linear<ObjectSpace, AcquisitionSpace> Deformation::differences(const Point<AcquisitionSpace>& p0,
                                                               double object_diameter) const {
  // A later step changes over a length that the steps before it have stretched: taken back by their growth here.
  double change = object_diameter > 0 && std::isfinite(object_diameter) ? object_diameter : 1.0;
  Vec3 p = p0.raw();
  Mat3 total;
  for (const auto& step : steps_) {
    double growth = 0;
    for (const Vec3& row : total.row) growth += dot(row, row);
    change = std::min(change, step->lengthScale() / std::sqrt(growth));
    total = step->jacobian(p) * total;
    p = step->map(p);
  }
  // A power of two; the division is by the distance that the rounded points really have.
  const double epsilon = std::exp2(std::floor(std::log2(kStepOfLength * change)));
  Vec3 column[3];
  for (int a = 0; a < 3; ++a) {
    Vec3 before = p0.raw(), after = p0.raw();
    before[a] -= epsilon;
    after[a] += epsilon;
    column[a] =
        (map(Point<AcquisitionSpace>(after)) - map(Point<AcquisitionSpace>(before))).raw() / (after[a] - before[a]);
  }
  return Linear<ObjectSpace, AcquisitionSpace>(Mat3::fromColumns(column[0], column[1], column[2]));  // Eq. 6
}

namespace {

AnimatedDeformation::BindVertices parseSkin(const JsonNode& node, const std::filesystem::path& folder) {
  node.onlyKeys({"type", "file", "mesh", "animation", "proxy", "loop"});
  SkinSource source;
  source.gltf = std::make_shared<const Gltf>(readGltf(existingFile(node["file"], folder)));
  source.where = node.where();
  source.node = source.gltf->meshNode(node.has("mesh") ? node["mesh"].string() : "", node.where() + "/mesh");
  source.animation =
      source.gltf->animation(node.has("animation") ? node["animation"].string() : "", node.where() + "/animation");
  source.proxy = node.has("proxy") && node["proxy"].boolean();
  source.loop = node.has("loop") && node["loop"].boolean();
  return [source](const AcquisitionMesh& rest, double fps, Reporter& reporter) {
    return skinMotion(source, rest, fps, reporter);
  };
}

AnimatedDeformation::BindVertices parseSequence(const JsonNode& node, const std::filesystem::path& folder) {
  node.onlyKeys({"type", "file"});
  const std::string pattern = node["file"].string();
  if (std::filesystem::path(pattern).filename().string().find('#') == std::string::npos)
    throw node["file"].error("found '" + pattern + "', expected a pattern such as name.####.ply");
  return [file = (folder / pattern).string(), where = node["file"].where()](
             const AcquisitionMesh& rest, double, Reporter&) { return sequenceMotion(file, rest, where); };
}

}  // namespace

struct AnimatedDeformation::Step {
  MakeMap make;
  bool constant = true;
};

AnimatedDeformation AnimatedDeformation::parse(const JsonNode& list, const std::filesystem::path& folder,
                                               Reporter& reporter) {
  static constexpr std::array<MakeMap (*)(Parameters&), 6> kParsers{parseAffine, parseTwist, parseTaper,
                                                                    parseBend,   parseWave,  parseFfd};
  AnimatedDeformation result;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const JsonNode node = list.at(i);
    const std::size_t type =
        node["type"].choice({"affine", "twist", "taper", "bend", "wave", "ffd", "skin", "sequence"});
    if (type >= kParsers.size()) {
      if (i != 0)
        throw node.error("moves the model's own vertices; expected it as the first deformation, and only one such");
      result.bind_ = type == kParsers.size() ? parseSkin(node, folder) : parseSequence(node, folder);
      continue;
    }
    std::vector<double> key_frames;
    Parameters parameters(node, key_frames);
    auto step = std::make_shared<Step>();
    step->make = kParsers[type](parameters);
    step->constant = key_frames.empty();
    // Every key is tried now, so that a fault shows before anything is rendered.
    if (step->constant) key_frames.push_back(0);
    double wall_motion = 0;
    for (const double frame : key_frames) {
      const MapPointer map = step->make(frame);
      if (const auto* lattice = dynamic_cast<const LatticeMap*>(map.get()))
        wall_motion = std::max(wall_motion, lattice->wallMotion() / lattice->lengthScale());
    }
    if (wall_motion > 1e-9)
      reporter.warn(
          node.where() +
          ": control points on the box's walls are moved; points outside the box are left alone, "
          "so the surface tears where it crosses a wall. Make the box hold the whole object, or leave its outer "
          "control points in place");
    result.steps_.push_back(std::move(step));
  }
  return result;
}

Deformation AnimatedDeformation::at(double frame) const {
  std::vector<MapPointer> maps;
  maps.reserve(steps_.size());
  for (const auto& step : steps_) maps.push_back(step->make(frame));
  return Deformation(std::move(maps));
}

bool AnimatedDeformation::constant() const {
  return !movesVertices() && std::all_of(steps_.begin(), steps_.end(), [](const auto& step) { return step->constant; });
}

bool AnimatedDeformation::movesVertices() const {
  return static_cast<bool>(bind_);
}

std::unique_ptr<const VertexMotion> AnimatedDeformation::vertexMotion(const AcquisitionMesh& rest, double fps,
                                                                      Reporter& reporter) const {
  SRF_CHECK(movesVertices());
  return bind_(rest, fps, reporter);
}

}  // namespace srf
