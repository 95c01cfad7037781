// Second-order term of the energy, c_2 (I1_bar - 3)^2, I1_bar = J^(-2/3) |F|^2.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Stiffening {
    static constexpr EffectInfo info{
        .name = "stiffening",
        .summary = "second-order term c_2 (I1_bar - 3)^2",
        .site = Site::volume,
        .parameters = {{"c_2", "Pa", 0, 0, 1e9, 1e4, true}},
    };
    /// P = 4 c_2 (I1_bar - 3) J^(-2/3) (F - |F|^2/3 F^-T)
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S>& f = p.elastic;
        const Mat3<S> c = cofactor(f);
        const S j = determinant(f, c);
        const S power = exponential(R(-2.0 / 3.0) * logarithm(j));
        const S square = inner(f, f);
        const S scale = R(4) * q[0] * (power * square - R(3)) * power;
        const S pull = R(1.0 / 3.0) * square / j;
        Mat3<S> added;
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k) {
                added[i][k] = scale * (f[i][k] - pull * c[i][k]);
            }
        }
        p.stress = p.stress + (p.strained ? added * transpose(p.factor) : added);
    }
};

}  // namespace mphygs
