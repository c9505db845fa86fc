#include "acquire/silhouette_field.h"

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr double kSlack = 1.0;   // pixels that a silhouette's distance may jump by between pixels (thin parts)
constexpr double kDeep = 2.0;    // cells: views deeper inside than this do not matter at the surface
constexpr double kEnd = 0.02;    // of an edge: vertices stay this far from its ends, so that no triangle has zero area
constexpr double kTouch = 1e-6;  // of a cell: what touches the bounds but for rounding is not passed over
constexpr double kMarginOfStretch = 1.05;  // the lens is sampled, not bounded

// Most pixels that the picture moves by when x/z, y/z move by one (orthographic: x, y; fisheye: the direction, by one
// radian). Lenses are sampled over the picture and a margin around it.
double stretchOf(const Intrinsics& lens) {
  const double focal = std::max(lens.fl_x, lens.fl_y) + std::fabs(lens.skew);
  if (lens.model == CameraModel::pinhole || lens.isOrthographic()) return focal;
  constexpr int kSamples = 24;
  constexpr double kStep = 1e-5, kAround = 0.15;
  const bool fisheye = lens.model == CameraModel::opencv_fisheye;
  double most = focal;
  for (int j = 0; j <= kSamples; ++j)
    for (int i = 0; i <= kSamples; ++i) {
      const auto along = [](int k) { return (1 + 2 * kAround) * k / kSamples - kAround; };
      const auto ray = lens.unproject({along(i) * lens.width, along(j) * lens.height});
      if (!ray || (!fisheye && !(ray->raw().z > 0))) continue;
      const Vec3 p = fisheye ? ray->raw() : ray->raw() / ray->raw().z;
      const Vec3 across = fisheye ? anyPerpendicular(*ray).raw() : Vec3{1, 0, 0};
      const Vec3 down = fisheye ? cross(p, across) : Vec3{0, 1, 0};
      const auto a = lens.project(Point<CameraSpace>(p)), b = lens.project(Point<CameraSpace>(p + kStep * across)),
                 c = lens.project(Point<CameraSpace>(p + kStep * down));
      if (!a || !b || !c) continue;
      // The larger singular value of the 2 x 2 Jacobian.
      const double ax = (b->x - a->x) / kStep, ay = (b->y - a->y) / kStep, dx = (c->x - a->x) / kStep,
                   dy = (c->y - a->y) / kStep, half = 0.5 * (ax * ax + ay * ay + dx * dx + dy * dy);
      most = std::max(most, std::sqrt(half + std::sqrt(std::max(0.0, half * half - square(ax * dy - ay * dx)))));
    }
  return kMarginOfStretch * most;
}

bool distorted(const Intrinsics& lens) {
  return lens.model != CameraModel::pinhole && lens.model != CameraModel::orthographic;
}

double widthOf(const Intrinsics& lens, const Vec3& p) {
  const double across = std::hypot(p.x, p.y);
  return lens.model == CameraModel::opencv_fisheye ? std::atan2(across, p.z) : across / p.z;
}

// The largest length of (x/z, y/z), for a fisheye the largest angle, of rays through the picture of a distorted lens:
// that of its edge. Nothing is known where the lens does not reach the edge.
double widestOf(const Intrinsics& lens) {
  if (!distorted(lens)) return INFINITY;
  constexpr int kSamples = 24;
  double widest = 0;
  for (int k = 0; k <= kSamples; ++k) {
    const double x = double(k) * lens.width / kSamples, y = double(k) * lens.height / kSamples;
    for (const Vec2& edge : {Vec2{x, 0}, Vec2{x, double(lens.height)}, Vec2{0, y}, Vec2{double(lens.width), y}}) {
      const auto ray = lens.unproject(edge);
      if (!ray || (lens.model != CameraModel::opencv_fisheye && !(ray->raw().z > 0))) return INFINITY;
      widest = std::max(widest, widthOf(lens, ray->raw()));
    }
  }
  return kMarginOfStretch * widest;
}

// a x + b y + c z + d, in an order of its own: a corner has the same bits from every brick.
struct Affine {
  double a, b, c, d;
  double at(const Vec3& p) const { return a * p.x + (b * p.y + (c * p.z + d)); }
};

}  // namespace

Lattice latticeAround(const Box<AcquisitionSpace>& box, double cell) {
  const double side = maxComponent(box.max - box.min) + 4 * cell;
  Lattice lattice;
  lattice.cell = cell;
  lattice.size = kBrick;
  while (lattice.size * cell < side) lattice.size *= 2;
  lattice.origin = box.center() - Vector<AcquisitionSpace>(0.5 * lattice.size * cell * Vec3{1, 1, 1});
  return lattice;
}

SilhouetteField::SilhouetteField(std::span<const Camera<AcquisitionSpace>> cameras,
                                 std::span<const SignedSilhouette* const> silhouettes, int tolerance,
                                 const Box<AcquisitionSpace>& bounds)
    : tolerance_(tolerance), bounds_(bounds) {
  for (std::size_t i = 0; i < cameras.size(); ++i)
    views_.push_back({cameras[i], silhouettes[i], stretchOf(cameras[i].lens), widestOf(cameras[i].lens)});
}

// The octree walk over one lattice.
class SilhouetteField::Carver {
 public:
  // `lipschitz`: how fast a silhouette's distance may change from pixel to pixel. 1 for exact distances; interpolated
  // ones are bounded by sqrt(2). Nodes within the box `known` are passed over.
  Carver(const SilhouetteField& field, const Lattice& lattice, double lipschitz,
         const Box<AcquisitionSpace>& known = {})
      : field_(field), lattice_(lattice), lipschitz_(lipschitz), known_(known) {
    for (const View& view : field.views_) {
      // Rows of the camera's axes, acting on lattice coordinates; the origins are subtracted first, far from the
      // world's.
      const Mat3 turn = view.camera.pose.rotation().raw().transposed();
      const Vec3 offset = turn * (lattice.origin - view.camera.pose.origin()).raw();
      LatticeView v{};
      for (int i = 0; i < 3; ++i) {
        const Vec3 row = lattice.cell * turn.row[i];
        v.camera[i] = {row.x, row.y, row.z, offset[i]};
      }
      const Intrinsics& lens = view.camera.lens;
      const auto mix = [](const Affine& x, double s, const Affine& y, double t, const Affine& w, double r) {
        return Affine{s * x.a + t * y.a + r * w.a, s * x.b + t * y.b + r * w.b, s * x.c + t * y.c + r * w.c,
                      s * x.d + t * y.d + r * w.d};
      };
      const Affine one{0, 0, 0, 1}, &w = lens.isOrthographic() ? one : v.camera[2];
      v.pixel_x = mix(v.camera[0], lens.fl_x, v.camera[1], lens.skew, w, lens.cx);
      v.pixel_y = mix(v.camera[0], 0, v.camera[1], lens.fl_y, w, lens.cy);
      v.weight = w;
      v.unit = 1 / lens.fl_x;
      v.width = lens.width, v.height = lens.height;
      v.distorted = distorted(lens);
      v.whole = !view.silhouette->cropped();
      views_.push_back(v);
    }
  }

  struct Node {
    std::uint32_t x, y, z, size;  // cells
    std::uint32_t seen, missed;   // views left out of the list: deep inside; whole, and not seeing the node at all
  };
  enum class Kind { inside, brick };

  // Calls visit(kind, node, views) for what the bounds do not show to lie outside: bricks with the views that are not
  // decided there, and larger nodes that lie inside.
  template <class Visit>
  void walk(const Node& node, std::vector<std::uint16_t>& views, std::size_t begin, const Visit& visit) const {
    const std::size_t end = views.size();
    const double half = 0.5 * node.size;
    const Vec3 center{node.x + half, node.y + half, node.z + half};
    const double radius = half * std::sqrt(3.0) * lattice_.cell;
    const double to_bounds = boundsDistance(center);
    if (to_bounds > radius + kTouch * lattice_.cell) return;
    if (minComponent((lattice_.at(center) - Point<AcquisitionSpace>(known_.min)).raw()) >= half * lattice_.cell &&
        minComponent((Point<AcquisitionSpace>(known_.max) - lattice_.at(center)).raw()) >= half * lattice_.cell)
      return;

    Node next = node;
    int outside = 0, off = 0, unsure = 0, unsure_whole = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint16_t view = views[i];
      const Verdict verdict = judge(view, center, radius);
      if (verdict == Verdict::unseen) {
        next.missed += views_[view].whole;
      } else if (verdict == Verdict::inside) {
        ++next.seen;
      } else {
        views.push_back(view);
        const bool partly = verdict == Verdict::off || verdict == Verdict::unsure;
        outside += verdict == Verdict::outside;
        off += verdict == Verdict::off && views_[view].whole;
        unsure += partly;
        unsure_whole += partly && views_[view].whole;
      }
    }
    const auto listed = static_cast<std::uint32_t>(views.size() - end);
    const std::uint32_t most_seen = next.seen + listed, least_seen = most_seen - unsure;
    // Of the views that are off, no more than the tolerance leaves may see a point of the node; the others miss it.
    const int misses = std::max(0, off - (field_.tolerance_ - outside));
    const bool kept = outside <= field_.tolerance_ && most_seen > 0 && next.missed + 2 * misses <= most_seen;
    const bool inside = listed <= static_cast<std::uint32_t>(field_.tolerance_) && least_seen > 0 &&
                        next.missed + unsure_whole <= least_seen && to_bounds < -radius - kDeep * lattice_.cell;
    if (kept && inside) {
      visit(Kind::inside, next, std::span<const std::uint16_t>());
    } else if (kept && node.size == kBrick) {
      visit(Kind::brick, next, std::span<const std::uint16_t>(views).subspan(end));
    } else if (kept) {
      next.size = node.size / 2;
      for (std::uint32_t child = 0; child < 8; ++child) {
        next.x = node.x + (child & 1) * next.size;
        next.y = node.y + (child >> 1 & 1) * next.size;
        next.z = node.z + (child >> 2) * next.size;
        walk(next, views, end, visit);
      }
    }
    views.resize(end);
  }

  // Walks the whole lattice in parts; part(i) gives the visitor of part i. Parts follow each other in index order.
  static constexpr std::uint32_t kParts = 8;  // along each side
  template <class MakeVisit>
  void walkAll(Reporter::Stage* stage, const MakeVisit& makeVisit) const {
    const std::uint32_t side = std::min(kParts, lattice_.size / kBrick), size = lattice_.size / side;
    parallelFor(side * side * side, 1, [&](std::size_t begin, std::size_t) {
      const auto i = static_cast<std::uint32_t>(begin);
      std::vector<std::uint16_t> views(views_.size());
      for (std::size_t v = 0; v < views.size(); ++v) views[v] = static_cast<std::uint16_t>(v);
      walk({i % side * size, i / side % side * size, i / (side * side) * size, size, 0, 0}, views, 0, makeVisit(begin));
      if (stage) stage->advance();
    });
  }

  // phi at lattice positions of one brick, from the views that matter there. View by view, so that the loops over the
  // positions become vector instructions.
  struct Positions {
    static constexpr int kMost = 3 * kBrick * kBrick * kBrick;  // at most one on every edge that a brick owns
    static_assert(kMost >= kBrickCorners);
    int count = 0;
    double x[kMost], y[kMost], z[kMost];

    void add(const Vec3& p) { x[count] = p.x, y[count] = p.y, z[count] = p.z, ++count; }
    Vec3 at(int i) const { return {x[i], y[i], z[i]}; }
  };
  void values(const Node& node, std::span<const std::uint16_t> views, const Positions& at, double* phi) const {
    const int n = at.count, kept = field_.tolerance_ + 1;
    double largest[kMostTolerance + 1][Positions::kMost];
    for (int k = 0; k < kept; ++k) std::fill(largest[k], largest[k] + n, -kDeep * lattice_.cell);
    std::uint32_t unseen_whole[Positions::kMost] = {}, unseen[Positions::kMost] = {};
    for (const std::uint16_t index : views) {
      const LatticeView& view = views_[index];
      const SignedSilhouette& silhouette = *field_.views_[index].silhouette;
      double x[Positions::kMost], y[Positions::kMost], unit[Positions::kMost], d[Positions::kMost];
      project(index, at, x, y, unit);
      const double width = view.width, height = view.height;
      int blind = 0;
      for (int i = 0; i < n; ++i)
        blind += !((unit[i] > 0) & (x[i] >= 0) & (y[i] >= 0) & (x[i] <= width) & (y[i] <= height));
      if (blind == 0) {
        silhouette.at(x, y, n, d);
        for (int i = 0; i < n; ++i) d[i] *= unit[i];
      } else {
        for (int i = 0; i < n; ++i) {
          const bool sees = unit[i] > 0 && x[i] >= 0 && y[i] >= 0 && x[i] <= width && y[i] <= height;
          d[i] = sees ? silhouette.at(x[i], y[i]) * unit[i] : -kDeep * lattice_.cell;
          unseen[i] += !sees;
          unseen_whole[i] += !sees && view.whole;
        }
      }
      for (int k = 0; k < kept; ++k)
        for (int i = 0; i < n; ++i) {
          const double larger = std::max(largest[k][i], d[i]);
          d[i] = std::min(largest[k][i], d[i]);
          largest[k][i] = larger;
        }
    }
    const auto listed = static_cast<std::uint32_t>(views.size());
    for (int i = 0; i < n; ++i) {
      const std::uint32_t seen = node.seen + listed - unseen[i], missed = node.missed + unseen_whole[i];
      phi[i] = largest[kept - 1][i];
      if (seen == 0 || missed > seen) phi[i] = std::max(phi[i], lattice_.cell);
      phi[i] = std::max(phi[i], boundsDistance(at.at(i)));
    }
  }

  // The box of the nodes that a walk visits and that pass a test.
  template <class Test>
  Box<AcquisitionSpace> boxOfNodes(const Test& passes) const {
    std::vector<Box<AcquisitionSpace>> parts(kParts * kParts * kParts);
    walkAll(nullptr, [&](std::size_t part) {
      return [&, part](Kind kind, const Node& node, std::span<const std::uint16_t> views) {
        if (!passes(kind, node, views)) return;
        const Vec3 low{double(node.x), double(node.y), double(node.z)};
        parts[part].extend(lattice_.at(low));
        parts[part].extend(lattice_.at(low + double(node.size) * Vec3{1, 1, 1}));
      };
    });
    Box<AcquisitionSpace> box;
    for (const auto& part : parts)
      if (!part.empty()) box.extend(Point<AcquisitionSpace>(part.min)), box.extend(Point<AcquisitionSpace>(part.max));
    return box;
  }

  bool hasInsideCorner(const Node& node, std::span<const std::uint16_t> views) const {
    double phi[Positions::kMost];
    values(node, views, cornersOf(node), phi);
    return std::any_of(phi, phi + kBrickCorners, [](double value) { return value < 0; });
  }

  // The part of the surface in a brick; nothing is added where it has none.
  void addBrick(const Node& node, std::span<const std::uint16_t> views, std::vector<IsoBrick>& bricks,
                std::vector<Point<AcquisitionSpace>>& vertices) const {
    Positions at = cornersOf(node);
    double phi[Positions::kMost];
    values(node, views, at, phi);
    IsoBrick brick;
    int inside = 0;
    for (int corner = 0; corner < kBrickCorners; ++corner) {
      brick.inside[corner / 64] |= std::uint64_t{phi[corner] < 0} << (corner % 64);
      inside += phi[corner] < 0;
    }
    if (inside == 0 || inside == kBrickCorners) return;
    brick.place = {node.x / kBrick, node.y / kBrick, node.z / kBrick};
    brick.first_vertex = static_cast<std::uint32_t>(vertices.size());
    struct Edge {
      double start, from, to, first;  // along its axis; phi at its ends; share of it where the first guess lies
      int axis;
    } edges[Positions::kMost];
    at.count = 0;
    for (int axis = 0; axis < 3; ++axis)
      for (int bit = 0; bit < kBrick * kBrick * kBrick; ++bit) {
        const int x = bit % kBrick, y = bit / kBrick % kBrick, z = bit / (kBrick * kBrick);
        const int a = brickCorner(x, y, z), b = brickCorner(x + (axis == 0), y + (axis == 1), z + (axis == 2));
        if (brick.isInside(a) == brick.isInside(b)) continue;
        brick.crossed[axis] |= std::uint64_t{1} << bit;
        Vec3 p{double(node.x + x), double(node.y + y), double(node.z + z)};
        const Edge edge{p[axis], phi[a], phi[b], crossing(phi[a], phi[b]), axis};
        edges[at.count] = edge;
        p[axis] = edge.start + edge.first;
        at.add(p);
      }
    // One step of false position: the maximum of several cones has creases, where the first guess is off.
    values(node, views, at, phi);
    for (int i = 0; i < at.count; ++i) {
      const Edge& edge = edges[i];
      const double t = (phi[i] < 0) == (edge.from < 0) ? edge.first + (1 - edge.first) * crossing(phi[i], edge.to)
                                                       : edge.first * crossing(edge.from, phi[i]);
      Vec3 p = at.at(i);
      p[edge.axis] = edge.start + std::clamp(t, kEnd, 1 - kEnd);
      vertices.push_back(lattice_.at(p));
    }
    bricks.push_back(brick);
  }

 private:
  struct LatticeView {
    Affine camera[3], pixel_x, pixel_y, weight;
    double unit;  // units per pixel at weight one
    int width, height;
    bool distorted, whole;
  };
  // Of points in a ball. Partly out of the picture: off where those in it are outside the silhouette, else unsure.
  enum class Verdict { inside, outside, undecided, off, unsure, unseen };

  static Positions cornersOf(const Node& node) {
    Positions at;
    for (int z = 0; z <= kBrick; ++z)
      for (int y = 0; y <= kBrick; ++y)
        for (int x = 0; x <= kBrick; ++x) at.add({double(node.x + x), double(node.y + y), double(node.z + z)});
    return at;
  }

  static double crossing(double a, double b) { return std::clamp(a / (a - b), kEnd, 1 - kEnd); }

  double boundsDistance(const Vec3& p) const {
    const Vec3 x = lattice_.at(p).raw();
    Vec3 out;
    for (int i = 0; i < 3; ++i) out[i] = std::max(field_.bounds_.min[i] - x[i], x[i] - field_.bounds_.max[i]);
    const double most = maxComponent(out);
    if (most <= 0) return most;
    return std::sqrt(square(std::max(out.x, 0.0)) + square(std::max(out.y, 0.0)) + square(std::max(out.z, 0.0)));
  }

  Point<CameraSpace> inCamera(const LatticeView& view, const Vec3& p) const {
    return {view.camera[0].at(p), view.camera[1].at(p), view.camera[2].at(p)};
  }

  // Pixel of a lattice position; `unit` is scaled to units per pixel there.
  bool project(std::uint16_t index, const Vec3& p, double& x, double& y, double& unit) const {
    const LatticeView& view = views_[index];
    if (view.distorted) {
      const Intrinsics& lens = field_.views_[index].camera.lens;
      const Point<CameraSpace> q = inCamera(view, p);
      const auto pixel = lens.project(q);
      if (!pixel) return false;
      x = pixel->x, y = pixel->y;
      unit *= lens.model == CameraModel::opencv_fisheye ? length(q.raw()) : q.raw().z;
      return true;
    }
    const double w = view.weight.at(p);
    if (!(w > 0)) return false;
    const double inverse = 1 / w;
    x = view.pixel_x.at(p) * inverse;
    y = view.pixel_y.at(p) * inverse;
    unit *= w;
    return true;
  }

  // The same for many; `unit` is 0 where there is no pixel.
  void project(std::uint16_t index, const Positions& at, double* x, double* y, double* unit) const {
    const LatticeView& view = views_[index];
    if (view.distorted) {
      for (int i = 0; i < at.count; ++i) {
        unit[i] = view.unit;
        if (!project(index, at.at(i), x[i], y[i], unit[i])) unit[i] = 0;
      }
      return;
    }
    for (int i = 0; i < at.count; ++i) {
      const Vec3 p{at.x[i], at.y[i], at.z[i]};
      const double w = view.weight.at(p), inverse = 1 / w;
      x[i] = view.pixel_x.at(p) * inverse;
      y[i] = view.pixel_y.at(p) * inverse;
      unit[i] = view.unit * w;
    }
  }

  // What a view says of a whole ball.
  Verdict judge(std::uint16_t index, const Vec3& center, double radius) const {
    const LatticeView& view = views_[index];
    const View& source = field_.views_[index];
    const Intrinsics& lens = source.camera.lens;
    double reach = radius, nearest = 1;  // of what the lens maps to pixels; weight of the ball's nearest point
    if (!lens.isOrthographic()) {
      const Vec3 c = inCamera(view, center).raw();
      if (lens.model == CameraModel::opencv_fisheye) {
        const double away = length(c);
        nearest = away - radius;
        if (!(nearest > 1e-6 * radius)) return Verdict::unsure;
        reach = std::asin(radius / away);
      } else {
        if (c.z <= -radius) return Verdict::unseen;
        nearest = c.z - radius;
        if (!(nearest > 1e-6 * radius)) return Verdict::unsure;
        // |d(x/z, y/z)| <= |d| sqrt(1 + (x^2 + y^2) / z^2) / (z - |d|)
        reach *= std::sqrt(1 + (c.x * c.x + c.y * c.y) / (c.z * c.z)) / nearest;
      }
      if (view.distorted && widthOf(lens, c) - reach > source.widest) return Verdict::unseen;
    }
    reach *= source.stretch;
    double x, y, unit = view.unit;
    if (!project(index, center, x, y, unit)) return Verdict::unsure;
    if (x + reach < 0 || y + reach < 0 || x - reach > view.width || y - reach > view.height) return Verdict::unseen;
    const double d = source.silhouette->at(x, y), most = lipschitz_ * reach + kSlack;
    if (x - reach < 0 || y - reach < 0 || x + reach > view.width || y + reach > view.height)
      return d > most ? Verdict::off : Verdict::unsure;
    if (d > most) return Verdict::outside;
    if (d < -most - kDeep * lattice_.cell / (view.unit * nearest)) return Verdict::inside;
    return Verdict::undecided;
  }

  const SilhouetteField& field_;
  const Lattice& lattice_;
  double lipschitz_;
  Box<AcquisitionSpace> known_;
  std::vector<LatticeView> views_;
};

Box<AcquisitionSpace> SilhouetteField::occupied(const Lattice& lattice) const {
  const Carver carver(*this, lattice, 1.0);
  return carver.boxOfNodes([](Carver::Kind, const Carver::Node&, std::span<const std::uint16_t>) { return true; });
}

Box<AcquisitionSpace> SilhouetteField::extent(const Lattice& lattice, const Box<AcquisitionSpace>& known) const {
  const Carver carver(*this, lattice, 1.0, known);
  Box<AcquisitionSpace> box =
      carver.boxOfNodes([&](Carver::Kind kind, const Carver::Node& node, std::span<const std::uint16_t> views) {
        return kind == Carver::Kind::inside || carver.hasInsideCorner(node, views);
      });
  if (!known.empty()) box.extend(Point<AcquisitionSpace>(known.min)), box.extend(Point<AcquisitionSpace>(known.max));
  return box;
}

AcquisitionMesh SilhouetteField::surface(const Lattice& lattice, Reporter& reporter) const {
  // Distances of exact silhouettes change by at most one a pixel. Should strange masks break that, two bricks may
  // disagree; the bound that interpolation cannot break then decides.
  for (const double lipschitz : {1.0, 1.1 * std::sqrt(2.0)}) {
    const Carver carver(*this, lattice, lipschitz);
    constexpr std::size_t kAll = Carver::kParts * Carver::kParts * Carver::kParts;
    Reporter::Stage stage(reporter, "visual hull", kAll);
    std::vector<std::vector<IsoBrick>> bricks(kAll);
    std::vector<std::vector<Point<AcquisitionSpace>>> vertices(kAll);
    carver.walkAll(&stage, [&](std::size_t part) {
      return [&, part](Carver::Kind kind, const Carver::Node& node, std::span<const std::uint16_t> views) {
        if (kind == Carver::Kind::brick) carver.addBrick(node, views, bricks[part], vertices[part]);
      };
    });
    std::vector<IsoBrick> all_bricks;
    std::vector<Point<AcquisitionSpace>> all_vertices;
    for (std::size_t part = 0; part < kAll; ++part) {
      const auto offset = static_cast<std::uint32_t>(all_vertices.size());
      for (IsoBrick& brick : bricks[part]) {
        brick.first_vertex += offset;
        all_bricks.push_back(brick);
      }
      all_vertices.insert(all_vertices.end(), vertices[part].begin(), vertices[part].end());
    }
    if (auto mesh = joinIsoBricks(all_bricks, std::move(all_vertices))) return *std::move(mesh);
    reporter.debug("the silhouettes' distances are uneven; carving again with wider bounds");
  }
  throw Error(ErrorKind::failed, "the silhouettes' distances are too uneven for a closed surface; check the masks");
}

}  // namespace srf
