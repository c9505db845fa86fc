// `srf explain`: what a scene calls for and what each part of it costs; with --pixel how a pixel comes about: the chain
// (p*, l*, v*) to (p, l, v) with every number in between.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "apps/explain_plan.h"
#include "apps/program.h"
#include "base/numeric.h"
#include "base/text.h"
#include "render/animation.h"

namespace srf {
namespace {

constexpr std::size_t kMostLights = 8;  // listed one by one; of the others only how many

std::string text(const Vec3& a) {
  return format("(%.9g, %.9g, %.9g)", a.x, a.y, a.z);
}
template <class Values>
std::string colorText(const Values& c) {
  return format("%.7g %.7g %.7g", double{c[0]}, double{c[1]}, double{c[2]});
}
void line(int indent, const std::string& name, const std::string& value) {
  std::printf("%*s%-*s %s\n", indent, "", 22 - indent, name.c_str(), value.c_str());
}

double strength(const ExplainedLight& light) {
  double sum = 0;
  for (const LightEntry& entry : light.entries) sum += std::fabs(entry.weight[0] + entry.weight[1] + entry.weight[2]);
  return sum;
}

class Explanation {
 public:
  Explanation(const Scene& scene, int frame, const ExplainedFrame& explained)
      : scene_(scene), psi_(scene.deformation.at(frame)), explained_(explained) {}

  void print(const ExplainedHit& hit) const {
    printHit(hit);
    printLookUp(hit);
    printViews(hit);
    printLights(hit);
    printSum(hit);
  }

 private:
  const CaptureLight& lightOf(std::uint32_t view, std::uint32_t position) const {
    return explained_.field.lights[explained_.field.views[view].lights[position].value];
  }

  void printHit(const ExplainedHit& e) const {
    line(2, "ray", "from " + text(e.ray.origin.raw()) + " along " + text(e.ray.direction.raw()));
    line(2, "p*", text(e.hit.p_star.raw()) + format(", distance %.9g", e.hit.distance));
    const DeformableModel& model = explained_.model;
    std::printf("  made of %d %s:\n", e.hit.count,
                model.kind == ModelKind::surfels ? "overlapping surfels" : "corners of a triangle");
    for (int i = 0; i < e.hit.count; ++i) {
      const std::uint32_t point = e.hit.point[i];
      const Mat3 r0 = rotationFromRodrigues(model.r0[point]).raw();
      const Tangents<ObjectSpace>& t = explained_.tangents[point];
      std::printf("    point %u, weight %.7g\n", point, double{e.hit.weight[i]});
      line(6, "p0", text(model.p0[point].raw()));
      line(6, "Psi(p0)", text(explained_.positions[point].raw()));
      line(6, "r0", text(model.r0[point]));
      line(6, "u0, v0, n0", text(r0.column(0)) + " " + text(r0.column(1)) + " " + text(r0.column(2)));
      line(6, "u, v", text(t.u.raw()) + " " + text(t.v.raw()));
      if (scene_.deformation.movesVertices()) {
        line(6, "sigma", format("%+d, from the mesh that moves the point", t.handedness));
      } else {
        const Vec3 w = psi_.jacobian(model.p0[point]).raw() * r0.column(2);
        line(6, "w", text(w));
        line(6, "sigma", format("%+d, w . (u x v) = %.6g", t.handedness, dot(w, cross(t.u.raw(), t.v.raw()))));
      }
    }
  }

  void printLookUp(const ExplainedHit& e) const {
    const Mat3& r0 = e.hit.acquisition_from_tangent.raw();
    const Vec3 &u = e.hit.tangents.u.raw(), &v = e.hit.tangents.v.raw();
    const TangentChange change = tangentChange(e.hit.tangents);
    const Mat3& l = e.look_up.acquisition_from_object.raw();
    const Mat3 rows = r0.transposed() * l;  // of Eq. 10: (u-bar v-bar sigma n-bar)^T
    std::printf("  look-up\n");
    line(4, "p = p0", text(e.look_up.p.raw()) + "   Eq. 3");
    line(4, "u0, v0, n0", text(r0.column(0)) + " " + text(r0.column(1)) + " " + text(r0.column(2)) + "   blended R0");
    line(4, "u", text(u) + format(", length %.7g   Eq. 6", length(u)));
    line(4, "v", text(v) + format(", length %.7g", length(v)));
    line(4, "stretch, shear",
         format("%.7g to %.7g, %.6g degrees", change.shortest, change.longest, degrees(change.shear)));
    const char* mode = scene_.accuracy.frame == FrameMode::bisector ? "bisector, Eq. 8 and 9" : "polar";
    line(4, "u-bar", text(rows.row[0]) + "   " + (e.look_up.collapsed ? "fallback: u, v are no frame" : mode));
    line(4, "v-bar", text(rows.row[1]));
    line(4, "sigma n-bar", text(rows.row[2]) + format("   Eq. 7, sigma %+d", e.hit.tangents.handedness));
    for (int i = 0; i < 3; ++i) line(4, i == 0 ? "L" : "", text(l.row[i]) + (i == 0 ? "   Eq. 10" : ""));
    line(4, "v*", text(-e.ray.direction.raw()));
    line(4, "v = L v*", text(e.view.raw()));
  }

  void printViews(const ExplainedHit& e) const {
    static constexpr const char* kSeen[] = {"views that see p", "no view sees p: the nearest by angle stands in",
                                            "no picture covers p"};
    std::printf("  %s\n", kSeen[static_cast<int>(e.seen)]);
    for (const ChosenView& c : e.chosen) {
      const StoredView& view = explained_.field.views[c.view];
      const auto at = view.camera.project(e.look_up.p);
      line(4, view.name,
           format("weight %.7g, angle %.5g degrees, penalty %.6g, n0 . v_i %.4g, at pixel (%.3f, %.3f), covered %.4g",
                  c.weight, degrees(c.angle), c.penalty,
                  dot(e.look_up.normal.raw(), view.camera.viewDirection(e.look_up.p).raw()), at ? at->pixel.x : NAN,
                  at ? at->pixel.y : NAN, c.fetch.covered));
    }
  }

  void printLights(const ExplainedHit& e) const {
    if (e.chosen.empty()) return;
    const auto most = std::max_element(e.chosen.begin(), e.chosen.end(),
                                       [](const ChosenView& a, const ChosenView& b) { return a.weight < b.weight; });
    std::vector<const ExplainedLight*> order;
    for (const ExplainedLight& light : e.lights) order.push_back(&light);
    std::stable_sort(order.begin(), order.end(),
                     [](const auto* a, const auto* b) { return strength(*a) > strength(*b); });
    std::printf("  lights of the scene, the strongest first\n");
    static constexpr const char* kKinds[] = {"distant", "near", "captured"};
    for (std::size_t i = 0; i < std::min(order.size(), kMostLights); ++i) {
      const ExplainedLight& light = *order[i];
      std::string row;
      if (light.kind != ExplainedLight::Kind::captured)
        row = "l* " + text(light.direction.raw()) + ", l = L l* " + text(light.look_up.raw()) + "; ";
      for (const LightEntry& entry : light.entries)
        row += lightOf(most->view, entry.light).name + " " + colorText(entry.weight) + "; ";
      line(4, kKinds[static_cast<int>(light.kind)], row);
    }
    if (order.size() > kMostLights) std::printf("    and %zu more\n", order.size() - kMostLights);
    std::uint32_t handle = 0xffffffffu;
    for (const ShadingOperation& operation : e.operations) {
      if (operation.lights == handle) continue;
      handle = operation.lights;
      const auto& merged = explained_.pixel.merged[handle];
      std::string row;
      for (const LightEntry& entry : merged)
        row += lightOf(operation.view, entry.light).name + " " + colorText(entry.weight) + "; ";
      line(4, format("merged, %zu lights", merged.size()), row);
    }
  }

  void printSum(const ExplainedHit& e) const {
    std::printf("  texels: what each counts, and its photograph under these lights\n");
    for (const ExplainedTexel& texel : e.texels)
      line(4, format("%s (%d, %d)", explained_.field.views[texel.view].name.c_str(), texel.x, texel.y),
           format("%.7g x ", double{texel.tap}) + colorText(texel.relit));
    for (std::size_t i = 0; i < e.operations.size(); ++i)
      line(4,
           (i ? "+ " : "  ") + explained_.field.views[e.operations[i].view].name +
               format(" tile %u", e.operations[i].tile),
           colorText(e.results[i]));
    line(2, "color", colorText(e.color));
  }

  const Scene& scene_;
  Deformation psi_;
  const ExplainedFrame& explained_;
};

std::pair<int, int> parsePixel(const std::string& word) {
  int x = 0, y = 0, used = 0;
  if (std::sscanf(word.c_str(), "%d,%d%n", &x, &y, &used) != 2 || used != static_cast<int>(word.size()))
    throw Error(ErrorKind::usage, "found '" + word + "', expected x,y in pixels from the top left", "--pixel");
  return {x, y};
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  using namespace srf;
  Program program("explain",
                  "Tells which effects a scene calls for, why, and what each costs; with --pixel how a pixel "
                  "comes about, with every number in between.");
  std::string scene_file, pixel;
  std::vector<std::string> overrides;
  std::optional<int> frame;
  bool json = false;
  AnimationOptions options;
  CLI::App& app = program.app();
  app.add_option("scene", scene_file, "scene.json")->required();
  app.add_option("--pixel", pixel, "x,y, column and row from the top left: how this pixel comes about");
  app.add_flag("--json", json, "the plan as JSON");
  app.add_option("--srf", options.srf, "the field, X.srf; default: the scene's");
  app.add_option("--frame", frame, "default: the scene's first");
  app.add_option("--set", overrides, "/json/pointer=value: changes the scene; may be repeated")
      ->allow_extra_args(false);
  return program.run(argc, argv, [&](Reporter& reporter) {
    options.memory_bytes = program.memoryBudget();
    const Scene scene = readScene(scene_file, overrides, reporter);
    const int number = frame.value_or(scene.frames.empty() ? 0 : scene.frames.front());
    if (pixel.empty()) {
      const Json plan = planOfFrame(scene, options, number, reporter);
      if (json) {
        std::puts(plan.dump(2).c_str());
      } else {
        printPlan(plan);
      }
      return;
    }
    const auto [x, y] = parsePixel(pixel);
    const ExplainedFrame explained = explainPixel(scene, options, number, x, y, reporter);
    const PixelExplanation& why = explained.pixel;
    std::printf("pixel (%d, %d) of frame %d: %d samples, %zu met the model\n", x, y, number, why.samples,
                why.hits.size());
    const Explanation explanation(scene, number, explained);
    for (std::size_t i = 0; i < why.hits.size(); ++i) {
      std::printf("sample %zu\n", i);
      explanation.print(why.hits[i]);
    }
    std::printf("pixel: the sum of the samples / %d = %.9g %.9g %.9g, alpha %.9g\n", why.samples, double{why.rgba[0]},
                double{why.rgba[1]}, double{why.rgba[2]}, double{why.rgba[3]});
  });
}
