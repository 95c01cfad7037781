// Particles <-> grid by rows of nodes: the fast kernels for values.
//
// The three nodes of a row along the fastest axis lie side by side, so a particle touches nine rows
// of one register each; they are kept while the cell stays the same. The weights factor, and so do
// the sums: over the slow axis, the middle axis, and at last over the nodes of a row. Moments are
// summed about the nearest node, i in {-1, 0, 1}, and moved to the particle afterwards:
//   sum w V (i - s)^T = sum w V i^T - (sum w V) s^T,   q + n (i - s) = (q - n s) + n i.
// Registers have names because g++ 12 would leave an array of them in memory.
#pragma once

#include "mphygs/mls_mpm/lanes.hpp"
#include "mphygs/mls_mpm/transfer.hpp"

namespace mphygs {

/// Weights of a tile as the kernels read them.
template <class T>
struct RowWeights {
    alignas(64) T slow[3][tile_size], middle[3][tile_size];
    alignas(64) T fast[4 * tile_size + 16];  // four numbers a particle, the last 0

    explicit RowWeights(const MlsTile<T, 0>& tile, T (*slope)[3][tile_size] = nullptr, T* fast_slope = nullptr) {
        for (std::size_t p = 0; p < tile_size; p += MlsVector<T>::wide_count) {
            const auto weights = [&](int c) { return spline(read<Wide<T>>(&tile.s[0][c][p])); };
            for (const int c : {0, 1}) {
                const SplineWeights<Wide<T>> w = weights(c);
                auto& to = c == 0 ? slow : middle;
                for (int i = 0; i < 3; ++i) {
                    write(&to[i][p], w.value[i]);
                    if (slope) {
                        write(&slope[c][i][p], w.slope[i]);
                    }
                }
            }
            const SplineWeights<Wide<T>> w = weights(2);
            write_quads(&fast[4 * p], w.value[0], w.value[1], w.value[2]);
            if (slope) {
                write_quads(&fast_slope[4 * p], w.slope[0], w.slope[1], w.slope[2]);
            }
        }
    }

  private:
    static SplineWeights<Wide<T>> spline(Wide<T> s) {
        const Wide<T> a = T(0.5) - s, b = T(0.5) + s;
        return {{T(0.5) * a * a, T(0.75) - s * s, T(0.5) * b * b}, {-a, T(-2) * s, b}};
    }
};

/// From sums about the nearest node, a particle a row, to q and n of a tile, and the fourth number
/// where it is wanted.
template <class T>
inline void finish_gather(const T* sums, const T (*s)[tile_size], const std::array<int, 3>& axis, MlsTile<T, 0>& tile, T* fourth) {
    for (std::size_t p = 0; p < tile_size; p += MlsVector<T>::wide_count) {
        const Columns<T> sum = columns_of(sums + 16 * p);
        for (std::size_t c = 0; c < 3; ++c) {
            write(&tile.q[0][c][p], sum.at[0][c]);
            for (std::size_t e = 0; e < 3; ++e) {
                const Wide<T> moment = sum.at[e + 1][c] - sum.at[0][c] * read<Wide<T>>(&s[e][p]);
                write(&tile.n[0][3 * c + static_cast<std::size_t>(axis[e])][p], moment);
            }
        }
        if (fourth) {
            write(fourth + p, sum.at[0][3]);
        }
    }
}

template <class T>
inline void gather_rows(MlsTile<T, 0>& tile, const T* grid, const std::array<int, 3>& axis, const Box& box) {
    using R = Row<T>;
    const RowWeights<T> w(tile);
    alignas(64) T out[tile_size * 16];
    const std::ptrdiff_t row = 4 * box.count[2], plane = row * box.count[1];
    R r00{}, r01{}, r02{}, r10{}, r11{}, r12{}, r20{}, r21{}, r22{};
    std::int32_t current = -1;
    for (std::size_t p = 0; p < tile_size; ++p) {
        if (tile.corner[p] != current) {
            current = tile.corner[p];
            const T* a = grid + 4 * static_cast<std::ptrdiff_t>(current);
            const T* b = a + plane;
            const T* c = b + plane;
            r00 = read<R>(a), r01 = read<R>(a + row), r02 = read<R>(a + 2 * row);
            r10 = read<R>(b), r11 = read<R>(b + row), r12 = read<R>(b + 2 * row);
            r20 = read<R>(c), r21 = read<R>(c + row), r22 = read<R>(c + 2 * row);
        }
        const T am = w.slow[0][p], a0 = w.slow[1][p], ap = w.slow[2][p];
        const R m0 = am * r00, m1 = am * r01, m2 = am * r02, p0 = ap * r20, p1 = ap * r21, p2 = ap * r22;
        const R t0 = a0 * r10 + (m0 + p0), t1 = a0 * r11 + (m1 + p1), t2 = a0 * r12 + (m2 + p2);
        const T bm = w.middle[0][p], b0 = w.middle[1][p], bp = w.middle[2][p];
        const R bm0 = bm * t0, bp2 = bp * t2;
        const R fast = stretch(read<R>(&w.fast[4 * p]));
        const R value = (b0 * t1 + (bm0 + bp2)) * fast;
        const R by_middle = (bp2 - bm0) * fast;
        const R by_slow = (bm * (p0 - m0) + (b0 * (p1 - m1) + bp * (p2 - m2))) * fast;
        const R sign = node_signs<T>();
        write(&out[16 * p], sum_nodes(value, by_slow, by_middle, value * sign));
    }
    finish_gather<T>(out, tile.s[0], axis, tile, nullptr);
}

/// What each particle gives about its nearest node, a particle a row: {q - n s, mass}, and the
/// columns of n by memory axis.
template <class T>
inline void given_rows(const MlsTile<T, 0>& tile, const std::array<int, 3>& axis, T* rows) {
    for (std::size_t p = 0; p < tile_size; p += MlsVector<T>::wide_count) {
        Columns<T> given{};
        for (std::size_t c = 0; c < 3; ++c) {
            given.at[0][c] = read<Wide<T>>(&tile.q[0][c][p]);
            for (std::size_t e = 0; e < 3; ++e) {
                given.at[e + 1][c] = read<Wide<T>>(&tile.n[0][3 * c + static_cast<std::size_t>(axis[e])][p]);
                given.at[0][c] -= given.at[e + 1][c] * read<Wide<T>>(&tile.s[0][e][p]);
            }
        }
        given.at[0][3] = read<Wide<T>>(&tile.mass[0][p]);
        write_rows(rows + 16 * p, given);
    }
}

template <class T>
inline void scatter_given(const MlsTile<T, 0>& tile, const RowWeights<T>& w, const T* rows, T* grid, const Box& box) {
    using R = Row<T>;
    const std::ptrdiff_t row = 4 * box.count[2], plane = row * box.count[1];
    R s00{}, s01{}, s02{}, s10{}, s11{}, s12{}, s20{}, s21{}, s22{};
    std::int32_t current = tile.corner[0];
    const auto flush = [&]() {
        T* a = grid + 4 * static_cast<std::ptrdiff_t>(current);
        T* b = a + plane;
        T* c = b + plane;
        write(a, read<R>(a) + s00), write(a + row, read<R>(a + row) + s01), write(a + 2 * row, read<R>(a + 2 * row) + s02);
        write(b, read<R>(b) + s10), write(b + row, read<R>(b + row) + s11), write(b + 2 * row, read<R>(b + 2 * row) + s12);
        write(c, read<R>(c) + s20), write(c + row, read<R>(c + row) + s21), write(c + 2 * row, read<R>(c + 2 * row) + s22);
    };
    for (std::size_t p = 0; p < tile_size; ++p) {
        if (tile.corner[p] != current) {
            flush();
            current = tile.corner[p];
            s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = R{};
        }
        const R given = read<R>(&rows[16 * p]);
        const R fast = stretch(read<R>(&w.fast[4 * p]));
        const R sign = node_signs<T>();
        const R z0 = (repeat<0>(given) + repeat<3>(given) * sign) * fast;
        const R za = repeat<1>(given) * fast;
        const R zb = repeat<2>(given) * fast;
        const T am = w.slow[0][p], a0 = w.slow[1][p], ap = w.slow[2][p];
        const T bm = w.middle[0][p], b0 = w.middle[1][p], bp = w.middle[2][p];
        const R ym = am * (z0 - za), y0 = a0 * z0, yp = ap * (z0 + za);
        const R nm = am * zb, n0 = a0 * zb, np = ap * zb;
        s00 += bm * (ym - nm), s01 += b0 * ym, s02 += bp * (ym + nm);
        s10 += bm * (y0 - n0), s11 += b0 * y0, s12 += bp * (y0 + n0);
        s20 += bm * (yp - np), s21 += b0 * yp, s22 += bp * (yp + np);
    }
    flush();
}

template <class T>
inline void scatter_rows(const MlsTile<T, 0>& tile, T* grid, const std::array<int, 3>& axis, const Box& box) {
    const RowWeights<T> w(tile);
    alignas(64) T rows[tile_size * 16];
    given_rows<T>(tile, axis, rows);
    scatter_given<T>(tile, w, rows, grid, box);
}

/// The kernel for the number of directions. Lanes of the grid are `lane_stride` apart.
template <class T, int K>
inline void gather_tile(MlsTile<T, K>& tile, const T* grid, std::size_t lane_stride, const std::array<int, 3>& axis, const Box& box) {
    if constexpr (K == 0) {
        gather_rows(tile, grid, axis, box);
    } else {
        gather<T, K>(tile, grid, lane_stride, axis, box);
    }
}
template <class T, int K>
inline void scatter_tile(const MlsTile<T, K>& tile, T* grid, std::size_t lane_stride, const std::array<int, 3>& axis, const Box& box) {
    if constexpr (K == 0) {
        scatter_rows(tile, grid, axis, box);
    } else {
        scatter<T, K>(tile, grid, lane_stride, axis, box);
    }
}

}  // namespace mphygs
