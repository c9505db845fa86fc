// What stands for the distant lights of a frame, shared by all hits of like orientation (M13, M18, light_sharing): made
// when first asked for, the same bits whoever asks first.
#pragma once

#include <memory>
#include <shared_mutex>
#include <unordered_map>
#include <vector>

#include "render/light_weights.h"

namespace srf {

class SharedStandIns {
 public:
  struct Corner {
    std::vector<float> irradiance;       ///< 3 x pad: for which each captured light stands (computeShared)
    std::vector<std::uint32_t> nearest;  ///< of each distant light (paddedLanes), the captured one that counts most
  };
  /// Forgets what does not hold for the frame, or everything where more than `most_bytes` are held. Not while others
  /// ask.
  void prepare(const FrameLighting& lighting, std::size_t most_bytes);
  /// Thread-safe; stays until prepare().
  const Corner& at(const SharedKey& key, const FrameLighting& lighting);

 private:
  std::shared_mutex mutex_;
  std::unordered_map<SharedKey, std::unique_ptr<Corner>, SharedKeyHash> corners_;
  std::vector<DistantLight> distant_;
  std::optional<Orthogonal<AcquisitionSpace, ObjectSpace>> only_orientation_;
  std::size_t bytes_ = 0;
};

}  // namespace srf
