// The sums over nodes and points of `spline_tables.hpp` with directions in the lanes.
//
// A node's numbers for as many directions as a register holds stand side by side, so that a weight is one number for all
// of them: no lane is shuffled, and the eight points of a block read each node once.
#pragma once

#include <utility>

#include "mphygs/total_lagrangian/spline_tables.hpp"

namespace mphygs {

/// Numbers that a register of the processor holds.
template <class T>
inline constexpr int register_lanes = static_cast<int>(register_bytes / sizeof(T));

/// Sums that stay in registers at a time; their inputs need some as well.
inline constexpr std::size_t sums_at_once = register_bytes == 64 ? 24 : 12;
/// Numbers of a block's eight points along three axes.
inline constexpr std::size_t point_axes = 3 * lane_count;

namespace detail {

template <class W, class T, std::size_t... i>
[[gnu::always_inline]] inline void point_sums(const W* field, const Rows& rows, const T* weight, W* to, std::index_sequence<i...>) {
    W sum[sizeof...(i)] = {};
    for (int r = 0; r < row_count_27; ++r) {
        const W* node = field + 3 * rows[r];
#pragma GCC unroll 3
        for (int k = 0; k < 3; ++k, node += 3, weight += point_axes) {
            const W value = *node;
            ((sum[i] += weight[i] * value), ...);
        }
    }
    ((to[i] = sum[i]), ...);
}

template <class W, class T, std::size_t... i>
[[gnu::always_inline]] inline void node_sums(const W* from, const Rows& rows, const T* weight, W* field, std::index_sequence<i...>) {
    const W point[sizeof...(i)] = {from[i]...};
    for (int r = 0; r < row_count_27; ++r) {
        W* node = field + 3 * rows[r];
#pragma GCC unroll 3
        for (int k = 0; k < 3; ++k, node += 3, weight += point_axes) {
            W sum[2] = {};
            ((sum[i % 2] += weight[i] * point[i]), ...);
            *node += sum[0] + sum[1];
        }
    }
}

template <class W, class T, std::size_t... q>
[[gnu::always_inline]] inline void point_values(const W* field, const Rows& rows, const T* weight, Vec3<W>* to,
                                                std::index_sequence<q...>) {
    W x[sizeof...(q)] = {}, y[sizeof...(q)] = {}, z[sizeof...(q)] = {};
    for (int r = 0; r < row_count_27; ++r) {
        const W* node = field + 3 * rows[r];
#pragma GCC unroll 3
        for (int k = 0; k < 3; ++k, node += 3, weight += lane_count) {
            const W at[3] = {node[0], node[1], node[2]};
            ((x[q] += weight[q] * at[0], y[q] += weight[q] * at[1], z[q] += weight[q] * at[2]), ...);
        }
    }
    ((to[q] = {{x[q], y[q], z[q]}}), ...);
}

template <class W, class T, std::size_t... q>
[[gnu::always_inline]] inline void node_values(const Vec3<W>* from, const Rows& rows, const T* weight, W* field,
                                               std::index_sequence<q...>) {
    const W x[sizeof...(q)] = {from[q][0]...}, y[sizeof...(q)] = {from[q][1]...}, z[sizeof...(q)] = {from[q][2]...};
    for (int r = 0; r < row_count_27; ++r) {
        W* node = field + 3 * rows[r];
#pragma GCC unroll 3
        for (int k = 0; k < 3; ++k, node += 3, weight += lane_count) {
            W sum[3] = {};
            ((sum[0] += weight[q] * x[q], sum[1] += weight[q] * y[q], sum[2] += weight[q] * z[q]), ...);
            node[0] += sum[0];
            node[1] += sum[1];
            node[2] += sum[2];
        }
    }
}

}  // namespace detail

/// Gradients at the eight points of a field of all directions in W: to[c][j * 8 + q] = d u_c / d X_j at point q.
/// field: (N, 3) of W.
template <class W, class T>
inline void gather_directions(const W* field, const Rows& rows, const GradientTable<T>& table, W (&to)[3][point_axes]) {
    const T* weight = reinterpret_cast<const T*>(table.by_node);
    constexpr auto each = std::make_index_sequence<sums_at_once>{};
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t first = 0; first < point_axes; first += sums_at_once) {
            detail::point_sums<W, T>(field + c, rows, weight + first, &to[c][first], each);
        }
    }
}

/// f_a += sum over the points of stress (dN_a/dX), stress as `gather_directions` leaves gradients.
template <class W, class T>
inline void scatter_directions(const W (&stress)[3][point_axes], W* field, const Rows& rows, const GradientTable<T>& table) {
    const T* weight = reinterpret_cast<const T*>(table.by_node);
    constexpr auto each = std::make_index_sequence<sums_at_once>{};
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t first = 0; first < point_axes; first += sums_at_once) {
            detail::node_sums<W, T>(&stress[c][first], rows, weight + first, field + c, each);
        }
    }
}

/// Points whose values stay in registers at a time.
inline constexpr std::size_t points_at_once = sums_at_once / 3;

/// Values at the eight points: to[q].
template <class W, class T>
inline void gather_direction_values(const W* field, const Rows& rows, const ValueTable<T>& table, Vec3<W> (&to)[lane_count]) {
    const T* weight = reinterpret_cast<const T*>(table.by_node);
    for (std::size_t first = 0; first < lane_count; first += points_at_once) {
        detail::point_values<W, T>(field, rows, weight + first, to + first, std::make_index_sequence<points_at_once>{});
    }
}

/// f_a += sum over the points of force N_a.
template <class W, class T>
inline void scatter_direction_values(const Vec3<W> (&force)[lane_count], W* field, const Rows& rows, const ValueTable<T>& table) {
    const T* weight = reinterpret_cast<const T*>(table.by_node);
    for (std::size_t first = 0; first < lane_count; first += points_at_once) {
        detail::node_values<W, T>(force + first, rows, weight + first, field, std::make_index_sequence<points_at_once>{});
    }
}

}  // namespace mphygs
