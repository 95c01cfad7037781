// Adjoints of the row kernels.
//
// Both need d/ds of sum_i w_i R_i . Y_i, R the rows of a grid and Y_i = (q - n s) + n i what a
// particle gives to node i or has as bars there: the nine products e = R Y are summed with the
// weights and with their slopes. To it comes - n^T sum_i w_i R_i, from Y's own s.
#pragma once

#include "mphygs/mls_mpm/rows.hpp"

namespace mphygs {

/// Slopes of the weights beside the weights.
template <class T>
struct RowSlopes {
    alignas(64) T cross[2][3][tile_size];  // slow and middle axis
    alignas(64) T fast[4 * tile_size + 16];
};

/// Derivatives by s, by memory axis.
template <class T>
struct TileSlope {
    alignas(64) T by[3][tile_size];
};

/// From a particle's sums {slow, middle, fast} of four numbers each to the slope; `value`: sum w R.
template <class T>
inline void finish_slope(const T* sums, const MlsTile<T, 0>& given, const T (*value)[tile_size], const std::array<int, 3>& axis,
                         TileSlope<T>& slope) {
    using W = Wide<T>;
    for (std::size_t p = 0; p < tile_size; p += MlsVector<T>::wide_count) {
        const Columns<T> sum = columns_of(sums + 16 * p);
        for (std::size_t e = 0; e < 3; ++e) {
            W total = (sum.at[e][0] + sum.at[e][1]) + (sum.at[e][2] + sum.at[e][3]);
            for (std::size_t c = 0; c < 3; ++c) {
                total -= read<W>(&given.n[0][3 * c + static_cast<std::size_t>(axis[e])][p]) * read<W>(&value[c][p]);
            }
            write(&slope.by[e][p], total);
        }
    }
}

/// The nine rows of a cell.
template <class R>
struct NineRows {
    R r00, r01, r02, r10, r11, r12, r20, r21, r22;
};
template <class R, class T>
[[gnu::always_inline]] inline NineRows<R> nine_rows(const T* a, std::ptrdiff_t row, std::ptrdiff_t plane) {
    const T* b = a + plane;
    const T* c = b + plane;
    return {read<R>(a), read<R>(a + row), read<R>(a + 2 * row), read<R>(b), read<R>(b + row),
            read<R>(b + 2 * row), read<R>(c), read<R>(c + row), read<R>(c + 2 * row)};
}

/// Sums of e = R Y with the slopes of the weights, for particle p: {slow, middle, fast} of four
/// numbers each. Weights add up to 1 and slopes to 0: sums are of differences from the middle node.
template <class T>
[[gnu::always_inline]] inline Row<T> slope_sums(const NineRows<Row<T>>& r, const T* given, const RowWeights<T>& w, const RowSlopes<T>& d,
                                                std::size_t p) {
    using R = Row<T>;
    const R sign = node_signs<T>();
    const R y = read<R>(given);
    const R y0 = repeat<0>(y) + repeat<3>(y) * sign, ya = repeat<1>(y), yb = repeat<2>(y);
    const R ym = y0 - ya, yp = y0 + ya;
    const T am = w.slow[0][p], ap = w.slow[2][p], dm = d.cross[0][0][p], dp = d.cross[0][2][p];
    const R c0 = r.r10 * (y0 - yb), m0 = r.r00 * (ym - yb) - c0, p0 = r.r20 * (yp - yb) - c0;
    const R c1 = r.r11 * y0, m1 = r.r01 * ym - c1, p1 = r.r21 * yp - c1;
    const R c2 = r.r12 * (y0 + yb), m2 = r.r02 * (ym + yb) - c2, p2 = r.r22 * (yp + yb) - c2;
    const R t1 = c1 + (am * m1 + ap * p1), u1 = dm * m1 + dp * p1;
    const R tm = (c0 + (am * m0 + ap * p0)) - t1, um = (dm * m0 + dp * p0) - u1;
    const R tp = (c2 + (am * m2 + ap * p2)) - t1, up = (dm * m2 + dp * p2) - u1;
    const T bm = w.middle[0][p], bp = w.middle[2][p];
    const R fast = stretch(read<R>(&w.fast[4 * p]));
    const R slow = (u1 + (bm * um + bp * up)) * fast;
    const R middle = (d.cross[1][0][p] * tm + d.cross[1][2][p] * tp) * fast;
    const R along = (t1 + (bm * tm + bp * tp)) * stretch(read<R>(&d.fast[4 * p]));
    return sum_nodes(slow, middle, along, along);
}

/// Adjoint of the scatter: `out` gathers the bars of q, n and mass from the grid's, and the slope
/// is that of the work of what was given.
template <class T>
inline void reverse_scatter_rows(const MlsTile<T, 0>& given, const T* grid, const std::array<int, 3>& axis, const Box& box,
                                 MlsTile<T, 0>& out, TileSlope<T>& slope) {
    using R = Row<T>;
    RowSlopes<T> d;
    const RowWeights<T> w(given, d.cross, d.fast);
    alignas(64) T rows[tile_size * 16], values[tile_size * 16], sums[tile_size * 16];
    given_rows<T>(given, axis, rows);
    const std::ptrdiff_t row = 4 * box.count[2], plane = row * box.count[1];
    NineRows<R> r{};
    std::int32_t current = -1;
    for (std::size_t p = 0; p < tile_size; ++p) {
        if (given.corner[p] != current) {
            current = given.corner[p];
            r = nine_rows<R>(grid + 4 * static_cast<std::ptrdiff_t>(current), row, plane);
        }
        const T am = w.slow[0][p], a0 = w.slow[1][p], ap = w.slow[2][p];
        const T bm = w.middle[0][p], b0 = w.middle[1][p], bp = w.middle[2][p];
        const R fast = stretch(read<R>(&w.fast[4 * p]));
        const R sign = node_signs<T>();
        const R m0 = am * r.r00, m1 = am * r.r01, m2 = am * r.r02, p0 = ap * r.r20, p1 = ap * r.r21, p2 = ap * r.r22;
        const R t0 = a0 * r.r10 + (m0 + p0), t1 = a0 * r.r11 + (m1 + p1), t2 = a0 * r.r12 + (m2 + p2);
        const R bm0 = bm * t0, bp2 = bp * t2;
        const R value = (b0 * t1 + (bm0 + bp2)) * fast;
        const R by_middle = (bp2 - bm0) * fast;
        const R by_slow = (bm * (p0 - m0) + (b0 * (p1 - m1) + bp * (p2 - m2))) * fast;
        write(&values[16 * p], sum_nodes(value, by_slow, by_middle, value * sign));
        write(&sums[16 * p], slope_sums<T>(r, &rows[16 * p], w, d, p));
    }
    finish_gather<T>(values, given.s[0], axis, out, out.mass[0]);
    finish_slope<T>(sums, given, out.q[0], axis, slope);
}

/// Adjoint of the gather: scatters the bars of what was gathered, and the slope is that of their
/// work with the grid's velocities. velocity: what was gathered.
template <class T>
inline void reverse_gather_rows(const MlsTile<T, 0>& bars, const T (*velocity)[tile_size], const T* grid, T* bar_grid,
                                const std::array<int, 3>& axis, const Box& box, TileSlope<T>& slope) {
    using R = Row<T>;
    RowSlopes<T> d;
    const RowWeights<T> w(bars, d.cross, d.fast);
    alignas(64) T rows[tile_size * 16], sums[tile_size * 16];
    given_rows<T>(bars, axis, rows);
    const std::ptrdiff_t row = 4 * box.count[2], plane = row * box.count[1];
    NineRows<R> r{};
    std::int32_t current = -1;
    for (std::size_t p = 0; p < tile_size; ++p) {
        if (bars.corner[p] != current) {
            current = bars.corner[p];
            r = nine_rows<R>(grid + 4 * static_cast<std::ptrdiff_t>(current), row, plane);
        }
        write(&sums[16 * p], slope_sums<T>(r, &rows[16 * p], w, d, p));
    }
    finish_slope<T>(sums, bars, velocity, axis, slope);
    scatter_given<T>(bars, w, rows, bar_grid, box);
}

}  // namespace mphygs
