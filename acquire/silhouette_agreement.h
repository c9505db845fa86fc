// Masks and the hull of the other views, brought to agree.
#pragma once

#include <string>
#include <vector>

#include "acquire/silhouette.h"

namespace srf {

/// What mendSilhouettes did to a view.
struct MendedView {
  std::string name;
  double filled = 0;   ///< share of its mask that was missing where the hull of the others has the object
  double removed = 0;  ///< share that lay outside the hull of the others
};

/// A gap in one mask, or in few, where the hull that all others allow has the object is a shadow as dark as the
/// background, and what lies outside that hull is no object: both are mended, and a hull is carved anew, until nothing
/// changes (five rounds at most). The hull is the one that a 24th of the views (one at least) may be overruled
/// in; gaps narrower than 5 pixels of a picture of 640 are its looseness and stay, and so is what most views show: a
/// view is mended where it differs by more than the median of all and twice their spread (a hundredth at least). Warns
/// of views that were mended by more than 2 % of their mask, by name.
std::vector<MendedView> mendSilhouettes(std::vector<SilhouetteView>& views,
                                        const std::optional<Box<AcquisitionSpace>>& bounds, Reporter& reporter);

/// Masks by GrabCut (Rother et al. 2004, OpenCV): the projected bounds are the first guess of the object, the picture
/// beyond them the background (without bounds: its outer tenth); then the hull that the other views allow takes their
/// place, until hull and masks agree to 0.998 in the mean (intersection over union; six rounds at most). Works on
/// pictures of at most 512 pixels a side; edges are coverage. Figure `silhouette.grabcut_rounds`.
std::vector<SilhouetteView> grabCutSilhouettes(const Capture& capture, Reporter& reporter);

/// The mesh as a camera sees it, 255 where a ray through the pixel's centre meets it.
Image8 projectedMesh(const AcquisitionMesh& mesh, const Camera<AcquisitionSpace>& camera);
/// The same camera for a picture of another size.
Intrinsics resized(const Intrinsics& lens, int width, int height);

}  // namespace srf
