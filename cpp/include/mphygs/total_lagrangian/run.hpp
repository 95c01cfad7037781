// One run of the total-Lagrangian transfer: the step of the nodes, forward and tangent.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

#include "mphygs/numerics/team.hpp"
#include "mphygs/physics/constraint.hpp"
#include "mphygs/physics/observer_rows.hpp"
#include "mphygs/physics/reaction.hpp"
#include "mphygs/total_lagrangian/midpoint_state.hpp"
#include "mphygs/total_lagrangian/substep_rule.hpp"
#include "mphygs/total_lagrangian/surface_forces.hpp"

namespace mphygs {

/// T: float or double; K: number of directions (0: values only).
template <class T, int K>
class TotalLagrangianRun : public TotalLagrangianForces<T, K> {
  public:
    using Forces = TotalLagrangianForces<T, K>;
    using typename Forces::Model;
    using typename Forces::S;
    using typename Forces::U;
    using Forces::at, Forces::lanes;

    /// team: whose threads share the work of a substep.
    TotalLagrangianRun(const Model& model, const Inputs<T, K>& inputs, const Schedule& schedule, Team& team)
        : Forces(model, inputs), schedule_(schedule), team_(&team), sums_(model.geometry_, schedule, lanes) {
        f_.assign(lanes * size_, T{});
        prepare_mass();
        for (std::size_t c = 0; c < 3; ++c) {
            gravity_[static_cast<int>(c)] = inputs.plain(&Fields<T>::gravity, c);
        }
        compliance_ = U{};
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            if constexpr (E::info.site == Site::hold) {
                const EffectSlot& s = model.slots_[static_cast<std::size_t>(i)];
                if (s.active) {
                    compliance_ = compliance_ + this->parameters_[static_cast<std::size_t>(s.parameter)];
                }
            }
        });
        lambda_rows_.assign(static_cast<std::size_t>(lanes) * 3 * model.geometry_.row_count(), 0.0);
        if (inputs.observer) {
            observer_.emplace(*inputs.observer, stride_, [&](std::size_t k) {
                return k < model.node_count() && inverse_mass_[k] != T{} ? inputs.observer->reach_row_of(k) : -1;
            });
        }
        if (!model.geometry_.actuation.empty() && !inputs.primal->channel.empty()) {
            actuation_.emplace(model.geometry_.actuation);
        }
        first_step_ = schedule.first_steps();
    }

    /// Substep `n` of the whole run, in output interval `frame`. pulled: the observer's pulls are known already.
    void step(int n, int frame, double time, double dt, bool pulled = false) {
        if constexpr (K == 0) {
            if (schedule_.implicit) {
                solve_midpoint(n, frame, time, dt);
                finish_midpoint(n, frame, dt);
                return;
            }
        }
        refresh_uniforms(time, dt);
        team_->each(static_cast<int>(model_.chunks_.size()),
                    [&](int c) { chunk_forces(static_cast<std::size_t>(c), time, dt); });
        reduce_forces();
        place_forces(time);
        hook_forces(time, dt);
        known_forces(frame);
        actuate(index(frame), target_basis(n, frame, dt).value, n);
        if (!pulled && ask(n, frame, dt)) {
            spread_pulls(dt);
        }
        update_nodes(time, dt);
        add_pulls();
        hold(n, frame, dt);
        const T h = static_cast<T>(dt);
        for (std::size_t i = 0; i < u_.size(); ++i) {
            u_[i] += h * v_[i];
        }
    }

    /// Leaves M^-1 f (and its derivatives) at the start in the velocity, no hold applied: the
    /// linearised right-hand side, for the estimate of the largest rates.
    void accelerations(double dt) {
        refresh_uniforms(0.0, dt);
        for (std::size_t c = 0; c < model_.chunks_.size(); ++c) {
            chunk_forces(c, 0.0, dt);
        }
        reduce_forces();
        place_forces(0.0);
        hook_forces(0.0, dt);
        actuate(0, TargetBasis(0, 1, dt).value, -1);
        std::vector<T> before = v_;
        update_nodes(0.0, 1.0);
        for (std::size_t i = 0; i < v_.size(); ++i) {
            v_[i] -= before[i];
        }
    }

    std::vector<T>& displacement() { return u_; }
    const std::vector<T>& displacement() const { return u_; }
    std::vector<T>& velocity() { return v_; }
    const std::vector<T>& force() const { return f_; }
    std::vector<S>& history() { return history_; }
    /// What every hold exerts at the output frames, of the values or of a direction: see `Trajectory`.
    std::vector<double> reaction(int lane) const { return sums_.of(static_cast<std::size_t>(lane)); }
    const std::vector<T>& mass() const { return mass_; }
    const std::vector<T>& inverse_mass() const { return inverse_mass_; }
    const Constraint& constraint() const { return constraint_[0]; }
    const std::vector<S>& uniforms() const { return uniforms_; }

    bool finite() const {
        const T limit = static_cast<T>(model_.settings_.displacement_limit);
        bool good = true;
        for (std::size_t i = 0; i < size_; ++i) {
            good &= std::abs(u_[i]) < limit;  // false for anything that is not a number
        }
        for (std::size_t i = size_; i < u_.size(); ++i) {
            good &= std::isfinite(u_[i]);
        }
        return good;
    }

    /// Copies lane l of the node state to (N, 3) arrays.
    void output(int l, T* displacement, T* velocity) const {
        for (std::size_t n = 0; n < model_.node_count(); ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                displacement[3 * n + c] = u_[at(l, c, n)];
                velocity[3 * n + c] = v_[at(l, c, n)];
            }
        }
    }

  private:
    template <class TT>
    friend class TotalLagrangianForcesReverse;
    template <class TT>
    friend class TotalLagrangianReverse;
    template <class TT, int L>
    friend class TotalLagrangianDirections;
    template <class TT, int L>
    friend class CellAssembly;
    using Forces::chunk_force_, Forces::chunk_forces, Forces::f0_, Forces::history_, Forces::inputs_, Forces::model_;
    using Forces::load_point, Forces::parameters_, Forces::prestressed_, Forces::refresh_uniforms, Forces::size_;
    using Forces::stride_, Forces::u_, Forces::uniforms_, Forces::v_, Forces::volume_;

    void prepare_mass();
    void reduce_forces();

    MaterialPoint<U> material_point(std::size_t p, double time) const;

    std::vector<U> place_parameters(std::size_t p) const;

    void place_forces(double time);

    /// What the hook is shown: all quadrature points in the caller's order.
    PointState<T> hook_state(double time, double dt) const;

    void hook_forces(double time, double dt);

    /// Eight points' (3,) vectors or (3, 3) matrices, one after the other in memory.
    static Vec3<Pack<T>> point_vectors(const T* from) {
        Vec3<Pack<T>> r;
        for (int q = 0; q < 8; ++q) {
            for (int c = 0; c < 3; ++c) {
                r[c][q] = from[3 * q + c];
            }
        }
        return r;
    }
    static Mat3<Pack<T>> point_matrices(const T* from) {
        Mat3<Pack<T>> r;
        for (int q = 0; q < 8; ++q) {
            for (int i = 0; i < 9; ++i) {
                r[i / 3][i % 3][q] = from[9 * q + i];
            }
        }
        return r;
    }

    static std::size_t index(int n) { return static_cast<std::size_t>(n); }

    /// Where a substep stands in the targets of its output interval.
    TargetBasis target_basis(int n, int frame, double dt) const;

    /// What the observer's channels ask for at the start of a substep [m/s^2]; whether there is anything.
    bool ask(int n, int frame, double dt);

    /// dt G (what the channels ask for), of all lanes, and of columns that others have beside them.
    void spread_pulls(double dt, std::vector<const T*> asked = {}, std::vector<T*> pulled = {});

    void add_pulls();

    /// Adds the forces of tendons, pressures and known loads in an output interval. powers: of the share; step: number of
    /// the substep, for the holds' poses, -1: holds are at rest.
    void actuate(std::size_t interval, const double (&powers)[4], int step);
    /// Displacements of the nodes that loads read: component c of node n stands at c across + n apart.
    void look(ActuationStep& loads, const T* u, std::size_t across, std::size_t apart) const {
        const std::vector<std::int32_t>& read = model_.geometry_.actuation.read_carriers();
        for (std::size_t i = 0; i < 3 * read.size(); ++i) {
            loads.seen[i] = static_cast<double>(u[i % 3 * across + static_cast<std::size_t>(read[i / 3]) * apart]);
        }
    }
    void push(const ActuationStep& loads, T* f, std::size_t across, std::size_t apart) const {
        const std::vector<std::int32_t>& pushed = model_.geometry_.actuation.pushed_carriers();
        for (std::size_t i = 0; i < 3 * pushed.size(); ++i) {
            f[i % 3 * across + static_cast<std::size_t>(pushed[i / 3]) * apart] += static_cast<T>(loads.pushed[i]);
        }
    }
    /// First of the twelve numbers of a hold's pose before a substep.
    std::size_t pose_at(std::size_t hold, int step) const {
        return (hold * (static_cast<std::size_t>(schedule_.total_steps()) + 1) + static_cast<std::size_t>(step)) * 12;
    }
    void pose_loads(ActuationStep& loads, const Fields<T>& fields, int step) const;

    void known_forces(int frame);

    /// Adds what nodes that share mass push each other with in an implicit step: D (v_m - v_0) / span.
    void share_inertia(double span);

    /// v* = v + dt (f / m + gravity + body effects), eight nodes at a time.
    void update_nodes(double time, double dt);

    BodyPoint<S> body_point(std::size_t n, double time) const;

    /// Pose number i of hold h, as (12,) scalars of lane l.
    double pose(int l, std::size_t h, int step, std::size_t i) const {
        const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
        if (!fields || fields->pose.empty()) {
            return 0.0;
        }
        const std::size_t steps = static_cast<std::size_t>(schedule_.total_steps()) + 1;
        return static_cast<double>(fields->pose[(h * steps + static_cast<std::size_t>(step)) * 12 + i]);
    }

    void hold(int n, int frame, double dt) {
        if (constraint_[0].row_count() == 0) {
            return;
        }
        hold_lanes<0, 1>(n, dt);
        if constexpr (lanes > 1) {
            hold_lanes<1, lanes - 1>(n, dt);
        }
        if (sums_.wanted()) {
            react(n, frame);
        }
    }

    /// Rotations of all holds at the end of a substep, (holds, 9).
    std::vector<double> turns(int lane, int n) const;

    /// Adds what the holds exert in a substep to the reactions of the frames around it.
    void react(int n, int frame);

    /// The hold of some lanes, the values' before those of the derivatives. aimed: else only so that C (u + dt v) = 0.
    template <int First, int Count>
    void hold_lanes(int n, double dt, bool aimed = true);
    /// Of the holds in the constraint's terms [1/kg], infinite where only what moves a hold's rows against each other counts:
    /// a hold that gives way has a velocity of its own.
    double softness(int n, double dt, bool aimed) const {
        const double give = static_cast<double>(lane_of(compliance_, 0));
        return aimed ? rule(n).give() * give / (dt * dt) : give > 0.0 ? 1e100 : 0.0;
    }
    SubstepRule rule(int n) const { return SubstepRule::of(schedule_, n); }

    // See `midpoint.hpp`.
    void prepare_midpoint();
    void midpoint_map(const Eigen::VectorXd& x, int n, int frame, double time, double dt);
    void stand_at_middle();
    /// How far the body has turned around every node, where the middle is taken to be.
    NodeTurns turns_at_middle() const;
    /// Factors of the matrix at the middle as it stands, so long after forces were last asked for.
    void refresh_midpoint(double time, double elapsed, double span);
    void solve_midpoint(int n, int frame, double time, double dt);
    void finish_midpoint(int n, int frame, double dt);
    /// Vectors of the values, (component, node, padded), as the matrix has them, (node, component), and back.
    Eigen::VectorXd by_node(const std::vector<T>& from) const;
    void by_component(const Eigen::VectorXd& from, std::vector<T>& to) const;

    const Schedule& schedule_;
    Team* team_;
    std::vector<int> first_step_;             // of every output interval
    std::optional<ObserverRows<T>> observer_;
    int aimed_ = -1;                           // output interval whose targets are in aims_
    bool pulling_ = false;                     // whether any channel pulls in it
    std::vector<T> aims_[lanes], asked_[lanes], pulled_[lanes], blend_;  // see ObserverRows
    std::optional<ActuationStep> actuation_;                            // where there are loads, and they act
    std::vector<T> f_, mass_, inverse_mass_;  // lane, component, node
    SharedMass<T> shared_mass_;               // of the values
    Vec3<U> gravity_;
    U compliance_{};
    std::vector<double> lambda_rows_;  // lane, component, row: the impulse of each hold row [N s]
    std::vector<double> held_, missed_, impulse_, pull_;  // of the hold's work: (nodes or rows, columns)
    ReactionSums sums_;
    std::unique_ptr<MidpointState<T>> midpoint_;  // of implicit steps
    std::vector<T> past_u_, past_v_;              // at the start of a pair of them
    std::vector<Constraint> constraint_;  // one, built after the masses are known
};

}  // namespace mphygs
