// A tile of particles on the grid: where each one stands, and what passes between it and the nodes.
//
// All in cell units: s is the distance from the nearest node in spacings, by memory axis. What a
// particle gives to node i is w_i (q + n (i - s)), what it takes is q = sum w_i V_i and
// n = sum w_i V_i (i - s)^T, i in {-1, 0, 1}^3. Columns of n are coordinates, not memory axes.
#pragma once

#include <cstring>
#include <type_traits>

#include "mphygs/mls_mpm/state.hpp"
#include "mphygs/numerics/kernel.hpp"

namespace mphygs {

/// Numbers of a tile lie particle by particle, number by number, lane by lane.
template <class T, int K>
struct MlsTile {
    using S = PackScalar<T, K>;
    static constexpr int lanes = K + 1;
    alignas(64) T s[lanes][3][tile_size];  // by memory axis
    alignas(64) T q[lanes][3][tile_size];  // momentum (scatter) or velocity (gather)
    alignas(64) T n[lanes][9][tile_size];  // affine part (scatter) or moment (gather)
    alignas(64) T mass[lanes][tile_size];  // the fourth number of a node
    alignas(64) std::int32_t corner[tile_size];  // first of the 27 nodes in the box

    Vec3<S> get_q(int pack) const {
        Vec3<S> r;
        for (int c = 0; c < 3; ++c) {
            for (int l = 0; l < lanes; ++l) {
                lane_of(r[c], l) = load<T>(&q[l][c][pack * lane_count]);
            }
        }
        return r;
    }
    Mat3<S> get_n(int pack) const {
        Mat3<S> r;
        for (int e = 0; e < 9; ++e) {
            for (int l = 0; l < lanes; ++l) {
                lane_of(r[e / 3][e % 3], l) = load<T>(&n[l][e][pack * lane_count]);
            }
        }
        return r;
    }
    void set_q(int pack, const Vec3<S>& value) {
        for (int c = 0; c < 3; ++c) {
            for (int l = 0; l < lanes; ++l) {
                store<T>(&q[l][c][pack * lane_count], lane_of(value[c], l));
            }
        }
    }
    void set_n(int pack, const Mat3<S>& value) {
        for (int e = 0; e < 9; ++e) {
            for (int l = 0; l < lanes; ++l) {
                store<T>(&n[l][e][pack * lane_count], lane_of(value[e / 3][e % 3], l));
            }
        }
    }
    S get_mass(int pack) const {
        S r{};
        for (int l = 0; l < lanes; ++l) {
            lane_of(r, l) = load<T>(&mass[l][pack * lane_count]);
        }
        return r;
    }
    void set_mass(int pack, const S& value) {
        for (int l = 0; l < lanes; ++l) {
            store<T>(&mass[l][pack * lane_count], lane_of(value, l));
        }
    }
};

/// Nearest whole number; the magic number makes the addition round.
template <class V>
inline V nearest(V x) {
    constexpr typename VectorOf<V>::element magic = sizeof(typename VectorOf<V>::element) == 4 ? 12582912.0 : 6755399441055744.0;
    return (x + magic) - magic;
}

/// Smallest and largest nearest node so far, lane by lane.
template <class V>
struct SeenRange {
    V low[3], high[3];
    SeenRange() {
        for (int c = 0; c < 3; ++c) {
            low[c] = V{} + (1 << 29);
            high[c] = -low[c];
        }
    }
    CellRange range() const {
        CellRange r;
        for (std::size_t c = 0; c < 3; ++c) {
            for (int q = 0; q < VectorOf<V>::count; ++q) {
                r.low[c] = std::min(r.low[c], static_cast<int>(low[c][q]));
                r.high[c] = std::max(r.high[c], static_cast<int>(high[c][q]));
            }
        }
        return r;
    }
};

/// Stands the particles of one vector, from `at` on, on a box. x: by memory axis, in spacings.
/// Returns a mask of those that are not finite or outside the limits (nearest nodes by memory
/// axis); such a particle is put inside, so that memory is safe.
template <class V, class T>
inline typename VectorOf<V>::mask stand(const V (&x)[3], int at, T (*s)[tile_size], std::int32_t* corners, const Box& box,
                                        const CellRange& limits, SeenRange<V>& seen) {
    using M = typename VectorOf<V>::mask;
    M corner{}, bad{};
    for (std::size_t c = 0; c < 3; ++c) {
        const V wanted = nearest(x[c]);
        const V low = V{} + static_cast<T>(limits.low[c]);
        const V high = V{} + static_cast<T>(limits.high[c]);
        const V above = choose(wanted >= low, wanted, low);  // low for what is no number
        const V node = choose(above <= high, above, high);
        bad |= ~(node == wanted);
        const V distance = x[c] - node;
        write(&s[c][at], distance);
        seen.low[c] = choose(seen.low[c] < node, seen.low[c], node);
        seen.high[c] = choose(seen.high[c] > node, seen.high[c], node);
        corner = corner * box.count[c] + (convert<M>(node) - 1 - box.low[c]);
    }
    write(corners + at, convert<Vector<std::int32_t, VectorOf<V>::count>>(corner));
    return bad;
}

/// The same for a pack, with its directions.
template <class T, int K>
inline PackMask<T> locate(MlsTile<T, K>& tile, int pack, const Vec3<PackScalar<T, K>>& x, T inverse_spacing,
                          const std::array<int, 3>& axis, const Box& box, const CellRange& limits, SeenRange<Pack<T>>& seen) {
    const int at = pack * lane_count;
    Pack<T> scaled[3];
    for (std::size_t c = 0; c < 3; ++c) {
        scaled[c] = lane_of(x[axis[c]], 0) * inverse_spacing;
        for (int l = 1; l <= K; ++l) {
            store<T>(&tile.s[l][c][at], lane_of(x[axis[c]], l) * inverse_spacing);
        }
    }
    return stand<Pack<T>, T>(scaled, at, tile.s[0], tile.corner, box, limits, seen);
}
template <class M>
inline bool any(const M& mask) {
    M none{};
    return std::memcmp(&mask, &none, sizeof mask) != 0;
}

}  // namespace mphygs
