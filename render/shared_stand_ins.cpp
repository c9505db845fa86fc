#include "render/shared_stand_ins.h"

#include <mutex>

#include "render/vector_lanes.h"

namespace srf {

void SharedStandIns::prepare(const FrameLighting& lighting, std::size_t most_bytes) {
  if (bytes_ <= most_bytes && lighting.sharesLike(distant_, only_orientation_)) return;
  corners_.clear();
  bytes_ = 0;
  distant_ = lighting.lights().distant;
  only_orientation_ = lighting.options().only_orientation;
}

const SharedStandIns::Corner& SharedStandIns::at(const SharedKey& key, const FrameLighting& lighting) {
  {
    const std::shared_lock lock(mutex_);
    if (const auto found = corners_.find(key); found != corners_.end()) return *found->second;
  }
  auto corner = std::make_unique<Corner>();
  const AcquiredLights& list = lighting.lists()[key.list];
  const auto pad = static_cast<std::size_t>(lightPad(list.count()));
  corner->irradiance.resize(3 * pad);
  corner->nearest.resize(paddedLanes(lighting.lights().distant.size()));
  lighting.computeShared(key, corner->irradiance.data(), corner->nearest.data());
  for (std::size_t i = 0; i < list.inverseIrradiances().size(); ++i)
    for (std::size_t c = 0; c < 3; ++c) {
      const float inverse = list.inverseIrradiances()[i][c];
      corner->irradiance[c * pad + i] *= inverse > 0 ? 1 / inverse : 0.f;
    }
  const std::unique_lock lock(mutex_);
  const auto [entry, added] = corners_.try_emplace(key, std::move(corner));  // another thread may have been first
  if (added) bytes_ += 4 * (entry->second->irradiance.size() + entry->second->nearest.size()) + 128;
  return *entry->second;
}

}  // namespace srf
