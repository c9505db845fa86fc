// What the photographs hold at every model point: the samples that the reflectance model is fitted to. Gathered view by
// view in one pass over the field, every block decoded at most once.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "base/reporter.h"
#include "field/reflectance_store.h"
#include "field/srf_folder.h"
#include "model/deformable_model.h"

namespace srf {

struct SampleOptions {
  /// Of the whole process. Samples that need more than half of what is left of it lie in an unlinked file beside the
  /// field, of which no more than there is room for stays in memory.
  std::size_t memory_bytes = std::size_t{2} << 30;
  int most_views = 24;  ///< of a point
};

class FitSamples {
 public:
  /// Which views a point has samples from, and where they lie.
  struct PointView {
    std::uint32_t view = 0;
    std::uint32_t rank = 0;  ///< among the view's points
  };

  FitSamples(const std::filesystem::path& srf_folder, const SrfManifest& field, const DeformableModel& model,
             std::span<const Direction<AcquisitionSpace>> normals, const SampleOptions& options, Reporter& reporter);
  ~FitSamples();

  /// By rising view. Visible, at most as slanted as n.v = 0.1, wholly covered; spread over the directions.
  std::span<const PointView> views(std::size_t point) const {
    return std::span(views_).subspan(first_[point], first_[point + 1] - first_[point]);
  }
  /// Radiance as photographed, un-premultiplied, half[3][pad(view)]: channel, light of the view's list; 0 beyond it.
  const std::uint16_t* values(const PointView& at) const {
    keepMemory();
    return values_ + base_[at.view] + static_cast<std::size_t>(at.rank) * 3 * pad(at.view);
  }
  int pad(std::uint32_t view) const { return pad_[view]; }
  /// Radiance at which the capture's values end in a plateau: what reaches it was cut off there. Infinite where none
  /// does.
  double saturation() const { return saturation_; }
  std::uint64_t blocksDecoded() const { return blocks_decoded_; }

 private:
  class Buffer;
  /// Called now and then: what the file's samples take of the memory is given back where the process holds too much.
  void keepMemory() const;
  void choose(const SrfManifest& field, const DeformableModel& model,
              std::span<const Direction<AcquisitionSpace>> normals, int most_views, Reporter& reporter);
  void gather(const SrfManifest& field, const DeformableModel& model, Reporter& reporter);

  std::vector<ReflectanceStore> stores_;      ///< while gathering; of the views with reflectance, in order
  std::vector<std::uint32_t> store_of_view_;  ///< position in stores_
  std::vector<std::size_t> first_;            ///< of each point in views_, and the end
  std::vector<PointView> views_;
  std::vector<int> pad_;              ///< of each view: lights of its list, rounded up to 8
  std::vector<std::size_t> base_;     ///< of each view, in halves
  std::vector<std::uint32_t> count_;  ///< of each view: points
  std::unique_ptr<Buffer> buffer_;
  std::size_t most_resident_ = 0;                ///< bytes of the process, where the samples lie in a file; else 0
  mutable std::atomic<std::uint32_t> asked_{0};  ///< how often for memory
  std::uint16_t* values_ = nullptr;
  double saturation_ = 0;
  std::uint64_t blocks_decoded_ = 0;
};

}  // namespace srf
