// Fixed corotated solid, W = mu |F - R|^2 + lambda/2 (J - 1)^2.
// Source: Stomakhin, Howes, Schroeder, Teran, "Energetically consistent invertible elasticity", 2012.
#pragma once

#include "mphygs/numerics/polar.hpp"

namespace mphygs {

struct FixedCorotated {
    static constexpr const char* name = "fixed-corotated";
    template <class S>
    static S energy(const Mat3<S>& f, const S& mu, const S& lambda) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S> e = f - polar_rotation(f);
        const S j = determinant(f, cofactor(f)) - R(1);
        return mu * inner(e, e) + R(0.5) * lambda * j * j;
    }
    /// P = 2 mu (F - R) + lambda (J - 1) J F^-T
    template <class S>
    static Mat3<S> stress(const Mat3<S>& f, const S& mu, const S& lambda) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S> rotation = polar_rotation(f);
        const Mat3<S> c = cofactor(f);
        const S pressure = lambda * (determinant(f, c) - R(1));
        const S twice = R(2) * mu;
        Mat3<S> p;
        for (int a = 0; a < 3; ++a) {
            for (int b = 0; b < 3; ++b) {
                p[a][b] = twice * (f[a][b] - rotation[a][b]) + pressure * c[a][b];
            }
        }
        return p;
    }
};

}  // namespace mphygs
