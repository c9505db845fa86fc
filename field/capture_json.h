// Cameras and lights as JSON: one way of writing them, shared by transforms.json and an SRF's manifest.json.
#pragma once

#include <functional>

#include "base/json.h"
#include "field/capture.h"

namespace srf {

/// The keys of a lens, for JsonNode::onlyKeys.
#define SRF_LENS_KEYS "camera_model", "w", "h", "fl_x", "fl_y", "cx", "cy", "skew", "k1", "k2", "k3", "k4", "p1", "p2"

/// Sets the lens keys; those that are 0 and may be left out are.
void writeLens(Json& object, const Intrinsics& lens);
/// A lens whose keys stand in the first of `scopes` that has them. `size_from_image` is asked where w and h are
/// missing; where it is empty that is an error.
Intrinsics readLens(const std::vector<JsonNode>& scopes, const std::function<ImageSize()>& size_from_image = {});

/// transform_matrix: camera-to-world with the OpenGL camera.
Json poseJson(const Rigid<AcquisitionSpace, CameraSpace>& pose);
/// Throws where the matrix is not a rotation and a translation within 1e-3.
Rigid<AcquisitionSpace, CameraSpace> readPose(const JsonNode& matrix);

Json lightJson(const CaptureLight& light);
CaptureLight readLight(const JsonNode& node);
Json vec3Json(const Vec3& v);

}  // namespace srf
