// What stays fixed during a simulation, what it is differentiated against, and what comes out.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "mphygs/effect.hpp"
#include "mphygs/physics/actuation.hpp"

namespace mphygs {

/// An unstable or impossible run; the message names the frame, the part and the cause.
struct SimulationError : std::runtime_error {
    using std::runtime_error::runtime_error;
    int frame = -1;
    int part = -1;
    bool shorter = false;  // whether shorter steps before `frame` may do
};

/// Geometry of the discretised object. Points come in blocks of eight that share one cell.
struct Geometry {
    std::array<double, 3> origin{};   // of node (0, 0, 0) [m]
    std::array<double, 3> spacing{};  // [m]
    // Parts may have grids of their own, side by side in one numbering: node (i + k grid_width, j, l) is node
    // (i, j, l) of grid k, for i in [0, grid_width). 0: one grid for all.
    int grid_width = 0;
    std::vector<double> grid_origin, grid_spacing;  // (G, 3) of every grid [m]; none: as `origin` and `spacing` say
    // Nodes that stand elsewhere: their grids are curved, and points of their cells are where these nodes' splines put them.
    std::vector<std::int32_t> curved_node;  // (K, 3) node index, of a curved grid all that material touches
    std::vector<double> curved_position;    // (K, 3) [m]
    std::vector<std::int32_t> cell;   // (B, 3) knot span of each block
    std::vector<std::int32_t> part;   // (B,)
    std::vector<double> points;       // (B, 8, 3) [m]
    std::vector<double> volume;       // (B, 8) of the material [m^3], none: alike in all; of thin parts, see `consistent_mass.hpp`
    std::vector<double> sparse;       // (B,) or none: how much of the cell is filled where that is little, else 0
    std::vector<std::int32_t> surface_cell;  // (S, 3)
    std::vector<double> surface_points;      // (S, 8, 3) [m]
    std::vector<double> surface_area;        // (S, 8) [m^2], 0 pads
    std::vector<std::int32_t> place_cell;    // (P, 3) knot span of each place of a point or mass effect
    std::vector<double> places;              // (P, 3) [m]
    // Holds: rows of the constraint sum_k weight_k u_k = motion of the hold at `target`; ties of grids: = 0.
    std::vector<std::int32_t> row_begin;   // (R + 1,)
    std::vector<std::int32_t> row_node;    // (W, 3) node index on the grid
    std::vector<double> row_weight;        // (W,)
    std::vector<double> row_target;        // (R, 3) [m]
    std::vector<std::int32_t> row_hold;    // (R,), -1 - j: of the j-th joint's tie, which moves with no hold
    int hold_count = 0;
    std::vector<double> hold_centre;       // (H, 3) about which torques are told [m]; needed for reactions only
    int part_count = 1;
    Actuation actuation;  // loads that change with time and follow the object; its carriers are the nodes

    std::size_t block_count() const { return part.size(); }
    std::size_t surface_count() const { return surface_cell.size() / 3; }
    std::size_t place_count() const { return places.size() / 3; }
    std::size_t row_count() const { return row_hold.size(); }
    /// The grid of the cell or node at i along the first axis.
    int grid_of(int i) const { return (i - standing(i)) / std::max(grid_width, 1); }
    /// Along the first axis, the number of a cell or node on its own grid.
    int standing(int i) const { return grid_width > 0 ? ((i % grid_width) + grid_width) % grid_width : i; }
    /// Origin and spacing of the grid of the cell or node at i along the first axis [m].
    std::array<double, 3> origin_at(int i) const { return of_grid(grid_origin, i, origin); }
    std::array<double, 3> spacing_at(int i) const { return of_grid(grid_spacing, i, spacing); }

  private:
    std::array<double, 3> of_grid(const std::vector<double>& each, int i, const std::array<double, 3>& all) const {
        if (each.empty()) {
            return all;
        }
        const std::size_t g = 3 * static_cast<std::size_t>(grid_of(i));
        return {each.at(g), each.at(g + 1), each.at(g + 2)};
    }
};

/// How it is integrated.
struct Schedule {
    std::vector<int> steps;     // (F,) substeps between output frame f and f + 1
    std::vector<double> dt;     // (F,) substep in that interval [s]
    double start = 0;           // time of the initial state [s]
    // (substeps, 2) what each counts for in the reactions at the frame before it and at the one after; none: none wanted
    std::vector<double> reaction_weight = {};
    bool implicit = false;      // by the midpoint rule, as long a step as accuracy allows; only of the total-Lagrangian transfer
    bool paired = false;        // every second implicit substep is one of BDF2 over itself and the one before
    int total_steps() const {
        int n = 0;
        for (int s : steps) {
            n += s;
        }
        return n;
    }
    int frame_count() const { return static_cast<int>(steps.size()); }
    /// (F,) the number of the first substep of every output interval.
    std::vector<int> first_steps() const {
        std::vector<int> first(steps.size());
        std::exclusive_scan(steps.begin(), steps.end(), first.begin(), 0);
        return first;
    }
};

struct Settings {
    Law law = usual_law;
    std::vector<bool> active;       // per effect of the registry
    int threads = 1;
    std::size_t memory_budget = std::size_t(2) << 30;  // of the adjoint's checkpoints [byte]
    double displacement_limit = 1e3;  // a larger displacement is an unstable run [m]
};

/// Everything a simulation may be differentiated against. Empty means: absent (all zero in a
/// tangent, not wanted in a gradient). N nodes in the order of `TotalLagrangian::nodes`.
template <class T>
struct Fields {
    std::vector<T> mu, lambda;       // (B, 8) [Pa]
    std::vector<T> stress_volume;    // (B, 8) volume in the stress-free state [m^3]
    std::vector<T> mass;             // (B, 8) [kg]
    std::vector<T> deformation0;     // (B, 9, 8) from the stress-free to the reference state; empty: I
    std::vector<T> effect;           // (parameters of all effects,)
    std::vector<T> place_mass;       // (P,) [kg]
    std::vector<T> place_effect;     // (P, parameters of all point effects)
    std::vector<T> gravity;          // (3,) [m/s^2]
    std::vector<T> displacement0;    // (N, 3) [m]
    std::vector<T> velocity0;        // (N, 3) [m/s]
    std::vector<T> node_force;       // (F, N, 3) known force between frames [N]
    std::vector<T> pose;             // (H, steps + 1, 12): R (row major) and p of every hold [-, m]
    std::vector<T> target;           // (F, M, 4, 3) of an observer's channels, polynomials in each interval [m]
    std::vector<T> channel;          // (F, C, 4) of an actuation's channels, polynomials in each interval [N or Pa]; empty: none acts
    // The same names, for loops over all of them.
    static constexpr int count = 15;
    std::array<std::vector<T>*, count> all() {
        return {&mu, &lambda, &stress_volume, &mass, &deformation0, &effect, &place_mass, &place_effect,
                &gravity, &displacement0, &velocity0, &node_force, &pose, &target, &channel};
    }
    static constexpr std::array<const char*, count> names = {
        "mu", "lambda", "stress_volume", "mass", "deformation0", "effect", "place_mass", "place_effect",
        "gravity", "displacement0", "velocity0", "node_force", "pose", "target", "channel"};
};

/// Node states at the output frames (the initial state is frame 0).
template <class T>
struct Trajectory {
    std::vector<T> displacement;  // (F + 1, N, 3) [m]
    std::vector<T> velocity;      // (F + 1, N, 3) [m/s]
    std::vector<double> reaction = {};  // (F + 1, H, 6) what each hold exerts [N, N m], where the schedule asks for it
};

}  // namespace mphygs
