// Particles <-> grid, one particle and node at a time: for any number of directions, and the oracle
// for the row kernels.
#pragma once

#include "mphygs/mls_mpm/tile.hpp"

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
    U s[3];
    SplineWeights<U> w[3];
    for (std::size_t c = 0; c < 3; ++c) {
        for (int l = 0; l <= K; ++l) {
            lane_of(s[c], l) = tile.s[l][c][p];
        }
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
        for (int l = 0; l <= K; ++l) {
            for (int c = 0; c < 3; ++c) {
                tile.q[l][c][p] = lane_of(velocity[c], l);
                for (int j = 0; j < 3; ++j) {
                    tile.n[l][3 * c + j][p] = lane_of(moment[c][j], l);
                }
            }
        }
    }
}

template <class T, int K>
inline void scatter(const MlsTile<T, K>& tile, T* grid, std::size_t lane_stride, const std::array<int, 3>& axis, const Box& box) {
    using U = PlainScalar<T, K>;
    for (std::size_t p = 0; p < tile_size; ++p) {
        U given[13], part[4];
        for (int l = 0; l <= K; ++l) {
            for (std::size_t e = 0; e < 3; ++e) {
                lane_of(given[e], l) = tile.q[l][e][p];
            }
            for (std::size_t e = 0; e < 9; ++e) {
                lane_of(given[3 + e], l) = tile.n[l][e][p];
            }
            lane_of(given[12], l) = tile.mass[l][p];
        }
        each_node<T, K>(tile, p, axis, box, [&](const U& weight, std::size_t node, const Vec3<U>& offset) {
            for (int c = 0; c < 3; ++c) {
                part[c] = weight * (given[c] + given[3 + 3 * c] * offset[0] + given[4 + 3 * c] * offset[1] + given[5 + 3 * c] * offset[2]);
            }
            part[3] = weight * given[12];
            for (int l = 0; l <= K; ++l) {
                for (std::size_t c = 0; c < 4; ++c) {
                    grid[static_cast<std::size_t>(l) * lane_stride + 4 * node + c] += lane_of(part[c], l);
                }
            }
        });
    }
}

}  // namespace mphygs
