// Derivatives of a total-Lagrangian run in many directions, beside the run itself.
//
// The values are those of TotalLagrangianRun<T, 0>, to the bit; the directions stand in the lanes, (node, component) of as
// many as a register holds. Every substep: forces of all directions at the values' state, then the values' substep, then
// the directions' own.
#pragma once

#include "mphygs/total_lagrangian/added.hpp"
#include "mphygs/total_lagrangian/direction_sums.hpp"
#include "mphygs/total_lagrangian/holds.hpp"
#include "mphygs/total_lagrangian/hook.hpp"

namespace mphygs {

/// L: lanes, at most what a register holds. Few directions are quicker in few.
template <class T, int L>
class TotalLagrangianDirections {
  public:
    using Model = TotalLagrangian<T>;
    using W = Vector<T, L>;
    using D = Dual<W, 1>;
    static constexpr std::size_t width = static_cast<std::size_t>(L);

    /// directions: one or more; added: as many, or none; first_direction: number of the first among the caller's.
    TotalLagrangianDirections(const Model& model, const Fields<T>& fields, std::vector<const Fields<T>*> directions,
                              const std::vector<const Added<T>*>& added, const PointHook<T>* hook, const Observer* observer,
                              int first_direction, const Schedule& schedule, Team& team)
        : model_(model), directions_(std::move(directions)), hook_(hook), observer_(observer), first_direction_(first_direction), schedule_(schedule),
          team_(&team), slabs_((directions_.size() + width - 1) / width), stride_(model.stride_), slab_(3 * model.stride_),
          value_(model, values_alone(fields), schedule, team), sums_(model.geometry_, schedule, directions_.size()) {
        u_.assign(slabs_ * slab_, W{});
        v_ = f_ = u_;
        for (std::size_t s = 0; s < slabs_; ++s) {
            for (std::size_t i = 0; i < 3 * model.node_count(); ++i) {
                u_[s * slab_ + i] = lanes(&Fields<T>::displacement0, s, i);
                v_[s * slab_ + i] = lanes(&Fields<T>::velocity0, s, i);
            }
            for (std::size_t c = 0; c < 3; ++c) {
                gravity_.push_back(lanes(&Fields<T>::gravity, s, c));
            }
            for (std::size_t i = 0; i < value_.parameters_.size(); ++i) {
                parameters_.push_back(dual(value_.parameters_[i], lanes(&Fields<T>::effect, s, i)));
            }
        }
        uniforms_.resize(slabs_ * static_cast<std::size_t>(Registry::total_uniform_count));
        pack_points();
        pack_springs();
        prepare_mass();
        for (std::size_t k = 0; k < added.size(); ++k) {
            if (added[k] && !added[k]->active.empty()) {
                added_.push_back({k, AddedForces<T>(*added[k], model.settings_.active, directions_[k]->effect, model.rows_.size())});
            }
        }
        for (const Direction& a : added_) {
            rate_ = rate_ || a.forces.needs_rate();
            surface_ = surface_ || a.forces.own().surface;
            volume_added_ = volume_added_ || a.forces.own().volume;
        }
        surface_ = surface_ || model.sites_.surface;
        for (const auto& c : model.chunks_) {
            const std::size_t span = static_cast<std::size_t>(c.node_end - c.node_begin);
            chunk_force_.emplace_back(slabs_ * 3 * span, W{});
            chunk_added_.emplace_back(added_.size() * 3 * span, T{});
        }
    }

    /// Substep `n` of the whole run, in output interval `frame`.
    void step(int n, int frame, double time, double dt) {
        if (schedule_.implicit) {
            midpoint_step(n, frame, time, dt);
            return;
        }
        refresh(time, dt);
        team_->each(static_cast<int>(model_.chunks_.size()), [&](int c) { chunk_forces(static_cast<std::size_t>(c), time, dt); });
        reduce_forces();
        place_forces(time);
        hook_forces(time, dt);
        known_forces(frame);
        actuate(n, frame, dt);
        const bool pulls = value_.ask(n, frame, dt);
        if (pulls) {
            ask(n, frame, dt);
            spread_pulls(dt);
        }
        accelerate(time, dt);
        if (pulls) {
            add_pulls();
        }
        value_.step(n, frame, time, dt, true);
        lighten(dt);
        hold(n, frame, dt);
        const T h = static_cast<T>(dt);
        for (std::size_t i = 0; i < u_.size(); ++i) {
            u_[i] += h * v_[i];
        }
    }

    const TotalLagrangianRun<T, 0>& value() const { return value_; }

    bool finite() const {
        const T* numbers[2] = {reinterpret_cast<const T*>(u_.data()), reinterpret_cast<const T*>(v_.data())};
        bool good = value_.finite();
        for (const T* x : numbers) {
            for (std::size_t i = 0; i < u_.size() * width; ++i) {
                good &= std::isfinite(x[i]);
            }
        }
        return good;
    }

    /// What every hold exerts at the output frames, in direction k.
    std::vector<double> reaction(std::size_t k) const { return sums_.of(k); }

    /// Copies direction k of the node state to (N, 3) arrays.
    void output(std::size_t k, T* displacement, T* velocity) const {
        const W* u = u_.data() + k / width * slab_;
        const W* v = v_.data() + k / width * slab_;
        for (std::size_t i = 0; i < 3 * model_.node_count(); ++i) {
            displacement[i] = u[i][k % width];
            velocity[i] = v[i][k % width];
        }
    }

  private:
    template <class TT, int LL>
    friend class CellAssembly;

    struct Direction {
        std::size_t number;
        AddedForces<T> forces;
    };
    using Member = std::vector<T> Fields<T>::*;
    using Points = W[3][point_axes];

    static D dual(T value, const W& slope) {
        D r(fill<W>(value));
        r.d[0] = slope;
        return r;
    }
    static Mat3<W> at_point(const Points& p, int q) {
        Mat3<W> r;
        for (int i = 0; i < 9; ++i) {
            r.e[i / 3][i % 3] = p[i / 3][i % 3 * lane_count + q];
        }
        return r;
    }
    static void put(Points& p, int q, const Mat3<W>& m) {
        for (int i = 0; i < 9; ++i) {
            p[i / 3][i % 3 * lane_count + q] = m.e[i / 3][i % 3];
        }
    }

    template <class A, class B>
    static Mat3<W> product(const Mat3<A>& a, const Mat3<B>& b) {
        return mixed_product<W>(a, b);
    }

    Inputs<T, 0> values_alone(const Fields<T>& fields);
    bool any(Member member) const {
        return std::any_of(directions_.begin(), directions_.end(), [&](const Fields<T>* d) { return !(d->*member).empty(); });
    }
    /// One number of a field in all directions of a slab; absent fields read as zero.
    W lanes(Member member, std::size_t slab, std::size_t index) const {
        T of[width] = {};
        for (std::size_t l = 0; l < width && slab * width + l < directions_.size(); ++l) {
            const std::vector<T>& field = directions_[slab * width + l]->*member;
            of[l] = field.empty() ? T{} : field[index];
        }
        return read<W>(of);
    }

    /// In the sorted order, (slab, point).
    void pack_points();
    void pack_springs();
    static W of(const std::vector<W>& numbers, std::size_t i) { return numbers.empty() ? W{} : numbers[i]; }

    /// What the directions' masses do to 1 / m.
    void prepare_mass();

    void refresh(double time, double dt) {
        const std::size_t count = static_cast<std::size_t>(Registry::total_uniform_count);
        const std::size_t parameters = value_.parameters_.size();
        for (std::size_t s = 0; s < slabs_; ++s) {
            all_uniforms(model_.slots_, &parameters_[s * parameters], static_cast<T>(time), static_cast<T>(dt), &uniforms_[s * count]);
        }
        if (model_.sites_.out_of_reach || model_.sites_.volume) {
            value_.refresh_uniforms(time, dt);
        }
        for (Direction& a : added_) {
            a.forces.refresh(time, dt);
        }
    }

    void chunk_forces(std::size_t index, double time, double dt);
    bool linearised() const {
        return model_.sites_.linearised && !model_.sites_.body_volume && model_.settings_.law == linearised_law;
    }
    struct OfNodes;
    template <class Ends>
    void block_forces(std::size_t b, double time, double dt, const Ends& ends);
    template <bool Effects, class Ends>
    void linearised_forces(std::size_t b, double time, double dt, const Ends& ends);
    template <class Ends>
    void volume_forces(std::size_t b, double time, double dt, const Ends& ends);
    void spring_forces(std::size_t b, W* out, std::size_t span) const;
    void surface_forces(std::size_t b, double time, W* out, std::size_t span, T* added);
    void added_volume(std::size_t b, double time, double dt, T* out, std::size_t span);

    void reduce_forces();

    void place_forces(double time);
    void hook_forces(double time, double dt);
    void actuate(int n, int frame, double dt);

    /// What the observer's channels ask for in all directions, at the start of a substep [m/s^2].
    void ask(int n, int frame, double dt);

    /// dt G (what the channels ask for), of the values and of all directions.
    void spread_pulls(double dt);

    void add_pulls();

    void known_forces(int frame);

    /// As in the values' run, and what the directions' masses do there.
    void share_inertia(double span);

    /// dv* = dv + dt (df / m + d(gravity + body effects)); the change of 1 / m follows in `lighten`.
    void accelerate(double time, double dt);

    void add_acceleration(const Direction& a, double time, T h);

    /// What is left of dv*: dt f d(1 / m), with the forces of the values' substep.
    void lighten(double dt);

    /// aimed: as in the values' run; reacting: whether it counts in the reactions.
    void hold(int n, int frame, double dt, bool aimed = true, bool reacting = true);
    // See `direction_midpoint.hpp`. Changes of the velocity are (3 N, directions) there.
    void midpoint_step(int n, int frame, double time, double dt);
    void midpoint_map(const Eigen::MatrixXd& x, int n, int frame, double middle, double dt, bool last);
    void enter(const Eigen::MatrixXd& x);
    Eigen::MatrixXd velocities() const;
    void still_without_mass();
    /// Adds what the holds exert in a substep to the reactions, in the directions of a slab.
    void react(int n, int frame, std::size_t slab);

    /// How much softer the holds are in a direction.
    T compliance(std::size_t slab, std::size_t lane) const;

    const Model& model_;
    std::vector<const Fields<T>*> directions_;
    const PointHook<T>* hook_;
    const Observer* observer_;
    int first_direction_;
    const Schedule& schedule_;
    Team* team_;
    std::size_t slabs_, stride_, slab_;  // registers of directions; nodes, padded; numbers of a slab
    PointHook<T> of_values_;
    PointForces<T> given_;  // by the hook, of the values
    TotalLagrangianRun<T, 0> value_;
    ReactionSums sums_;
    bool rate_ = false, surface_ = false, volume_added_ = false;
    std::vector<W> u_, v_, f_;                          // slab, node, component
    std::vector<W> u0_, v0_, history0_;                 // at the start of an implicit step
    std::vector<W> past_u_, past_v_;                    // at the start of a pair of them
    int aimed_ = -1;                                    // output interval whose targets are in aims_
    std::vector<W> aims_;                               // slab, channel, power, component; empty where no direction has any
    std::vector<W> blend_;                              // stiffness u + damping v of what channels read, (carriers, 3)
    std::vector<W> asked_;                              // slab, channel, component [m/s^2]
    std::vector<T> columns_, pulled_;                   // of each direction: asked_ as ObserverRows has it; what it makes of it
    std::vector<W> gravity_;                            // slab, component
    std::vector<D> parameters_, uniforms_;              // slab, number
    std::vector<W> mu_, lambda_, volume_, mass_points_;  // slab, point; empty where no direction changes it
    std::vector<Mat3<W>> f0_;
    std::vector<W> history_;           // slab, point, number
    std::vector<W> spring_stiffness_;  // slab, spring [N/m]
    std::vector<W> inverse_mass_;      // slab, node; empty where no direction has a mass
    std::vector<SharedMass<T>> shared_mass_;  // of each direction; empty where none has a mass
    std::vector<Direction> added_, added0_;  // and as they are at the start of an implicit step
    std::vector<std::vector<W>> chunk_force_;
    std::vector<std::vector<T>> chunk_added_;  // of each chunk: direction with added effects, component, node
    int frame_ = -1;
    std::vector<W> known_;  // slab, node, component, in the present interval
    std::vector<double> held_, missed_, impulse_, reaction_, pull_;
};

}  // namespace mphygs
