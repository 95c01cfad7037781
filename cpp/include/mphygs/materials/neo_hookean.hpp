// Compressible neo-Hookean solid, W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2.
// Source: Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, section 6.4.3.
#pragma once

#include "mphygs/small.hpp"

namespace mphygs {

struct NeoHookean {
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
};

}  // namespace mphygs
