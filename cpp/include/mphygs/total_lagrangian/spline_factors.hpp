// Weights of eight points as products of splines along the axes: a tenth of the memory of the whole table.
//
// Where every block has a table of its own (cells that the surface cuts), reading the tables takes longer than the sums
// that they are read for.
#pragma once

#include <cstdint>

#include "mphygs/small.hpp"

namespace mphygs {

inline constexpr int row_count_27 = 9;

/// First nodes of the nine rows of three, along z, that a block stands on.
using Rows = std::int32_t[row_count_27];

/// Splines of eight points along the three axes: weights, and their slopes [1/m], of three nodes each.
template <class T>
struct SplineFactors {
    Pack<T> value[3][3], slope[3][3];
};

/// sum_a f_a (dN_a/dx)^T, axis by axis; at, wide: as in `gradient_sums`.
template <class W, class T, class At, class Wide>
inline Mat3<W> factored_gradient_sums(const T* field, std::size_t stride, const Rows& rows, const SplineFactors<T>& s, const At& at,
                                      const Wide& wide) {
    const W z0 = wide(s.value[2][0]), z1 = wide(s.value[2][1]), z2 = wide(s.value[2][2]);
    const W dz0 = wide(s.slope[2][0]), dz1 = wide(s.slope[2][1]), dz2 = wide(s.slope[2][2]);
    Mat3<W> g;
    for (int c = 0; c < 3; ++c, field += stride) {
        W gx{}, gy{}, gz{};
#pragma GCC unroll 3
        for (int i = 0; i < 3; ++i) {
            W whole{}, along_y{}, along_z{};
#pragma GCC unroll 3
            for (int j = 0; j < 3; ++j) {
                const T* node = field + rows[3 * i + j];
                const auto a = at(node), b = at(node + 1), d = at(node + 2);
                const W value = a * z0 + b * z1 + d * z2, slope = a * dz0 + b * dz1 + d * dz2;
                const W wy = wide(s.value[1][j]);
                whole += value * wy;
                along_y += value * wide(s.slope[1][j]);
                along_z += slope * wy;
            }
            const W wx = wide(s.value[0][i]);
            gx += whole * wide(s.slope[0][i]);
            gy += along_y * wx;
            gz += along_z * wx;
        }
        g.e[c][0] = gx;
        g.e[c][1] = gy;
        g.e[c][2] = gz;
    }
    return g;
}

/// Sums over eight lanes of eight packs: lane k of the result is the sum of the k-th. Of pairs, in both halves.
template <class W>
inline W sums_of_lanes(const W& a, const W& b, const W& c, const W& d, const W& e, const W& f, const W& g, const W& h) {
    if constexpr (VectorOf<W>::count == 8) {
        const auto first = [](const W& x, const W& y) {
            return shuffle<0, 8, 1, 9, 4, 12, 5, 13>(x, y) + shuffle<2, 10, 3, 11, 6, 14, 7, 15>(x, y);
        };
        const auto second = [](const W& x, const W& y) {
            return shuffle<0, 1, 8, 9, 4, 5, 12, 13>(x, y) + shuffle<2, 3, 10, 11, 6, 7, 14, 15>(x, y);
        };
        const W x = second(first(a, b), first(c, d)), y = second(first(e, f), first(g, h));
        return shuffle<0, 1, 2, 3, 8, 9, 10, 11>(x, y) + shuffle<4, 5, 6, 7, 12, 13, 14, 15>(x, y);
    } else {
        const auto first = [](const W& x, const W& y) {
            return shuffle<0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29>(x, y) +
                   shuffle<2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31>(x, y);
        };
        const auto second = [](const W& x, const W& y) {
            return shuffle<0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29>(x, y) +
                   shuffle<2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31>(x, y);
        };
        const W x = second(first(a, b), first(c, d)), y = second(first(e, f), first(g, h));
        return shuffle<0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27>(x, y) +
               shuffle<4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31>(x, y);
    }
}

/// Rows 2 n and 2 n + 1 of what one component of a stress gives to the nodes, as `sums_of_lanes`.
template <class W, class T, class Wide>
inline void factored_rows(const W (&p)[3], const SplineFactors<T>& s, const Wide& wide, W (&sums)[5]) {
    const W z0 = wide(s.value[2][0]), z1 = wide(s.value[2][1]), z2 = wide(s.value[2][2]);
    const W dz0 = wide(s.slope[2][0]), dz1 = wide(s.slope[2][1]), dz2 = wide(s.slope[2][2]);
    const W none{};
    W row[10][2];  // of each row: what goes with the weights along z, and with their slopes
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
        const W wx = wide(s.value[0][i]);
        const W a = p[0] * wide(s.slope[0][i]), b = p[1] * wx, c = p[2] * wx;
#pragma GCC unroll 3
        for (int j = 0; j < 3; ++j) {
            const W wy = wide(s.value[1][j]);
            row[3 * i + j][0] = a * wy + b * wide(s.slope[1][j]);
            row[3 * i + j][1] = c * wy;
        }
    }
    row[9][0] = row[9][1] = none;
#pragma GCC unroll 5
    for (int n = 0; n < 5; ++n) {
        const W v = row[2 * n][0], r = row[2 * n][1];
        const W w = row[2 * n + 1][0], t = row[2 * n + 1][1];
        sums[n] = sums_of_lanes<W>(v * z0 + r * dz0, v * z1 + r * dz1, v * z2 + r * dz2, none, w * z0 + t * dz0, w * z1 + t * dz1,
                                   w * z2 + t * dz2, none);
    }
}

}  // namespace mphygs
