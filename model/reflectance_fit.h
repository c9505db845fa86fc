// The reflectance model fitted to the samples of every model point, once, by `srf model`; stored beside the model as
// X.srf/models/NAME.srffit (manifest kind "fit", same name as its model). Interpolation is guided by it where it
// exists.
#pragma once

#include <optional>
#include <vector>

#include "base/reporter.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"
#include "model/normal_spread.h"
#include "model/reflectance_model.h"

namespace srf {

/// What is known of one model point.
struct FittedPoint {
  PointReflectance reflectance;
  float gate = 0;  ///< 0: plain interpolation, 1: guided, by the leave-one-light-out error at this point
  /// For a light that lights the point, 0: the residual is relit by lights that light it too (G1); 1: by all as they
  /// are (G2). For one that does not, 0: dark; 1: what photographs hold under lights that do not light it either, which
  /// is indirect light and translucency. Each by its own error with lights left out.
  float indirect = 0, indirect_shadow = 0;
  /// How far a view that sees the point aslant counts less for the residual: 0 by the root of n.v as in plain
  /// interpolation, 0.5 by n.v, 1 by its square; by the error with views left out.
  float slant = 0.5f;
  SymmetricMatrix turn{};  ///< normalTurns: how much wider the lobe is through a pixel
};

struct ReflectanceFit {
  std::vector<FittedPoint> points;  ///< of the model, in its order
  /// Whether each captured light (LightId) lights each point at rest: by rays, corrected by the photographs where the
  /// surface is a hull.
  VisibilityBits lit;
  /// The same by rays through the model alone where a hull hides a concavity: where the two differ, photographs
  /// overrule the rays of every pose. Elsewhere as `lit`, also along the outlines of shadows, where a ray may be a
  /// pixel off.
  VisibilityBits lit_by_rays;
  /// lit, also at the points one or two capture pixels around: away from the outline of a captured shadow.
  VisibilityBits lit_around;
  /// Views (ViewId) that see the point and also the points one or two capture pixels around.
  VisibilityBits seen_around;
  /// Captured lights (LightId) about which guidance does worse at the point than plain interpolation, which holds
  /// there.
  VisibilityBits worse;
  // How well it holds, over all points that have samples: root mean square of the relative leave-one-light-out error.
  double error_plain = 0, error_guided = 0;
};

inline constexpr std::uint32_t kFitVersion = 5;  ///< of the file, the only one that is read

struct FitOptions {
  std::size_t memory_bytes = std::size_t{2} << 30;  ///< for the samples held at once
  int most_views = 24;                              ///< samples of a point come from at most this many views
};

/// Fits the active geometry. None where the field cannot be relit (one unknown light) or has too few lights (fewer than
/// 8 of known direction): said as a warning-free note through the reporter; interpolation is then plain.
std::optional<ReflectanceFit> fitReflectance(const std::filesystem::path& srf_folder, const SrfManifest& field,
                                             const DeformableModel& model, const FitOptions& options,
                                             Reporter& reporter);

/// Writes models/NAME.srffit and names it in the manifest, beside the model NAME.
void storeFit(const std::filesystem::path& srf_folder, const ReflectanceFit& fit, const std::string& name);
/// The active model's fit; none where it has none. Throws bad_input where the file does not fit model and field.
std::optional<ReflectanceFit> loadFit(const std::filesystem::path& srf_folder, const SrfManifest& manifest,
                                      const DeformableModel& model);

}  // namespace srf
