// What a study makes anew of a field, to see what its making costs and saves: the blocks in another coding, the hull
// carved coarser, the surface as surfels.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "base/reporter.h"
#include "field/reflectance_store.h"

namespace srf {

struct FieldVariant {
  enum class Kind { coding, hull, surfels };
  Kind kind = Kind::coding;
  std::string label;  ///< the value of the knob
  std::string name;   ///< of the folder
  StoreCoding coding;
  int hull_cells = 0;  ///< along the longest side of the object
  std::size_t surfels = 0;
};

/// A property of the field from what it is to cheap.
struct FieldKnob {
  std::string name, unit, own;  ///< `own`: the label of the field as it is
  std::vector<FieldVariant> variants;
};

/// Those of which no variant takes longer than about `seconds` to make; of the others a line is told. A field of
/// principal components has no other coding, for their error cannot be taken back; a model that is not the hull no
/// coarser one, nor one whose vertices the scene moves (`keeps_vertices`).
std::vector<FieldKnob> fieldKnobs(const std::filesystem::path& srf_folder, bool keeps_vertices, double seconds,
                                  Reporter& reporter);

/// Makes `out`, which must not exist, of the field; what does not change shares the files. The hull is carved from the
/// coverage that the field holds, no view overruled. Where the model has a fit, a new one gets a fit too.
void makeVariant(const std::filesystem::path& srf_folder, const FieldVariant& variant, const std::filesystem::path& out,
                 std::size_t memory_bytes, Reporter& reporter);

}  // namespace srf
