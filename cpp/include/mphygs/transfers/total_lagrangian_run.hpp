// One run of the total-Lagrangian transfer: forward and tangent step, and below them the adjoint.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "mphygs/constraint.hpp"
#include "mphygs/team.hpp"
#include "mphygs/transfers/total_lagrangian.hpp"

namespace mphygs {

/// T: float or double; K: number of directions (0: values only).
template <class T, int K>
class TotalLagrangianRun {
  public:
    using Model = TotalLagrangian<T>;
    using S = PackScalar<T, K>;
    using U = PlainScalar<T, K>;
    static constexpr int lanes = K + 1;

    /// team: whose threads share the work of a substep.
    TotalLagrangianRun(const Model& model, const Inputs<T, K>& inputs, const Schedule& schedule, Team& team)
        : model_(model), inputs_(inputs), schedule_(schedule), team_(&team), stride_(model.stride_), size_(3 * model.stride_) {
        const Geometry& g = model.geometry_;
        const std::size_t blocks = g.block_count();
        u_.assign(lanes * size_, T{});
        v_.assign(lanes * size_, T{});
        f_.assign(lanes * size_, T{});
        for (std::size_t n = 0; n < model.node_count(); ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                for (int l = 0; l < lanes; ++l) {
                    u_[at(l, c, n)] = lane_of(inputs.plain(&Fields<T>::displacement0, 3 * n + c), l);
                    v_[at(l, c, n)] = lane_of(inputs.plain(&Fields<T>::velocity0, 3 * n + c), l);
                }
            }
        }
        for (int k = 0; k < K; ++k) {
            used_ = inputs.direction[k] ? k + 2 : used_;
        }
        // Packed per block, in the sorted order, so that a substep reads straight through.
        prestressed_ = !inputs.primal->deformation0.empty();
        mu_.resize(blocks);
        lambda_.resize(blocks);
        volume_.resize(blocks);
        mass_points_.resize(model.sites_.body_volume ? blocks : 0);
        f0_.resize(prestressed_ ? blocks : 0);
        history_.assign(blocks * static_cast<std::size_t>(model.sites_.history), S{});
        for (std::size_t b = 0; b < blocks; ++b) {
            const std::size_t from = 8 * static_cast<std::size_t>(model.order_[b]);
            mu_[b] = inputs.pack(&Fields<T>::mu, from);
            lambda_[b] = inputs.pack(&Fields<T>::lambda, from);
            volume_[b] = inputs.pack(&Fields<T>::stress_volume, from);
            if (model.sites_.body_volume) {
                mass_points_[b] = inputs.pack(&Fields<T>::mass, from);
            }
            if (prestressed_) {
                for (int i = 0; i < 9; ++i) {
                    f0_[b][i / 3][i % 3] = inputs.pack(&Fields<T>::deformation0, 9 * from + 8 * static_cast<std::size_t>(i));
                }
            }
        }
        surface_area_.resize(model.surface_rows_.size());
        for (std::size_t b = 0; b < surface_area_.size(); ++b) {
            for (int q = 0; q < 8; ++q) {
                surface_area_[b][q] =
                    static_cast<T>(g.surface_area[8 * static_cast<std::size_t>(model.surface_order_[b]) + static_cast<std::size_t>(q)]);
            }
        }
        prepare_mass();
        for (const auto& c : model.chunks_) {
            chunk_force_.emplace_back(static_cast<std::size_t>(lanes) * 3 * static_cast<std::size_t>(c.node_end - c.node_begin), T{});
        }
        uniforms_.resize(static_cast<std::size_t>(Registry::total_uniform_count));
        plain_uniforms_.resize(uniforms_.size());
        parameters_.resize(static_cast<std::size_t>(Registry::parameter_count));
        for (std::size_t i = 0; i < parameters_.size(); ++i) {
            parameters_[i] = inputs.plain(&Fields<T>::effect, i);
        }
        for (std::size_t c = 0; c < 3; ++c) {
            gravity_[static_cast<int>(c)] = inputs.plain(&Fields<T>::gravity, c);
        }
        compliance_ = U{};
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            if constexpr (E::info.site == Site::hold) {
                const EffectSlot& s = model_.slots_[static_cast<std::size_t>(i)];
                if (s.active) {
                    compliance_ = compliance_ + parameters_[static_cast<std::size_t>(s.parameter)];
                }
            }
        });
        lambda_rows_.assign(static_cast<std::size_t>(lanes) * 3 * g.row_count(), 0.0);
    }

    /// Substep `n` of the whole run, in output interval `frame`.
    void step(int n, int frame, double time, double dt) {
        refresh_uniforms(time, dt);
        team_->each(static_cast<int>(model_.chunks_.size()),
                    [&](int c) { chunk_forces(static_cast<std::size_t>(c), time, dt); });
        reduce_forces();
        place_forces(time);
        hook_forces(time, dt);
        known_forces(frame);
        update_nodes(time, dt);
        hold(n, dt);
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
        std::vector<T> before = v_;
        update_nodes(0.0, 1.0);
        for (std::size_t i = 0; i < v_.size(); ++i) {
            v_[i] -= before[i];
        }
    }

    std::size_t at(int lane, std::size_t component, std::size_t node) const {
        return static_cast<std::size_t>(lane) * size_ + component * stride_ + node;
    }
    std::vector<T>& displacement() { return u_; }
    std::vector<T>& velocity() { return v_; }
    const std::vector<T>& force() const { return f_; }
    std::vector<S>& history() { return history_; }
    const std::vector<double>& reactions() const { return lambda_rows_; }
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
    friend class TotalLagrangianReverse;

    void refresh_uniforms(double time, double dt) {
        all_uniforms(model_.slots_, parameters_.data(), static_cast<T>(time), static_cast<T>(dt), plain_uniforms_.data());
        for (std::size_t i = 0; i < uniforms_.size(); ++i) {
            for (int l = 0; l < lanes; ++l) {
                lane_of(uniforms_[i], l) = broadcast<T>(lane_of(plain_uniforms_[i], l));
            }
        }
        value_uniforms_.resize(uniforms_.size());
        for (std::size_t i = 0; i < uniforms_.size(); ++i) {
            value_uniforms_[i] = lane_of(uniforms_[i], 0);
        }
        if constexpr (std::is_same_v<T, float> && K > 1) {
            pair_uniforms_.resize(static_cast<std::size_t>(K / 2) * uniforms_.size());
            for (std::size_t k = 0; k < static_cast<std::size_t>(K / 2); ++k) {
                for (std::size_t i = 0; i < uniforms_.size(); ++i) {
                    pair_uniforms_[k * uniforms_.size() + i] = pair_of(uniforms_[i], 2 * static_cast<int>(k) + 1);
                }
            }
        }
    }

    void prepare_mass() {
        std::vector<T> mass(lanes * stride_, T{});
        for (int l = 0; l < lanes; ++l) {
            const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
            T* m = &mass[static_cast<std::size_t>(l) * stride_];
            if (fields && !fields->mass.empty()) {
                for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
                    const Pack<T> point = load<T>(&fields->mass[8 * static_cast<std::size_t>(model_.order_[b])]);
                    const ValueTable<T>& table = model_.values_[static_cast<std::size_t>(model_.table_[b])];
                    for (int a = 0; a < 27; ++a) {
                        m[model_.rows_[b][static_cast<std::size_t>(a / 3)] + a % 3] += sum_lanes<T>(point * table.by_node[a]);
                    }
                }
            }
            if (fields && model_.sites_.mass && !fields->place_mass.empty()) {
                for (std::size_t p = 0; p < model_.places_.size(); ++p) {
                    for (std::size_t a = 0; a < 27; ++a) {
                        m[model_.places_[p].node[a]] += fields->place_mass[p] * model_.places_[p].value[a];
                    }
                }
            }
        }
        mass_ = mass;
        inverse_mass_.assign(lanes * stride_, T{});
        std::vector<double> inverse(stride_, 0.0);
        for (std::size_t n = 0; n < model_.node_count(); ++n) {
            if (mass[n] > T{}) {
                inverse[n] = 1.0 / static_cast<double>(mass[n]);
                inverse_mass_[n] = static_cast<T>(inverse[n]);
                for (int l = 1; l < lanes; ++l) {
                    const std::size_t i = static_cast<std::size_t>(l) * stride_ + n;
                    inverse_mass_[i] = -inverse_mass_[n] * inverse_mass_[n] * mass[i];
                }
            }
        }
        constraint_.emplace_back(model_.geometry_, model_.constraint_node_, inverse);
    }

    void chunk_forces(std::size_t index, double time, double dt) {
        const auto& chunk = model_.chunks_[index];
        std::vector<T>& out = chunk_force_[index];
        const std::size_t span = static_cast<std::size_t>(chunk.node_end - chunk.node_begin);
        std::fill(out.begin(), out.end(), T{});
        for (std::size_t b = chunk.block_begin; b < chunk.block_end; ++b) {
            block_forces(b, time, dt, out.data() - chunk.node_begin, span);
        }
        if (model_.sites_.surface) {
            for (std::size_t b = chunk.surface_begin; b < chunk.surface_end; ++b) {
                surface_forces(b, time, out.data() - chunk.node_begin, span);
            }
        }
    }

    void block_forces(std::size_t b, double time, double dt, T* out, std::size_t span) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const GradientTable<T>& table = model_.gradients_[static_cast<std::size_t>(model_.table_[b])];
        if (!model_.sites_.volume && model_.settings_.law == Law::neo_hookean) {
            elastic_forces(b, out, span, rows, table);
            return;
        }
        if constexpr (std::is_same_v<T, float> && K > 1) {
            if (used_ > 1) {
                volume_pairs(b, time, dt, out, span, rows, table);
                return;
            }
        }
        VolumePoint<S> p;
        load_point(b, p, time, dt);
        Mat3<S> stress;
        if (!model_.sites_.volume) {
            stress = elastic_stress(p.law, p.deformation, p.mu, p.lambda);
        } else {
            const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
            thread_local std::vector<S> before, after;
            before.assign(history_.begin() + static_cast<std::ptrdiff_t>(b * count),
                          history_.begin() + static_cast<std::ptrdiff_t>((b + 1) * count));
            after.resize(count);
            evaluate_volume(model_.slots_, uniforms_.data(), p, before.data(), after.data());
            std::copy(after.begin(), after.end(), history_.begin() + static_cast<std::ptrdiff_t>(b * count));
            stress = p.stress;
            if (model_.sites_.body_volume) {
                const Vec3<S> force = mass_points_[b] * p.acceleration;
                for (int l = 0; l < used_; ++l) {
                    Vec3<Pack<T>> part;
                    for (int c = 0; c < 3; ++c) {
                        part[c] = lane_of(force[c], l);
                    }
                    scatter_value<T>(part, out + static_cast<std::size_t>(l) * 3 * span, span, rows,
                                     model_.values_[static_cast<std::size_t>(model_.table_[b])]);
                }
            }
        }
        if (prestressed_) {
            stress = stress * transpose(f0_[b]);
        }
        stress = (-volume_[b]) * stress;
        for (int l = 0; l < used_; ++l) {
            scatter_gradient<T>(get_lane<Pack<T>>(stress, l), out + static_cast<std::size_t>(l) * 3 * span, span, rows, table);
        }
    }

    /// The law alone, one direction after the other: nothing but registers between gather and scatter.
    void elastic_forces(std::size_t b, T* out, std::size_t span, const Rows& rows, const GradientTable<T>& table) const {
        using P = Pack<T>;
        const Mat3<P> gradient = gather_gradient<T>(u_.data(), stride_, rows, table);
        Mat3<P> f0, f0t, f;
        if (prestressed_) {
            f0 = get_lane<P>(f0_[b], 0);
            f0t = transpose(f0);
            f = f0 + gradient * f0;
        } else {
            f = Mat3<P>::identity() + gradient;
        }
        const P volume = -lane_of(volume_[b], 0);
        const NeoHookean::Linearised<P> law(f, lane_of(mu_[b], 0), lane_of(lambda_[b], 0));
        Mat3<P> stress = law.stress();  // without the volume: the directions need it
        const Mat3<P> pulled = prestressed_ ? stress * f0t : stress;
        scatter_gradient<T>(volume * pulled, out, span, rows, table);
        int done = 1;
        if constexpr (std::is_same_v<T, float> && K > 1) {
            done = elastic_pairs(b, out, span, rows, table, law, gradient, stress, pulled);
        }
        for (int l = done; l < used_; ++l) {
            Mat3<P> df = gather_gradient<T>(u_.data() + at(l, 0, 0), stride_, rows, table);
            Mat3<P> df0;
            if (prestressed_) {
                df0 = get_lane<P>(f0_[b], l);
                df = df * f0 + df0 + gradient * df0;
            }
            Mat3<P> change = law.change(df, lane_of(mu_[b], l), lane_of(lambda_[b], l));
            if (prestressed_) {
                change = change * f0t + stress * transpose(df0);
            }
            scatter_gradient<T>(volume * change + (-lane_of(volume_[b], l)) * pulled, out + static_cast<std::size_t>(l) * 3 * span,
                                span, rows, table);
        }
    }

    /// Two directions at a time, the points of the second in the upper eight lanes. Returns the first lane left.
    int elastic_pairs(std::size_t b, float* out, std::size_t span, const Rows& rows, const GradientTable<float>& table,
                      const NeoHookean::Linearised<Pack<float>>& point, const Mat3<Pack<float>>& gradient,
                      const Mat3<Pack<float>>& stress, const Mat3<Pack<float>>& pulled) const {
        using W = PackPair;
        const auto twice = [](const Mat3<Pack<float>>& m) {
            Mat3<W> r;
            for (int i = 0; i < 9; ++i) {
                r.e[i / 3][i % 3] = join(m.e[i / 3][i % 3], m.e[i / 3][i % 3]);
            }
            return r;
        };
        const auto lanes_of = [](const S& x, int l) { return pair_lanes(x, l); };
        NeoHookean::Linearised<W> law;
        law.f = twice(point.f);
        law.c = twice(point.c);
        law.mu = join(point.mu, point.mu);
        law.lambda = join(point.lambda, point.lambda);
        law.inverse_j = join(point.inverse_j, point.inverse_j);
        law.log_j = join(point.log_j, point.log_j);
        law.scale = join(point.scale, point.scale);
        const Mat3<W> both_pulled = twice(pulled);
        Mat3<W> f0, f0t, g, s;
        if (prestressed_) {
            f0 = twice(get_lane<Pack<float>>(f0_[b], 0));
            f0t = transpose(f0);
            g = twice(gradient);
            s = twice(stress);
        }
        const W volume = join(-volume_[b].v, -volume_[b].v);
        int l = 1;
        for (; l + 1 < used_; l += 2) {
            Mat3<W> df = gather_gradient_pair(u_.data() + at(l, 0, 0), size_, stride_, rows, table);
            Mat3<W> df0;
            if (prestressed_) {
                for (int i = 0; i < 9; ++i) {
                    df0.e[i / 3][i % 3] = lanes_of(f0_[b].e[i / 3][i % 3], l);
                }
                df = df * f0 + df0 + g * df0;
            }
            Mat3<W> change = law.change(df, lanes_of(mu_[b], l), lanes_of(lambda_[b], l));
            if (prestressed_) {
                change = change * f0t + s * transpose(df0);
            }
            const W dvolume = -lanes_of(volume_[b], l);
            alignas(64) float p[2][3][3][8];
            for (int i = 0; i < 9; ++i) {
                const W sum = volume * change.e[i / 3][i % 3] + dvolume * both_pulled.e[i / 3][i % 3];
                store<float>(p[0][i / 3][i % 3], lower(sum));
                store<float>(p[1][i / 3][i % 3], upper(sum));
            }
            for (int k = 0; k < 2; ++k) {
                scatter_gradient_rows(p[k], out + static_cast<std::size_t>(l + k) * 3 * span, span, rows, table);
            }
        }
        return l;
    }

    /// Law and volume effects, two directions at a time: numbers with all directions would live in memory.
    void volume_pairs(std::size_t b, double time, double dt, float* out, std::size_t span, const Rows& rows,
                      const GradientTable<float>& table) {
        using D = PairScalar;
        static_assert(K % 2 == 0);
        const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
        thread_local std::vector<D> before, after;
        before.resize(count);
        after.resize(count);
        const Mat3<Pack<float>> strain = gather_gradient<float>(u_.data(), stride_, rows, table);
        Mat3<Pack<float>> speed;
        if (model_.sites_.rate) {
            speed = gather_gradient<float>(v_.data(), stride_, rows, table);
        }
        const auto gathered = [&](const Mat3<Pack<float>>& value, const std::vector<float>& field, int l) {
            const Mat3<PackPair> change = gather_gradient_pair(field.data() + at(l, 0, 0), size_, stride_, rows, table);
            Mat3<D> r;
            for (int i = 0; i < 9; ++i) {
                r.e[i / 3][i % 3] = D(join(value.e[i / 3][i % 3], value.e[i / 3][i % 3]));
                r.e[i / 3][i % 3].d[0] = change.e[i / 3][i % 3];
            }
            return r;
        };
        thread_local VolumePoint<D> p;  // large: cleared once, written over
        for (int l = 1; l < used_; l += 2) {
            p.acceleration = {};
            Mat3<D> f0;
            p.deformation = gathered(strain, u_, l);
            if (prestressed_) {
                f0 = pair_of(f0_[b], l);
                p.deformation = f0 + p.deformation * f0;
            } else {
                p.deformation = Mat3<D>::identity() + p.deformation;
            }
            if (model_.sites_.rate) {
                p.rate = gathered(speed, v_, l);
                if (prestressed_) {
                    p.rate = p.rate * f0;
                }
            }
            p.mu = pair_of(mu_[b], l);
            p.lambda = pair_of(lambda_[b], l);
            p.law = model_.settings_.law;
            p.time = static_cast<float>(time);
            p.dt = static_cast<float>(dt);
            if (model_.sites_.volume) {
                S* history = history_.data() + b * count;
                for (std::size_t i = 0; i < count; ++i) {
                    before[i] = pair_of(history[i], l);
                }
                const D* uniforms = pair_uniforms_.data() + static_cast<std::size_t>(l / 2) * uniforms_.size();
                evaluate_volume(model_.slots_, uniforms, p, before.data(), after.data());
                if (l + 2 < used_) {
                    // The other pairs still need the value before.
                    for (std::size_t i = 0; i < count; ++i) {
                        history[i].d[l - 1] = lower(after[i].d[0]);
                        history[i].d[l] = upper(after[i].d[0]);
                    }
                } else {
                    for (std::size_t i = 0; i < count; ++i) {
                        put_pair(history[i], l, after[i]);
                    }
                }
                if (model_.sites_.body_volume) {
                    const Vec3<D> force = pair_of(mass_points_[b], l) * p.acceleration;
                    const ValueTable<float>& values = model_.values_[static_cast<std::size_t>(model_.table_[b])];
                    for (int k = l == 1 ? 0 : l; k < std::min(l + 2, used_); ++k) {
                        scatter_value<float>(pair_part(force, l, k), out + static_cast<std::size_t>(k) * 3 * span, span, rows, values);
                    }
                }
            } else {
                p.stress = elastic_stress(p.law, p.deformation, p.mu, p.lambda);
            }
            Mat3<D> stress = prestressed_ ? p.stress * transpose(f0) : p.stress;
            stress = (-pair_of(volume_[b], l)) * stress;
            alignas(64) float values[3][3][3][8];
            for (int i = 0; i < 9; ++i) {
                const D& x = stress.e[i / 3][i % 3];
                store<float>(values[0][i / 3][i % 3], lower(x.v));
                store<float>(values[1][i / 3][i % 3], lower(x.d[0]));
                store<float>(values[2][i / 3][i % 3], upper(x.d[0]));
            }
            if (l == 1) {
                scatter_gradient_rows(values[0], out, span, rows, table);
            }
            for (int k = 0; k < 2 && l + k < used_; ++k) {
                scatter_gradient_rows(values[k + 1], out + static_cast<std::size_t>(l + k) * 3 * span, span, rows, table);
            }
        }
    }

    void load_point(std::size_t b, VolumePoint<S>& p, double time, double dt) const {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const GradientTable<T>& table = model_.gradients_[static_cast<std::size_t>(model_.table_[b])];
        Mat3<S> gradient;
        for (int l = 0; l < used_; ++l) {
            set_lane(gradient, l, gather_gradient<T>(u_.data() + at(l, 0, 0), stride_, rows, table));
        }
        p.deformation = prestressed_ ? f0_[b] + gradient * f0_[b] : Mat3<S>::identity() + gradient;
        if (model_.sites_.rate) {
            for (int l = 0; l < used_; ++l) {
                set_lane(gradient, l, gather_gradient<T>(v_.data() + at(l, 0, 0), stride_, rows, table));
            }
            p.rate = prestressed_ ? gradient * f0_[b] : gradient;
        }
        p.mu = mu_[b];
        p.lambda = lambda_[b];
        p.law = model_.settings_.law;
        p.time = static_cast<T>(time);
        p.dt = static_cast<T>(dt);
    }

    SurfacePoint<S> surface_point(std::size_t b, double time) const {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
        const ValueTable<T>& table = model_.surface_values_[b];
        SurfacePoint<S> p;
        for (int l = 0; l < used_; ++l) {
            const Vec3<Pack<T>> u = gather_value<T>(u_.data() + at(l, 0, 0), stride_, rows, table);
            const Vec3<Pack<T>> v = gather_value<T>(v_.data() + at(l, 0, 0), stride_, rows, table);
            const Vec3<Pack<T>> x = l == 0 ? surface_position(b, u) : u;
            for (int c = 0; c < 3; ++c) {
                lane_of(p.position[c], l) = x[c];
                lane_of(p.velocity[c], l) = v[c];
            }
        }
        p.area = S(surface_area_[b]);
        p.time = static_cast<T>(time);
        return p;
    }

    /// Where the eight surface points of a block are.
    Vec3<Pack<T>> surface_position(std::size_t b, const Vec3<Pack<T>>& displacement) const {
        const double* rest = &model_.geometry_.surface_points[24 * static_cast<std::size_t>(model_.surface_order_[b])];
        Vec3<Pack<T>> x = displacement;
        for (int c = 0; c < 3; ++c) {
            for (int q = 0; q < 8; ++q) {
                x[c][q] += static_cast<T>(rest[3 * q + c]);
            }
        }
        return x;
    }

    void surface_forces(std::size_t b, double time, T* out, std::size_t span) const {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
        const ValueTable<T>& table = model_.surface_values_[b];
        if (model_.sites_.out_of_reach) {
            const Vec3<Pack<T>> x = surface_position(b, gather_value<T>(u_.data(), stride_, rows, table));
            if (surface_out_of_reach(model_.slots_, value_uniforms_.data(), x)) {
                return;
            }
        }
        if constexpr (std::is_same_v<T, float> && K > 1) {
            if (used_ > 1) {
                surface_pairs(b, time, out, span, rows, table);
                return;
            }
        }
        const Vec3<S> force = evaluate_surface(model_.slots_, uniforms_.data(), surface_point(b, time));
        for (int l = 0; l < used_; ++l) {
            Vec3<Pack<T>> part;
            for (int c = 0; c < 3; ++c) {
                part[c] = lane_of(force[c], l);
            }
            scatter_value<T>(part, out + static_cast<std::size_t>(l) * 3 * span, span, rows, table);
        }
    }

    /// Two directions at a time, as `volume_pairs`.
    void surface_pairs(std::size_t b, double time, float* out, std::size_t span, const Rows& rows,
                       const ValueTable<float>& table) const {
        using D = PairScalar;
        const Vec3<Pack<float>> x = surface_position(b, gather_value<float>(u_.data(), stride_, rows, table));
        const Vec3<Pack<float>> v = gather_value<float>(v_.data(), stride_, rows, table);
        for (int l = 1; l < used_; l += 2) {
            SurfacePoint<D> p;
            const Vec3<PackPair> dx = gather_value_pair(u_.data() + at(l, 0, 0), size_, stride_, rows, table);
            const Vec3<PackPair> dv = gather_value_pair(v_.data() + at(l, 0, 0), size_, stride_, rows, table);
            for (int c = 0; c < 3; ++c) {
                p.position[c].v = join(x[c], x[c]);
                p.position[c].d[0] = dx[c];
                p.velocity[c].v = join(v[c], v[c]);
                p.velocity[c].d[0] = dv[c];
            }
            p.area = D(join(surface_area_[b], surface_area_[b]));
            p.time = static_cast<float>(time);
            const Vec3<D> force =
                evaluate_surface(model_.slots_, pair_uniforms_.data() + static_cast<std::size_t>(l / 2) * uniforms_.size(), p);
            for (int k = l == 1 ? 0 : l; k < std::min(l + 2, used_); ++k) {
                scatter_value<float>(pair_part(force, l, k), out + static_cast<std::size_t>(k) * 3 * span, span, rows, table);
            }
        }
    }

    /// Lane k of a vector that holds the value and lanes l and l + 1.
    static Vec3<Pack<float>> pair_part(const Vec3<PairScalar>& a, int l, int k) {
        Vec3<Pack<float>> r;
        for (int c = 0; c < 3; ++c) {
            r[c] = k == 0 ? lower(a[c].v) : k == l ? lower(a[c].d[0]) : upper(a[c].d[0]);
        }
        return r;
    }

    void reduce_forces() {
        std::fill(f_.begin(), f_.end(), T{});
        for (std::size_t c = 0; c < model_.chunks_.size(); ++c) {
            const auto& chunk = model_.chunks_[c];
            const std::size_t span = static_cast<std::size_t>(chunk.node_end - chunk.node_begin);
            const std::size_t used = std::min(span, stride_ - static_cast<std::size_t>(chunk.node_begin));
            for (std::size_t k = 0; k < 3 * static_cast<std::size_t>(lanes); ++k) {
                const T* from = chunk_force_[c].data() + k * span;
                T* to = f_.data() + k * stride_ + chunk.node_begin;
                for (std::size_t i = 0; i < used; ++i) {
                    to[i] += from[i];
                }
            }
        }
    }

    MaterialPoint<U> material_point(std::size_t p, double time) const {
        MaterialPoint<U> m;
        const auto& place = model_.places_[p];
        for (int c = 0; c < 3; ++c) {
            const T rest = static_cast<T>(model_.geometry_.places[3 * p + static_cast<std::size_t>(c)]);
            m.rest[c] = constant<U>(rest);
            m.position[c] = constant<U>(rest);
            for (int l = 0; l < lanes; ++l) {
                for (std::size_t a = 0; a < 27; ++a) {
                    const std::size_t i = at(l, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]));
                    lane_of(m.position[c], l) += place.value[a] * u_[i];
                    lane_of(m.velocity[c], l) += place.value[a] * v_[i];
                }
            }
        }
        m.time = static_cast<T>(time);
        return m;
    }

    std::vector<U> place_parameters(std::size_t p) const {
        const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
        std::vector<U> q(count);
        for (std::size_t i = 0; i < count; ++i) {
            q[i] = inputs_.plain(&Fields<T>::place_effect, p * count + i);
        }
        return q;
    }

    void place_forces(double time) {
        if (!model_.sites_.point) {
            return;
        }
        for (std::size_t p = 0; p < model_.places_.size(); ++p) {
            const std::vector<U> q = place_parameters(p);
            const Vec3<U> force = evaluate_point(model_.slots_, q.data(), material_point(p, time));
            const auto& place = model_.places_[p];
            for (int l = 0; l < lanes; ++l) {
                for (int c = 0; c < 3; ++c) {
                    for (std::size_t a = 0; a < 27; ++a) {
                        f_[at(l, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]))] +=
                            place.value[a] * lane_of(force[c], l);
                    }
                }
            }
        }
    }

    /// What the hook is shown: all quadrature points in the caller's order.
    PointState<T> hook_state(double time, double dt) const {
        const std::size_t points = 8 * model_.rows_.size();
        PointState<T> s;
        s.time = time;
        s.first_direction = inputs_.first_direction;
        for (int k = 0; k < K; ++k) {
            s.lanes += inputs_.direction[k] ? 1 : 0;
        }
        const std::size_t shown = static_cast<std::size_t>(s.lanes);
        s.position.resize(shown * points * 3);
        s.velocity.resize(shown * points * 3);
        s.deformation.resize(shown * points * 9);
        for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
            const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
            const ValueTable<T>& table = model_.values_[static_cast<std::size_t>(model_.table_[b])];
            const std::size_t from = 8 * static_cast<std::size_t>(model_.order_[b]);
            VolumePoint<S> p;
            load_point(b, p, time, dt);
            for (std::size_t l = 0; l < shown; ++l) {
                const int lane = static_cast<int>(l);
                const Vec3<Pack<T>> u = gather_value<T>(u_.data() + at(lane, 0, 0), stride_, rows, table);
                const Vec3<Pack<T>> v = gather_value<T>(v_.data() + at(lane, 0, 0), stride_, rows, table);
                const Mat3<Pack<T>> f = get_lane<Pack<T>>(p.deformation, lane);
                for (int q = 0; q < 8; ++q) {
                    const std::size_t i = l * points + from + static_cast<std::size_t>(q);
                    for (int c = 0; c < 3; ++c) {
                        const std::size_t to = 3 * i + static_cast<std::size_t>(c);
                        s.position[to] = u[c][q];
                        s.velocity[to] = v[c][q];
                        if (l == 0) {
                            s.position[to] += static_cast<T>(model_.geometry_.points[to]);
                        }
                        for (int j = 0; j < 3; ++j) {
                            s.deformation[3 * to + static_cast<std::size_t>(j)] = f[c][j][q];
                        }
                    }
                }
            }
        }
        return s;
    }

    void hook_forces(double time, double dt) {
        if (!inputs_.hook) {
            return;
        }
        const PointState<T> state = hook_state(time, dt);
        const PointForces<T> given = inputs_.hook->forward(state);
        const std::size_t points = 8 * model_.rows_.size();
        for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
            const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
            const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
            const std::size_t from = 8 * static_cast<std::size_t>(model_.order_[b]);
            Mat3<S> stress;
            for (int l = 0; l < state.lanes; ++l) {
                const std::size_t first = static_cast<std::size_t>(l) * points + from;
                if (!given.force.empty()) {
                    scatter_value<T>(point_vectors(&given.force[3 * first]), f_.data() + at(l, 0, 0), stride_, rows, model_.values_[table]);
                }
                if (!given.stress.empty()) {
                    set_lane(stress, l, point_matrices(&given.stress[9 * first]));
                }
            }
            if (!given.stress.empty()) {
                if (prestressed_) {
                    stress = stress * transpose(f0_[b]);
                }
                stress = (-volume_[b]) * stress;
                for (int l = 0; l < state.lanes; ++l) {
                    scatter_gradient<T>(get_lane<Pack<T>>(stress, l), f_.data() + at(l, 0, 0), stride_, rows, model_.gradients_[table]);
                }
            }
        }
    }

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

    void known_forces(int frame) {
        const std::size_t nodes = model_.node_count();
        for (int l = 0; l < lanes; ++l) {
            const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
            if (!fields || fields->node_force.empty()) {
                continue;
            }
            const T* from = fields->node_force.data() + static_cast<std::size_t>(frame) * 3 * nodes;
            for (std::size_t n = 0; n < nodes; ++n) {
                for (std::size_t c = 0; c < 3; ++c) {
                    f_[at(l, c, n)] += from[3 * n + c];
                }
            }
        }
    }

    /// v* = v + dt (f / m + gravity + body effects), eight nodes at a time.
    void update_nodes(double time, double dt) {
        const T h = static_cast<T>(dt);
        Vec3<S> gravity;
        for (int c = 0; c < 3; ++c) {
            for (int l = 0; l < lanes; ++l) {
                lane_of(gravity[c], l) = broadcast<T>(lane_of(gravity_[c], l));
            }
        }
        for (std::size_t n = 0; n < stride_; n += lane_count) {
            S inverse_mass{};
            for (int l = 0; l < lanes; ++l) {
                lane_of(inverse_mass, l) = load<T>(&inverse_mass_[static_cast<std::size_t>(l) * stride_ + n]);
            }
            Vec3<S> acceleration = gravity;
            if (model_.sites_.body) {
                acceleration = acceleration + evaluate_body(model_.slots_, uniforms_.data(), body_point(n, time));
            }
            for (int c = 0; c < 3; ++c) {
                S force{};
                for (int l = 0; l < lanes; ++l) {
                    lane_of(force, l) = load<T>(&f_[at(l, static_cast<std::size_t>(c), n)]);
                }
                const S total = acceleration[c] + force * inverse_mass;
                for (int l = 0; l < lanes; ++l) {
                    T* v = &v_[at(l, static_cast<std::size_t>(c), n)];
                    store<T>(v, load<T>(v) + h * lane_of(total, l));
                }
            }
        }
        // Nodes without mass (the padding) stay where they are.
        for (std::size_t n = 0; n < stride_; ++n) {
            if (inverse_mass_[n] == T{}) {
                for (int l = 0; l < lanes; ++l) {
                    for (std::size_t c = 0; c < 3; ++c) {
                        v_[at(l, c, n)] = T{};
                    }
                }
            }
        }
    }

    BodyPoint<S> body_point(std::size_t n, double time) const {
        BodyPoint<S> p;
        for (int c = 0; c < 3; ++c) {
            for (int l = 0; l < lanes; ++l) {
                lane_of(p.position[c], l) = load<T>(&u_[at(l, static_cast<std::size_t>(c), n)]);
                lane_of(p.velocity[c], l) = load<T>(&v_[at(l, static_cast<std::size_t>(c), n)]);
            }
            for (std::size_t q = 0; q < lane_count && n + q < model_.node_count(); ++q) {
                lane_of(p.position[c], 0)[static_cast<int>(q)] +=
                    static_cast<T>(model_.node_positions_[3 * (n + q) + static_cast<std::size_t>(c)]);
            }
        }
        p.time = static_cast<T>(time);
        return p;
    }

    /// Pose number i of hold h, as (12,) scalars of lane l.
    double pose(int l, std::size_t h, int step, std::size_t i) const {
        const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
        if (!fields || fields->pose.empty()) {
            return 0.0;
        }
        const std::size_t steps = static_cast<std::size_t>(schedule_.total_steps()) + 1;
        return static_cast<double>(fields->pose[(h * steps + static_cast<std::size_t>(step)) * 12 + i]);
    }

    void hold(int n, double dt) {
        const std::size_t rows = constraint_[0].row_count();
        if (rows == 0) {
            return;
        }
        const Geometry& g = model_.geometry_;
        const double softness = static_cast<double>(lane_of(compliance_, 0)) / (dt * dt);
        std::vector<double> b(rows), solution(rows), held(rows), sums(static_cast<std::size_t>(g.hold_count));
        for (std::size_t c = 0; c < 3; ++c) {
            for (int l = 0; l < lanes; ++l) {
                T* v = v_.data() + at(l, c, 0);
                double* lambda = &lambda_rows_[(static_cast<std::size_t>(l) * 3 + c) * rows];
                if (l > 0) {
                    // - d(M^-1) C^T lambda
                    const T* slope = &inverse_mass_[static_cast<std::size_t>(l) * stride_];
                    constraint_[0].transposed(&lambda_rows_[c * rows], [&](std::int32_t node, double y) {
                        v[node] -= slope[node] * static_cast<T>(y);
                    });
                }
                constraint_[0].apply(v, b.data());
                constraint_[0].apply(u_.data() + at(l, c, 0), held.data());
                for (std::size_t r = 0; r < rows; ++r) {
                    const std::size_t h = static_cast<std::size_t>(g.row_hold[r]);
                    double target = pose(l, h, n + 1, 9 + c);
                    for (std::size_t k = 0; k < 3; ++k) {
                        target += pose(l, h, n + 1, 3 * c + k) * g.row_target[3 * r + k];
                    }
                    if (l == 0) {
                        target -= g.row_target[3 * r + c];
                    }
                    b[r] -= (target - held[r]) / dt;
                }
                if (l > 0 && lane_of(compliance_, l) != T{}) {
                    constraint_[0].sum_per_hold(&lambda_rows_[c * rows], sums.data());
                    for (std::size_t r = 0; r < rows; ++r) {
                        b[r] -= static_cast<double>(lane_of(compliance_, l)) / (dt * dt) * sums[static_cast<std::size_t>(g.row_hold[r])];
                    }
                }
                constraint_[0].solve(b.data(), softness, solution.data());
                constraint_[0].transposed(solution.data(), [&](std::int32_t node, double y) {
                    v[node] -= inverse_mass_[static_cast<std::size_t>(node)] * static_cast<T>(y);
                });
                std::copy(solution.begin(), solution.end(), lambda);
            }
        }
    }

    const Model& model_;
    Inputs<T, K> inputs_;
    const Schedule& schedule_;
    Team* team_;
    std::size_t stride_, size_;
    bool prestressed_ = false;
    int used_ = 1;  // lanes: the value and the directions that are given
    std::vector<T> u_, v_, f_, mass_, inverse_mass_;  // lane, component, node
    std::vector<S> mu_, lambda_, volume_, mass_points_, history_;
    std::vector<Mat3<S>> f0_;
    std::vector<Pack<T>> surface_area_;
    std::vector<std::vector<T>> chunk_force_;
    std::vector<S> uniforms_;
    std::vector<Pack<T>> value_uniforms_;    // the same without directions
    std::vector<PairScalar> pair_uniforms_;  // and for every two of them
    std::vector<U> plain_uniforms_, parameters_;
    Vec3<U> gravity_;
    U compliance_{};
    std::vector<double> lambda_rows_;  // lane, component, row: the impulse of each hold row [N s]
    std::vector<Constraint> constraint_;  // one, built after the masses are known
};

}  // namespace mphygs
