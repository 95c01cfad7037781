// Compressible neo-Hookean solid, W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2.
// Source: Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, section 6.4.3.
#pragma once

#include "mphygs/small.hpp"

namespace mphygs {

struct NeoHookean {
    static constexpr const char* name = "neo-hookean";
    static constexpr bool usual = true, linearised = true;
    template <class S>
    static S energy(const Mat3<S>& f, const S& mu, const S& lambda) {
        using R = typename ScalarOf<S>::type;
        const S log_j = logarithm(determinant(f, cofactor(f)));
        return R(0.5) * (mu * (inner(f, f) - R(3)) + lambda * log_j * log_j) - mu * log_j;
    }
    /// P = mu (F - F^-T) + lambda ln J F^-T
    template <class S>
    static Mat3<S> stress(const Mat3<S>& f, const S& mu, const S& lambda) {
        const Mat3<S> c = cofactor(f);
        const S j = determinant(f, c);
        const S scale = (lambda * logarithm(j) - mu) / j;
        Mat3<S> p;
        for (int a = 0; a < 3; ++a) {
            for (int b = 0; b < 3; ++b) {
                p[a][b] = mu * f[a][b] + scale * c[a][b];
            }
        }
        return p;
    }

    /// Stress at one state, and its change in any number of directions, hand-written.
    template <class S>
    struct Linearised {
        Mat3<S> f, c;
        S mu, lambda, inverse_j, log_j, scale;

        Linearised() = default;
        Linearised(const Mat3<S>& deformation, const S& mu_, const S& lambda_)
            : f(deformation), c(cofactor(deformation)), mu(mu_), lambda(lambda_) {
            const S j = determinant(f, c);
            inverse_j = 1 / j;
            log_j = logarithm(j);
            scale = (lambda * log_j - mu) * inverse_j;
        }
        Mat3<S> stress() const { return mu * f + scale * c; }
        /// dP for dF, d mu, d lambda. D: S, or directions in the lanes where S is a number.
        template <class D>
        Mat3<D> change(const Mat3<D>& df, const D& dmu, const D& dlambda) const {
            D volumetric{};  // d ln J
            for (int a = 0; a < 3; ++a) {
                for (int b = 0; b < 3; ++b) {
                    volumetric = volumetric + c[a][b] * df[a][b];
                }
            }
            volumetric = volumetric * inverse_j;
            const D dscale = (dlambda * log_j + lambda * volumetric - dmu) * inverse_j - scale * volumetric;
            Mat3<D> dp;
            for (int a = 0; a < 3; ++a) {
                for (int b = 0; b < 3; ++b) {
                    dp[a][b] = mu * df[a][b] + dmu * f[a][b] + dscale * c[a][b] + scale * cofactor_change(f, df, a, b);
                }
            }
            return dp;
        }
    };
};

}  // namespace mphygs
