// Which photographs a hit is made from, and where in them it lies (M12).
#pragma once

#include <algorithm>
#include <array>
#include <functional>
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
  Direction<AcquisitionSpace> view;    ///< v
  Direction<AcquisitionSpace> normal;  ///< n0
  /// |e* - p*| = |p - d|, divided by how far the deformation stretches the surface there; infinite: orthographic.
  double eye_distance = std::numeric_limits<double>::infinity();
  std::span<const std::uint32_t> points;  ///< the model points that the hit blends
  std::span<const float> point_weights;   ///< sum 1
};

struct ChosenView {
  std::uint32_t view = 0;
  double weight = 0;
  double angle = 0;           ///< radians between v and the view's direction at p
  double penalty = 0;         ///< viewPenalty; infinite for one that stands in where no view sees p
  double foreshortening = 1;  ///< root of n0 . v_i, kept above a little: in the weight
  Fetch fetch;
};

/// What shading needs of a chosen view.
struct PickedView {
  std::uint32_t view;
  float weight;
  int x, y, level;  ///< as Fetch has them
  bool covered;     ///< at all
  const float* tap;

  /// `fetch` must outlive it.
  static PickedView of(std::uint32_t view, double weight, const Fetch& fetch) {
    return {view, static_cast<float>(weight), fetch.x, fetch.y, fetch.level, fetch.covered > 0, fetch.tap};
  }
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
  /// Memory that select() uses; one for each thread. Hits are looked at some at a time. A pair is a hit and a view that
  /// is looked at for it: first come those of the nearest views, rank by rank, of rank j and hit h at j * kAtOnce + h;
  /// then more of them for the hit at hand.
  struct Scratch {
    static constexpr std::size_t kAtOnce = 64;
    template <std::size_t kCount>
    using Lanes = std::array<std::array<double, kCount>, 11>;
    Lanes<kAtOnce> hit{};                              ///< HitLanes
    std::array<std::array<float, kAtOnce>, 7> near{};  ///< NearLanes
    std::vector<std::uint32_t> seen, by_all;           ///< views that see one of its points, or all, by word and hit
    std::vector<std::uint64_t> words;                  ///< views that see some hit; then those that are allowed
    Lanes<kVectorLanes> again{};                       ///< the hit at hand, once for each of its pairs
    std::vector<std::uint32_t> again_by_all;
    std::vector<std::uint32_t> views, slot;     ///< that see some hit; where each view is in `views`
    std::array<std::vector<float>, 3> centers;  ///< of those views
    std::vector<float> bounds;                  ///< nearestViews
    std::array<float, kAtOnce> rest{};
    std::vector<std::int32_t> view;                   ///< of each pair; -1: none
    std::array<std::vector<double>, 6> view_lanes;    ///< ViewLanes of each pair
    std::array<std::vector<std::int32_t>, 3> texels;  ///< likewise
    std::vector<float> tap;
    std::vector<std::uint32_t> fetch;       ///< of each pair: into `fetches`
    std::vector<Fetch> fetches;             ///< those whose four texels are not all covered
    std::vector<std::int64_t> chosen_pair;  ///< weighViews
    std::vector<double> weight;
    std::array<std::int64_t, kAtOnce> taken{};
    std::vector<Ranked> ranked;  ///< of one hit
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
  /// Is shown a hit's views where they are settled at once, as most are, and does with them what is to be done: true.
  /// Otherwise they are wanted as ChosenView.
  using Take = std::function<bool(std::size_t hit, std::span<const PickedView>)>;
  /// Chooses the views of hits; what a hit gets does not depend on the others. `allowed[i]`: view i may be used. Of
  /// hits that are taken no views are in `chosen`.
  void select(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& scratch,
              Chosen& chosen, const Take& take = {}) const;

  const std::vector<SourceView>& views() const { return views_; }

 private:
  /// The same of at most Scratch::kAtOnce hits from `first` on, whose views are appended.
  void selectSome(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& scratch,
                  Chosen& chosen, const Take& take, std::size_t first) const;
  /// Puts hits side by side, with the views that see some of them.
  void readHits(std::span<const ViewQuery> queries, std::span<const std::uint8_t> allowed, Scratch& s) const;
  /// The weight of the hit's points that the view sees.
  double seenShare(const ViewQuery& query, std::uint32_t view) const;
  /// How many views of a hit are looked at first: one more than suffice where all of them show it well.
  std::size_t nearViews() const { return static_cast<std::size_t>(std::min(k_ + 2, kMostNearViews)); }
  /// Looks at `count` pairs from `first` on; the i-th is of the hit query[i * step], which `from` has in lane i.
  void lookAt(const ViewQuery* query, std::size_t step, const HitLanes& from, std::size_t first, std::size_t count,
              Scratch& s) const;
  /// What is not known of pair `pair` of a hit that lies in lane i.
  void ask(const ViewQuery& query, const HitLanes& from, std::size_t i, std::size_t pair, Scratch& s) const;
  /// Ranks all views that may be among the k + 1 nearest of hit h, or tie with them.
  void rankAll(const ViewQuery& query, std::size_t h, Scratch& s) const;
  PickedView picked(std::size_t pair, double weight, const Scratch& s) const;
  void choose(std::size_t pair, double weight, const Scratch& s, Chosen& chosen) const;
  /// The nearest picture by angle that covers p, where no view sees it.
  bool standIn(const ViewQuery& query, std::span<const std::uint8_t> allowed, Scratch& s, ChosenView& chosen) const;

  std::vector<SourceView> views_;
  std::vector<PlacedView> placed_;  ///< of each view
  WholeTexels whole_;
  const VisibilityBits& visible_;
  int k_;
};

}  // namespace srf
