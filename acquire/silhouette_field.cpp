#include "acquire/silhouette_field.h"

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/numeric.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr double kSlack = 1.0;  // pixels that a silhouette's distance may jump by between pixels (thin parts)
constexpr double kDeep = 2.0;   // cells: views deeper inside than this do not matter at the surface
constexpr double kEnd = 0.02;   // of an edge: vertices stay this far from its ends, so that no triangle has zero area
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

// a x + b y + c z + d, in an order of its own: a corner has the same bits from every brick.
struct Affine {
  double a, b, c, d;
  double at(const Vec3& p) const { return a * p.x + (b * p.y + (c * p.z + d)); }
};

bool distorted(const Intrinsics& lens) {
  return lens.model != CameraModel::pinhole && lens.model != CameraModel::orthographic;
}

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
    views_.push_back({cameras[i], silhouettes[i], stretchOf(cameras[i].lens)});
}

// The octree walk over one lattice.
class SilhouetteField::Carver {
 public:
  // `lipschitz`: how fast a silhouette's distance may change from pixel to pixel. 1 for exact distances; interpolated
  // ones are bounded by sqrt(2).
  Carver(const SilhouetteField& field, const Lattice& lattice, double lipschitz)
      : field_(field), lattice_(lattice), lipschitz_(lipschitz) {
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
    if (to_bounds > radius) return;

    Node next = node;
    int outside = 0, unsure = 0, unsure_whole = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint16_t view = views[i];
      const Verdict verdict = judge(view, center, radius);
      if (verdict == Verdict::unseen) {
        next.missed += views_[view].whole;
      } else if (verdict == Verdict::inside) {
        ++next.seen;
      } else {
        views.push_back(view);
        outside += verdict == Verdict::outside;
        unsure += verdict == Verdict::unsure;
        unsure_whole += verdict == Verdict::unsure && views_[view].whole;
      }
    }
    const auto listed = static_cast<std::uint32_t>(views.size() - end);
    const std::uint32_t most_seen = next.seen + listed, least_seen = most_seen - unsure;
    const bool kept = outside <= field_.tolerance_ && most_seen > 0 && next.missed <= most_seen;
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

  // phi at a lattice position, from the views that matter there.
  double value(const Node& node, std::span<const std::uint16_t> views, const Vec3& p) const {
    double largest[kMostTolerance + 1];
    const int count = field_.tolerance_ + 1;
    std::fill(largest, largest + count, -kDeep * lattice_.cell);
    std::uint32_t seen = node.seen, missed = node.missed;
    for (const std::uint16_t index : views) {
      const LatticeView& view = views_[index];
      double x, y, unit = view.unit;
      if (!project(index, p, x, y, unit) || !(x >= 0 && y >= 0 && x <= view.width && y <= view.height)) {
        missed += view.whole;
        continue;
      }
      ++seen;
      double d = field_.views_[index].silhouette->at(x, y) * unit;
      for (int k = 0; k < count; ++k)
        if (d > largest[k]) std::swap(d, largest[k]);
    }
    double phi = largest[count - 1];
    if (seen == 0 || missed > seen) phi = std::max(phi, lattice_.cell);
    return std::max(phi, boundsDistance(p));
  }

  // The part of the surface in a brick; nothing is added where it has none.
  void addBrick(const Node& node, std::span<const std::uint16_t> views, std::vector<IsoBrick>& bricks,
                std::vector<Point<AcquisitionSpace>>& vertices) const {
    double phi[kBrickCorners];
    IsoBrick brick;
    for (int z = 0; z <= kBrick; ++z)
      for (int y = 0; y <= kBrick; ++y)
        for (int x = 0; x <= kBrick; ++x) {
          const int corner = brickCorner(x, y, z);
          phi[corner] = value(node, views, {double(node.x + x), double(node.y + y), double(node.z + z)});
          if (phi[corner] < 0) brick.inside[corner / 64] |= std::uint64_t{1} << (corner % 64);
        }
    int inside = 0;
    for (int corner = 0; corner < kBrickCorners; ++corner) inside += brick.isInside(corner);
    if (inside == 0 || inside == kBrickCorners) return;
    brick.place = {node.x / kBrick, node.y / kBrick, node.z / kBrick};
    brick.first_vertex = static_cast<std::uint32_t>(vertices.size());
    for (int axis = 0; axis < 3; ++axis)
      for (int bit = 0; bit < kBrick * kBrick * kBrick; ++bit) {
        const int x = bit % kBrick, y = bit / kBrick % kBrick, z = bit / (kBrick * kBrick);
        const int a = brickCorner(x, y, z), b = brickCorner(x + (axis == 0), y + (axis == 1), z + (axis == 2));
        if (brick.isInside(a) == brick.isInside(b)) continue;
        brick.crossed[axis] |= std::uint64_t{1} << bit;
        Vec3 p{double(node.x + x), double(node.y + y), double(node.z + z)};
        const double start = p[axis], first = crossing(phi[a], phi[b]);
        // One step of false position: the maximum of several cones has creases, where the first guess is off.
        p[axis] = start + first;
        const double middle = value(node, views, p);
        const double t = (middle < 0) == (phi[a] < 0) ? first + (1 - first) * crossing(middle, phi[b])
                                                      : first * crossing(phi[a], middle);
        p[axis] = start + std::clamp(t, kEnd, 1 - kEnd);
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
  enum class Verdict { inside, outside, undecided, unsure, unseen };  // unsure: partly outside the picture

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

  // What a view says of a whole ball.
  Verdict judge(std::uint16_t index, const Vec3& center, double radius) const {
    const LatticeView& view = views_[index];
    const View& source = field_.views_[index];
    double reach = source.stretch * radius, nearest = 1;  // pixels; weight of the ball's nearest point
    if (source.camera.lens.model == CameraModel::opencv_fisheye) {
      const double away = length(inCamera(view, center).raw());
      nearest = away - radius;
      if (!(nearest > 1e-6 * radius)) return Verdict::unsure;
      reach = source.stretch * std::asin(radius / away);
    } else if (!source.camera.lens.isOrthographic()) {
      const Vec3 c = inCamera(view, center).raw();
      if (c.z <= -radius) return Verdict::unseen;
      nearest = c.z - radius;
      if (!(nearest > 1e-6 * radius)) return Verdict::unsure;
      // |d(x/z, y/z)| <= |d| sqrt(1 + (x^2 + y^2) / z^2) / (z - |d|)
      reach *= std::sqrt(1 + (c.x * c.x + c.y * c.y) / (c.z * c.z)) / nearest;
    }
    double x, y, unit = view.unit;
    if (!project(index, center, x, y, unit)) return Verdict::unsure;
    if (x + reach < 0 || y + reach < 0 || x - reach > view.width || y - reach > view.height) return Verdict::unseen;
    if (x - reach < 0 || y - reach < 0 || x + reach > view.width || y + reach > view.height) return Verdict::unsure;
    const double d = source.silhouette->at(x, y), most = lipschitz_ * reach + kSlack;
    if (d > most) return Verdict::outside;
    if (d < -most - kDeep * lattice_.cell / (view.unit * nearest)) return Verdict::inside;
    return Verdict::undecided;
  }

  const SilhouetteField& field_;
  const Lattice& lattice_;
  double lipschitz_;
  std::vector<LatticeView> views_;
};

Box<AcquisitionSpace> SilhouetteField::occupied(const Lattice& lattice) const {
  const Carver carver(*this, lattice, 1.0);
  std::vector<Box<AcquisitionSpace>> parts(Carver::kParts * Carver::kParts * Carver::kParts);
  carver.walkAll(nullptr, [&](std::size_t part) {
    return [&, part](Carver::Kind, const Carver::Node& node, std::span<const std::uint16_t>) {
      const Vec3 low{double(node.x), double(node.y), double(node.z)};
      parts[part].extend(lattice.at(low));
      parts[part].extend(lattice.at(low + double(node.size) * Vec3{1, 1, 1}));
    };
  });
  Box<AcquisitionSpace> box;
  for (const auto& part : parts)
    if (!part.empty()) box.extend(Point<AcquisitionSpace>(part.min)), box.extend(Point<AcquisitionSpace>(part.max));
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
