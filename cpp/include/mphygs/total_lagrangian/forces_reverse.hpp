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

    void reverse_places(double time);

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
                       std::vector<double>& uniform_bar);

    /// The springs' matrix is symmetric: the bar of u is what they pull with where the bar of f is.
    void reverse_springs(std::size_t b, T* ubar, std::size_t span);

    void reverse_surface(std::size_t b, double time, T* ubar, T* vbar, std::size_t span, std::vector<double>& uniform_bar);

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
