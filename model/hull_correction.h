// What the photographs know better than a visual hull: its normals, and which captured lights reach it.
#pragma once

#include <vector>

#include "model/captured_visibility.h"
#include "model/point_samples.h"

namespace srf {

/// The normal under which the model of the roughness of `point`, brushed along `tangent_angle` (setFrame), explains the
/// samples best, at most 41 degrees from `start`, if that explains them much better than `start` does; else `start`.
Direction<AcquisitionSpace> photometricNormal(PointSamples& samples, const Direction<AcquisitionSpace>& start,
                                              PointReflectance point, double tangent_angle);

/// Sets the point's lit bits to what most of its views say, where the model of `point` (fitted to the samples) lets
/// them tell: the surface is as bright as lit, or dark. Bits about which the photographs say nothing stay.
void correctLit(const FitInput& input, const PointSamples& samples, const PointReflectance& point, std::size_t i,
                VisibilityBits& lit);

/// Takes away what is narrower than twice aroundReach, by shrinking and growing again: along the outline of a shadow
/// a pixel's blur sets photographs against rays and model; what a hull fills is wider.
void dropOutlines(const SrfManifest& field, const DeformableModel& model, VisibilityBits& bits);

/// Leaves lit_by_rays other than lit only where that is more than an outline. There photographs overrule rays in every
/// pose, and where a shadow ended at rest says nothing of others.
void agreeAlongOutlines(const FitInput& input, CapturedVisibility& visibility);

/// lit_around anew, from the bits of the points around: hull or not, an outline lies between points that differ.
void litAroundFromNeighbours(const FitInput& input, CapturedVisibility& visibility);

}  // namespace srf
