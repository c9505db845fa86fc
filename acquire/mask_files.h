// Mask files beside the photographs: where they lie, and which side of them is the object.
#pragma once

#include <filesystem>
#include <string>

#include "base/image.h"
#include "base/reporter.h"
#include "field/capture.h"

namespace srf {

/// Gives views without a mask the file that belongs to their photographs, by the first naming that fits the most views:
///   beside the photograph   img.png.png, img_mask.png, img-mask.png, img.mask.png, mask_img.png, img_matte.png, ...
///   in a folder of masks    masks/img.png, masks/img.png.png, masks/img_mask.png, mask/, mattes/, silhouettes/,
///                           segmentation/, obj_masks/, com_masks/, ..: within the capture's folder, the photographs'
///                           folder or beside it; below it the photograph's own subfolder or none
///   where a view has a folder of photographs (images/VIEW/LIGHT.exr)   masks/VIEW.png, images/VIEW/mask.png
/// A capture that names masks itself keeps them. Says which naming was taken and for how many views (information; a
/// warning where some views have none, or where another folder of masks was passed over).
void findMaskFiles(Capture& capture, Reporter& reporter);

/// What the values of a mask file mean.
enum class MaskPolarity { automatic, white_is_object, black_is_object };

/// Coverage from a mask file: its alpha where that varies, else its brightness. Files that hold 0 and a small number n
/// (labels) are read as 0 and 255. `automatic`: black is the object where the picture's edge is white and its middle
/// is not. What was found is told in `note`, empty where the file is what everybody expects.
Image8 readMaskFile(const std::filesystem::path& file, MaskPolarity polarity, std::string& note);

}  // namespace srf
