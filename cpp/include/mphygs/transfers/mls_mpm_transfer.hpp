// Particles <-> grid, one particle and node at a time: any number of directions, and the oracle
// for the row kernels. Gather, scatter, and below them what their adjoints need.
#pragma once

#include "mphygs/transfers/mls_mpm_tile.hpp"

namespace mphygs {

/// Lane q of a pack scalar.
template <class T, int K>
inline PlainScalar<T, K> pick(const PackScalar<T, K>& s, int q) {
    PlainScalar<T, K> r{};
    for (int l = 0; l <= K; ++l) {
        lane_of(r, l) = lane_of(s, l)[q];
    }
    return r;
}
template <class T, int K>
inline void put(PackScalar<T, K>& s, int q, const PlainScalar<T, K>& value) {
    for (int l = 0; l <= K; ++l) {
        lane_of(s, l)[q] = lane_of(value, l);
    }
}

/// Calls f(weight, node, offsets) for the 27 nodes of particle `p` of a tile; offsets i - s are by
/// coordinate.
template <class T, int K, class F>
inline void each_node(const MlsTile<T, K>& tile, std::size_t p, const std::array<int, 3>& axis, const Box& box, F&& f) {
    using U = PlainScalar<T, K>;
    const int pack = static_cast<int>(p) / lane_count, lane = static_cast<int>(p) % lane_count;
    U s[3];
    SplineWeights<U> w[3];
    for (int c = 0; c < 3; ++c) {
        s[c] = pick<T, K>(tile.s[pack][c], lane);
        w[c] = spline_weights(s[c]);
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            const U row = w[0].value[i] * w[1].value[j];
            for (int k = 0; k < 3; ++k) {
                Vec3<U> offset;
                offset[axis[0]] = T(i - 1) - s[0];
                offset[axis[1]] = T(j - 1) - s[1];
                offset[axis[2]] = T(k - 1) - s[2];
                const std::size_t node =
                    static_cast<std::size_t>(tile.corner[p] + (i * box.count[1] + j) * box.count[2] + k);
                f(row * w[2].value[k], node, offset);
            }
        }
    }
}

/// grid: {vx, vy, vz, m} per node, lanes `lane_stride` numbers apart.
template <class T, int K>
inline void gather(MlsTile<T, K>& tile, const T* grid, std::size_t lane_stride, const std::array<int, 3>& axis, const Box& box) {
    using U = PlainScalar<T, K>;
    for (std::size_t p = 0; p < tile_size; ++p) {
        Vec3<U> velocity;
        Mat3<U> moment;
        each_node<T, K>(tile, p, axis, box, [&](const U& weight, std::size_t node, const Vec3<U>& offset) {
            for (int c = 0; c < 3; ++c) {
                U value{};
                for (int l = 0; l <= K; ++l) {
                    lane_of(value, l) = grid[static_cast<std::size_t>(l) * lane_stride + 4 * node + static_cast<std::size_t>(c)];
                }
                const U part = weight * value;
                velocity[c] += part;
                for (int j = 0; j < 3; ++j) {
                    moment[c][j] += part * offset[j];
                }
            }
        });
        const int pack = static_cast<int>(p) / lane_count, lane = static_cast<int>(p) % lane_count;
        for (int c = 0; c < 3; ++c) {
            put<T, K>(tile.q[pack][c], lane, velocity[c]);
            for (int j = 0; j < 3; ++j) {
                put<T, K>(tile.n[pack][c][j], lane, moment[c][j]);
            }
        }
    }
}

template <class T, int K>
inline void scatter(const MlsTile<T, K>& tile, T* grid, std::size_t lane_stride, const std::array<int, 3>& axis, const Box& box) {
    using U = PlainScalar<T, K>;
    for (std::size_t p = 0; p < tile_size; ++p) {
        const int pack = static_cast<int>(p) / lane_count, lane = static_cast<int>(p) % lane_count;
        U part[4];
        each_node<T, K>(tile, p, axis, box, [&](const U& weight, std::size_t node, const Vec3<U>& offset) {
            for (int c = 0; c < 3; ++c) {
                U sum = pick<T, K>(tile.q[pack][c], lane);
                for (int j = 0; j < 3; ++j) {
                    sum += pick<T, K>(tile.n[pack][c][j], lane) * offset[j];
                }
                part[c] = weight * sum;
            }
            part[3] = weight * pick<T, K>(tile.mass[pack], lane);
            for (int l = 0; l <= K; ++l) {
                for (std::size_t c = 0; c < 4; ++c) {
                    grid[static_cast<std::size_t>(l) * lane_stride + 4 * node + c] += lane_of(part[c], l);
                }
            }
        });
    }
}

/// sum_i w_i m_i of one particle, m the fourth number of a node.
template <class T>
inline T gather_fourth(const MlsTile<T, 0>& tile, std::size_t p, const T* grid, const std::array<int, 3>& axis, const Box& box) {
    T sum{};
    each_node<T, 0>(tile, p, axis, box, [&](T weight, std::size_t node, const Vec3<T>&) { sum += weight * grid[4 * node + 3]; });
    return sum;
}

/// d/ds of sum_i w_i R_i . (q + n (i - s), mass), R the four numbers of a node: by memory axis.
template <class T>
inline Vec3<T> contracted_slope(const MlsTile<T, 0>& tile, std::size_t p, const T* grid, const std::array<int, 3>& axis,
                                const Box& box) {
    // The chain rule by dual numbers: three directions, one per axis.
    using D = Dual<T, 3>;
    const int pack = static_cast<int>(p) / lane_count, lane = static_cast<int>(p) % lane_count;
    D s[3];
    SplineWeights<D> w[3];
    for (int c = 0; c < 3; ++c) {
        s[c] = D(tile.s[pack][c][lane]);
        s[c].d[c] = T(1);
        w[c] = spline_weights(s[c]);
    }
    D total{};
    for (int a = 0; a < 27; ++a) {
        const int i = a / 9, j = (a / 3) % 3, k = a % 3;
        Vec3<D> offset;
        offset[axis[0]] = T(i - 1) - s[0];
        offset[axis[1]] = T(j - 1) - s[1];
        offset[axis[2]] = T(k - 1) - s[2];
        const T* node = grid + 4 * static_cast<std::size_t>(tile.corner[p] + (i * box.count[1] + j) * box.count[2] + k);
        D sum(node[3] * tile.mass[pack][lane]);
        for (int c = 0; c < 3; ++c) {
            D given(tile.q[pack][c][lane]);
            for (int e = 0; e < 3; ++e) {
                given += tile.n[pack][c][e][lane] * offset[e];
            }
            sum += node[c] * given;
        }
        total += w[0].value[i] * w[1].value[j] * w[2].value[k] * sum;
    }
    return {{total.d[0], total.d[1], total.d[2]}};
}

}  // namespace mphygs
