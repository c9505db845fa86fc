// Which photographs a hit is made from, and where in them it lies (M12).
#pragma once

#include <limits>
#include <span>
#include <vector>

#include "field/bilinear_fetch.h"
#include "field/lumigraph_weights.h"
#include "model/deformable_model.h"

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
  double angle = 0;    ///< radians between v and the view's direction at p
  double penalty = 0;  ///< viewPenalty; infinite for one that stands in where no view sees p
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
  /// How a view lies to a query, before its picture is looked at.
  struct Candidate {
    std::uint32_t view;
    double chord;           ///< between v and the view's direction at p
    double resolution;      ///< resolutionPenalty
    double foreshortening;  ///< factor of the view's weight: sqrt(n0 . v_i), kept above 0
    double bound;           ///< at most the view's penalty
  };
  /// Memory that select() uses; one for each thread.
  struct Scratch {
    std::vector<Candidate> open;
    std::vector<Penalised> penalised;
    std::vector<Weighted> weights;
    std::vector<ChosenView> tried;
  };
  /// The views of a hit with weights that sum to 1, least penalty first. `allowed[i]`: view i may be used.
  Result select(const ViewQuery& query, std::span<const std::uint8_t> allowed, Scratch& scratch,
                std::vector<ChosenView>& chosen) const;

  const std::vector<SourceView>& views() const { return views_; }

 private:
  bool consider(const ViewQuery& query, std::uint32_t view, Candidate& candidate) const;
  /// How much of p the view's picture holds, 0 to 1, and where.
  double covered(const ViewQuery& query, std::uint32_t view, Fetch& fetch) const;

  std::vector<SourceView> views_;
  const VisibilityBits& visible_;
  int k_;
};

}  // namespace srf
