// Adjoint of the hot path: the steps of plain.hpp backwards, a register of particles at a time.
#pragma once

#include "mphygs/mls_mpm/plain.hpp"
#include "mphygs/mls_mpm/rows_reverse.hpp"

namespace mphygs {

/// What one tile keeps between gathering, giving and their adjoints.
template <class T>
struct PlainTile {
    MlsTile<T, 0> took;   // stood at n: v and the moment M, later their bars
    MlsTile<T, 0> given;  // stood at n + 1: what the particles gave
    MlsTile<T, 0> bars;   // of what they gave
    TileSlope<T> slope;
    alignas(64) T velocity[3][tile_size];
    alignas(64) T strained[9][tile_size];  // F - I at n + 1
    alignas(64) T logarithm[tile_size];    // of det F
};

/// Particles at n + 1 and what they gave there. before: their u and F - I at n.
template <class T>
inline void plain_given(PlainTile<T>& tile, const T* before, std::size_t first, const PlainPass<T>& pass, const MlsOrder<T>& order,
                        const std::array<int, 3>& axis, const Box& box, const CellRange& limits) {
    using W = Wide<T>;
    SeenRange<W> ignored;
    const T strain = T(4) * pass.inverse_spacing * pass.dt;
    const T stress = T(4) * pass.inverse_spacing * pass.next_dt;
    for (std::size_t k = 0; k < tile_size; k += MlsVector<T>::wide_count) {
        const T* moving = before + slot_of(0, moving_numbers, first + k);
        const T* fixed = &order.fixed[slot_of(0, fixed_numbers, first + k)];
        const T* rest = &order.rest[slot_of(0, rest_numbers, first + k)];
        W v[3], m[3][3], f[3][3], g[3][3], scaled[3];
        for (std::size_t c = 0; c < 3; ++c) {
            v[c] = read<W>(&tile.took.q[0][c][k]);
            write(&tile.velocity[c][k], v[c]);
            for (std::size_t j = 0; j < 3; ++j) {
                m[c][j] = read<W>(&tile.took.n[0][3 * c + j][k]);
                f[c][j] = read<W>(moving + group_size * (3 + 3 * c + j));
            }
        }
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) {
                g[i][j] = f[i][j] + strain * (m[i][j] + (m[i][0] * f[0][j] + m[i][1] * f[1][j] + m[i][2] * f[2][j]));
                write(&tile.strained[3 * i + j][k], g[i][j]);
            }
            const std::size_t a = static_cast<std::size_t>(axis[i]);
            scaled[i] = (read<W>(rest + group_size * a) + (read<W>(moving + group_size * a) + pass.dt * v[a])) * pass.inverse_spacing;
        }
        stand<W, T>(scaled, static_cast<int>(k), tile.given.s[0], tile.given.corner, box, limits, ignored);
        const W log_j = wide_logarithm_of_one_plus(wide_expansion(g));
        write(&tile.logarithm[k], log_j);
        const W scale = stress * read<W>(fixed + group_size * fixed_volume);
        const W mu = scale * read<W>(fixed + group_size * fixed_mu);
        const W pressure = scale * read<W>(fixed + group_size * fixed_lambda) * log_j;
        const W mass = read<W>(fixed + group_size * fixed_mass);
        const W inertia = T(4) * mass;
        give_affine<T>(tile.given, k, m, g, inertia, mu, pressure);
        for (std::size_t a = 0; a < 3; ++a) {
            write(&tile.given.q[0][a][k], mass * (v[a] + pass.next_dt * pass.gravity[a]));
        }
        write(&tile.given.mass[0][k], mass);
    }
}

/// From the bars of what was given to those of what was taken, of F at n, and of the fixed numbers.
/// bars: of x and F, at n + 1 before and at n after, but for the slope of what was taken.
template <class T>
inline void plain_bars(PlainTile<T>& tile, const T* before, T* bars, T* fixed_bars, std::size_t first, const PlainPass<T>& pass,
                       const MlsOrder<T>& order, const std::array<int, 3>& axis, Wide<T> (&gravity_bar)[3]) {
    using W = Wide<T>;
    const T strain = T(4) * pass.inverse_spacing * pass.dt;
    const T stress = T(4) * pass.inverse_spacing * pass.next_dt;
    for (std::size_t k = 0; k < tile_size; k += MlsVector<T>::wide_count) {
        const T* moving = before + slot_of(0, moving_numbers, first + k);
        const T* fixed = &order.fixed[slot_of(0, fixed_numbers, first + k)];
        T* bar = bars + slot_of(0, moving_numbers, first + k);
        T* sums = fixed_bars + slot_of(0, fixed_numbers, first + k);
        const W mass = read<W>(fixed + group_size * fixed_mass), mu = read<W>(fixed + group_size * fixed_mu);
        const W lambda = read<W>(fixed + group_size * fixed_lambda), log_j = read<W>(&tile.logarithm[k]);
        const W scale = -stress * read<W>(fixed + group_size * fixed_volume);
        W m[3][3], h[3][3], g[3][3], n[3][3], fbar[3][3];
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) {
                m[i][j] = read<W>(&tile.took.n[0][3 * i + j][k]);
                h[i][j] = read<W>(&tile.strained[3 * i + j][k]);
                g[i][j] = i == j ? h[i][j] + T(1) : h[i][j];
                n[i][j] = read<W>(&tile.bars.n[0][3 * i + j][k]);
                fbar[i][j] = read<W>(bar + group_size * (3 + 3 * i + j));
            }
        }
        // q = m (v + dt g), mass, and the inertia 4 m M of the affine part
        W mass_bar = read<W>(&tile.bars.mass[0][k]);
        W product = W{};
        for (std::size_t c = 0; c < 3; ++c) {
            const W q = read<W>(&tile.bars.q[0][c][k]);
            const W v = read<W>(&tile.velocity[c][k]);
            mass_bar += q * (v + pass.next_dt * pass.gravity[c]);
            gravity_bar[c] += mass * q;
            std::size_t memory = 0;
            while (static_cast<std::size_t>(axis[memory]) != c) {
                ++memory;
            }
            const W xbar = read<W>(bar + group_size * c) + pass.inverse_spacing * read<W>(&tile.slope.by[memory][k]);
            write(bar + group_size * c, xbar);
            write(&tile.took.q[0][c][k], mass * q + pass.dt * xbar);
            for (std::size_t j = 0; j < 3; ++j) {
                product += n[c][j] * m[c][j];
            }
        }
        mass_bar += T(4) * product;
        // tau = mu (F F^T - I) + lambda ln J I with the bar T = scale n: F's is mu (T + T^T) F + lambda tr T F^-T
        W square = W{};
        const W symmetric[3][3] = {{n[0][0] + n[0][0], n[0][1] + n[1][0], n[0][2] + n[2][0]},
                                   {n[1][0] + n[0][1], n[1][1] + n[1][1], n[1][2] + n[2][1]},
                                   {n[2][0] + n[0][2], n[2][1] + n[1][2], n[2][2] + n[2][2]}};
        const W trace = n[0][0] + n[1][1] + n[2][2];
        const W cofactor[3][3] = {
            {g[1][1] * g[2][2] - g[1][2] * g[2][1], g[1][2] * g[2][0] - g[1][0] * g[2][2], g[1][0] * g[2][1] - g[1][1] * g[2][0]},
            {g[0][2] * g[2][1] - g[0][1] * g[2][2], g[0][0] * g[2][2] - g[0][2] * g[2][0], g[0][1] * g[2][0] - g[0][0] * g[2][1]},
            {g[0][1] * g[1][2] - g[0][2] * g[1][1], g[0][2] * g[1][0] - g[0][0] * g[1][2], g[0][0] * g[1][1] - g[0][1] * g[1][0]}};
        const W j = g[0][0] * cofactor[0][0] + g[0][1] * cofactor[0][1] + g[0][2] * cofactor[0][2];
        const W pull = scale * lambda * trace / j;
        const W shear = scale * mu;
        for (std::size_t a = 0; a < 3; ++a) {
            for (std::size_t b = 0; b < 3; ++b) {
                const W t = symmetric[a][0] * g[0][b] + symmetric[a][1] * g[1][b] + symmetric[a][2] * g[2][b];
                square += (t + symmetric[a][b]) * h[a][b];  // twice n : (F F^T - I)
                fbar[a][b] += shear * t + pull * cofactor[a][b];
            }
        }
        const W stretch_work = T(0.5) * square, volume_work = trace * log_j;
        const auto add = [&](Fixed number, W x) { write(sums + group_size * number, read<W>(sums + group_size * number) + x); };
        add(fixed_mu, scale * stretch_work);
        add(fixed_lambda, scale * volume_work);
        add(fixed_volume, -stress * (mu * stretch_work + lambda * volume_work));
        add(fixed_mass, mass_bar);
        // F at n + 1 = F + strain M F; f: F - I
        W f[3][3];
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j2 = 0; j2 < 3; ++j2) {
                f[i][j2] = read<W>(moving + group_size * (3 + 3 * i + j2));
            }
        }
        const W inertia = T(4) * mass;
        for (std::size_t a = 0; a < 3; ++a) {
            for (std::size_t b = 0; b < 3; ++b) {
                const W from_strain = fbar[a][b] + (fbar[a][0] * f[b][0] + fbar[a][1] * f[b][1] + fbar[a][2] * f[b][2]);
                write(&tile.took.n[0][3 * a + b][k], inertia * n[a][b] + strain * from_strain);
                const W turned = m[0][a] * fbar[0][b] + m[1][a] * fbar[1][b] + m[2][a] * fbar[2][b];
                write(bar + group_size * (3 + 3 * a + b), fbar[a][b] + strain * turned);
            }
        }
        write(&tile.took.mass[0][k], W{});
    }
}

/// x's bar gains the slope of what was taken.
template <class T>
inline void plain_slope(const TileSlope<T>& slope, T* bars, std::size_t first, T inverse_spacing, const std::array<int, 3>& axis) {
    using W = Wide<T>;
    for (std::size_t k = 0; k < tile_size; k += MlsVector<T>::wide_count) {
        for (std::size_t c = 0; c < 3; ++c) {
            T* x = bars + slot_of(static_cast<std::size_t>(axis[c]), moving_numbers, first + k);
            write(x, read<W>(x) + inverse_spacing * read<W>(&slope.by[c][k]));
        }
    }
}

}  // namespace mphygs
