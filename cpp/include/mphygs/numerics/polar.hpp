// Rotation of the polar decomposition A = R U, by Higham's iteration.
//
// R <- (R + R^-T)/2 converges quadratically to the orthogonal factor; ten steps reach round-off
// for condition numbers that a continuum still has, and running derivatives through the
// iteration gives the derivative of R (the map is a contraction near its fixed point).
// Source: N. J. Higham, "Computing the polar decomposition, with applications", 1986.
#pragma once

#include "mphygs/small.hpp"

namespace mphygs {

template <class S>
inline Mat3<S> polar_rotation(const Mat3<S>& a) {
    using R = typename ScalarOf<S>::type;
    Mat3<S> r = a;
    for (int step = 0; step < 10; ++step) {
        const Mat3<S> c = cofactor(r);
        const S scale = R(0.5) / determinant(r, c);
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                r[i][j] = R(0.5) * r[i][j] + scale * c[i][j];
            }
        }
    }
    return r;
}

}  // namespace mphygs
