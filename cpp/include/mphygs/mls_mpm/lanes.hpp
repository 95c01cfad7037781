// Vectors of the MLS-MPM row kernels, and the change between "a particle a row" and "a number a row".
//
// Row: sixteen numbers, four grid nodes {x, y, z, m}. Wide: as many particles as a 64-byte register
// holds.
#pragma once

#include "mphygs/mls_mpm/tile.hpp"
#include "mphygs/numerics/vector.hpp"

namespace mphygs {

template <class T>
struct MlsVector;
template <>
struct MlsVector<float> {
    static constexpr int wide_count = 16;
};
template <>
struct MlsVector<double> {
    static constexpr int wide_count = 8;
};
template <class T>
using Row = Vector<T, 16>;
template <class T>
using Quad = Vector<T, 4>;
template <class T>
using Wide = Vector<T, MlsVector<T>::wide_count>;

/// Of a row's nodes: the place along it, in {-1, 0, 1}; nothing for the fourth.
template <class T>
inline Row<T> node_signs() {
    alignas(64) static constexpr T signs[16] = {-1, -1, -1, -1, 0, 0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 0};
    return read<Row<T>>(signs);
}
/// Block k of four numbers, four times.
template <int k, class R>
inline R repeat(R r) {
    constexpr int i = 4 * k;
    return shuffle<i, i + 1, i + 2, i + 3, i, i + 1, i + 2, i + 3, i, i + 1, i + 2, i + 3, i, i + 1, i + 2, i + 3>(r, r);
}
/// Each of the first four numbers four times.
template <class R>
inline R stretch(R r) {
    return shuffle<0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3>(r, r);
}
/// The fourth number of each node, four times.
template <class R>
inline R fourth(R r) {
    return shuffle<3, 3, 3, 3, 7, 7, 7, 7, 11, 11, 11, 11, 15, 15, 15, 15>(r, r);
}
/// The first three numbers of each node from a, the fourth from b.
template <class R>
inline R keep_fourth(R a, R b) {
    return shuffle<0, 1, 2, 19, 4, 5, 6, 23, 8, 9, 10, 27, 12, 13, 14, 31>(a, b);
}
/// Sum of the first three numbers of each node, four times.
template <class R>
inline R sum_three(R r) {
    return shuffle<0, 0, 0, 0, 4, 4, 4, 4, 8, 8, 8, 8, 12, 12, 12, 12>(r, r) +
           shuffle<1, 1, 1, 1, 5, 5, 5, 5, 9, 9, 9, 9, 13, 13, 13, 13>(r, r) +
           shuffle<2, 2, 2, 2, 6, 6, 6, 6, 10, 10, 10, 10, 14, 14, 14, 14>(r, r);
}
/// The four numbers of which a (b, c, d) has four each, summed over the nodes: {a, b, c, d}.
template <class R>
inline R sum_nodes(R a, R b, R c, R d) {
    const R ab = shuffle<0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23>(a, b) +
                 shuffle<8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31>(a, b);
    const R cd = shuffle<0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23>(c, d) +
                 shuffle<8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31>(c, d);
    return shuffle<0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27>(ab, cd) +
           shuffle<4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31>(ab, cd);
}

/// A register of particles for each of sixteen numbers, by blocks of four.
template <class T>
struct Columns {
    Wide<T> at[4][4];
};

namespace detail {
using F = Row<float>;
inline F low32(F a, F b) { return shuffle<0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29>(a, b); }
inline F high32(F a, F b) { return shuffle<2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31>(a, b); }
inline F low64(F a, F b) { return shuffle<0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29>(a, b); }
inline F high64(F a, F b) { return shuffle<2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31>(a, b); }
inline F even128(F a, F b) { return shuffle<0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27>(a, b); }
inline F odd128(F a, F b) { return shuffle<4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31>(a, b); }

struct Four {
    F a, b, c, d;
};
/// 4x4 blocks of numbers, transposed within each.
[[gnu::always_inline]] inline Four transpose_small(F a, F b, F c, F d) {
    const F ab = low32(a, b), cd = low32(c, d), ef = high32(a, b), gh = high32(c, d);
    return {low64(ab, cd), high64(ab, cd), low64(ef, gh), high64(ef, gh)};
}
/// The blocks themselves.
[[gnu::always_inline]] inline Four transpose_blocks(F a, F b, F c, F d) {
    const F e = even128(a, b), f = even128(c, d), o = odd128(a, b), p = odd128(c, d);
    return {even128(e, f), even128(o, p), odd128(e, f), odd128(o, p)};
}
}  // namespace detail

/// {a, b, c, 0} of each particle, one after the other.
inline void write_quads(float* to, detail::F a, detail::F b, detail::F c) {
    const detail::Four small = detail::transpose_small(a, b, c, detail::F{});
    const detail::Four blocks = detail::transpose_blocks(small.a, small.b, small.c, small.d);
    write(to, blocks.a), write(to + 16, blocks.b), write(to + 32, blocks.c), write(to + 48, blocks.d);
}
inline void write_quads(double* to, Wide<double> a, Wide<double> b, Wide<double> c) {
    for (int i = 0; i < 8; ++i) {
        to[4 * i] = a[i], to[4 * i + 1] = b[i], to[4 * i + 2] = c[i], to[4 * i + 3] = 0;
    }
}

/// rows: sixteen numbers of each particle, one particle after the other.
[[gnu::always_inline]] inline Columns<float> columns_of(const float* rows) {
    using namespace detail;
    const auto row = [&](std::size_t i) { return read<F>(rows + 16 * i); };
    const Four g0 = transpose_small(row(0), row(1), row(2), row(3));
    const Four g1 = transpose_small(row(4), row(5), row(6), row(7));
    const Four g2 = transpose_small(row(8), row(9), row(10), row(11));
    const Four g3 = transpose_small(row(12), row(13), row(14), row(15));
    const Four x = transpose_blocks(g0.a, g1.a, g2.a, g3.a), y = transpose_blocks(g0.b, g1.b, g2.b, g3.b);
    const Four z = transpose_blocks(g0.c, g1.c, g2.c, g3.c), m = transpose_blocks(g0.d, g1.d, g2.d, g3.d);
    return {{{x.a, y.a, z.a, m.a}, {x.b, y.b, z.b, m.b}, {x.c, y.c, z.c, m.c}, {x.d, y.d, z.d, m.d}}};
}
[[gnu::always_inline]] inline void write_rows(float* rows, const Columns<float>& c) {
    using namespace detail;
    const auto small = [&](int k) { return transpose_small(c.at[k][0], c.at[k][1], c.at[k][2], c.at[k][3]); };
    const Four g0 = small(0), g1 = small(1), g2 = small(2), g3 = small(3);
    const auto put = [&](std::size_t j, const Four& f) {
        write(rows + 16 * j, f.a), write(rows + 16 * (j + 4), f.b), write(rows + 16 * (j + 8), f.c), write(rows + 16 * (j + 12), f.d);
    };
    put(0, transpose_blocks(g0.a, g1.a, g2.a, g3.a));
    put(1, transpose_blocks(g0.b, g1.b, g2.b, g3.b));
    put(2, transpose_blocks(g0.c, g1.c, g2.c, g3.c));
    put(3, transpose_blocks(g0.d, g1.d, g2.d, g3.d));
}
inline Columns<double> columns_of(const double* rows) {
    Columns<double> c;
    for (int i = 0; i < 8; ++i) {
        for (int k = 0; k < 16; ++k) {
            c.at[k / 4][k % 4][i] = rows[16 * i + k];
        }
    }
    return c;
}
inline void write_rows(double* rows, const Columns<double>& c) {
    for (int i = 0; i < 8; ++i) {
        for (int k = 0; k < 16; ++k) {
            rows[16 * i + k] = c.at[k / 4][k % 4][i];
        }
    }
}

}  // namespace mphygs
