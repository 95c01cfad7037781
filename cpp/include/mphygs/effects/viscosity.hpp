// Kelvin-Voigt solid: Cauchy stress 2 eta dev(D), D the symmetric velocity gradient.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Viscosity {
    static constexpr EffectInfo info{"viscosity", "Kelvin-Voigt Cauchy stress 2 eta dev(D)", Site::volume, false, true, 0, 1,
                                     {{"eta", "Pa s", 0, 0, 1e6, 10, true}}};
    /// P = J sigma F^-T = sigma cof(F), with L = dF/dt F^-1 = dF/dt cof(F)^T / J
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S> c = cofactor(p.deformation);
        const S scale = q[0] / determinant(p.deformation, c);
        Mat3<S> d = p.rate * transpose(c);
        const S mean = (R(2) / R(3)) * trace(d);
        Mat3<S> sigma;  // up to the common factor `scale`
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                sigma[i][j] = d[i][j] + d[j][i];
            }
            sigma[i][i] = sigma[i][i] - mean;
        }
        p.stress = p.stress + scale * (sigma * c);
    }
};

}  // namespace mphygs
