// Psi: maps of space from acquisition to object space (doc: formats, Deformations), composed in the order of the
// scene's list, and what they do to tangents (Eq. 6, M8). All in double.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/animated.h"
#include "base/json.h"
#include "base/mesh.h"
#include "base/reporter.h"
#include "base/transform.h"
#include "model/mesh_motion.h"

namespace srf {

/// Points on their way through Psi, with up to three vectors at each, as plain arrays: loops over them are made wide.
struct CarriedPoints {
  static constexpr std::size_t kMost = 64;
  std::size_t count = 0;       ///< of points
  std::size_t vectors = 0;     ///< at each
  double p[3][kMost];          ///< by coordinate
  double vector[3][3][kMost];  ///< by vector and coordinate
  double handedness[kMost];    ///< 1 or -1; turned by every step that mirrors there

  using Coordinates = double[3][kMost];
  static Vec3 get(const Coordinates& from, std::size_t i) { return {from[0][i], from[1][i], from[2][i]}; }
  static void put(const Vec3& a, Coordinates& to, std::size_t i) { to[0][i] = a.x, to[1][i] = a.y, to[2][i] = a.z; }
};

/// One step of Psi at one frame: a map of space onto itself.
class SpaceMap {
 public:
  virtual ~SpaceMap() = default;
  virtual Vec3 map(const Vec3& p) const = 0;
  /// The Jacobian D(Psi)(p); one-sided at creases.
  virtual Mat3 jacobian(const Vec3& p) const = 0;
  /// Takes every p to Psi(p), its vectors to D(Psi)(p) times them, and turns the handedness where det D(Psi)(p) < 0.
  virtual void carry(CarriedPoints& points) const;
  /// A length over which the map changes little, units; infinite for affine maps. Sets the step of Eq. 6.
  virtual double lengthScale() const = 0;
  virtual bool rigid() const { return false; }
};

/// Psi at one frame of the animation: the composition of its steps. Immutable and thread-safe.
class Deformation {
 public:
  Deformation() = default;  ///< the identity
  explicit Deformation(std::vector<std::shared_ptr<const SpaceMap>> steps) : steps_(std::move(steps)) {}

  bool identity() const { return steps_.empty(); }
  bool rigid() const;
  bool affine() const;  ///< its Jacobian is the same everywhere
  Point<ObjectSpace> map(const Point<AcquisitionSpace>& p0) const;
  /// The analytic Jacobian, by the chain rule.
  Linear<ObjectSpace, AcquisitionSpace> jacobian(const Point<AcquisitionSpace>& p0) const;
  /// p* of points and what becomes of vectors at them, in one pass. The same bits as `map` gives.
  void carry(CarriedPoints& points) const {
    for (const auto& step : steps_) step->carry(points);
  }
  /// The Jacobian by central differences (Eq. 6), with the step 2^-17 of the length scale of object and map: the check
  /// of the analytic one, and what a map without one would use.
  Linear<ObjectSpace, AcquisitionSpace> differences(const Point<AcquisitionSpace>& p0, double object_diameter) const;

 private:
  std::vector<std::shared_ptr<const SpaceMap>> steps_;
};

/// What a scene's "deformation" list describes over all frames.
class AnimatedDeformation {
 public:
  AnimatedDeformation() = default;
  /// Parses the list; validates keys, types and ranges. `folder`: what relative file names refer to. Warnings (an ffd
  /// whose walls moved) go to the reporter.
  static AnimatedDeformation parse(const JsonNode& list, const std::filesystem::path& folder, Reporter& reporter);

  /// The maps of space at `frame`, without a leading skin or sequence.
  Deformation at(double frame) const;
  bool constant() const;  ///< the same at every frame
  bool none() const { return steps_.empty() && !movesVertices(); }
  /// A leading `skin` or `sequence`: what moves the vertices of the rest mesh before the maps of space apply.
  bool movesVertices() const;
  /// Finds which vertex of the file moves which of `rest`; `fps`: frames a second, for files that count in seconds.
  /// Throws bad_input that names file, vertex and what was found where they do not belong together.
  std::unique_ptr<const VertexMotion> vertexMotion(const AcquisitionMesh& rest, double fps, Reporter& reporter) const;
  using BindVertices = std::function<std::unique_ptr<const VertexMotion>(const AcquisitionMesh&, double, Reporter&)>;

 private:
  struct Step;
  std::vector<std::shared_ptr<const Step>> steps_;
  BindVertices bind_;  ///< empty: no skin, no sequence
};

}  // namespace srf
