// The deformable model of an SRF (M7, M9): triangles or elliptical surfels whose points carry {p0, r0}, and which
// captured views see each point at rest. Made once by `srf model`, stored in X.srf/models.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "base/mesh.h"
#include "base/reporter.h"
#include "field/capture.h"
#include "field/srf_folder.h"
#include "model/local_frame.h"

namespace srf {

enum class ModelKind { mesh, surfels };

/// One bit for each point and view: is the point seen, at rest.
class VisibilityBits {
 public:
  VisibilityBits() = default;
  VisibilityBits(std::size_t points, std::size_t views)
      : views_(views), words_((views + 63) / 64), bits_(points * words_, 0) {}
  bool get(std::size_t point, std::size_t view) const { return bits_[point * words_ + view / 64] >> (view % 64) & 1; }
  void set(std::size_t point, std::size_t view) {
    bits_[point * words_ + view / 64] |= std::uint64_t{1} << (view % 64);
  }
  std::size_t views() const { return views_; }
  std::size_t wordsPerPoint() const { return words_; }
  const std::uint64_t* row(std::size_t point) const { return bits_.data() + point * words_; }
  std::vector<std::uint64_t>& words() { return bits_; }
  const std::vector<std::uint64_t>& words() const { return bits_; }

 private:
  std::size_t views_ = 0, words_ = 0;
  std::vector<std::uint64_t> bits_;
};

struct DeformableModel {
  ModelKind kind = ModelKind::mesh;
  std::string shape;                        ///< "hull", "sphere" or the file it came from
  std::vector<Point<AcquisitionSpace>> p0;  ///< of each point: vertices, or surfel centres
  std::vector<Vec3> r0;                     ///< of each point (Eq. 5); n0 = R0 z points outwards
  std::vector<Triangle> triangles;          ///< kind mesh: of points
  std::vector<float> radius;                ///< kind surfels: rest radius in units; the rest ellipse is a circle
  /// The mesh that surfels were sampled from, and where each sits on it: what lets a mesh sequence move them.
  AcquisitionMesh rest_mesh;
  std::vector<std::uint32_t> anchor_triangle;        ///< kind surfels
  std::vector<std::array<float, 2>> anchor_weights;  ///< b1, b2 on that triangle
  VisibilityBits visible;                            ///< of each point from each view of the field
  double positional_error = 0;  ///< how far the surface may be off, units (half a voxel for a hull)

  std::size_t size() const { return p0.size(); }
  /// The mesh that a mesh sequence moves: the triangles themselves, or what the surfels were sampled from.
  AcquisitionMesh restMesh() const { return kind == ModelKind::mesh ? AcquisitionMesh{p0, triangles, {}} : rest_mesh; }
  Box<AcquisitionSpace> bounds() const {
    Box<AcquisitionSpace> box;
    for (const auto& p : p0) box.extend(p);
    return box;
  }
};

/// Options of `srf model`.
struct ModelOptions {
  ModelKind kind = ModelKind::mesh;
  std::size_t surfels = 0;        ///< about how many; 0: as many as make the radius one pixel footprint, 20k to 400k
  double visibility_bias = 1e-3;  ///< of the diameter: how far along the ray an occluder must lie to count
};

/// Makes the model of a closed or open surface: frames, surfels if asked for, visibility by rays at rest.
DeformableModel buildModel(const AcquisitionMesh& surface, const std::string& shape, double positional_error,
                           const SrfManifest& field, const ModelOptions& options, Reporter& reporter);

/// Writes the model into X.srf/models and names it in the manifest as the active one.
void storeModel(const std::filesystem::path& srf_folder, const DeformableModel& model, const std::string& name);
/// The active model. Throws bad_input where there is none, or where file and field do not fit.
DeformableModel loadModel(const std::filesystem::path& srf_folder, const SrfManifest& manifest);

}  // namespace srf
