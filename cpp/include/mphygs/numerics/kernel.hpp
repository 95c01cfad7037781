// Quadratic B-spline of one knot span.
//
// Nodes sit at origin + i * spacing. Span i is [i - 1/2, i + 1/2] and is touched by the nodes
// i - 1, i, i + 1; with s in [-1/2, 1/2] the distance from node i in spacings,
//   N_-1 = (1/2 - s)^2 / 2,  N_0 = 3/4 - s^2,  N_+1 = (1/2 + s)^2 / 2.
#pragma once

namespace mphygs {

template <class T>
struct SplineWeights {
    T value[3];
    T slope[3];  // d/ds; divide by the spacing for d/dx
};

template <class T>
inline SplineWeights<T> spline_weights(T s) {
    const T a = T(0.5) - s;
    const T b = T(0.5) + s;
    return {{T(0.5) * a * a, T(0.75) - s * s, T(0.5) * b * b}, {-a, T(-2) * s, b}};
}

}  // namespace mphygs
