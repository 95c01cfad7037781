// The hot path: neo-Hookean particles under gravity alone, a register of particles at a time.
//
// tau = mu (F F^T - I) + lambda ln J I. The same sums as MlsForces; the tests compare the two.
#pragma once

#include "mphygs/transfers/mls_mpm_rows.hpp"

namespace mphygs {

/// ln x lane by lane, by packs of eight.
inline Wide<double> wide_logarithm(Wide<double> x) { return logarithm(x); }
inline Wide<float> wide_logarithm(Wide<float> x) {
    Pack<float> half[2];
    std::memcpy(half, &x, sizeof x);
    half[0] = logarithm(half[0]);
    half[1] = logarithm(half[1]);
    std::memcpy(&x, half, sizeof x);
    return x;
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
/// from, to: x and F of all particles before and after, the same or not; velocity: (3, size) at
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
        W v[3], m[3][3], f[3][3], scaled[3], x[3];
        for (std::size_t c = 0; c < 3; ++c) {
            v[c] = read<W>(&tile.q[0][c][k]);
            x[c] = read<W>(moving + group_size * c) + pass.dt * v[c];
            write(moved + group_size * c, x[c]);
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
                g[i][j] = f[i][j] + strain * (m[i][0] * f[0][j] + m[i][1] * f[1][j] + m[i][2] * f[2][j]);
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
        const W j = g[0][0] * (g[1][1] * g[2][2] - g[1][2] * g[2][1]) + g[0][1] * (g[1][2] * g[2][0] - g[1][0] * g[2][2]) +
                    g[0][2] * (g[1][0] * g[2][1] - g[1][1] * g[2][0]);
        const W scale = stress * read<W>(fixed + group_size * fixed_volume);
        const W mu = scale * read<W>(fixed + group_size * fixed_mu);
        const W pressure = scale * read<W>(fixed + group_size * fixed_lambda) * wide_logarithm(j) - mu;
        const W mass = read<W>(fixed + group_size * fixed_mass);
        const W inertia = T(4) * mass;
        for (std::size_t a = 0; a < 3; ++a) {
            for (std::size_t b = 0; b < 3; ++b) {
                W tau = mu * (g[a][0] * g[b][0] + g[a][1] * g[b][1] + g[a][2] * g[b][2]);
                if (a == b) {
                    tau += pressure;
                }
                write(&tile.n[0][3 * a + b][k], inertia * m[a][b] - tau);
            }
            write(&tile.q[0][a][k], mass * (v[a] + pass.next_dt * pass.gravity[a]));
        }
        write(&tile.mass[0][k], mass);
    }
    return failed;
}

}  // namespace mphygs
