// How far the capture supports what a frame shows: how near the acquired views and lights are to those asked for,
// whether any view sees the place at all, and how much the surface is stretched there.
#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "render/light_weights.h"
#include "render/look_up.h"
#include "render/view_selection.h"

namespace srf {

struct HitSupport {
  double light_angle = 0;  ///< degrees to the nearest acquired light; mean of the frame's lights by what each gives
  double light_far = 0;    ///< share of what they give that comes from further than one spacing from any acquired one
  bool view_far = false;   ///< the nearest view is further than one spacing
  bool occluded = false;   ///< no view sees the place
  bool stretched = false;  ///< by more than 2, or to less than half, along some direction
  /// Share of the light under which all is well, 0..1.
  double supported() const { return view_far || occluded || stretched ? 0 : 1 - light_far; }
};

/// Sums over hits.
struct FrameSupport {
  std::uint64_t hits = 0;
  double supported = 0, view_far = 0, light_far = 0, occluded = 0, stretched = 0;

  void add(const HitSupport& hit);
  void add(const FrameSupport& other);
  double share(double sum) const { return hits > 0 ? sum / static_cast<double>(hits) : 0; }
  /// "93 % of the picture is supported by the capture; ...".
  std::string text() const;
  /// The sums, for a frame's header, and back; none where the text is not such.
  std::string numbers() const;
  static std::optional<FrameSupport> fromNumbers(const std::string& text);
};

/// FrameSupport is summed over every so manieth row and column: some 128 x 128 pixels of a frame, of large ones up to
/// four times as many.
int supportStep(int width, int height);

/// One sentence on several frames: "41 to 97 % of the picture is supported by the capture (least: frame 24)". Empty
/// where no frame tells.
std::string supportOfFrames(std::span<const std::pair<int, FrameSupport>> frames);

class CaptureSupport {
 public:
  /// Whether a layer of --aovs needs it.
  static bool wanted(const std::set<std::string>& layers);
  /// `object`: box of the model at rest; spacings are those of the directions seen from its centre. Everything must
  /// outlive it.
  CaptureSupport(std::span<const SourceView> views, std::span<const AcquiredLights> lists,
                 std::span<const std::uint32_t> list_of_view, const Box<AcquisitionSpace>& object);
  HitSupport at(const SurfaceHit& hit, const LookUp& look_up, std::span<const ChosenView> chosen,
                ViewSelection::Result result, const FrameLighting& lighting) const;

 private:
  std::span<const AcquiredLights> lists_;
  std::span<const std::uint32_t> list_of_view_;
  double view_spacing_ = 0;            ///< radians: median of the angles from a view to the next
  std::vector<double> light_spacing_;  ///< of each list
};

}  // namespace srf
