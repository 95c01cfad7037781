// Saint Venant-Kirchhoff solid, W = mu E:E + lambda/2 (tr E)^2, E = (F^T F - I) / 2.
// Source: Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, section 6.4.1.
#pragma once

#include "mphygs/small.hpp"

namespace mphygs {

struct SaintVenantKirchhoff {
    static constexpr const char* name = "saint-venant-kirchhoff";
    template <class S>
    static Mat3<S> strain(const Mat3<S>& f) {
        using R = typename ScalarOf<S>::type;
        Mat3<S> e = transpose(f) * f;
        for (int a = 0; a < 3; ++a) {
            for (int b = 0; b < 3; ++b) {
                e[a][b] = R(0.5) * (a == b ? e[a][b] - R(1) : e[a][b]);
            }
        }
        return e;
    }
    template <class S>
    static S energy(const Mat3<S>& f, const S& mu, const S& lambda) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S> e = strain(f);
        const S t = trace(e);
        return mu * inner(e, e) + R(0.5) * lambda * t * t;
    }
    /// P = F (2 mu E + lambda tr E I)
    template <class S>
    static Mat3<S> stress(const Mat3<S>& f, const S& mu, const S& lambda) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S> e = strain(f);
        Mat3<S> s = (R(2) * mu) * e;
        const S pressure = lambda * trace(e);
        for (int a = 0; a < 3; ++a) {
            s[a][a] = s[a][a] + pressure;
        }
        return f * s;
    }
};

}  // namespace mphygs
