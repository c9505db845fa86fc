// `srf synth`: a synthetic capture, or the exact picture of a scene of one.
#include <algorithm>
#include <filesystem>
#include <variant>

#include "acquire/synthetic_capture.h"
#include "acquire/synthetic_reference.h"
#include "apps/program.h"
#include "base/error.h"
#include "base/image_io.h"
#include "field/capture_file.h"
#include "render/effects.h"
#include "render/light_set.h"
#include "render/look_up.h"
#include "render/scene.h"

namespace srf {
namespace {

struct ReferenceJob {
  std::filesystem::path scene, capture;
  std::string output, frames;
  std::vector<std::string> overrides;
  ReferenceShadows shadows = ReferenceShadows::deformed;
  int samples = 16;
  int environment_samples = 1024;
};

// The scene's Psi and the renderer's own L.
class SceneWarp : public ReferenceWarp {
 public:
  SceneWarp(const Deformation& psi, FrameMode mode) : psi_(psi), mode_(mode) {}
  Point<ObjectSpace> map(const Point<AcquisitionSpace>& p0) const override { return psi_.map(p0); }
  Linear<ObjectSpace, AcquisitionSpace> jacobian(const Point<AcquisitionSpace>& p0) const override {
    return psi_.jacobian(p0);
  }
  Orthogonal<AcquisitionSpace, ObjectSpace> lookUp(const Linear<ObjectSpace, AcquisitionSpace>& jacobian,
                                                   const Direction<AcquisitionSpace>& n0) const override {
    SurfaceHit hit;
    hit.acquisition_from_tangent = restFrame(n0);
    hit.tangents.u = jacobian * (hit.acquisition_from_tangent * Vector<TangentSpace>(1, 0, 0));
    hit.tangents.v = jacobian * (hit.acquisition_from_tangent * Vector<TangentSpace>(0, 1, 0));
    hit.tangents.handedness = determinant(jacobian) < 0 ? -1 : 1;
    return srf::lookUp(hit, mode_).acquisition_from_object;
  }

 private:
  const Deformation& psi_;
  FrameMode mode_;
};

ReferenceLights referenceLights(const FrameLights& frame, const Capture& capture) {
  ReferenceLights lights;
  for (const DistantLight& l : frame.distant) lights.distant.push_back({l.direction, l.irradiance});
  for (const NearLight& l : frame.near_lights) lights.near_lights.push_back({l.position, l.intensity});
  for (const RestLight& l : frame.rest) lights.rest.push_back({capture.lights[l.light.value], l.scale});
  return lights;
}

void setEffects(const FrameEffects& effects, ReferenceOptions& options) {
  options.lens.reset();
  options.ground.reset();
  if (const auto& lens = effects.lens) options.lens = {lens->aperture, lens->focus};
  if (const auto& ground = effects.ground) options.ground = {ground->height, ground->albedo, ground->shadow_only};
}

void renderReferences(const ReferenceJob& job, const std::string& command, Reporter& reporter) {
  const SyntheticObject object = readSyntheticObject(job.capture);
  const Capture capture = readCapture(job.capture);
  Scene scene = readScene(job.scene, job.overrides, reporter);
  if (scene.deformation.movesVertices())
    throw badInput(job.scene.string() + ": /deformation",
                   "'skin' and 'sequence' move the vertices of a mesh; a reference needs maps of space");
  for (SceneLight& light : scene.lights)
    if (auto* environment = std::get_if<EnvironmentLight>(&light)) {
      // Every texel of a small map. Of a large one, 1024 samples are within 78 dB of 4096 (a studio, on rough plastic).
      const ImageSize size = readImageSize(environment->map);
      environment->samples = size.width * size.height <= job.environment_samples ? 0 : job.environment_samples;
    }
  SrfManifest field;  // what the scene's `captured` lights refer to
  field.lights = capture.lights;
  const LightSet lights(scene, field, reporter);

  ReferenceOptions options;
  options.shadows = job.shadows;
  options.supersampling = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(job.samples)) - 1e-9));
  const std::vector<int> frames = job.frames.empty() ? scene.frames : parseFrames(job.frames, "--frames");
  Reporter::Stage stage(reporter, "frames", frames.size());
  // Of motion, four times the moments that the scene asks for.
  if (auto& blur = scene.effects.motion_blur) blur->samples *= 4;
  for (const int frame : frames) {
    const std::vector<double> moments = momentsOf(scene.effects, frame);
    std::vector<double> sum;
    ImageF picture;
    for (const double moment : moments) {
      const Deformation psi = scene.deformation.at(moment);
      const SceneWarp warp(psi, scene.accuracy.frame);
      setEffects(effectsAt(scene.effects, moment), options);
      picture = renderReference(object, warp, scene.cameraAt(moment), referenceLights(lights.at(moment), capture),
                                options, reporter);
      sum.resize(picture.data().size());
      for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += picture.data()[i];
    }
    for (std::size_t i = 0; i < sum.size(); ++i)
      picture.data()[i] = static_cast<float>(sum[i] / static_cast<double>(moments.size()));
    writeExr(frameFile(job.output, frame), picture,
             {{"command", command},
              {"version", projectVersion()},
              {"shadows", referenceShadowNames()[static_cast<std::size_t>(job.shadows)]}});
    stage.advance();
  }
}

template <class Enum>
CLI::Option* addChoice(CLI::App& app, const std::string& flag, Enum& value, const std::vector<std::string>& names,
                       const std::string& help) {
  return app
      .add_option_function<std::string>(
          flag,
          [&value, &names](const std::string& word) {
            value = static_cast<Enum>(std::find(names.begin(), names.end(), word) - names.begin());
          },
          help)
      ->check(CLI::IsMember(names))
      ->type_name("NAME")
      ->default_str(names[static_cast<std::size_t>(value)]);
}

int run(int argc, char** argv) {
  Program program("synth",
                  "Writes a synthetic capture by formula, or with --reference the exact picture of a scene of one.");
  CLI::App& app = program.app();
  std::string output;
  app.add_option("-o,--output", output, "folder of the capture; with --reference the frames, e.g. truth.####.exr")
      ->required();

  SyntheticCaptureOptions capture;
  static const std::vector<std::string> kLightTypes{"directional", "point"};
  std::vector<CLI::Option*> of_capture{
      addChoice(app, "--object", capture.shape, syntheticShapeNames(), "shape"),
      addChoice(app, "--material", capture.material, syntheticMaterialNames(), "reflectance"),
      app.add_flag("--interreflection", capture.interreflection,
                   "light that matt surfaces throw on each other (lambert, white)"),
      addChoice(app, "--rig", capture.rig, syntheticRigNames(), "how the cameras stand"),
      addChoice(app, "--light-type", capture.light_kind, kLightTypes, "kind of the lights"),
      app.add_option("--views", capture.views, "number of views"),
      app.add_option("--lights", capture.lights, "lights of each view"),
      app.add_option("--size", capture.size, "width and height of a photograph, pixels"),
      app.add_option("--supersampling", capture.supersampling, "n: n x n samples a pixel"),
      app.add_option("--fov", capture.vfov, "vertical field of view, degrees"),
      app.add_option("--distance", capture.distance,
                     "camera to object, units; 0: the object fills 80 % of the picture"),
      app.add_option("--noise", capture.noise, "noise at white, as a share of it, e.g. 0.02"),
      app.add_option("--exposure", capture.exposure,
                     "gain error of the photographs, standard deviation of its logarithm"),
      app.add_option("--saturate", capture.saturation, "most radiance that a photograph holds; 0: no bound"),
      app.add_option("--missing", capture.missing, "share of the photographs left out at random, e.g. 0.2"),
      app.add_option("--mask-error", capture.mask_error, "error of the masks, pixels"),
      app.add_option("--mesh-cells", capture.mesh_cells, "cells of model.ply along the object's longest side"),
      app.add_option("--range-views", capture.range_views, "range views of a laser scanner besides the photographs"),
      app.add_option("--range-noise", capture.range_noise, "of range views: units along the beam, standard deviation"),
      app.add_option("--range-outliers", capture.range_outliers, "of range views: share of stray points, e.g. 0.05"),
      app.add_option("--seed", capture.seed, "of noise, exposure, mask errors, missing photographs and ranges")};

  ReferenceJob job;
  CLI::Option* reference = app.add_option("--reference", job.scene, "scene.json: render its exact picture instead");
  std::vector<CLI::Option*> of_reference{
      app.add_option("--capture", job.capture, "the synthetic capture that the scene shows"),
      addChoice(app, "--shadows", job.shadows, referenceShadowNames(), "cast shadows"),
      app.add_option("--samples", job.samples, "per pixel (rounded up to a square)")->check(CLI::Range(1, 1024)),
      app.add_option("--frames", job.frames, "frames to render, e.g. 0-10; default: the scene's"),
      app.add_option("--set", job.overrides, "change a value of the scene: /json/pointer=value"),
      app.add_option("--environment-samples", job.environment_samples,
                     "distant lights that stand for an environment map; maps of no more texels are taken whole")
          ->check(CLI::Range(1, 1 << 24))};
  for (CLI::Option* option : of_capture) option->capture_default_str()->excludes(reference);
  for (CLI::Option* option : of_reference) option->capture_default_str()->needs(reference);
  reference->needs(of_reference.front());

  return program.run(argc, argv, [&](Reporter& reporter) {
    if (job.scene.empty()) return writeSyntheticCapture(capture, output, reporter);
    job.output = output;
    renderReferences(job, program.commandLine(), reporter);
  });
}

}  // namespace
}  // namespace srf

int main(int argc, char** argv) {
  return srf::run(argc, argv);
}
