#include "model/gltf_pose.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/parallel.h"

namespace srf {
namespace {

constexpr std::size_t kGrain = 4096;  // vertices a task
// Cosine between quaternions above which their slerp is their normalized mix: both agree to 1e-15 there.
constexpr double kSameRotation = 1 - 1e-10;

void makeUnit(double* q) {
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  // A spline of rotations may pass through 0: the identity stands there.
  if (!(norm > 0))
    q[0] = q[1] = q[2] = 0, q[3] = 1;
  else
    for (int c = 0; c < 4; ++c) q[c] /= norm;
}

// Along the shorter arc (appendix C.3).
void slerp(const double* a, const double* b, double t, double* out) {
  double unit_a[4], unit_b[4], cosine = 0;
  std::copy_n(a, 4, unit_a), std::copy_n(b, 4, unit_b);
  makeUnit(unit_a), makeUnit(unit_b);
  for (int c = 0; c < 4; ++c) cosine += unit_a[c] * unit_b[c];
  const double sign = cosine < 0 ? -1 : 1;
  cosine = std::fabs(cosine);
  double wa = 1 - t, wb = t;
  if (cosine < kSameRotation) {
    const double angle = std::acos(cosine);
    wa = std::sin((1 - t) * angle) / std::sin(angle), wb = std::sin(t * angle) / std::sin(angle);
  }
  for (int c = 0; c < 4; ++c) out[c] = wa * unit_a[c] + sign * wb * unit_b[c];
}

// The channel's value at `seconds`, `components` numbers.
void sample(const GltfChannel& channel, double seconds, double* out) {
  const auto width = static_cast<std::size_t>(channel.components);
  const bool cubic = channel.interpolation == GltfInterpolation::cubic;
  const auto value = [&](std::size_t key, std::size_t part = 1) {  // of a cubic: in-tangent, value, out-tangent
    return &channel.values[(cubic ? 3 * key + part : key) * width];
  };
  const std::vector<double>& times = channel.times;
  const auto after = static_cast<std::size_t>(std::upper_bound(times.begin(), times.end(), seconds) - times.begin());
  const bool rotation = channel.path == GltfPath::rotation;
  if (after == 0 || after == times.size() || channel.interpolation == GltfInterpolation::step) {
    std::copy_n(value(after == 0 ? 0 : after - 1), width, out);
  } else {
    const std::size_t k = after - 1;
    const double h = times[after] - times[k], t = (seconds - times[k]) / h;
    const double *a = value(k), *b = value(after);
    if (cubic) {
      const double t2 = t * t, t3 = t2 * t;
      const double *ma = value(k, 2), *mb = value(after, 0);
      for (std::size_t c = 0; c < width; ++c)
        out[c] = (2 * t3 - 3 * t2 + 1) * a[c] + h * (t3 - 2 * t2 + t) * ma[c] + (3 * t2 - 2 * t3) * b[c] +
                 h * (t3 - t2) * mb[c];
    } else if (rotation) {
      slerp(a, b, t, out);
    } else {
      for (std::size_t c = 0; c < width; ++c) out[c] = a[c] + t * (b[c] - a[c]);
    }
  }
  if (rotation) makeUnit(out);
}

AffineTransform localTransform(const GltfNode& node) {
  if (node.matrix) return *node.matrix;
  const Mat3 turn = rotationFromQuaternion(node.rotation);
  return {
      Mat3::fromColumns(node.scale.x * turn.column(0), node.scale.y * turn.column(1), node.scale.z * turn.column(2)),
      node.translation};
}

}  // namespace

GltfPose poseAt(const Gltf& gltf, const GltfAnimation* animation, double seconds) {
  std::vector<GltfNode> nodes = gltf.nodes;
  static const GltfAnimation kStill;
  for (const GltfChannel& channel : (animation ? *animation : kStill).channels) {
    GltfNode& node = nodes[static_cast<std::size_t>(channel.node)];
    double v[4];
    switch (channel.path) {
      case GltfPath::translation:
        sample(channel, seconds, v);
        node.translation = {v[0], v[1], v[2]};
        break;
      case GltfPath::rotation:
        sample(channel, seconds, v);
        node.rotation = {v[3], v[0], v[1], v[2]};
        break;
      case GltfPath::scale:
        sample(channel, seconds, v);
        node.scale = {v[0], v[1], v[2]};
        break;
      case GltfPath::weights:
        sample(channel, seconds, node.weights.data());
    }
  }
  GltfPose pose;
  pose.world.resize(nodes.size());
  for (const int i : gltf.order) {
    const GltfNode& node = nodes[static_cast<std::size_t>(i)];
    const AffineTransform local = localTransform(node);
    pose.world[static_cast<std::size_t>(i)] =
        node.parent < 0 ? local : pose.world[static_cast<std::size_t>(node.parent)] * local;
  }
  for (GltfNode& node : nodes) pose.weights.push_back(std::move(node.weights));
  return pose;
}

PosedMesh posedMesh(const Gltf& gltf, int node_index, const GltfPose& pose) {
  const auto at = static_cast<std::size_t>(node_index);
  const GltfNode& node = gltf.nodes[at];
  SRF_CHECK(node.mesh >= 0);
  const GltfMesh& mesh = gltf.meshes[static_cast<std::size_t>(node.mesh)];
  std::vector<AffineTransform> joints;
  if (node.skin >= 0) {
    const GltfSkin& skin = gltf.skins[static_cast<std::size_t>(node.skin)];
    for (std::size_t j = 0; j < skin.joints.size(); ++j)
      joints.push_back(pose.world[static_cast<std::size_t>(skin.joints[j])] * skin.inverse_bind[j]);
  }
  const auto influences = static_cast<std::size_t>(joints.empty() ? 0 : mesh.influences);
  PosedMesh posed;
  posed.positions.resize(mesh.positions.size());
  posed.handedness.resize(mesh.positions.size());
  parallelFor(mesh.positions.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      Vec3 p = mesh.positions[v];
      for (std::size_t t = 0; t < mesh.targets.size(); ++t)
        if (pose.weights[at][t] != 0) p += pose.weights[at][t] * mesh.targets[t][v];
      // A skinned mesh is where its joints are, whatever its own node does (3.7.3.3).
      AffineTransform blend{0.0 * Mat3{}, {}};
      double total = 0;
      for (std::size_t k = v * influences; k < (v + 1) * influences; ++k) {
        const double weight = mesh.joint_weights[k];
        if (weight == 0) continue;
        const AffineTransform& joint = joints[mesh.joints[k]];
        blend.linear = blend.linear + weight * joint.linear;
        blend.translation += weight * joint.translation;
        total += weight;
      }
      if (total == 0) blend = pose.world[at];
      posed.positions[v] = blend * p;
      posed.handedness[v] = determinant(blend.linear) < 0 ? -1 : 1;
    }
  });
  return posed;
}

AcquisitionMesh meshFromGltf(const std::filesystem::path& file) {
  const Gltf gltf = readGltf(file);
  const int node = gltf.meshNode("", file.string());
  AcquisitionMesh mesh;
  for (const Vec3& p : posedMesh(gltf, node, poseAt(gltf, nullptr, 0)).positions)
    mesh.positions.emplace_back(objectFromGltf(p));
  mesh.triangles = gltf.meshes[static_cast<std::size_t>(gltf.nodes[static_cast<std::size_t>(node)].mesh)].triangles;
  return mesh;
}

}  // namespace srf
