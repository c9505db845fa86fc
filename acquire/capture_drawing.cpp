#include "acquire/capture_drawing.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "acquire/check_lights.h"
#include "base/numeric.h"
#include "base/text.h"

namespace srf {
namespace {

constexpr double kSide = 400, kGap = 20, kHead = 24;  // of a panel, pixels
constexpr double kMargin = 26;
constexpr double kMapWidth = 2 * kSide + kGap, kMapHeight = 0.5 * kMapWidth;
constexpr std::size_t kNamed = 8;   // cameras and lights beyond this go without names
constexpr std::size_t kLined = 48;  // directional lights beyond this go without lines
const char* const kRed = "#d03a2e";
const char* const kGreen = "#2f9e44";
const char* const kBlue = "#2f62c9";
const char* const kLight = "#d99a00";
const char* const kGrey = "#8a8a8a";

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text)
    out += c == '&' ? std::string("&amp;") : c == '<' ? std::string("&lt;") : c == '>' ? "&gt;" : std::string(1, c);
  return out;
}
std::string number(double x) {
  return fixedNumber(x, 1);
}
std::string point(const Vec2& p) {
  return number(p.x) + "," + number(p.y);
}
std::string line(const Vec2& a, const Vec2& b, const std::string& colour, double width = 1) {
  return "<path d=\"M" + point(a) + "L" + point(b) + "\" fill=\"none\" stroke=\"" + colour + "\" stroke-width=\"" +
         number(width) + "\"/>\n";
}
std::string dot(const Vec2& at, const std::string& colour) {
  return "<circle cx=\"" + number(at.x) + "\" cy=\"" + number(at.y) + "\" r=\"3\" fill=\"" + colour + "\"/>\n";
}
std::string words(const Vec2& at, const std::string& text, const std::string& colour = "#444",
                  const std::string& anchor = "start") {
  return "<text x=\"" + number(at.x) + "\" y=\"" + number(at.y) + "\" fill=\"" + colour + "\" text-anchor=\"" + anchor +
         "\">" + escaped(text) + "</text>\n";
}
std::string arrow(const Vec2& a, const Vec2& b, const std::string& colour) {
  const double dx = b.x - a.x, dy = b.y - a.y, length = std::hypot(dx, dy);
  std::string out = line(a, b, colour, 1.6);
  if (length < 4) return out + dot(b, colour);  // towards the eye or away from it
  const double ux = dx / length * 5, uy = dy / length * 5;
  return out + "<path d=\"M" + point(b) + "L" + point({b.x - ux - 0.5 * uy, b.y - uy + 0.5 * ux}) + "L" +
         point({b.x - ux + 0.5 * uy, b.y - uy - 0.5 * ux}) + "Z\" fill=\"" + colour + "\"/>\n";
}

/// Acquisition space along one axis, the scale that of all panels.
struct Panel {
  double left = 0;
  int right_axis = 0, up_axis = 1;
  std::string title, right_name, up_name;
  Vec3 middle;
  double scale = 1;  // pixels a unit
  Vec2 at(const Vec3& p) const {
    return {left + 0.5 * kSide + scale * (p[right_axis] - middle[right_axis]),
            kHead + 0.5 * kSide - scale * (p[up_axis] - middle[up_axis])};
  }
};

struct Scene {
  const Capture& capture;
  CameraAxes axes;
  Vec3 center;
  double ring = 1;  // radius on which directional lights stand
  double mark = 1;  // length of a camera's axes, units
};

Vec3 placeOf(const Scene& scene, const CaptureLight& light) {
  return light.kind == LightKind::point ? light.position.raw() : scene.center + scene.ring * light.direction.raw();
}

std::string drawCamera(const Scene& scene, const CaptureView& view, const Panel& panel, bool named) {
  const Camera<AcquisitionSpace>& camera = view.camera;
  const Vec3 center = camera.center().raw(), forward = camera.forward().raw();
  const double w = camera.lens.width, h = camera.lens.height;
  std::string out;
  std::vector<Vec2> corners;
  for (const Vec2& pixel : {Vec2{0, 0}, Vec2{w, 0}, Vec2{w, h}, Vec2{0, h}, Vec2{0.5 * w, 0}}) {
    const auto ray = camera.ray(pixel);
    if (!ray) break;  // beyond the lens
    const Vec3 d = ray->direction.raw();
    corners.push_back(panel.at(ray->origin.raw() + 1.6 * scene.mark / std::max(0.2, srf::dot(d, forward)) * d));
  }
  const Mat3& r = camera.pose.rotation().raw();
  if (corners.size() == 5) {
    std::string path = "M" + point(corners[0]);
    for (int i = 1; i < 4; ++i) path += "L" + point(corners[static_cast<std::size_t>(i)]);
    path += "Z";
    if (!camera.lens.isOrthographic())
      for (int i = 0; i < 4; ++i)
        path += "M" + point(panel.at(center)) + "L" + point(corners[static_cast<std::size_t>(i)]);
    const Vec3 up = -1.0 * (r * Vec3{0, 1, 0});
    const Vec2 tip{panel.at(up).x - panel.at(Vec3{}).x, panel.at(up).y - panel.at(Vec3{}).y};
    const Vec2& edge = corners[4];
    path += "M" + point(edge) + "L" + point({edge.x + 0.5 * scene.mark * tip.x, edge.y + 0.5 * scene.mark * tip.y});
    out += "<path d=\"" + path + "\" fill=\"none\" stroke=\"" + kGrey + "\" stroke-width=\"0.8\"/>\n";
  }
  const double sign = scene.axes == CameraAxes::opencv ? 1 : -1;
  const std::array<std::pair<Vec3, std::pair<const char*, const char*>>, 3> axes{
      {{{1, 0, 0}, {"x", kRed}}, {{0, sign, 0}, {"y", kGreen}}, {{0, 0, sign}, {"z", kBlue}}}};
  const Vec2 from = panel.at(center);
  for (const auto& [axis, look] : axes) {
    const Vec2 to = panel.at(center + scene.mark * (r * axis));
    out += arrow(from, to, look.second);
    if (named && std::hypot(to.x - from.x, to.y - from.y) > 8)
      out += words({to.x + 0.3 * (to.x - from.x) - 3, to.y + 0.3 * (to.y - from.y) + 4}, look.first, look.second);
  }
  if (named) out += words({from.x + 5, from.y - 5}, view.name, "#222");
  return out;
}

std::string drawPanel(const Scene& scene, const Panel& panel) {
  const Capture& capture = scene.capture;
  std::string out = "<rect x=\"" + number(panel.left) + "\" y=\"" + number(kHead) + "\" width=\"" + number(kSide) +
                    "\" height=\"" + number(kSide) + "\" fill=\"#fafafa\" stroke=\"#ddd\"/>\n" +
                    words({panel.left + 4, kHead - 8}, panel.title, "#222");
  if (capture.bounds) {
    const Vec2 a = panel.at(capture.bounds->min), b = panel.at(capture.bounds->max);
    out += "<rect x=\"" + number(a.x) + "\" y=\"" + number(b.y) + "\" width=\"" + number(b.x - a.x) + "\" height=\"" +
           number(a.y - b.y) + "\" fill=\"#e8e8e8\" stroke=\"#aaa\"/>\n";
  }
  const Vec2 center = panel.at(scene.center), origin = panel.at({});
  std::size_t directional = 0;
  for (const CaptureLight& light : capture.lights) directional += light.kind == LightKind::directional;
  for (const CaptureLight& light : capture.lights) {
    if (light.kind == LightKind::captured) continue;
    const Vec2 at = panel.at(placeOf(scene, light));
    if (light.kind == LightKind::directional && directional <= kLined)
      out += line(at, {at.x + 0.3 * (center.x - at.x), at.y + 0.3 * (center.y - at.y)}, kLight);
    out += dot(at, kLight);
    if (capture.lights.size() <= kNamed) out += words({at.x + 5, at.y + 4}, light.name, kLight);
  }
  for (const CaptureView& view : capture.views) out += drawCamera(scene, view, panel, capture.views.size() <= kNamed);
  if (origin.x > panel.left && origin.x < panel.left + kSide && origin.y > kHead && origin.y < kHead + kSide)
    out += line({origin.x - 4, origin.y}, {origin.x + 4, origin.y}, "#222") +
           line({origin.x, origin.y - 4}, {origin.x, origin.y + 4}, "#222") +
           words({origin.x + 5, origin.y + 12}, "0", "#222");
  // Which way the panel looks, and how long a unit is.
  const Vec2 corner{panel.left + 10, kHead + kSide - 10};
  out += arrow(corner, {corner.x + 30, corner.y}, "#222") + arrow(corner, {corner.x, corner.y - 30}, "#222") +
         words({corner.x + 34, corner.y + 4}, panel.right_name, "#222") +
         words({corner.x - 4, corner.y - 34}, panel.up_name, "#222");
  const double wanted = 80 / panel.scale, power = std::pow(10, std::floor(std::log10(wanted)));
  const double bar = power * (wanted >= 5 * power ? 5 : wanted >= 2 * power ? 2 : 1);
  const Vec2 end{panel.left + kSide - 10, kHead + kSide - 10};
  return out + line({end.x - bar * panel.scale, end.y}, end, "#222", 2) +
         words({end.x, end.y - 5}, shortNumber(bar) + " " + capture.units, "#222", "end");
}

/// The latitude-longitude map of doc/conventions.md: +z up, +x in the middle, +y a quarter to the left.
std::string drawMap(const Scene& scene, double top) {
  const auto at = [&](const Vec3& d) {
    return Vec2{kMapWidth * (0.5 - std::atan2(d.y, d.x) / (2 * kPi)),
                top + kMapHeight * std::acos(std::clamp(d.z, -1.0, 1.0)) / kPi};
  };
  std::string out = words({4, top - 8}, "environment map: what the object sees about it", "#222") +
                    "<rect x=\"0\" y=\"" + number(top) + "\" width=\"" + number(kMapWidth) + "\" height=\"" +
                    number(kMapHeight) + "\" fill=\"#fafafa\" stroke=\"#ddd\"/>\n";
  out += line({0, top + 0.5 * kMapHeight}, {kMapWidth, top + 0.5 * kMapHeight}, "#e0e0e0");
  for (const double share : {0.25, 0.5, 0.75})
    out += line({share * kMapWidth, top}, {share * kMapWidth, top + kMapHeight}, "#e0e0e0");
  const double level = top + 0.5 * kMapHeight + 14;
  out += words({3, level}, "-x", "#222") + words({0.25 * kMapWidth + 3, level}, "+y", "#222") +
         words({0.5 * kMapWidth + 3, level}, "+x", "#222") + words({0.75 * kMapWidth + 3, level}, "-y", "#222") +
         words({kMapWidth - 3, level}, "-x", "#222", "end") +
         words({3, top + 14}, "+z: all of the upper edge", "#222") +
         words({3, top + kMapHeight - 5}, "-z: all of the lower edge", "#222");
  const Point<AcquisitionSpace> center(scene.center);
  for (const CaptureView& view : scene.capture.views) {
    const Vec2 p = at(view.camera.viewDirection(center).raw());
    out += "<rect x=\"" + number(p.x - 3) + "\" y=\"" + number(p.y - 3) +
           "\" width=\"6\" height=\"6\" fill=\"none\" stroke=\"" + kBlue + "\"/>\n";
    if (scene.capture.views.size() <= kNamed) out += words({p.x + 6, p.y - 4}, view.name, kBlue);
  }
  for (const CaptureLight& light : scene.capture.lights) {
    if (light.kind == LightKind::captured) continue;
    const Vec2 p = at(light.directionFrom(center).raw());
    out += dot(p, kLight);
    if (scene.capture.lights.size() <= kNamed) out += words({p.x + 5, p.y + 4}, light.name, kLight);
  }
  return out;
}

}  // namespace

std::string captureDrawing(const Capture& capture, CameraAxes axes) {
  Scene scene{capture, axes, objectCentre(capture).raw()};
  Box<AcquisitionSpace> box;
  box.extend(Point<AcquisitionSpace>(scene.center));
  if (capture.bounds)
    for (const Vec3& corner : {capture.bounds->min, capture.bounds->max}) box.extend(Point<AcquisitionSpace>(corner));
  double reach = 0;
  for (const CaptureView& view : capture.views) {
    box.extend(view.camera.center());
    reach = std::max(reach, length(view.camera.center().raw() - scene.center));
  }
  if (!(reach > 0)) reach = capture.bounds ? capture.bounds->diameter() : 1;
  scene.ring = 1.1 * reach;
  scene.mark = (capture.views.size() <= kNamed ? 0.2 : 0.1) * reach;
  for (const CaptureLight& light : capture.lights)
    if (light.kind != LightKind::captured) box.extend(Point<AcquisitionSpace>(placeOf(scene, light)));
  const double widest = maxComponent(box.max - box.min) + 2 * scene.mark;
  const double scale = (kSide - 2 * kMargin) / widest;
  const Vec3 middle = box.center().raw();
  const Panel above{0, 0, 1, "from above, along -z", "x", "y", middle, scale};
  const Panel side{kSide + kGap, 0, 2, "from the side, along +y", "x", "z", middle, scale};
  const double top = kHead + kSide + 2 * kHead, width = kMapWidth, height = top + kMapHeight + 36;
  const std::string cameras = std::string("cameras: x red, y green, z blue (") +
                              (axes == CameraAxes::opencv ? "OpenCV: y down, z forward" : "OpenGL: y up, z backward") +
                              "), a flag at the picture's upper edge; in the map blue squares";
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-2 -2 " + number(width + 4) + " " + number(height + 4) +
         "\" width=\"" + number(width + 4) + "\" height=\"" + number(height + 4) +
         "\" font-family=\"sans-serif\" font-size=\"11\">\n<rect x=\"-2\" y=\"-2\" width=\"100%\" height=\"100%\" "
         "fill=\"#fff\"/>\n" +
         drawPanel(scene, above) + drawPanel(scene, side) + drawMap(scene, top) +
         words({4, top + kMapHeight + 16}, cameras) +
         words({4, top + kMapHeight + 31},
               "lights: yellow; those of a direction alone on a ring, with a line towards the object") +
         "</svg>\n";
}

}  // namespace srf
