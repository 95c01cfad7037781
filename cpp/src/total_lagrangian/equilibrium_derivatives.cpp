// Derivatives of the rest shape by the implicit-function theorem, in both directions.
#include "mphygs/total_lagrangian/equilibrium_assembly.hpp"

namespace mphygs {

namespace {

using P = Pack<double>;

}  // namespace

std::vector<Equilibrium::Solution> Equilibrium::tangent(const std::vector<Direction>& directions) {
    factorise_here();
    const Assembly a{*model_};
    using D = Dual<P, 1>;
    std::vector<Solution> result;
    for (const Direction& d : directions) {
        Eigen::VectorXd right = Eigen::VectorXd::Zero(unknown_.size());
        for (std::size_t i = 0; i < d.load.size(); ++i) {
            right[static_cast<Eigen::Index>(i)] += d.load[i];
        }
        const auto value = [&](std::size_t i) {
            Dual<double, 1> x(fields_.effect[i]);
            x.d[0] = d.fields.effect.empty() ? 0.0 : d.fields.effect[i];
            return x;
        };
        const std::vector<D> uniforms = uniforms_at_rest<D>(a.slots(), value);
        for (std::size_t b = 0; b < a.blocks(); ++b) {
            const std::size_t from = 8 * a.caller(b);
            const Mat3<P> plain = a.gradient(b, w_);
            Mat3<D> gradient;
            for (int i = 0; i < 9; ++i) {
                gradient[i / 3][i % 3] = D(plain[i / 3][i % 3]);
            }
            D mu(load<double>(&fields_.mu[from])), lambda(load<double>(&fields_.lambda[from]));
            if (!d.fields.mu.empty()) {
                mu.d[0] = load<double>(&d.fields.mu[from]);
            }
            if (!d.fields.lambda.empty()) {
                lambda.d[0] = load<double>(&d.fields.lambda[from]);
            }
            const Mat3<D> s = cauchy_stress<D>(*model_, a.slots(), uniforms, a.history(), gradient, mu, lambda);
            const P volume = load<double>(&volume_[from]);
            for (int na = 0; na < 27; ++na) {
                const int n = 3 * node_of<double>(a.rows(b), na);
                for (int i = 0; i < 3; ++i) {
                    P sum{};
                    for (int j = 0; j < 3; ++j) {
                        sum += s[i][j].d[0] * a.table(b).by_node[na][j];
                    }
                    right[n + i] -= sum_lanes<double>(volume * sum);
                }
            }
        }
        const Eigen::VectorXd dw = solver_.solve(right);
        Solution r;
        r.map.assign(dw.data(), dw.data() + 3 * model_->node_count());
        r.deformation0.resize(72 * a.blocks());
        r.volume_ratio.resize(8 * a.blocks());
        for (std::size_t b = 0; b < a.blocks(); ++b) {
            const Mat3<P> h = Mat3<P>::identity() + a.gradient(b, w_);
            const Mat3<P> dh = a.gradient(b, r.map);
            const Mat3<P> f = inverse(h);
            const Mat3<P> df = f * dh * f;
            for (std::size_t i = 0; i < 9; ++i) {
                store<double>(&r.deformation0[72 * a.caller(b) + 8 * i], -df[static_cast<int>(i / 3)][i % 3]);
            }
            store<double>(&r.volume_ratio[8 * a.caller(b)], inner(cofactor(h), dh));
        }
        result.push_back(std::move(r));
    }
    return result;
}

Equilibrium::Direction Equilibrium::adjoint(const std::vector<double>& deformation0_bar,
                                            const std::vector<double>& volume_ratio_bar) {
    factorise_here();
    const Assembly a{*model_};
    using V = Var<P>;
    Eigen::VectorXd bar = Eigen::VectorXd::Zero(unknown_.size());
    for (std::size_t b = 0; b < a.blocks(); ++b) {
        const Mat3<P> h = Mat3<P>::identity() + a.gradient(b, w_);
        const Mat3<P> f = inverse(h);
        Mat3<P> f_bar;
        for (std::size_t i = 0; i < 9; ++i) {
            f_bar[static_cast<int>(i / 3)][i % 3] = load<double>(&deformation0_bar[72 * a.caller(b) + 8 * i]);
        }
        const P ratio_bar = load<double>(&volume_ratio_bar[8 * a.caller(b)]);
        const Mat3<P> h_bar = ratio_bar * cofactor(h) - transpose(f) * f_bar * transpose(f);
        for (int na = 0; na < 27; ++na) {
            const int n = 3 * node_of<double>(a.rows(b), na);
            for (int i = 0; i < 3; ++i) {
                P sum{};
                for (int j = 0; j < 3; ++j) {
                    sum += h_bar[i][j] * a.table(b).by_node[na][j];
                }
                bar[n + i] += sum_lanes<double>(sum);
            }
        }
    }
    const Eigen::VectorXd z = solver_.solve_transposed(bar);
    Direction out;
    out.load.assign(z.data(), z.data() + 3 * model_->node_count());
    out.fields.mu.assign(fields_.mu.size(), 0.0);
    out.fields.lambda.assign(fields_.lambda.size(), 0.0);
    out.fields.effect.assign(fields_.effect.size(), 0.0);
    std::vector<double> uniform_bar(static_cast<std::size_t>(Registry::total_uniform_count), 0.0);
    const std::vector<V> constants = uniforms_at_rest<V>(a.slots(), [&](std::size_t i) { return fields_.effect[i]; });
    Tape<P>& tape = Tape<P>::current();
    for (std::size_t b = 0; b < a.blocks(); ++b) {
        const std::size_t from = 8 * a.caller(b);
        tape.reset();
        const Mat3<P> plain = a.gradient(b, w_);
        Mat3<V> gradient;
        for (int i = 0; i < 9; ++i) {
            gradient[i / 3][i % 3] = V(plain[i / 3][i % 3]);
        }
        std::vector<V> uniforms(constants);
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            const EffectSlot& s = a.slots()[static_cast<std::size_t>(i)];
            if (s.active && E::info.site == Site::volume) {
                for (int k = 0; k < uniform_count<E>(); ++k) {
                    V& x = uniforms[static_cast<std::size_t>(s.uniform + k)];
                    x = V::input(x.v);
                }
            }
        });
        const V mu = V::input(load<double>(&fields_.mu[from])), lambda = V::input(load<double>(&fields_.lambda[from]));
        const Mat3<V> s = cauchy_stress<V>(*model_, a.slots(), uniforms, a.history(), gradient, mu, lambda);
        tape.prepare();
        const P volume = load<double>(&volume_[from]);
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                P sum{};
                for (int na = 0; na < 27; ++na) {
                    sum += z[3 * node_of<double>(a.rows(b), na) + i] * a.table(b).by_node[na][j];
                }
                if (s[i][j].i >= 0) {
                    tape.adjoint(s[i][j].i) += -volume * sum;
                }
            }
        }
        tape.sweep();
        store<double>(&out.fields.mu[from], tape.adjoint(mu.i));
        store<double>(&out.fields.lambda[from], tape.adjoint(lambda.i));
        for (std::size_t i = 0; i < uniforms.size(); ++i) {
            if (uniforms[i].i >= 0) {
                uniform_bar[i] += sum_lanes<double>(tape.adjoint(uniforms[i].i));
            }
        }
    }
    Registry::each([&](auto tag, int i) {
        using E = typename decltype(tag)::type;
        using D = Dual<double, max_effect_parameters>;
        const EffectSlot& s = a.slots()[static_cast<std::size_t>(i)];
        if constexpr (uniform_count<E>() > 0 && E::info.site == Site::volume) {
            if (!s.active) {
                return;
            }
            D parameters[max_effect_parameters], q[uniform_count<E>()];
            for (int k = 0; k < E::info.parameter_count(); ++k) {
                parameters[k] = D(fields_.effect[static_cast<std::size_t>(s.parameter + k)]);
                parameters[k].d[k] = 1;
            }
            effect_uniforms<E>(parameters, 0.0, 1.0, q);
            for (int j = 0; j < uniform_count<E>(); ++j) {
                for (int k = 0; k < E::info.parameter_count(); ++k) {
                    out.fields.effect[static_cast<std::size_t>(s.parameter + k)] +=
                        uniform_bar[static_cast<std::size_t>(s.uniform + j)] * q[j].d[k];
                }
            }
        }
    });
    return out;
}

}  // namespace mphygs
