// Total-Lagrangian transfer: weights computed once in the reference configuration.
//
// State lives on the grid nodes (displacement u, velocity v); points are quadrature points with
// F = (I + sum_a u_a (dN_a/dX)^T) F0. Lumped mass, symplectic Euler:
//   f = f(u_n, v_n),  v* = v_n + dt (f / m + a),
//   v_n+1 = v* - M^-1 C^T lambda with C u_n+1 = hold,  u_n+1 = u_n + dt v_n+1.
// Source of the scheme: de Vaucorbeil, Nguyen, Hutchinson, "A total-Lagrangian material point
// method for solid mechanics problems involving large deformations", 2020.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "mphygs/model.hpp"
#include "mphygs/physics/evaluation.hpp"
#include "mphygs/physics/observer.hpp"
#include "mphygs/physics/point_hook.hpp"
#include "mphygs/total_lagrangian/cell_springs.hpp"
#include "mphygs/total_lagrangian/consistent_mass.hpp"
#include "mphygs/total_lagrangian/curved_grid.hpp"
#include "mphygs/total_lagrangian/spline_tables.hpp"

namespace mphygs {

class Equilibrium;
class Team;
template <class T>
class MidpointAssembly;

/// Called at every output frame; returning false stops the run (SimulationError "interrupted").
using Progress = std::function<bool(int frame)>;

/// Weights of material points on the nodes.
struct PointWeights {
    std::vector<std::int32_t> node;  // (M, 27)
    std::vector<double> value;       // (M, 27)
    std::vector<double> gradient;    // (M, 27, 3) [1/m]
};

/// Effects that one direction has besides the model's own: at their null, where they leave motion and stiffness as they are.
/// Only those of the volume, the surface and the body.
template <class T>
struct Added {
    std::vector<bool> active;  // by number in the registry; empty: none
    std::vector<T> effect;     // parameters of all effects, as the direction's owner has them
};

template <class T>
class TotalLagrangian {
  public:
    /// Throws std::invalid_argument where a hold or a surface point touches no material.
    TotalLagrangian(Geometry geometry, Settings settings);

    std::size_t node_count() const { return node_positions_.size() / 3; }
    /// Numbers of one component in the arrays that runs keep.
    std::size_t padded_nodes() const { return stride_; }
    const std::vector<double>& node_positions() const { return node_positions_; }  // (N, 3) [m]
    const std::vector<std::int32_t>& node_index() const { return node_index_; }    // (N, 3) on the grids
    const Geometry& geometry() const { return geometry_; }
    const Settings& settings() const { return settings_; }
    /// Threads of the next runs; the results do not depend on it. Not while one is under way.
    void set_threads(int threads) { settings_.threads = threads; }
    /// Lumped node mass of given inputs, (N,) [kg].
    std::vector<T> node_mass(const Fields<T>& fields) const;
    /// What is lumped too much in it: the nodes' mass less this is what implicit steps have. See `consistent_mass.hpp`.
    SharedMass<T> shared_mass(const Fields<T>& fields) const;
    /// cell: (M, 3) knot span of each point; it must be one of the object's.
    PointWeights weights(const std::vector<double>& points, const std::vector<std::int32_t>& cell) const;

    /// hook: further forces at the quadrature points, or nullptr; observer: feedback to the fields' target, or nullptr.
    Trajectory<T> simulate(const Fields<T>& fields, const Schedule& schedule, const Progress& progress = {},
                           const PointHook<T>* hook = nullptr, const Observer* observer = nullptr) const;

    /// The trajectory and its derivative in each direction (directions may leave fields empty).
    /// added: for every direction the effects that it alone has, or empty.
    std::vector<Trajectory<T>> tangent(const Fields<T>& fields, const std::vector<Fields<T>>& directions,
                                       const Schedule& schedule, const Progress& progress = {},
                                       const PointHook<T>* hook = nullptr, const std::vector<Added<T>>& added = {},
                                       const Observer* observer = nullptr) const;

    /// Gradient of a loss whose derivatives by the trajectory are given; checkpointed.
    /// `recomputed` returns the number of substeps computed again.
    Fields<T> adjoint(const Fields<T>& fields, const Schedule& schedule, const Trajectory<T>& bar,
                      const Progress& progress = {}, long* recomputed = nullptr, const PointHook<T>* hook = nullptr,
                      const Observer* observer = nullptr) const;

    /// The same where the loss is only known once the trajectory is: one forward run less. progress: of this run too.
    using Loss = std::function<Trajectory<T>(const Trajectory<T>&)>;
    Fields<T> gradient(const Fields<T>& fields, const Schedule& schedule, const Loss& loss, const Progress& progress = {},
                       long* recomputed = nullptr, const PointHook<T>* hook = nullptr, const Observer* observer = nullptr) const;

    /// Forces at rest of the effects that act on the surface and at places (wind, tether), and the
    /// body effects times the node mass, (N, 3) [N]: what a rest shape in equilibrium carries
    /// besides m g.
    std::vector<T> rest_forces(const Fields<T>& fields) const;

    /// Largest squared natural frequency [1/s^2] and largest damping rate [1/s] of the
    /// linearised model at rest, by power iteration. Channels of an actuation are those of one interval, at its start.
    std::array<double, 2> largest_rates(const Fields<T>& fields, int iterations = 60, const PointHook<T>* hook = nullptr) const;

    /// Of the matrix of implicit steps. All given must live longer.
    std::unique_ptr<MidpointAssembly<T>> midpoint_assembly(const Fields<T>& fields, const Schedule& schedule, Team& team) const;
    /// The nodes of all cells with points or surface, and those of all places.
    std::vector<std::array<std::int32_t, 27>> coupled_nodes() const;
    /// The node of every weight of the geometry's rows.
    const std::vector<std::int32_t>& constraint_node() const { return constraint_node_; }

    /// Diagonal of the box around all nodes [m].
    double extent() const;

    /// Checks the sizes of all inputs; std::invalid_argument names the one that is wrong.
    void check(const Fields<T>& fields, const Schedule& schedule, const Observer* observer = nullptr) const;
    /// The same for all inputs that do not depend on the schedule.
    void check_body(const Fields<T>& fields) const;

  private:
    /// The trajectory and its derivative in a single direction of an explicit run, `number` of those asked for.
    std::vector<Trajectory<T>> tangent_of_one(const Fields<T>& fields, const Fields<T>& direction, int number, const Schedule& schedule,
                                              const Progress& progress, const PointHook<T>* hook, const Observer* observer) const;
    template <class U, int K>
    friend class TotalLagrangianForces;
    template <class U, int K>
    friend class TotalLagrangianRun;
    template <class U>
    friend class TotalLagrangianForcesReverse;
    template <class U>
    friend class TotalLagrangianReverse;
    template <class U, int L>
    friend class TotalLagrangianDirections;
    template <class U, int L>
    friend class CellAssembly;
    friend class Equilibrium;

    struct Chunk {
        std::size_t block_begin, block_end, surface_begin, surface_end;
        int node_begin, node_end;  // node_end counts the over-read of the last row
    };
    struct PlaceRows {
        std::array<std::int32_t, 27> node;
        std::array<T, 27> value;
    };

    Geometry geometry_;
    Settings settings_;
    Slots slots_;
    ActiveSites sites_;
    std::vector<double> node_positions_;
    std::vector<std::int32_t> node_index_;
    std::vector<std::int32_t> node_of_grid_;  // node number of a grid index, -1 where there is none
    std::array<int, 3> grid_shape_{};
    std::array<int, 3> grid_low_{};
    std::vector<bool> curved_;                 // of every grid, as far as any is
    std::vector<std::array<bool, 3>> spanned_; // of every such grid: the axes that one cell spans
    std::vector<std::int32_t> order_;          // sorted blocks -> the caller's
    std::vector<std::int32_t> surface_order_;
    std::vector<std::array<std::int32_t, 9>> rows_, surface_rows_;
    std::vector<std::int32_t> table_, surface_table_;
    std::vector<GradientTable<T>> gradients_;
    std::vector<ValueTable<T>> values_;
    std::vector<MassTable<T>> masses_;
    std::vector<ValueTable<T>> surface_values_;
    std::vector<std::int32_t> spring_;  // of each sorted block: its springs, -1 where it has none
    std::vector<CellSprings<T>> springs_;
    std::vector<PlaceRows> places_;
    std::vector<SharedPoints<T>> shared_points_, shared_places_;  // of curved grids
    std::vector<Chunk> chunks_;
    std::vector<std::int32_t> constraint_node_;
    std::size_t stride_ = 0;  // nodes, padded

    std::array<std::int32_t, 9> rows_of(const std::int32_t* cell) const;
    void place_curved_nodes();
    bool is_curved(int i) const;  // the grid of the cell or node at i along the first axis
    CurvedCell curved_cell(const std::int32_t* cell) const;
    /// Where in its cell a point is, in spacings from the cell's node.
    void in_cell(const double* point, const std::int32_t* cell, double (&s)[3]) const;
    /// N_a and dN_a/dX there.
    void weights_at(const double (&s)[3], const std::int32_t* cell, double (&n)[27], double (&dn)[27][3]) const;
    void set_points(const double (&s)[8][3], const std::int32_t* cell, GradientTable<T>& gradient, ValueTable<T>& value) const;
    void share_mass();
    void leave_mass();
    /// share[c][q][k] of point q's mass is the k-th node's along axis c.
    void mass_shares(const double (&s)[8][3], const std::int32_t* cell, double (&share)[3][8][3]) const;
    MassTable<T> mass_table(const double (&s)[8][3], const std::int32_t* cell, const ValueTable<T>& value) const;
    CellSprings<T> curved_springs(std::size_t block) const;
    int find_node(int i, int j, int k) const;
    SimulationError failure(const std::vector<T>& u, int frame, double time) const;
    std::string describe_failure(const std::vector<T>& u, std::size_t lane_offset, int frame, double time, int* part) const;
};

extern template class TotalLagrangian<float>;
extern template class TotalLagrangian<double>;

}  // namespace mphygs
