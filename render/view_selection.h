// Which photographs a hit is made from, and where in them it lies (M12).
#pragma once

#include <array>
#include <limits>
#include <span>
#include <vector>

#include "field/bilinear_fetch.h"
#include "field/lumigraph_weights.h"
#include "model/deformable_model.h"
#include "render/view_kernels.h"

namespace srf {

/// A desired ray in acquisition space.
struct ViewQuery {
  Point<AcquisitionSpace> p;
  Direction<AcquisitionSpace> view;                               ///< v
  Direction<AcquisitionSpace> normal;                             ///< n0
  double eye_distance = std::numeric_limits<double>::infinity();  ///< |e* - p*| = |p - d|; infinite: orthographic
  std::span<const std::uint32_t> points;                          ///< the model points that the hit blends
  std::span<const float> point_weights;                           ///< sum 1
};

struct ChosenView {
  std::uint32_t view = 0;
  double weight = 0;
  double angle = 0;           ///< radians between v and the view's direction at p
  double penalty = 0;         ///< viewPenalty; infinite for one that stands in where no view sees p
  double foreshortening = 1;  ///< root of n0 . v_i, kept above a little: in the weight
  Fetch fetch;
};

class ViewSelection {
 public:
  /// `visible`: of the model's points; must outlive this. `k`: the most views of a hit (more where penalties tie).
  ViewSelection(std::vector<SourceView> views, const VisibilityBits& visible, int k);

  enum class Result {
    seen,      ///< from views that see p
    not_seen,  ///< no view sees p: the nearest by angle whose picture covers it stands in
    none       ///< no picture covers p
  };
  /// A view that may be used, and its pair. By penalty, ties by view.
  struct Ranked {
    double penalty;
    std::uint32_t view, pair;
    friend bool operator<(const Ranked& a, const Ranked& b) {
      return a.penalty != b.penalty ? a.penalty < b.penalty : a.view < b.view;
    }
  };
  /// Memory that select() uses; one for each thread. A pair is a hit and a view that is looked at for it. First come
  /// those of the nearest views, rank by rank: of rank j and hit h at j * stride + h; then, hit by hit, more of them.
  struct Scratch {
    std::vector<std::uint64_t> seen, by_all;         ///< of each hit: views that see one of its points, or all of them
    std::array<std::vector<double>, 11> hit_lanes;   ///< HitLanes of all hits
    std::array<std::vector<double>, 11> more_lanes;  ///< HitLanes of the pairs after the nearest
    std::array<std::vector<float>, 7> near;          ///< NearLanes of all hits
    std::vector<std::uint32_t> seen_lanes;           ///< the same views, by word and hit
    std::vector<std::uint32_t> views, slot;          ///< that see some hit; where each view is in `views`
    std::array<std::vector<float>, 3> centers;       ///< of those views
    std::vector<float> bounds, rest;                 ///< nearestViews
    std::vector<std::uint32_t> each_hit, hit_of;     ///< 0, 1, ..; of the pairs after the nearest
    std::vector<std::int32_t> more_views;            ///< of those pairs
    std::vector<std::array<std::uint32_t, 2>> more;  ///< of each hit: its pairs after the nearest
    std::vector<std::int32_t> view;                  ///< of each pair; -1: none
    std::array<std::vector<double>, 11> view_lanes;  ///< ViewLanes of each pair
    std::vector<std::uint32_t> fetch;                ///< of each pair: into `fetches`
    std::vector<Fetch> fetches;                      ///< those whose four texels are not all covered
    std::vector<Ranked> ranked;                      ///< of one hit
    std::vector<std::pair<double, std::uint32_t>> standing_in;
  };
  /// The views of each hit.
  struct Chosen {
    std::vector<ChosenView> views;     ///< those of a hit one after the other, least penalty first, weights sum 1
    std::vector<std::uint32_t> first;  ///< of each hit, in `views`, and the end
    std::vector<Result> result;
    std::span<const ChosenView> of(std::size_t hit) const {
      return std::span(views).subspan(first[hit], first[hit + 1] - first[hit]);
    }
  };
  /// Chooses the views of hits; what a hit gets does not depend on the others. `allowed[i]`: view i may be used.
  void select(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& scratch,
              Chosen& chosen) const;

  const std::vector<SourceView>& views() const { return views_; }

 private:
  /// The weight of the hit's points that the view sees.
  double seenShare(const ViewQuery& query, std::uint32_t view) const;
  /// Looks at `count` pairs from `first` on; the i-th is of hit hit_of[i], which `from` has in lane i.
  void lookAt(std::span<const ViewQuery> queries, const HitLanes& from, const std::uint32_t* hit_of, std::size_t first,
              std::size_t count, Scratch& s) const;
  /// The nearest picture by angle that covers p, where no view sees it.
  bool standIn(const ViewQuery& query, std::span<const std::uint8_t> allowed, Scratch& s, ChosenView& chosen) const;

  std::vector<SourceView> views_;
  std::vector<PlacedView> placed_;  ///< of each view
  const VisibilityBits& visible_;
  int k_;
};

}  // namespace srf
