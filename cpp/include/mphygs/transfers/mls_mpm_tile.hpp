// A tile of particles on the grid: where each one stands, and what passes between it and the nodes.
//
// All in cell units: s is the distance from the nearest node in spacings, by memory axis. What a
// particle gives to node i is w_i (q + n (i - s)), what it takes is v = sum w_i V_i and
// m = sum w_i V_i (i - s)^T, i in {-1, 0, 1}^3. Columns of n and m are coordinates, not memory axes.
#pragma once

#include "mphygs/kernel.hpp"
#include "mphygs/transfers/mls_mpm_state.hpp"

namespace mphygs {

template <class T, int K>
struct MlsTile {
    using S = PackScalar<T, K>;
    Vec3<S> s[tile_packs];             // by memory axis
    std::int32_t corner[tile_size];    // first of the 27 nodes in the box
    Vec3<S> q[tile_packs];             // momentum (scatter) or velocity (gather)
    Mat3<S> n[tile_packs];             // affine part (scatter) or moment (gather)
    S mass[tile_packs];
};

/// Nearest whole number; the magic number makes the addition round.
inline Pack<float> nearest(Pack<float> x) { return (x + 12582912.0f) - 12582912.0f; }
inline Pack<double> nearest(Pack<double> x) { return (x + 6755399441055744.0) - 6755399441055744.0; }

/// Stands a pack of particles on a box. Returns false where one is not finite or outside the
/// limits (nearest nodes by memory axis); such a particle is put inside, so that memory is safe.
template <class T, int K>
inline bool locate(MlsTile<T, K>& tile, int pack, const Vec3<PackScalar<T, K>>& x, T inverse_spacing,
                   const std::array<int, 3>& axis, const Box& box, const CellRange& limits, CellRange& seen) {
    using M = PackMask<T>;
    M corner{}, bad{};
    for (std::size_t c = 0; c < 3; ++c) {
        const PackScalar<T, K>& coordinate = x[axis[c]];
        const Pack<T> scaled = lane_of(coordinate, 0) * inverse_spacing;
        const Pack<T> wanted = nearest(scaled);
        const Pack<T> low = broadcast<T>(static_cast<T>(limits.low[c]));
        const Pack<T> high = broadcast<T>(static_cast<T>(limits.high[c]));
        const Pack<T> node = wanted >= low ? (wanted <= high ? wanted : high) : low;  // low for what is no number
        bad |= ~(node == wanted);
        for (int l = 1; l <= K; ++l) {
            lane_of(tile.s[pack][static_cast<int>(c)], l) = lane_of(coordinate, l) * inverse_spacing;
        }
        lane_of(tile.s[pack][static_cast<int>(c)], 0) = scaled - node;
        const M index = __builtin_convertvector(node, M);
        for (int i = 0; i < lane_count; ++i) {
            seen.low[c] = std::min(seen.low[c], static_cast<int>(index[i]));
            seen.high[c] = std::max(seen.high[c], static_cast<int>(index[i]));
        }
        corner = corner * box.count[c] + (index - 1 - box.low[c]);
    }
    bool good = true;
    for (int i = 0; i < lane_count; ++i) {
        tile.corner[pack * lane_count + i] = static_cast<std::int32_t>(corner[i]);
        good &= bad[i] == 0;
    }
    return good;
}

}  // namespace mphygs
