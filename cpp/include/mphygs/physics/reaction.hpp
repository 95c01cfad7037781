// What holds exert: force and torque of each, from the impulses of its rows.
//
// A substep's constraint gives the nodes -C^T lambda [N s]. The weights of a row sum to one and move its target with the
// hold, so that a hold of pose (R, p) exerts, on the object and about its centre R c + p,
//   F = -sum_r lambda_r / dt,   T = -sum_r R (g_r - c) x lambda_r / dt,   g_r the target of row r at rest.
// A frame's reaction is the mean over substeps around it, with the weights of the schedule.
#pragma once

#include "mphygs/model.hpp"

namespace mphygs {

/// Numbers of one hold's reaction: force [N], torque about its centre [N m].
inline constexpr std::size_t wrench_size = 6;

/// Adds `share` times what impulses do, to (holds, 6). impulse: (3, rows) [N s]; turn: (holds, 9) rotations, rows first.
/// forces: whether the forces are added, which no change of a rotation has.
void add_wrenches(const Geometry& g, const double* impulse, const double* turn, double share, bool forces, double* out);

/// Bars of impulses, (3, rows), and of rotations, (holds, 9), for those of wrenches (holds, 6) that count `share`: added.
void add_wrench_bars(const Geometry& g, const double* impulse, const double* turn, double share, const double* bar,
                     double* impulse_bar, double* turn_bar);

/// Force and torque by which momentum (3,) [N s] at an arm (3,) [m], and an affine part whose axial vector is `turn` (3,),
/// change a body. Lanes of (3,) one after the other, the values and then derivatives; quarter: h^2 / 4, what an affine part
/// of a particle weighs on a grid of quadratic splines [m^2]. Adds to `out`, 6 a lane, `stride` apart.
void add_momentum(int lanes, const double* momentum, const double* arm, const double* turn, double quarter, double* out,
                  std::size_t stride);

/// Reactions of a run at its output frames, of the values or of several directions, summed substep by substep.
class ReactionSums {
  public:
    ReactionSums(const Geometry& geometry, const Schedule& schedule, std::size_t lanes);
    /// Of holds that are known by their number alone: for `add_sums`.
    ReactionSums(int hold_count, const Schedule& schedule, std::size_t lanes);
    bool wanted() const { return !schedule_.reaction_weight.empty(); }
    /// Substep n of the whole run, in output interval `frame`; see `add_wrenches`.
    void add(std::size_t lane, int n, int frame, const double* impulse, const double* turn, bool forces = true);
    /// The same of wrenches that are summed already, (H, 6) [N s, N m s].
    void add_sums(std::size_t lane, int n, int frame, const double* sums, double sign);
    /// (F + 1, H, 6) of one lane; empty where none are wanted.
    std::vector<double> of(std::size_t lane) const;

  private:
    const Geometry* geometry_ = nullptr;
    const Schedule& schedule_;
    std::size_t size_ = 0;  // numbers of a lane
    std::vector<double> sums_;
};

}  // namespace mphygs
