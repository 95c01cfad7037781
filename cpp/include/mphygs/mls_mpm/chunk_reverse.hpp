// A substep backwards of the particles of one chunk.
#pragma once

#include "mphygs/mls_mpm/step_reverse.hpp"

namespace mphygs {

template <class T>
inline void MlsStepReverse<T>::reverse_given(std::size_t c, std::size_t t, const MlsOrder<T>& order, const ParticlePoint<P>* points, const T* history,
                                             ParticlePoint<P>* bars) {
    const CellRange limits = inside(bar_box_, bar_ranges_[c]);
    SeenRange<Pack<T>> ignored;
    MlsTile<T, 0> tile, given;
    for (int k = 0; k < tile_packs; ++k) {
        const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
        locate(tile, k, points[k].x, run_.inverse_spacing_, model_.axis_, bar_box_, limits, ignored);
        Vec3<P> momentum;
        Mat3<P> affine;
        run_.forces_.evaluate(order, p, points[k], run_.state_.history.data(), momentum, affine);
        run_.pull(order, p, momentum);
        tile.set_q(k, momentum);
        tile.set_n(k, broadcast<T>(static_cast<T>(model_.geometry_.spacing)) * affine);
        tile.set_mass(k, run_.forces_.fixed(order, fixed_mass, p));
    }
    TileSlope<T> slope;
    reverse_scatter_rows<T>(tile, bar_grid_.data(), model_.axis_, bar_box_, given, slope);
    for (int k = 0; k < tile_packs; ++k) {
        GivenBars<T> g;
        g.momentum = given.get_q(k);
        g.affine = broadcast<T>(static_cast<T>(model_.geometry_.spacing)) * given.get_n(k);
        g.mass = given.get_mass(k);
        add_slope(slope, k, bars[k].x);
        const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
        if (reacts(order, p)) {
            const HeldBars held = held_bars(order, p, run_.forces_.substep(), 1.0, points[k].u, tile.get_q(k), sums_[c].pose, 24, 12);
            g.momentum = g.momentum + held.momentum;
            g.affine = g.affine + held.affine;
            bars[k].x = bars[k].x + held.arm;
        }
        forces_.reverse(order, p, points[k], history, g, history_bar_.data(), bars[k], particles_, sums_[c]);
        if (run_.pulling()) {
            const P mass = run_.forces_.fixed(order, fixed_mass, p);
            T* mass_bar = particles_.at(fixed_mass, p);
            store<T>(mass_bar, load<T>(mass_bar) + dot(g.momentum, run_.pulls_->given(p)));
            for (std::size_t a = 0; a < 3; ++a) {
                store<T>(&given_bar_[a * order.size + p], mass * g.momentum[static_cast<int>(a)]);
            }
        }
        for (std::size_t a = 0; run_.actuation_ && a < 3; ++a) {
            store<T>(&pushed_bar_[a * order.size + p], g.momentum[static_cast<int>(a)]);
        }
    }
}

template <class T>
inline void MlsStepReverse<T>::reverse_chunk(std::size_t c, int n, const MlsState<T>& record, bool forces) {
    const T h = static_cast<T>(table_.dt[static_cast<std::size_t>(n)]);
    const CellRange limits = inside(record.box, record.ranges[c]);
    const std::size_t size = record.order->size;
    SeenRange<Pack<T>> ignored;
    MlsTile<T, 0> tile;
    PlainTile<T> plain;
    Wide<T> gravity_bar[3] = {};
    const PlainPass<T> pass = run_.plain_pass(h, forces);
    const bool hot = forces && run_.forces_.plain() && !table_.is_frame(n + 1);
    for (std::size_t t = run_.chunk_begin(c); t < run_.chunk_begin(c + 1); t += tile_size) {
        if (hot && run_.forces_.plain_tile(*record.order, t) && !(reacting() && run_.tile_reacts(*record.order, t))) {
            run_.stand_tile(plain.took, *record.order, record.moving, record.box, t, limits);
            gather_rows<T>(plain.took, record.grid.data(), model_.axis_, record.box);
            plain_given<T>(plain, record.moving.data(), t, pass, *record.order, model_.axis_, bar_box_, inside(bar_box_, bar_ranges_[c]));
            run_.pull_tile(plain.given, t);
            const auto moved = [&](std::size_t p, std::size_t a) {
                return record.moving[slot_of(a, moving_numbers, p)] + h * plain.velocity[a][p - t];  // u
            };
            run_.forces_.each_held_of_tile(*record.order, t, [&](std::size_t p, std::size_t hold, std::size_t id) {
                for (std::size_t a = 0; a < 3; ++a) {
                    run_.give_held(plain.given, p - t, hold, id, a, moved(p, a));
                }
            });
            reverse_scatter_rows<T>(plain.given, bar_grid_.data(), model_.axis_, bar_box_, plain.bars, plain.slope);
            plain_bars<T>(plain, record.moving.data(), bars_.data(), particles_.fixed.data(), t, pass, *record.order, model_.axis_,
                          gravity_bar);
            for (std::size_t a = 0; run_.pulling() && a < 3; ++a) {
                const T* given = run_.pulls_->values(t, a);
                for (std::size_t p = 0; p < tile_size; ++p) {
                    const T bar = plain.bars.q[0][a][p];
                    given_bar_[a * size + t + p] = plain.given.mass[0][p] * bar;
                    *particles_.at(fixed_mass, t + p) += bar * given[p];
                }
            }
            for (std::size_t a = 0; run_.actuation_ && a < 3; ++a) {
                std::copy_n(plain.bars.q[0][a], tile_size, &pushed_bar_[a * size + t]);
            }
            run_.forces_.each_held_of_tile(*record.order, t, [&](std::size_t p, std::size_t hold, std::size_t id) {
                for (std::size_t a = 0; a < 3; ++a) {  // the hold's velocity stood in place of the particle's
                    const T bar = plain.bars.q[0][a][p - t], velocity_bar = plain.given.mass[0][p - t] * bar;
                    const T held = run_.forces_.held_velocity(hold, id, static_cast<int>(a), moved(p, a));
                    *particles_.at(fixed_mass, p) += bar * (held - plain.velocity[a][p - t]);
                    forces_.reverse_held(hold, id, static_cast<int>(a), velocity_bar, sums_[c]);
                    const T x_bar = -run_.forces_.relaxation() * velocity_bar;
                    bars_[slot_of(a, moving_numbers, p)] += x_bar;
                    plain.took.q[0][a][p - t] += h * x_bar - velocity_bar;
                }
            });
            reverse_gather_rows<T>(plain.took, plain.velocity, record.grid.data(), grids_.private_grid(c), model_.axis_, record.box,
                                   plain.slope);
            plain_slope<T>(plain.slope, bars_.data(), t, run_.inverse_spacing_, model_.axis_);
            continue;
        }
        ParticlePoint<P> points[tile_packs], bars[tile_packs];
        Mat3<P> before[tile_packs];
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            points[k] = load_moving<T, 0>(record.moving.data(), size, p);
            locate(tile, k, placed<T, 0>(*record.order, p, points[k].x), run_.inverse_spacing_, model_.axis_, record.box, limits, ignored);
        }
        gather_tile<T, 0>(tile, record.grid.data(), 0, model_.axis_, record.box);
        alignas(64) T velocity[3][tile_size];
        std::memcpy(velocity, tile.q[0], sizeof velocity);
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            points[k].v = tile.get_q(k);
            points[k].c = run_.affine_velocity(tile.get_n(k));
            before[k] = with_identity(points[k].f);
            points[k].x = points[k].x + broadcast<T>(h) * points[k].v;
            points[k].f = strained(points[k].f, points[k].c, broadcast<T>(h));
            complete<T, 0>(*record.order, p, points[k]);
            bars[k] = load_moving<T, 0>(bars_.data(), size, p);
            if (table_.is_frame(n + 1)) {
                add_seeds(table_.frame_of_state(n + 1), *record.order, p, bars[k]);
            }
        }
        if (forces) {
            reverse_given(c, t, *record.order, points, record.history.data(), bars);
        }
        Vec3<P> late[tile_packs] = {};  // bars of the places before the substep
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            if (reacts(*record.order, p)) {
                late[k] = reverse_taken(c, n, *record.order, p, h, points[k], bars[k]);
            }
        }
        for (int k = 0; k < tile_packs; ++k) {
            ParticlePoint<P>& bar = bars[k];
            bar.v = bar.v + broadcast<T>(h) * bar.x;
            bar.x = bar.x + late[k];
            bar.c = bar.c + broadcast<T>(h) * (bar.f * transpose(before[k]));
            bar.f = bar.f + broadcast<T>(h) * (transpose(points[k].c) * bar.f);
            tile.set_q(k, bar.v);
            tile.set_n(k, run_.affine_velocity(bar.c));
            tile.set_mass(k, P{});
        }
        TileSlope<T> slope;
        reverse_gather_rows<T>(tile, velocity, record.grid.data(), grids_.private_grid(c), model_.axis_, record.box, slope);
        for (int k = 0; k < tile_packs; ++k) {
            add_slope(slope, k, bars[k].x);
            store_moving<T, 0>(bars_.data(), size, t + static_cast<std::size_t>(k * lane_count), bars[k]);
        }
    }
    for (std::size_t a = 0; a < 3; ++a) {
        for (int q = 0; q < MlsVector<T>::wide_count; ++q) {
            sums_[c].gravity[a] += static_cast<double>(pass.next_dt * gravity_bar[a][q]);
        }
    }
}

}  // namespace mphygs
