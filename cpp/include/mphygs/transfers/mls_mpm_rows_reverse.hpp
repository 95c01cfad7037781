// Adjoints of the row kernels.
//
// Both need d/ds of sum_i w_i R_i . Y_i, R the rows of a grid and Y_i = (q - n s) + n i what a
// particle gives to node i or has as bars there: the nine products e = R Y are summed with the
// weights and with their slopes. To it comes - n^T sum_i w_i R_i, from Y's own s.
#pragma once

#include "mphygs/transfers/mls_mpm_rows.hpp"

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
    alignas(64) T columns[12][tile_size];
    for (std::size_t p = 0; p < tile_size; p += 16) {
        T* to[16] = {};
        for (std::size_t j = 0; j < 12; ++j) {
            to[j] = &columns[j][p];
        }
        transpose_rows<T>(sums + 16 * p, 16, to);
    }
    using W = Wide<T>;
    for (std::size_t p = 0; p < tile_size; p += MlsVector<T>::wide_count) {
        for (std::size_t e = 0; e < 3; ++e) {
            const auto sum = [&](std::size_t j) { return read<W>(&columns[4 * e + j][p]); };
            W total = (sum(0) + sum(1)) + (sum(2) + sum(3));
            for (std::size_t c = 0; c < 3; ++c) {
                total -= read<W>(&given.n[0][3 * c + static_cast<std::size_t>(axis[e])][p]) * read<W>(&value[c][p]);
            }
            write(&slope.by[e][p], total);
        }
    }
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
    R r00{}, r01{}, r02{}, r10{}, r11{}, r12{}, r20{}, r21{}, r22{};
    std::int32_t current = -1;
    constexpr R sign = {-1, -1, -1, -1, 0, 0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 0};
    for (std::size_t p = 0; p < tile_size; ++p) {
        if (given.corner[p] != current) {
            current = given.corner[p];
            const T* a = grid + 4 * static_cast<std::ptrdiff_t>(current);
            const T* b = a + plane;
            const T* c = b + plane;
            r00 = read<R>(a), r01 = read<R>(a + row), r02 = read<R>(a + 2 * row);
            r10 = read<R>(b), r11 = read<R>(b + row), r12 = read<R>(b + 2 * row);
            r20 = read<R>(c), r21 = read<R>(c + row), r22 = read<R>(c + 2 * row);
        }
        const T am = w.slow[0][p], a0 = w.slow[1][p], ap = w.slow[2][p];
        const T bm = w.middle[0][p], b0 = w.middle[1][p], bp = w.middle[2][p];
        const R fast = stretch(read<R>(&w.fast[4 * p]));
        {
            const R m0 = am * r00, m1 = am * r01, m2 = am * r02, p0 = ap * r20, p1 = ap * r21, p2 = ap * r22;
            const R t0 = a0 * r10 + (m0 + p0), t1 = a0 * r11 + (m1 + p1), t2 = a0 * r12 + (m2 + p2);
            const R bm0 = bm * t0, bp2 = bp * t2;
            const R value = (b0 * t1 + (bm0 + bp2)) * fast;
            const R by_middle = (bp2 - bm0) * fast;
            const R by_slow = (bm * (p0 - m0) + (b0 * (p1 - m1) + bp * (p2 - m2))) * fast;
            write(&values[16 * p], sum_nodes(value, by_slow, by_middle, value * sign));
        }
        const R y = read<R>(&rows[16 * p]);
        const R y0 = repeat<0>(y) + repeat<3>(y) * sign, ya = repeat<1>(y), yb = repeat<2>(y);
        const R ym = y0 - ya, yp = y0 + ya;
        const T dm = d.cross[0][0][p], d0 = d.cross[0][1][p], dp = d.cross[0][2][p];
        const R e00 = r00 * (ym - yb), e10 = r10 * (y0 - yb), e20 = r20 * (yp - yb);
        const R t0 = am * e00 + (a0 * e10 + ap * e20), u0 = dm * e00 + (d0 * e10 + dp * e20);
        const R e01 = r01 * ym, e11 = r11 * y0, e21 = r21 * yp;
        const R t1 = am * e01 + (a0 * e11 + ap * e21), u1 = dm * e01 + (d0 * e11 + dp * e21);
        const R e02 = r02 * (ym + yb), e12 = r12 * (y0 + yb), e22 = r22 * (yp + yb);
        const R t2 = am * e02 + (a0 * e12 + ap * e22), u2 = dm * e02 + (d0 * e12 + dp * e22);
        const T em = d.cross[1][0][p], e0 = d.cross[1][1][p], ep = d.cross[1][2][p];
        const R slow = (bm * u0 + (b0 * u1 + bp * u2)) * fast;
        const R middle = (em * t0 + (e0 * t1 + ep * t2)) * fast;
        const R along = (bm * t0 + (b0 * t1 + bp * t2)) * stretch(read<R>(&d.fast[4 * p]));
        write(&sums[16 * p], sum_nodes(slow, middle, along, along));
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
    R r00{}, r01{}, r02{}, r10{}, r11{}, r12{}, r20{}, r21{}, r22{};
    std::int32_t current = -1;
    constexpr R sign = {-1, -1, -1, -1, 0, 0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 0};
    for (std::size_t p = 0; p < tile_size; ++p) {
        if (bars.corner[p] != current) {
            current = bars.corner[p];
            const T* a = grid + 4 * static_cast<std::ptrdiff_t>(current);
            const T* b = a + plane;
            const T* c = b + plane;
            r00 = read<R>(a), r01 = read<R>(a + row), r02 = read<R>(a + 2 * row);
            r10 = read<R>(b), r11 = read<R>(b + row), r12 = read<R>(b + 2 * row);
            r20 = read<R>(c), r21 = read<R>(c + row), r22 = read<R>(c + 2 * row);
        }
        const T am = w.slow[0][p], a0 = w.slow[1][p], ap = w.slow[2][p];
        const T bm = w.middle[0][p], b0 = w.middle[1][p], bp = w.middle[2][p];
        const R y = read<R>(&rows[16 * p]);
        const R y0 = repeat<0>(y) + repeat<3>(y) * sign, ya = repeat<1>(y), yb = repeat<2>(y);
        const R ym = y0 - ya, yp = y0 + ya;
        const T dm = d.cross[0][0][p], d0 = d.cross[0][1][p], dp = d.cross[0][2][p];
        const R e00 = r00 * (ym - yb), e10 = r10 * (y0 - yb), e20 = r20 * (yp - yb);
        const R t0 = am * e00 + (a0 * e10 + ap * e20), u0 = dm * e00 + (d0 * e10 + dp * e20);
        const R e01 = r01 * ym, e11 = r11 * y0, e21 = r21 * yp;
        const R t1 = am * e01 + (a0 * e11 + ap * e21), u1 = dm * e01 + (d0 * e11 + dp * e21);
        const R e02 = r02 * (ym + yb), e12 = r12 * (y0 + yb), e22 = r22 * (yp + yb);
        const R t2 = am * e02 + (a0 * e12 + ap * e22), u2 = dm * e02 + (d0 * e12 + dp * e22);
        const T em = d.cross[1][0][p], e0 = d.cross[1][1][p], ep = d.cross[1][2][p];
        const R fast = stretch(read<R>(&w.fast[4 * p]));
        const R slow = (bm * u0 + (b0 * u1 + bp * u2)) * fast;
        const R middle = (em * t0 + (e0 * t1 + ep * t2)) * fast;
        const R along = (bm * t0 + (b0 * t1 + bp * t2)) * stretch(read<R>(&d.fast[4 * p]));
        write(&sums[16 * p], sum_nodes(slow, middle, along, along));
    }
    finish_slope<T>(sums, bars, velocity, axis, slope);
    scatter_given<T>(bars, w, rows, bar_grid, box);
}

}  // namespace mphygs
