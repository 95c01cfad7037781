// Maxwell branch in parallel with the spring (standard linear solid):
// Q' + Q / tau = ratio S', S the base law's second Piola-Kirchhoff stress.
//
// Exact for S linear within a substep:
// Q_n+1 = e^(-dt/tau) Q_n + ratio e^(-dt/(2 tau)) (S_n+1 - S_n).
// Source: Simo & Hughes, Computational Inelasticity, section 10.3.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Relaxation {
    static constexpr EffectInfo info{
        .name = "relaxation",
        .summary = "Maxwell branch: Q' + Q/tau = ratio S'",
        .site = Site::volume,
        .history_count = 13,
        .simpler = "viscosity",
        .parameters = {{"ratio", "-", 0, 0, 100, 0.1, true},
                       {"tau", "s", 0.1, 1e-4, 1e4, 0.1, true, Role::level, 0.02, 0.5}},
    };
    /// At the first instant the branch is a further spring.
    static double stiffness_factor(const double* q) { return 1.0 + q[0]; }
    /// Q = ratio tau S' as tau goes to zero: a viscosity of ratio tau mu.
    static void simplify(const double* q, const ObjectScales& of, double* viscosity) {
        viscosity[0] = q[0] * q[1] * of.shear_modulus;
    }
    static constexpr int uniform_count = 2;
    template <class S>
    static void uniforms(const S* p, typename ScalarOf<S>::type, typename ScalarOf<S>::type dt, S* q) {
        const S half = exponential(-(typename ScalarOf<S>::type(0.5) * dt) / p[1]);
        q[0] = half * half;
        q[1] = p[0] * half;
    }
    static constexpr int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};
    /// History: 0..5 Q, 6..11 S before the substep, 12 whether S was ever set. The branch is
    /// relaxed at the start: the first substep only stores S.
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        const Mat3<S> s = inverse(p.elastic) * elastic_stress(p.law, p.elastic, p.mu, p.lambda);
        Mat3<S> branch;
        for (int k = 0; k < 6; ++k) {
            const S now = s[row[k]][column[k]];
            const S next = q[0] * p.history[k] + p.history[12] * (q[1] * (now - p.history[6 + k]));
            p.history_next[k] = next;
            p.history_next[6 + k] = now;
            branch[row[k]][column[k]] = next;
            branch[column[k]][row[k]] = next;
        }
        p.history_next[12] = constant<S>(1);
        // P = F_e Q factor^T: pushed forward as the base law's own stress is.
        const Mat3<S> added = p.elastic * branch;
        p.stress = p.stress + (p.strained ? added * transpose(p.factor) : added);
    }

    template <class P>
    struct Linearised {
        using R = typename ScalarOf<P>::type;
        Mat3<P> f, inverted, now, branch, stress;  // F, F^-1, S, Q after the substep
        P begun, before[6], moved[6];              // whether S was ever set; Q before the substep; change of S

        Linearised(const VolumePoint<P>& p, const R* q, const P* history)
            : f(p.deformation), inverted(inverse(f)), now(inverted * p.stress), begun(history[12]) {
            for (int k = 0; k < 6; ++k) {
                before[k] = history[k];
                moved[k] = begun * (now[row[k]][column[k]] - history[6 + k]);
                branch[row[k]][column[k]] = branch[column[k]][row[k]] = q[0] * before[k] + q[1] * moved[k];
            }
            stress = f * branch;
        }
        template <class W>
        void change(int lane, VolumeChange<W>& d, const Dual<W, 1>* q) const {
            // dS = F^-1 (dP - dF S)
            const Mat3<W> pulled = d.law - mixed_product<W>(d.deformation, in_lane(now, lane));
            const Mat3<R> back = in_lane(inverted, lane);
            Mat3<W> dbranch;
            for (int k = 0; k < 6; ++k) {
                const int i = row[k], j = column[k];
                const W dnow = back[i][0] * pulled[0][j] + back[i][1] * pulled[1][j] + back[i][2] * pulled[2][j];
                const W next = q[0].v * d.history[k] + before[k][lane] * q[0].d[0] + moved[k][lane] * q[1].d[0] +
                               begun[lane] * (q[1].v * (dnow - d.history[6 + k]));
                d.history_next[k] = next;
                d.history_next[6 + k] = dnow;
                dbranch[i][j] = dbranch[j][i] = next;
            }
            d.history_next[12] = W{};
            d.stress = d.stress + mixed_product<W>(d.deformation, in_lane(branch, lane)) + mixed_product<W>(in_lane(f, lane), dbranch);
        }
    };
};

}  // namespace mphygs
