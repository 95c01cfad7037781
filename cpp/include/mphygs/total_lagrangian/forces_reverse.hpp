// Adjoint of the forces of one substep of the total-Lagrangian run, and the sums that all substeps add to.
#pragma once

#include <array>

#include "mphygs/total_lagrangian/holds.hpp"
#include "mphygs/total_lagrangian/hook.hpp"

namespace mphygs {

template <class T>
class TotalLagrangianForcesReverse {
  public:
    using Run = TotalLagrangianRun<T, 0>;
    using V = Var<Pack<T>>;

    TotalLagrangianForcesReverse(const TotalLagrangian<T>& model, const Fields<T>& fields, const Schedule& schedule,
                                 const PointHook<T>* hook, const Observer* observer, Team& team)
        : model_(model), run_(model, inputs_of(fields, hook, observer), schedule, team) {
        const std::size_t blocks = model.geometry_.block_count();
        ubar_.assign(run_.size_, T{});
        vbar_.assign(run_.size_, T{});
        fbar_.assign(run_.size_, T{});
        history_bar_.assign(run_.history_.size(), Pack<T>{});
        mu_bar_.assign(8 * blocks, 0.0);
        lambda_bar_.assign(8 * blocks, 0.0);
        volume_bar_.assign(8 * blocks, 0.0);
        mass_bar_.assign(8 * blocks, 0.0);
        deformation0_bar_.assign(run_.prestressed_ ? 72 * blocks : 0, 0.0);
        inverse_mass_bar_.assign(run_.stride_, 0.0);
        parameter_bar_.assign(static_cast<std::size_t>(Registry::parameter_count), 0.0);
        place_effect_bar_.assign(fields.place_effect.size(), 0.0);
        node_force_bar_.assign(fields.node_force.size(), T{});
        target_bar_.assign(fields.target.size(), 0.0);
        channel_bar_.assign(fields.channel.size(), 0.0);
        pose_bar_.assign(fields.pose.size(), 0.0);
        for (const auto& c : model.chunks_) {
            chunk_bar_.emplace_back(6 * static_cast<std::size_t>(c.node_end - c.node_begin), T{});
            chunk_uniform_bar_.emplace_back(static_cast<std::size_t>(Registry::total_uniform_count), 0.0);
        }
    }

    /// Sums over all substeps of the bars of the inputs.
    struct Sums {
        std::vector<std::vector<double>> of;
        std::vector<T> node_force;
        double gravity[3] = {0, 0, 0}, compliance = 0;
    };

  protected:
    std::array<std::vector<double>*, 11> own_sums() {
        return {&mu_bar_, &lambda_bar_, &volume_bar_, &mass_bar_, &deformation0_bar_, &inverse_mass_bar_, &parameter_bar_,
                &place_effect_bar_, &pose_bar_, &target_bar_, &channel_bar_};
    }
    Sums sums_like_own() {
        Sums sums;
        for (const std::vector<double>* own : own_sums()) {
            sums.of.emplace_back(own->size(), 0.0);
        }
        sums.node_force.assign(node_force_bar_.size(), T{});
        return sums;
    }
    void swap_sums(Sums& other) {
        const auto own = own_sums();
        for (std::size_t i = 0; i < own.size(); ++i) {
            std::swap(*own[i], other.of[i]);
        }
        std::swap(node_force_bar_, other.node_force);
        std::swap(gravity_bar_, other.gravity);
        std::swap(compliance_bar_, other.compliance);
    }

    static Inputs<T, 0> inputs_of(const Fields<T>& fields, const PointHook<T>* hook, const Observer* observer) {
        Inputs<T, 0> inputs;
        inputs.primal = &fields;
        inputs.hook = hook;
        inputs.observer = observer;
        return inputs;
    }
    static std::size_t index(int n) { return static_cast<std::size_t>(n); }

    /// Uniforms as inputs of the tape; those of effects that are not active stay constants.
    std::vector<V> tape_uniforms(Site site) const {
        std::vector<V> u(run_.uniforms_.begin(), run_.uniforms_.end());
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            const EffectSlot& s = model_.slots_[static_cast<std::size_t>(i)];
            if (s.active && E::info.site == site) {
                for (int k = 0; k < uniform_count<E>(); ++k) {
                    V& x = u[static_cast<std::size_t>(s.uniform + k)];
                    x = V::input(x.v);
                }
            }
        });
        return u;
    }
    void add_uniform_bar(const std::vector<V>& uniforms, std::vector<double>& bar) const {
        Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
        for (std::size_t i = 0; i < uniforms.size(); ++i) {
            if (uniforms[i].i >= 0) {
                bar[i] += static_cast<double>(sum_lanes<T>(tape.adjoint(uniforms[i].i)));
            }
        }
    }
    static Vec3<V> input(const Vec3<Pack<T>>& x) {
        return {{V::input(x[0]), V::input(x[1]), V::input(x[2])}};
    }
    static Mat3<V> input(const Mat3<Pack<T>>& x) {
        Mat3<V> r;
        for (int i = 0; i < 9; ++i) {
            r[i / 3][i % 3] = V::input(x[i / 3][i % 3]);
        }
        return r;
    }

    static void seed(const V& x, Pack<T> bar) {
        if (x.i >= 0) {
            Tape<Pack<T>>::current().adjoint(x.i) += bar;
        }
    }
    static Vec3<Pack<T>> adjoint(const Vec3<V>& x) {
        Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
        return {{tape.adjoint(x[0].i), tape.adjoint(x[1].i), tape.adjoint(x[2].i)}};
    }
    static Mat3<Pack<T>> adjoint(const Mat3<V>& x) {
        Mat3<Pack<T>> r;
        for (int i = 0; i < 9; ++i) {
            r[i / 3][i % 3] = Tape<Pack<T>>::current().adjoint(x[i / 3][i % 3].i);
        }
        return r;
    }

    void reverse_body(double time, T h) {
        Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
        for (std::size_t n = 0; n < run_.stride_; n += lane_count) {
            tape.reset();
            const BodyPoint<Pack<T>> value = run_.body_point(n, time);
            BodyPoint<V> p;
            p.position = input(value.position);
            p.velocity = input(value.velocity);
            p.time = value.time;
            const std::vector<V> uniforms = tape_uniforms(Site::body);
            const Vec3<V> a = evaluate_body(model_.slots_, uniforms.data(), p);
            tape.prepare();
            // Padding nodes carry no mass and no bar: vbar_ is zero there.
            for (int c = 0; c < 3; ++c) {
                seed(a[c], h * load<T>(&vbar_[run_.at(0, static_cast<std::size_t>(c), n)]));
            }
            tape.sweep();
            const Vec3<Pack<T>> xbar = adjoint(p.position), vbar = adjoint(p.velocity);
            for (int c = 0; c < 3; ++c) {
                const std::size_t i = run_.at(0, static_cast<std::size_t>(c), n);
                store<T>(&ubar_[i], load<T>(&ubar_[i]) + xbar[c]);
                store<T>(&vbar_[i], load<T>(&vbar_[i]) + vbar[c]);
            }
            add_uniform_bar(uniforms, chunk_uniform_bar_[0]);
        }
    }

    void reverse_places(double time) {
        Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
        const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
        for (std::size_t p = 0; p < model_.places_.size(); ++p) {
            const auto& place = model_.places_[p];
            tape.reset();
            const MaterialPoint<T> value = run_.material_point(p, time);
            MaterialPoint<V> m;
            for (int c = 0; c < 3; ++c) {
                m.rest[c] = V(broadcast<T>(value.rest[c]));
                m.position[c] = V::input(broadcast<T>(value.position[c]));
                m.velocity[c] = V::input(broadcast<T>(value.velocity[c]));
            }
            m.time = value.time;
            std::vector<V> q;
            for (const T x : run_.place_parameters(p)) {
                q.push_back(V::input(broadcast<T>(x)));
            }
            const Vec3<V> force = evaluate_point(model_.slots_, q.data(), m);
            tape.prepare();
            for (int c = 0; c < 3; ++c) {
                T bar{};
                for (std::size_t a = 0; a < 27; ++a) {
                    bar += place.value[a] * fbar_[run_.at(0, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]))];
                }
                seed(force[c], broadcast<T>(bar));
            }
            tape.sweep();
            const Vec3<Pack<T>> xbar = adjoint(m.position), vbar = adjoint(m.velocity);
            for (int c = 0; c < 3; ++c) {
                for (std::size_t a = 0; a < 27; ++a) {
                    const std::size_t i = run_.at(0, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]));
                    ubar_[i] += place.value[a] * xbar[c][0];
                    vbar_[i] += place.value[a] * vbar[c][0];
                }
            }
            for (std::size_t i = 0; i < count; ++i) {
                place_effect_bar_[p * count + i] += static_cast<double>(tape.adjoint(q[i].i)[0]);
            }
        }
    }

    void reverse_hook(double time, double dt);

    /// from: number of the block's first point in the caller's order.
    void add_deformation0_bar(std::size_t from, const Mat3<Pack<T>>& bar) {
        for (int i = 0; i < 9; ++i) {
            accumulate(&deformation0_bar_[9 * from + 8 * static_cast<std::size_t>(i)], bar[i / 3][i % 3]);
        }
    }

    void reverse_chunk(std::size_t c, double time, double dt) {
        const auto& chunk = model_.chunks_[c];
        std::vector<T>& out = chunk_bar_[c];
        const std::size_t span = static_cast<std::size_t>(chunk.node_end - chunk.node_begin);
        std::fill(out.begin(), out.end(), T{});
        T* ubar = out.data() - chunk.node_begin;
        T* vbar = ubar + 3 * span;
        for (std::size_t b = chunk.block_begin; b < chunk.block_end; ++b) {
            reverse_block(b, time, dt, ubar, vbar, span, chunk_uniform_bar_[c]);
            if (model_.spring_[b] >= 0) {
                reverse_springs(b, ubar, span);
            }
        }
        if (model_.sites_.surface) {
            for (std::size_t b = chunk.surface_begin; b < chunk.surface_end; ++b) {
                reverse_surface(b, time, ubar, vbar, span, chunk_uniform_bar_[c]);
            }
        }
    }

    static void accumulate(double* to, Pack<T> x) {
        for (int q = 0; q < lane_count; ++q) {
            to[q] += static_cast<double>(x[q]);
        }
    }

    void reverse_block(std::size_t b, double time, double dt, T* ubar, T* vbar, std::size_t span,
                       std::vector<double>& uniform_bar) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t table_index = static_cast<std::size_t>(model_.table_[b]);
        const GradientTable<T>& table = model_.gradients_[table_index];
        const Pack<T> volume = run_.volume_[b];
        // f_a = - V P_u dN_a: the bar of P_u is -V G, the bar of V is -G : P_u.
        const Mat3<Pack<T>> g = gather_gradient<T>(fbar_.data(), run_.stride_, rows, table);
        VolumePoint<Pack<T>> value;
        run_.load_point(b, value, time, dt);
        const Mat3<Pack<T>> pulled = run_.prestressed_ ? g * run_.f0_[b] : g;
        const Mat3<Pack<T>> stress_bar = (-volume) * pulled;
        Mat3<Pack<T>> stress, deformation_bar, rate_bar;
        Pack<T> mu_bar, lambda_bar;
        if (!model_.sites_.volume) {
            // The Hessian of an energy is symmetric: its adjoint is its tangent.
            using D = Dual<Pack<T>, 3>;
            Mat3<D> f;
            for (int i = 0; i < 9; ++i) {
                f[i / 3][i % 3] = D(value.deformation[i / 3][i % 3]);
                f[i / 3][i % 3].d[0] = stress_bar[i / 3][i % 3];
            }
            D mu(value.mu), lambda(value.lambda);
            mu.d[1] = broadcast<T>(1);
            lambda.d[2] = broadcast<T>(1);
            const Mat3<D> p = elastic_stress(value.law, f, mu, lambda);
            mu_bar = lambda_bar = Pack<T>{};
            for (int i = 0; i < 9; ++i) {
                const D& x = p[i / 3][i % 3];
                stress[i / 3][i % 3] = x.v;
                deformation_bar[i / 3][i % 3] = x.d[0];
                mu_bar += stress_bar[i / 3][i % 3] * x.d[1];
                lambda_bar += stress_bar[i / 3][i % 3] * x.d[2];
            }
        } else {
            Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
            tape.reset();
            VolumePoint<V> p;
            p.deformation = input(value.deformation);
            p.rate = input(value.rate);
            p.mu = V::input(value.mu);
            p.lambda = V::input(value.lambda);
            p.law = value.law;
            p.time = value.time;
            p.dt = value.dt;
            const std::vector<V> uniforms = tape_uniforms(Site::volume);
            const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
            std::vector<V> before(count), after(count);
            for (std::size_t i = 0; i < count; ++i) {
                before[i] = V::input(run_.history_[b * count + i]);
            }
            evaluate_volume(model_.slots_, uniforms.data(), p, before.data(), after.data());
            tape.prepare();
            for (int i = 0; i < 9; ++i) {
                stress[i / 3][i % 3] = p.stress[i / 3][i % 3].v;
                seed(p.stress[i / 3][i % 3], stress_bar[i / 3][i % 3]);
            }
            for (std::size_t i = 0; i < count; ++i) {
                seed(after[i], history_bar_[b * count + i]);
            }
            if (model_.sites_.body_volume) {
                const Vec3<Pack<T>> force_bar = gather_value<T>(fbar_.data(), run_.stride_, rows, model_.values_[table_index]);
                Pack<T> mass_bar{};
                for (int c = 0; c < 3; ++c) {
                    seed(p.acceleration[c], run_.mass_points_[b] * force_bar[c]);
                    mass_bar += force_bar[c] * p.acceleration[c].v;
                }
                accumulate(&mass_bar_[8 * static_cast<std::size_t>(model_.order_[b])], mass_bar);
            }
            tape.sweep();
            deformation_bar = adjoint(p.deformation);
            rate_bar = adjoint(p.rate);
            mu_bar = tape.adjoint(p.mu.i);
            lambda_bar = tape.adjoint(p.lambda.i);
            for (std::size_t i = 0; i < count; ++i) {
                history_bar_[b * count + i] = tape.adjoint(before[i].i);
            }
            add_uniform_bar(uniforms, uniform_bar);
        }
        const std::size_t to = 8 * static_cast<std::size_t>(model_.order_[b]);
        accumulate(&mu_bar_[to], mu_bar);
        accumulate(&lambda_bar_[to], lambda_bar);
        accumulate(&volume_bar_[to], -inner(pulled, stress));
        Mat3<Pack<T>> gradient_bar = deformation_bar;
        if (run_.prestressed_) {
            // F = F_u F0, dF/dt = G_v F0, P_u = P F0^T
            const Mat3<Pack<T>>& f0 = run_.f0_[b];
            gradient_bar = deformation_bar * transpose(f0);
            Mat3<Pack<T>> f0_bar = transpose(value.deformation * inverse(f0)) * deformation_bar +
                                   (-volume) * (transpose(g) * stress);
            if (model_.sites_.rate) {
                f0_bar = f0_bar + transpose(value.rate * inverse(f0)) * rate_bar;
            }
            add_deformation0_bar(to, f0_bar);
        }
        scatter_gradient<T>(gradient_bar, ubar, span, rows, table);
        if (model_.sites_.rate) {
            const Mat3<Pack<T>> velocity_bar = run_.prestressed_ ? rate_bar * transpose(run_.f0_[b]) : rate_bar;
            scatter_gradient<T>(velocity_bar, vbar, span, rows, table);
        }
    }

    /// The springs' matrix is symmetric: the bar of u is what they pull with where the bar of f is.
    void reverse_springs(std::size_t b, T* ubar, std::size_t span) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t index_here = static_cast<std::size_t>(model_.spring_[b]);
        const CellSprings<T>& springs = model_.springs_[index_here];
        const T stiffness = run_.spring_stiffness_[index_here];
        double stiffness_bar = 0;
        for (std::size_t c = 0; c < 3; ++c) {
            const auto value = springs.along(run_.u_.data() + run_.at(0, c, 0), rows);
            auto pull = springs.along(fbar_.data() + run_.at(0, c, 0), rows);
            for (std::size_t k = 0; k < pull.size(); ++k) {
                stiffness_bar -= static_cast<double>(pull[k] * value[k]);
                pull[k] *= -stiffness;
            }
            springs.add(pull, rows, ubar + c * span);
        }
        const std::size_t to = 8 * static_cast<std::size_t>(model_.order_[b]);
        const Pack<T> bar = broadcast<T>(static_cast<T>(stiffness_bar) * springs.stiffness);
        accumulate(&mu_bar_[to], bar * run_.volume_[b]);
        accumulate(&volume_bar_[to], bar * run_.mu_[b]);
    }

    void reverse_surface(std::size_t b, double time, T* ubar, T* vbar, std::size_t span, std::vector<double>& uniform_bar) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
        const ValueTable<T>& table = model_.surface_values_[b];
        Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
        tape.reset();
        const SurfacePoint<Pack<T>> value = run_.surface_point(b, time);
        SurfacePoint<V> p;
        p.position = input(value.position);
        p.velocity = input(value.velocity);
        p.area = V(value.area);
        p.time = value.time;
        const std::vector<V> uniforms = tape_uniforms(Site::surface);
        const Vec3<V> force = evaluate_surface(model_.slots_, uniforms.data(), p);
        tape.prepare();
        const Vec3<Pack<T>> force_bar = gather_value<T>(fbar_.data(), run_.stride_, rows, table);
        for (int c = 0; c < 3; ++c) {
            seed(force[c], force_bar[c]);
        }
        tape.sweep();
        scatter_value<T>(adjoint(p.position), ubar, span, rows, table);
        scatter_value<T>(adjoint(p.velocity), vbar, span, rows, table);
        add_uniform_bar(uniforms, uniform_bar);
    }

    /// Chain of the once-per-substep functions, parameters -> uniforms.
    void reverse_uniforms(double time, double dt) {
        std::vector<double> total(chunk_uniform_bar_[0].size(), 0.0);
        for (const auto& chunk : chunk_uniform_bar_) {
            for (std::size_t i = 0; i < total.size(); ++i) {
                total[i] += chunk[i];
            }
        }
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            using D = Dual<double, max_effect_parameters>;
            const EffectSlot& s = model_.slots_[static_cast<std::size_t>(i)];
            if constexpr (uniform_count<E>() > 0 && E::info.site != Site::point) {
                if (!s.active) {
                    return;
                }
                D parameters[max_effect_parameters], q[uniform_count<E>()];
                for (int k = 0; k < E::info.parameter_count(); ++k) {
                    parameters[k] = D(static_cast<double>(run_.parameters_[static_cast<std::size_t>(s.parameter + k)]));
                    parameters[k].d[k] = 1;
                }
                effect_uniforms<E>(parameters, time, dt, q);
                for (int j = 0; j < uniform_count<E>(); ++j) {
                    for (int k = 0; k < E::info.parameter_count(); ++k) {
                        parameter_bar_[static_cast<std::size_t>(s.parameter + k)] +=
                            total[static_cast<std::size_t>(s.uniform + j)] * q[j].d[k];
                    }
                }
            }
        });
    }

    const TotalLagrangian<T>& model_;
    Run run_;
    std::vector<T> ubar_, vbar_, fbar_, node_force_bar_;
    std::vector<Pack<T>> history_bar_;
    std::vector<std::vector<T>> chunk_bar_;  // u and v bars, 3 components each
    std::vector<std::vector<double>> chunk_uniform_bar_;
    // Sums over thousands of substeps are kept in double.
    std::vector<double> mu_bar_, lambda_bar_, volume_bar_, mass_bar_, deformation0_bar_, inverse_mass_bar_, parameter_bar_,
        place_effect_bar_, pose_bar_, target_bar_, channel_bar_;
    // What the hook was asked in this step already, and answered: it adds up itself what concerns its parameters.
    PointForces<T> hook_told_;
    PointState<T> hook_answer_;
    double gravity_bar_[3] = {0, 0, 0};
    double compliance_bar_ = 0;
};

}  // namespace mphygs
