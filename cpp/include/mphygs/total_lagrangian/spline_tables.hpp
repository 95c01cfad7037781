// Constant weights of a block of eight points that share one cell, and the two loops on them.
//
// `gather` sums over the 27 nodes with the eight points in the lanes; `scatter` sums over the
// eight points with the nodes in the lanes. The three nodes of a row along z are neighbours in
// every node array, so a block is nine rows; a scattered row is four lanes wide, its last one zero.
#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>

#include "mphygs/numerics/kernel.hpp"
#include "mphygs/total_lagrangian/spline_factors.hpp"

namespace mphygs {

inline constexpr int node_lanes = 40;  // 9 rows of 4, padded to whole packs

/// Four numbers: a row of three nodes and one lane of nothing.
template <class T>
using FourNodes = Vector<T, 4>;

template <class T>
struct ValueTable {
    Pack<T> by_node[27];                     // N_a at the eight points
    alignas(64) T by_point[8][node_lanes];   // N_a of one point, nodes in the lanes
};

/// What each node is given of the eight points' masses.
template <class T>
struct MassTable {
    Pack<T> by_node[27];
};

template <class T>
struct GradientTable {
    bool common = true;                          // several blocks share it: it stays in the cache
    SplineFactors<T> factors;                    // read instead where it does not
    Pack<T> by_node[27][3];                      // dN_a/dx_j at the eight points [1/m]
    alignas(64) T by_point[8][3][node_lanes];
};

/// Spline weights of a point given by its distance from the cell's node, in spacings.
inline void point_weights(const double s[3], const double spacing[3], double value[27], double gradient[27][3]) {
    const SplineWeights<double> w[3] = {spline_weights(s[0]), spline_weights(s[1]), spline_weights(s[2])};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            for (int k = 0; k < 3; ++k) {
                const int a = (i * 3 + j) * 3 + k;
                value[a] = w[0].value[i] * w[1].value[j] * w[2].value[k];
                gradient[a][0] = w[0].slope[i] * w[1].value[j] * w[2].value[k] / spacing[0];
                gradient[a][1] = w[0].value[i] * w[1].slope[j] * w[2].value[k] / spacing[1];
                gradient[a][2] = w[0].value[i] * w[1].value[j] * w[2].slope[k] / spacing[2];
            }
        }
    }
}

/// Point q of a block: N_a and dN_a/dX there.
template <class T>
inline void set_point(int q, const double (&n)[27], const double (&dn)[27][3], GradientTable<T>& gradient, ValueTable<T>& value) {
    for (int a = 0; a < 27; ++a) {
        value.by_node[a][q] = static_cast<T>(n[a]);
        value.by_point[q][a / 3 * 4 + a % 3] = static_cast<T>(n[a]);
        for (int j = 0; j < 3; ++j) {
            gradient.by_node[a][j][q] = static_cast<T>(dn[a][j]);
            gradient.by_point[q][j][a / 3 * 4 + a % 3] = static_cast<T>(dn[a][j]);
        }
    }
}

/// The same on a lattice, the point given as in `point_weights`.
template <class T>
inline void set_point(int q, const double s[3], const double spacing[3], GradientTable<T>& gradient, ValueTable<T>& value) {
    double n[27], dn[27][3];
    point_weights(s, spacing, n, dn);
    for (int c = 0; c < 3; ++c) {
        const SplineWeights<double> w = spline_weights(s[c]);
        for (int k = 0; k < 3; ++k) {
            gradient.factors.value[c][k][q] = static_cast<T>(w.value[k]);
            gradient.factors.slope[c][k][q] = static_cast<T>(w.slope[k] / spacing[c]);
        }
    }
    set_point(q, n, dn, gradient, value);
}

template <class T>
inline int node_of(const Rows& rows, int a) {
    return rows[a / 3] + a % 3;
}

/// sum_a f_a (dN_a/dx)^T. at: reads a number of the field, wide: makes a weight, as lanes of W.
template <class W, class T, class At, class Wide>
inline Mat3<W> gradient_sums(const T* field, std::size_t stride, const Rows& rows, const GradientTable<T>& table, const At& at,
                             const Wide& wide) {
    if (!table.common) {
        return factored_gradient_sums<W>(field, stride, rows, table.factors, at, wide);
    }
    // Named sums: g++ 12 leaves an indexed local array in memory inside a loop.
    W xx{}, xy{}, xz{}, yx{}, yy{}, yz{}, zx{}, zy{}, zz{};
    const T* x = field;
    const T* y = field + stride;
    const T* z = field + 2 * stride;
    const Pack<T>(*w)[3] = table.by_node;
    for (int r = 0; r < row_count_27; ++r) {
        for (int k = 0; k < 3; ++k, ++w) {
            const int n = rows[r] + k;
            const W wx = wide((*w)[0]), wy = wide((*w)[1]), wz = wide((*w)[2]);
            const auto a = at(x + n), b = at(y + n), c = at(z + n);
            xx += a * wx;
            xy += a * wy;
            xz += a * wz;
            yx += b * wx;
            yy += b * wy;
            yz += b * wz;
            zx += c * wx;
            zy += c * wy;
            zz += c * wz;
        }
    }
    return {{{xx, xy, xz}, {yx, yy, yz}, {zx, zy, zz}}};
}

/// sum_a f_a N_a, as `gradient_sums`.
template <class W, class T, class At, class Wide>
inline Vec3<W> value_sums(const T* field, std::size_t stride, const Rows& rows, const ValueTable<T>& table, const At& at,
                          const Wide& wide) {
    W x{}, y{}, z{};
    for (int r = 0; r < row_count_27; ++r) {
        for (int k = 0; k < 3; ++k) {
            const T* node = field + rows[r] + k;
            const W w = wide(table.by_node[r * 3 + k]);
            x += at(node) * w;
            y += at(node + stride) * w;
            z += at(node + 2 * stride) * w;
        }
    }
    return {{x, y, z}};
}

/// Gradient of a field at the eight points. field: 3 arrays of `stride` numbers.
template <class T>
inline Mat3<Pack<T>> gather_gradient(const T* field, std::size_t stride, const Rows& rows, const GradientTable<T>& table) {
    return gradient_sums<Pack<T>>(field, stride, rows, table, [](const T* p) { return *p; }, [](const Pack<T>& w) { return w; });
}
/// Value of a field at the eight points.
template <class T>
inline Vec3<Pack<T>> gather_value(const T* field, std::size_t stride, const Rows& rows, const ValueTable<T>& table) {
    return value_sums<Pack<T>>(field, stride, rows, table, [](const T* p) { return *p; }, [](const Pack<T>& w) { return w; });
}
/// Adds to the three nodes of a row, the last lane left out: lines of nodes are short, and a row of four read just after
/// its neighbour was written across its first node waits until that has left the processor's store buffer.
template <class T>
[[gnu::always_inline]] inline void add_row(T* row, const FourNodes<T>& by) {
    using Two = Vector<T, 2>;
    const Two first{by[0], by[1]};
    write(row, read<Two>(row) + first);
    row[2] += by[2];
}

/// Adds nine rows of four to the rows of a component.
template <class T>
inline void add_rows(const T* flat, T* component, const Rows& rows) {
    for (int r = 0; r < row_count_27; ++r) {
        add_row<T>(component + rows[r], read<FourNodes<T>>(flat + 4 * r));
    }
}
template <class T>
inline void add_rows(const Pack<T> (&sums)[5], T* component, const Rows& rows) {
    alignas(64) T flat[node_lanes];
    std::memcpy(flat, sums, sizeof flat);
    add_rows<T>(flat, component, rows);
}

/// Sums of nine rows: four in a register, four in the next, and the last one.
struct RowSums {
    PackPair first{}, second{};
    FourNodes<float> last{};
    void add(float factor, const PackPair& w0, const PackPair& w1, const FourNodes<float>& w2) {
        first += factor * w0;
        second += factor * w1;
        last += factor * w2;
    }
    void to(float* component, const Rows& rows) const {
        alignas(64) float flat[36];
        std::memcpy(flat, &first, sizeof first);
        std::memcpy(flat + 16, &second, sizeof second);
        std::memcpy(flat + 32, &last, sizeof last);
        add_rows<float>(flat, component, rows);
    }
};

/// As `scatter_gradient`, where the table is no other block's.
template <class T>
inline void scatter_gradient_factored(const Mat3<Pack<T>>& stress, T* field, std::size_t stride, const Rows& rows,
                                      const GradientTable<T>& table) {
    for (std::size_t c = 0; c < 3; ++c) {
        Pack<T> sums[5];
        factored_rows<Pack<T>>(stress.e[c], table.factors, [](const Pack<T>& w) { return w; }, sums);
        add_rows<T>(sums, field + c * stride, rows);
    }
}

inline void scatter_gradient_rows(const float (&p)[3][3][8], float* field, std::size_t stride, const Rows& rows,
                                  const GradientTable<float>& table) {
    RowSums x, y, z;
    for (int q = 0; q < 8; ++q) {
        for (int j = 0; j < 3; ++j) {
            const float* w = table.by_point[q][j];
            const PackPair w0 = load_pair(w), w1 = load_pair(w + 16);
            FourNodes<float> w2;
            std::memcpy(&w2, w + 32, sizeof w2);
            x.add(p[0][j][q], w0, w1, w2);
            y.add(p[1][j][q], w0, w1, w2);
            z.add(p[2][j][q], w0, w1, w2);
        }
    }
    x.to(field, rows);
    y.to(field + stride, rows);
    z.to(field + 2 * stride, rows);
}

/// f_a += sum over the points of stress (dN_a/dx).
template <class T>
inline void scatter_gradient(const Mat3<Pack<T>>& stress, T* field, std::size_t stride, const Rows& rows,
                             const GradientTable<T>& table) {
    if (!table.common) {
        scatter_gradient_factored<T>(stress, field, stride, rows, table);
        return;
    }
    alignas(64) T p[3][3][8];
    std::memcpy(p, stress.e, sizeof p);
    if constexpr (std::is_same_v<T, float>) {
        scatter_gradient_rows(p, field, stride, rows, table);
        return;
    }
    // Fifteen sums at once hide the latency of the multiply-add.
    Pack<T> x0{}, x1{}, x2{}, x3{}, x4{}, y0{}, y1{}, y2{}, y3{}, y4{}, z0{}, z1{}, z2{}, z3{}, z4{};
    for (int q = 0; q < 8; ++q) {
        for (int j = 0; j < 3; ++j) {
            const T* w = table.by_point[q][j];
            const Pack<T> w0 = load<T>(w), w1 = load<T>(w + 8), w2 = load<T>(w + 16), w3 = load<T>(w + 24), w4 = load<T>(w + 32);
            const T a = p[0][j][q], b = p[1][j][q], c = p[2][j][q];
            x0 += a * w0;
            x1 += a * w1;
            x2 += a * w2;
            x3 += a * w3;
            x4 += a * w4;
            y0 += b * w0;
            y1 += b * w1;
            y2 += b * w2;
            y3 += b * w3;
            y4 += b * w4;
            z0 += c * w0;
            z1 += c * w1;
            z2 += c * w2;
            z3 += c * w3;
            z4 += c * w4;
        }
    }
    const Pack<T> x[5] = {x0, x1, x2, x3, x4}, y[5] = {y0, y1, y2, y3, y4}, z[5] = {z0, z1, z2, z3, z4};
    add_rows<T>(x, field, rows);
    add_rows<T>(y, field + stride, rows);
    add_rows<T>(z, field + 2 * stride, rows);
}

/// f_a += sum over the points of force N_a.
template <class T>
inline void scatter_value(const Vec3<Pack<T>>& force, T* field, std::size_t stride, const Rows& rows,
                          const ValueTable<T>& table) {
    for (int c = 0; c < 3; ++c) {
        Pack<T> sums[5] = {};
        for (int q = 0; q < 8; ++q) {
            const T value = force.e[c][q];
            for (int n = 0; n < 5; ++n) {
                sums[n] += value * load<T>(table.by_point[q] + 8 * n);
            }
        }
        add_rows<T>(sums, field + static_cast<std::size_t>(c) * stride, rows);
    }
}

}  // namespace mphygs
