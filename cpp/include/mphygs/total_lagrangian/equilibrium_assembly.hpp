// What the rest shape's residual, its matrix and its derivatives are summed from.
#pragma once

#include <cstdint>
#include <vector>

#include "mphygs/physics/evaluation.hpp"
#include "mphygs/total_lagrangian/equilibrium.hpp"

namespace mphygs {

/// Cauchy stress of the state whose inverse deformation is I + gradient.
template <class S>
inline Mat3<S> cauchy_stress(const TotalLagrangian<double>& model, const Slots& slots, const std::vector<S>& uniforms, int history,
                      const Mat3<S>& gradient, const S& mu, const S& lambda) {
    VolumePoint<S> p;
    p.deformation = inverse(Mat3<S>::identity() + gradient);
    p.mu = mu;
    p.lambda = lambda;
    p.law = model.settings().law;
    const std::vector<S> before(static_cast<std::size_t>(history), S{});
    std::vector<S> after(before);
    evaluate_volume(slots, uniforms.data(), p, before.data(), after.data());
    const Mat3<S> c = cofactor(p.deformation);
    const S scale = 1.0 / determinant(p.deformation, c);
    return scale * (p.stress * transpose(p.deformation));
}

/// What the effects compute once a substep, at rest: of every effect parameter's value.
template <class S, class Value>
inline std::vector<S> uniforms_at_rest(const Slots& slots, Value&& parameter) {
    using U = decltype(parameter(std::size_t{0}));
    std::vector<U> parameters, plain(static_cast<std::size_t>(Registry::total_uniform_count));
    for (std::size_t i = 0; i < static_cast<std::size_t>(Registry::parameter_count); ++i) {
        parameters.push_back(parameter(i));
    }
    all_uniforms(slots, parameters.data(), 0.0, 1.0, plain.data());
    std::vector<S> packed(plain.size());
    for (std::size_t i = 0; i < plain.size(); ++i) {
        if constexpr (IsDual<S>::value) {
            for (int l = 0; l <= IsDual<S>::count; ++l) {
                lane_of(packed[i], l) = broadcast<double>(lane_of(plain[i], l));
            }
        } else {
            packed[i] = S(broadcast<double>(plain[i]));
        }
    }
    return packed;
}

// The tables that the assembly reads; TotalLagrangian keeps them private to its own runs.
struct Equilibrium::Assembly {
    const TotalLagrangian<double>& m;
    std::size_t blocks() const { return m.rows_.size(); }
    std::size_t caller(std::size_t b) const { return static_cast<std::size_t>(m.order_[b]); }
    const Rows& rows(std::size_t b) const { return *reinterpret_cast<const Rows*>(m.rows_[b].data()); }
    const GradientTable<double>& table(std::size_t b) const { return m.gradients_[static_cast<std::size_t>(m.table_[b])]; }
    const Slots& slots() const { return m.slots_; }
    int history() const { return m.sites_.history; }
    const std::vector<std::int32_t>& constraint_node() const { return m.constraint_node_; }
    Vec3<Pack<double>> value(std::size_t b, const std::vector<double>& w) const {
        Vec3<Pack<double>> x;
        const ValueTable<double>& values = m.values_[static_cast<std::size_t>(m.table_[b])];
        for (int k = 0; k < 27; ++k) {
            const std::size_t n = 3 * static_cast<std::size_t>(node_of<double>(rows(b), k));
            for (std::size_t i = 0; i < 3; ++i) {
                x.e[i] += w[n + i] * values.by_node[k];
            }
        }
        return x;
    }
    Mat3<Pack<double>> gradient(std::size_t b, const std::vector<double>& w) const {
        Mat3<Pack<double>> g;
        for (int a = 0; a < 27; ++a) {
            const std::size_t n = 3 * static_cast<std::size_t>(node_of<double>(rows(b), a));
            for (std::size_t i = 0; i < 3; ++i) {
                for (int j = 0; j < 3; ++j) {
                    g.e[i][j] += w[n + i] * table(b).by_node[a][j];
                }
            }
        }
        return g;
    }
};

}  // namespace mphygs
