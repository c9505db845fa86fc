// A drawing of a capture: where its cameras and lights stand and how they are turned.
#pragma once

#include <string>

#include "field/capture.h"

namespace srf {

/// The axes of a camera that are drawn: as here and in OpenCV (x right, y down, z forward), or as in OpenGL (x right, y
/// up, z backward).
enum class CameraAxes { opencv, opengl };

/// An SVG of three panels. Two show acquisition space from above (along -z) and from the side (along +y) at one scale:
/// each camera as the pyramid of its picture with a flag at the upper edge and its x, y and z axes in red, green and
/// blue; point lights in place; directional ones on a ring about the object, with a line towards it; the capture's box.
/// The third is the latitude-longitude map in which scenes give environments, with the lights and views seen from the
/// object.
std::string captureDrawing(const Capture& capture, CameraAxes axes);

}  // namespace srf
