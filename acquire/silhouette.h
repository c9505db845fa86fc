// Masks of the object in each view (M3): from files, from alpha, from a picture of the empty place, from a screen of
// one colour, by GrabCut, or from a plain background inside a bounding box.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "acquire/mask_files.h"
#include "acquire/visual_hull.h"
#include "field/capture.h"

namespace srf {

/// Where masks come from. `automatic`: a view's mask file, else the alpha of its photographs, else a plain dark
/// background. The others look at the photographs alone.
enum class SilhouetteSource { automatic, clean_plate, chroma_key, grab_cut };

struct SilhouetteOptions {
  /// Values (0..1 of the file's encoding, brightest channel) above this are object where the background is plain;
  /// absent: found from the picture.
  std::optional<double> background_threshold;
  SilhouetteSource source = SilhouetteSource::automatic;
  /// clean_plate: a picture of the place without the object, or a folder that holds one for each photograph (its path
  /// below the capture, its file name, or the view's name).
  std::filesystem::path clean_plate;
  std::optional<Vec3>
      key;  ///< chroma_key: colour of the screen, sRGB 0..1; absent: that of each picture's surroundings
  /// Masks found in photographs are mended by the hull of the other views until both agree: see mendSilhouettes.
  bool mend = false;
  MaskPolarity polarity = MaskPolarity::automatic;  ///< of mask files
  std::size_t memory_bytes = std::size_t{1} << 30;  ///< photographs are open in so many threads as fit
};

/// Coverage of one view: its mask file, else the alpha of its photographs, else segmentation against a plain dark
/// background: above the threshold, inside the projected capture.bounds, closed 3x3, largest component, holes kept but
/// for specks. Throws bad_input (empty, all white, wrong size, background not dark), naming file and mend.
Image8 silhouette(const Capture& capture, ViewId view, const SilhouetteOptions& options, Reporter& reporter);
/// All views, in parallel. A threshold that is to be found is one for all of them (figure `silhouette.threshold`),
/// which is steadier than what silhouette() finds from its view alone. Edges of clean_plate, chroma_key and grab_cut
/// are coverage: how far the pixel's colour lies from the background's towards the object's beside it.
std::vector<SilhouetteView> silhouettes(const Capture& capture, const SilhouetteOptions& options, Reporter& reporter);

/// Where the object may be: the projection of the capture's bounds, 2 pixels wider (255 inside); all of the picture
/// where they are not told or reach behind the camera.
Image8 boundsRegion(const Capture& capture, const Camera<AcquisitionSpace>& camera);

/// The mean of a view's photographs, linear, three channels.
ImageF meanPhotograph(const Capture& capture, const CaptureView& view);

/// Hard masks to coverage along their edges, from the photograph's colours: within 2 pixels of the edge, the place of
/// the colour between the background's (`plate`, or what lies beside it) and the object's. Interiors stay as they are.
Image8 softEdges(const Image8& mask, const ImageF& photograph, const ImageF* plate);

/// The largest part of a mask, with its holes but for specks (a 200th of its area at most).
Image8 largestPart(const Image8& mask);

}  // namespace srf
