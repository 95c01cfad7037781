// The hot path: neo-Hookean particles under gravity alone, a register of particles at a time.
//
// tau = mu (F F^T - I) + lambda ln J I, from H = F - I.
// The same sums as MlsForces; the tests compare the two.
#pragma once

#include "mphygs/mls_mpm/rows.hpp"

namespace mphygs {

/// ln (1 + x) to the last digits of x: what the rounding of 1 + x took comes back.
template <class W>
inline W wide_logarithm_of_one_plus(W x) {
    using T = typename VectorOf<W>::element;
    const W sum = x + T(1);
    return logarithm(sum) + (x - (sum - T(1)));
}

/// det (I + H) - 1.
template <class W>
inline W wide_expansion(const W (&h)[3][3]) {
    const W c0 = h[1][1] * h[2][2] - h[1][2] * h[2][1], c1 = h[1][2] * h[2][0] - h[1][0] * h[2][2];
    const W c2 = h[1][0] * h[2][1] - h[1][1] * h[2][0];
    const W minors = c0 + (h[0][0] * h[1][1] - h[0][1] * h[1][0]) + (h[0][0] * h[2][2] - h[0][2] * h[2][0]);
    return (h[0][0] + h[1][1] + h[2][2]) + (minors + (h[0][0] * c0 + h[0][1] * c1 + h[0][2] * c2));
}

/// Adds -mu (H + H^T + H H^T) - pressure I to the affine momentum m M.
template <class T, class W>
inline void give_affine(MlsTile<T, 0>& tile, std::size_t k, const W (&m)[3][3], const W (&h)[3][3], W inertia, W mu, W pressure) {
    for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = a; b < 3; ++b) {
            W tau = mu * ((h[a][b] + h[b][a]) + (h[a][0] * h[b][0] + h[a][1] * h[b][1] + h[a][2] * h[b][2]));
            if (a == b) {
                tau += pressure;
            }
            write(&tile.n[0][3 * a + b][k], inertia * m[a][b] - tau);
            if (a != b) {
                write(&tile.n[0][3 * b + a][k], inertia * m[b][a] - tau);
            }
        }
    }
}

/// What every particle of a chunk shares in one pass.
template <class T>
struct PlainPass {
    std::size_t size;
    T inverse_spacing;
    T dt;          // of the motion
    bool forces;   // whether a scatter follows
    T next_dt;     // of the forces
    T gravity[3];
};

/// Moves and strains the tile's particles by what was gathered, and fills it with what they give.
/// from, to: u and F - I of all particles before and after, the same or not; velocity: (3, size) at
/// output frames, else null. Returns the first that left the limits, -1: none.
template <class T>
inline long plain_tile(MlsTile<T, 0>& tile, std::size_t first, const PlainPass<T>& pass, const T* from, T* to, T* velocity,
                       const MlsOrder<T>& order, const std::array<int, 3>& axis, const Box& box, const CellRange& limits, SeenRange<Wide<T>>& seen) {
    using W = Wide<T>;
    long failed = -1;
    const T strain = T(4) * pass.inverse_spacing * pass.dt;  // C dt from the moment
    const T stress = T(4) * pass.inverse_spacing * pass.next_dt;
    for (std::size_t k = 0; k < tile_size; k += MlsVector<T>::wide_count) {
        const std::size_t p = first + k;
        const T* moving = from + slot_of(0, moving_numbers, p);
        T* moved = to + slot_of(0, moving_numbers, p);
        const T* fixed = &order.fixed[slot_of(0, fixed_numbers, p)];
        const T* rest = &order.rest[slot_of(0, rest_numbers, p)];
        W v[3], m[3][3], f[3][3], scaled[3], x[3];
        for (std::size_t c = 0; c < 3; ++c) {
            v[c] = read<W>(&tile.q[0][c][k]);
            const W u = read<W>(moving + group_size * c) + pass.dt * v[c];
            write(moved + group_size * c, u);
            x[c] = read<W>(rest + group_size * c) + u;
            if (velocity) {
                write(&velocity[c * pass.size + p], v[c]);
            }
            for (std::size_t j = 0; j < 3; ++j) {
                m[c][j] = read<W>(&tile.n[0][3 * c + j][k]);
                f[c][j] = read<W>(moving + group_size * (3 + 3 * c + j));
            }
        }
        W g[3][3];
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) {
                g[i][j] = f[i][j] + strain * (m[i][j] + (m[i][0] * f[0][j] + m[i][1] * f[1][j] + m[i][2] * f[2][j]));
                write(moved + group_size * (3 + 3 * i + j), g[i][j]);
            }
            scaled[i] = x[axis[i]] * pass.inverse_spacing;
        }
        const auto bad = stand<W, T>(scaled, static_cast<int>(k), tile.s[0], tile.corner, box, limits, seen);
        if (any(bad) && failed < 0) {
            int q = 0;
            while (bad[q] == 0) {
                ++q;
            }
            failed = static_cast<long>(p) + q;
        }
        if (!pass.forces) {
            continue;
        }
        const W scale = stress * read<W>(fixed + group_size * fixed_volume);
        const W mu = scale * read<W>(fixed + group_size * fixed_mu);
        const W pressure = scale * read<W>(fixed + group_size * fixed_lambda) * wide_logarithm_of_one_plus(wide_expansion(g));
        const W mass = read<W>(fixed + group_size * fixed_mass);
        const W inertia = T(4) * mass;
        give_affine<T>(tile, k, m, g, inertia, mu, pressure);
        for (std::size_t a = 0; a < 3; ++a) {
            write(&tile.q[0][a][k], mass * (v[a] + pass.next_dt * pass.gravity[a]));
        }
        write(&tile.mass[0][k], mass);
    }
    return failed;
}

}  // namespace mphygs
