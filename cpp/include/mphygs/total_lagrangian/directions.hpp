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

    Inputs<T, 0> values_alone(const Fields<T>& fields) {
        Inputs<T, 0> inputs;
        inputs.primal = &fields;
        if (hook_) {
            // The hook is asked once a substep, for the values and all directions; the middle of an implicit step is found by
            // the values alone.
            of_values_.forward = [this](const PointState<T>& state) { return schedule_.implicit ? hook_->forward(state) : given_; };
            inputs.hook = &of_values_;
        }
        inputs.observer = observer_;
        return inputs;
    }
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

    void reduce_forces() {
        std::fill(f_.begin(), f_.end(), W{});
        for (std::size_t c = 0; c < model_.chunks_.size(); ++c) {
            const auto& chunk = model_.chunks_[c];
            const std::size_t begin = static_cast<std::size_t>(chunk.node_begin);
            const std::size_t span = static_cast<std::size_t>(chunk.node_end) - begin, used = std::min(span, stride_ - begin);
            for (std::size_t s = 0; s < slabs_; ++s) {
                const W* from = &chunk_force_[c][s * 3 * span];
                W* to = &f_[s * slab_ + 3 * begin];
                for (std::size_t i = 0; i < 3 * used; ++i) {
                    to[i] += from[i];
                }
            }
            for (std::size_t a = 0; a < added_.size(); ++a) {
                const std::size_t k = added_[a].number;
                T* to = reinterpret_cast<T*>(&f_[k / width * slab_ + 3 * begin]) + k % width;
                for (std::size_t i = 0; i < 3; ++i) {
                    const T* from = &chunk_added_[c][(3 * a + i) * span];
                    for (std::size_t n = 0; n < used; ++n) {
                        to[(3 * n + i) * width] += from[n];
                    }
                }
            }
        }
    }

    void place_forces(double time);
    void hook_forces(double time, double dt);
    void actuate(int n, int frame, double dt);

    /// What the observer's channels ask for in all directions, at the start of a substep [m/s^2].
    void ask(int n, int frame, double dt) {
        const Observer& o = *observer_;
        const std::size_t count = o.channel_count(), from = static_cast<std::size_t>(frame) * count;
        if (frame != aimed_) {
            aimed_ = frame;
            aims_.clear();
            for (std::size_t s = 0; s < slabs_ && any(&Fields<T>::target); ++s) {
                for (std::size_t i = 0; i < 12 * count; ++i) {
                    aims_.push_back(lanes(&Fields<T>::target, s, 12 * from + i));
                }
            }
        }
        const ObserverRows<T>& rows = *value_.observer_;
        const auto factors = rows.factors(value_.target_basis(n, frame, dt));
        const std::vector<std::size_t>& read = rows.read_carriers();
        blend_.resize(3 * read.size());
        asked_.resize(slabs_ * 3 * count);
        for (std::size_t s = 0; s < slabs_; ++s) {
            // Rows are linear: one pass over them does for place and rate.
            for (std::size_t k = 0; k < read.size(); ++k) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const std::size_t i = s * slab_ + 3 * read[k] + c;
                    blend_[3 * k + c] = rows.stiffness() * u_[i] + rows.damping() * v_[i];
                }
            }
            for (std::size_t i = 0; i < count; ++i) {
                const T share = static_cast<T>(o.share[from + i]);
                W asked[3] = {};
                rows.each_row(i, [&](std::size_t at, T weight) {
                    for (std::size_t c = 0; c < 3; ++c) {
                        asked[c] -= weight * blend_[3 * at + c];
                    }
                });
                for (std::size_t c = 0; c < 3; ++c) {
                    for (std::size_t k = 0; !aims_.empty() && k < 4; ++k) {
                        asked[c] += factors[k] * aims_[((s * count + i) * 4 + k) * 3 + c];
                    }
                    asked_[(s * count + i) * 3 + c] = share * asked[c];
                }
            }
        }
    }

    /// dt G (what the channels ask for), of the values and of all directions.
    void spread_pulls(double dt) {
        constexpr std::size_t quad = ObserverRows<T>::quad;
        const std::size_t count = observer_->channel_count();
        columns_.resize(directions_.size() * quad * count);
        pulled_.resize(directions_.size() * slab_);
        std::vector<const T*> asked;
        std::vector<T*> pulled;
        for (std::size_t k = 0; k < directions_.size(); ++k) {
            T* column = &columns_[k * quad * count];
            const W* from = &asked_[k / width * 3 * count];
            for (std::size_t i = 0; i < 3 * count; ++i) {
                column[i / 3 * quad + i % 3] = from[i][k % width];
            }
            asked.push_back(column);
            pulled.push_back(&pulled_[k * slab_]);
        }
        value_.spread_pulls(dt, asked, pulled);
    }

    void add_pulls() {
        for (std::size_t k = 0; k < directions_.size(); ++k) {
            T* to = reinterpret_cast<T*>(&v_[k / width * slab_]) + k % width;
            for (std::size_t c = 0; c < 3; ++c) {
                const T* from = &pulled_[k * slab_ + c * stride_];
                for (std::size_t n = 0; n < model_.node_count(); ++n) {
                    to[(3 * n + c) * width] += from[n];
                }
            }
        }
    }

    void known_forces(int frame) {
        if (frame != frame_) {
            frame_ = frame;
            known_.clear();
            const std::size_t size = 3 * model_.node_count();
            for (std::size_t s = 0; s < slabs_ && any(&Fields<T>::node_force); ++s) {
                for (std::size_t i = 0; i < size; ++i) {
                    known_.push_back(lanes(&Fields<T>::node_force, s, static_cast<std::size_t>(frame) * size + i));
                }
            }
        }
        const std::size_t size = known_.size() / std::max<std::size_t>(slabs_, 1);
        for (std::size_t s = 0; s < slabs_; ++s) {
            for (std::size_t i = 0; i < size; ++i) {
                f_[s * slab_ + i] += known_[s * size + i];
            }
        }
    }

    /// dv* = dv + dt (df / m + d(gravity + body effects)); the change of 1 / m follows in `lighten`.
    void accelerate(double time, double dt) {
        const T h = static_cast<T>(dt);
        const std::size_t uniforms = static_cast<std::size_t>(Registry::total_uniform_count);
        for (std::size_t s = 0; s < slabs_; ++s) {
            for (std::size_t n = 0; n < model_.node_count(); ++n) {
                const T inverse = value_.inverse_mass_[n];
                W* v = &v_[s * slab_ + 3 * n];
                if (inverse == T{}) {
                    v[0] = v[1] = v[2] = W{};  // nodes without mass stay where they are
                    continue;
                }
                const W* f = &f_[s * slab_ + 3 * n];
                Vec3<D> effects;
                if (model_.sites_.body) {
                    BodyPoint<D> p;
                    p.time = static_cast<T>(time);
                    for (std::size_t c = 0; c < 3; ++c) {
                        const std::size_t i = value_.at(0, c, n);
                        p.position[static_cast<int>(c)] = dual(static_cast<T>(model_.node_positions_[3 * n + c]) + value_.u_[i], u_[s * slab_ + 3 * n + c]);
                        p.velocity[static_cast<int>(c)] = dual(value_.v_[i], v[c]);
                    }
                    effects = evaluate_body(model_.slots_, &uniforms_[s * uniforms], p);
                }
                for (int c = 0; c < 3; ++c) {
                    W total = gravity_[3 * s + static_cast<std::size_t>(c)] + f[c] * inverse;
                    if (model_.sites_.body) {
                        total += effects[c].d[0];
                    }
                    v[c] += h * total;
                }
            }
        }
        for (const Direction& a : added_) {
            if (a.forces.own().body) {
                add_acceleration(a, time, h);
            }
        }
    }

    void add_acceleration(const Direction& a, double time, T h) {
        T* to = reinterpret_cast<T*>(&v_[a.number / width * slab_]) + a.number % width;
        for (std::size_t n = 0; n < stride_; n += lane_count) {
            const BodyPoint<Pack<T>> now = value_.body_point(n, time);
            BodyPoint<typename AddedForces<T>::P> p;
            for (int c = 0; c < 3; ++c) {
                p.position[c].v = now.position[c];
                p.velocity[c].v = now.velocity[c];
            }
            p.time = now.time;
            const Vec3<Pack<T>> slope = a.forces.acceleration(p);
            for (std::size_t q = 0; q < static_cast<std::size_t>(lane_count); ++q) {
                for (std::size_t c = 0; c < 3 && value_.inverse_mass_[n + q] != T{}; ++c) {
                    to[(3 * (n + q) + c) * width] += h * slope[static_cast<int>(c)][q];
                }
            }
        }
    }

    /// What is left of dv*: dt f d(1 / m), with the forces of the values' substep.
    void lighten(double dt) {
        const T h = static_cast<T>(dt);
        for (std::size_t s = 0; s < slabs_ && !inverse_mass_.empty(); ++s) {
            for (std::size_t n = 0; n < model_.node_count(); ++n) {
                const W slope = inverse_mass_[s * stride_ + n];
                for (std::size_t c = 0; c < 3; ++c) {
                    v_[s * slab_ + 3 * n + c] += (h * value_.f_[value_.at(0, c, n)]) * slope;
                }
            }
        }
    }

    /// aimed: as in the values' run; reacting: whether it counts in the reactions.
    void hold(int n, int frame, double dt, bool aimed = true, bool reacting = true);
    // See `direction_midpoint.hpp`. Changes of the velocity are (3 N, directions) there.
    void midpoint_step(int n, int frame, double time, double dt);
    double stiffer(std::size_t k) const;
    void midpoint_map(const Eigen::MatrixXd& x, int n, int frame, double middle, double dt, bool last);
    void enter(const Eigen::MatrixXd& x);
    Eigen::MatrixXd velocities() const;
    void still_without_mass();
    /// Adds what the holds exert in a substep to the reactions, in the directions of a slab.
    void react(int n, int frame, std::size_t slab);

    /// How much softer the holds are in a direction.
    T compliance(std::size_t slab, std::size_t lane) const {
        T sum{};
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            if constexpr (E::info.site == Site::hold) {
                const EffectSlot& at = model_.slots_[static_cast<std::size_t>(i)];
                if (at.active) {
                    sum += parameters_[slab * value_.parameters_.size() + static_cast<std::size_t>(at.parameter)].d[0][lane];
                }
            }
        });
        return sum;
    }

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
    std::vector<Direction> added_, added0_;  // and as they are at the start of an implicit step
    std::vector<std::vector<W>> chunk_force_;
    std::vector<std::vector<T>> chunk_added_;  // of each chunk: direction with added effects, component, node
    int frame_ = -1;
    std::vector<W> known_;  // slab, node, component, in the present interval
    std::vector<double> held_, missed_, impulse_, reaction_, pull_;
};

}  // namespace mphygs
