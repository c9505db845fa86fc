// glTF 2.0 (.gltf with data URIs or files beside it, .glb): what moves. Nodes, meshes with skins and morph targets,
// animations, cameras, punctual lights; materials and pictures are not looked at. Everything is in the file's own space
// (right-handed, +y up, metres) as plain triples; gltf_pose.h evaluates it, and objectFromGltf() leads out of it.
// Hostile files end in an Error: every index, offset, stride, count and type is checked on reading, so that later code
// indexes without looking.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/mesh.h"
#include "base/transform.h"

namespace srf {

/// x -> linear x + translation.
struct AffineTransform {
  Mat3 linear;
  Vec3 translation;
  friend Vec3 operator*(const AffineTransform& m, const Vec3& p) { return m.linear * p + m.translation; }
  friend AffineTransform operator*(const AffineTransform& a, const AffineTransform& b) {
    return {a.linear * b.linear, a * b.translation};
  }
};

/// From glTF's axes (+y up) to ours (+z up): (x, y, z) -> (x, -z, y), a quarter turn about x, as Blender has it too.
inline Vec3 objectFromGltf(const Vec3& p) {
  return {p.x, -p.z, p.y};
}
inline Vec3 gltfFromObject(const Vec3& p) {
  return {p.x, p.z, -p.y};
}

struct GltfNode {
  std::string name;
  int parent = -1;
  int mesh = -1, skin = -1, camera = -1, light = -1;  ///< -1: none
  std::optional<AffineTransform> matrix;              ///< else translation * rotation * scale
  Vec3 translation, scale{1, 1, 1};
  Quaternion rotation;          ///< unit
  std::vector<double> weights;  ///< of morph targets; as many as its mesh has
};

/// All primitives of a mesh, one after another.
struct GltfMesh {
  std::string name;
  std::vector<Vec3> positions;
  std::vector<std::vector<Vec3>> targets;  ///< of each morph target: displacement of every vertex
  std::vector<Triangle> triangles;
  int influences = 0;                 ///< joints of a vertex; 0: no skin
  std::vector<std::uint16_t> joints;  ///< [vertex][influence], of the skin
  std::vector<double> joint_weights;  ///< [vertex][influence], summing to 1 or all 0
  /// What `_SRF_INDEX` and the second texture coordinate's u hold for each vertex; empty where a primitive lacks it.
  std::vector<double> srf_index, texture_index;
};

struct GltfSkin {
  std::vector<int> joints;                    ///< nodes
  std::vector<AffineTransform> inverse_bind;  ///< of each joint
};

enum class GltfPath { translation, rotation, scale, weights };
enum class GltfInterpolation { step, linear, cubic };
struct GltfChannel {
  int node;
  GltfPath path;
  GltfInterpolation interpolation;
  int components;              ///< of a value: 3, 4, or the number of morph targets
  std::vector<double> times;   ///< seconds, rising strictly
  std::vector<double> values;  ///< [key][components]; cubic: [key][in-tangent, value, out-tangent][components]
};
struct GltfAnimation {
  std::string name;
  std::vector<GltfChannel> channels;
};

struct GltfCamera {
  std::string name;
  bool perspective;
  double yfov;  ///< radians; orthographic: half the picture's height in units
};
struct GltfLight {
  std::string name;
  std::string type;  ///< "point", "directional", "spot"
  Vec3 colour{1, 1, 1};
  double intensity = 1;
  bool ranged = false;  ///< has a `range`
};

struct Gltf {
  std::filesystem::path file;
  std::uint64_t content_hash = 0;  ///< of the file and its buffers
  std::vector<GltfNode> nodes;
  std::vector<int> order;  ///< of all nodes, parents before their children
  std::vector<GltfMesh> meshes;
  std::vector<GltfSkin> skins;
  std::vector<GltfAnimation> animations;
  std::vector<GltfCamera> cameras;
  std::vector<GltfLight> lights;

  /// The animation of that name; empty: the only one, or none (nullptr) where there is none. Throws badInput naming
  /// `where`, and listing the names, where it is not there or not the only one.
  const GltfAnimation* animation(const std::string& name, const std::string& where) const;
  /// The node that carries the mesh of that name (or is itself so named); empty: the only node with a mesh. Throws as
  /// above.
  int meshNode(const std::string& name, const std::string& where) const;
  /// The same for cameras and lights.
  int cameraNode(const std::string& name, const std::string& where) const;
  int lightNode(const std::string& name, const std::string& where) const;
};

/// Throws bad_input naming the file, the place (JSON pointer) and what is wrong.
Gltf readGltf(const std::filesystem::path& file);

}  // namespace srf
