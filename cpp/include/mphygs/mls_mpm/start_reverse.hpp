// The start of a run backwards: the first scatter, and the rounds that found the affine velocities.
#pragma once

#include "mphygs/mls_mpm/reverse.hpp"

namespace mphygs {

template <class T>
inline void MlsMpmReverse<T>::reverse_start(const MlsState<T>& record) {
    const std::size_t size = record.order->size, count = model_.particle_count();
    v_bar_.assign(3 * size, T{});
    // The rounds once more: the grid and C before each of them.
    run_.state_ = record;
    std::fill(run_.state_.history.begin(), run_.state_.history.end(), T{});
    const std::vector<T> no_history = run_.state_.history;
    run_.start_velocity_.assign(3 * size, T{});
    run_.start_affine_.assign(9 * size, T{});
    for (std::size_t p = 0; p < size; ++p) {
        const std::size_t i = std::min(static_cast<std::size_t>(record.order->id[p]), count - 1);
        for (std::size_t c = 0; c < 3 && !fields_.velocity0.empty(); ++c) {
            run_.start_velocity_[c * size + p] = fields_.velocity0[3 * i + c];
        }
    }
    std::vector<Buffer<T>> grid;
    std::vector<std::vector<T>> affine;
    for (int round = 0; round < run_.start_rounds(); ++round) {
        run_.start_round(record.box, round > 0, false);
        grid.push_back(run_.state_.grid);
        affine.push_back(run_.start_affine_);
    }
    // The real scatter, with C_0 from the last of them.
    c_bar_.assign(9 * size, T{});
    run_.forces_.refresh(0);
    const bool pulled = run_.pulls_ && run_.pulls_->enter(0);
    if (pulled) {
        run_.follow(record.order);
        run_.pulls_->see_start(record.moving.data(), run_.start_velocity_);
        run_.pulls_->spread(*run_.team_);
    }
    if (run_.actuation_) {
        run_.actuation_->enter(0);
        run_.follow_loads(record.order);
        run_.actuation_->see_start(record.moving.data(), run_.start_velocity_);
        run_.actuation_->spread();
    }
    clear_sums();
    start_tiles(record, [&](std::size_t c, std::size_t t, MlsTile<T, 0>& tile, ParticlePoint<P>* points, ParticlePoint<P>* bars) {
        if (!grid.empty()) {
            gather_tile<T, 0>(tile, grid.back().data(), 0, model_.axis_, record.box);
        }
        for (int k = 0; k < tile_packs; ++k) {
            if (!grid.empty()) {
                points[k].c = run_.affine_velocity(tile.get_n(k));
            }
            add_seeds(0, *record.order, t + static_cast<std::size_t>(k * lane_count), bars[k]);
        }
        reverse_given(c, t, *record.order, points, no_history.data(), bars);
    });
    add_sums(0);
    if (pulled) {
        run_.pulls_->reverse(given_bar_, target_bar_);
        run_.pulls_->unsee_start(bars_.data(), v_bar_);
    }
    if (run_.actuation_) {
        run_.actuation_->reverse(pushed_bar_, channel_bar_, pose_bar_);
        run_.actuation_->unsee_start(bars_.data(), v_bar_);
    }
    for (int round = run_.start_rounds() - 1; round >= 0; --round) {
        // C of the next round was gathered from this grid ...
        const MlsState<T> here{record.order, {}, {}, grid[static_cast<std::size_t>(round)], record.box, record.ranges};
        grids_.prepare(record.box, record.ranges);
        start_tiles(record, [&](std::size_t c, std::size_t, MlsTile<T, 0>& tile, ParticlePoint<P>*, ParticlePoint<P>* bars) {
            gather_tile<T, 0>(tile, here.grid.data(), 0, model_.axis_, record.box);
            alignas(64) T velocity[3][tile_size];
            std::memcpy(velocity, tile.q[0], sizeof velocity);
            for (int k = 0; k < tile_packs; ++k) {
                tile.set_q(k, {});
                tile.set_n(k, run_.affine_velocity(bars[k].c));
                tile.set_mass(k, P{});
                bars[k].c = {};
            }
            TileSlope<T> slope;
            reverse_gather_rows<T>(tile, velocity, here.grid.data(), grids_.private_grid(c), model_.axis_, record.box, slope);
            for (int k = 0; k < tile_packs; ++k) {
                add_slope(slope, k, bars[k].x);
            }
        });
        grid_bar(here);
        // ... to which m v_0 and m C of this round were given.
        run_.start_affine_ = affine[static_cast<std::size_t>(round)];
        start_tiles(record, [&](std::size_t, std::size_t t, MlsTile<T, 0>& tile, ParticlePoint<P>* points, ParticlePoint<P>* bars) {
            for (int k = 0; k < tile_packs; ++k) {
                run_.give_velocity(tile, k, t + static_cast<std::size_t>(k * lane_count), points[k]);
            }
            MlsTile<T, 0> given;
            TileSlope<T> slope;
            reverse_scatter_rows<T>(tile, bar_grid_.data(), model_.axis_, record.box, given, slope);
            for (int k = 0; k < tile_packs; ++k) {
                add_slope(slope, k, bars[k].x);
                const P mass = tile.get_mass(k);
                const Vec3<P> momentum_bar = given.get_q(k);
                const Mat3<P> affine_bar = broadcast<T>(static_cast<T>(model_.geometry_.spacing)) * given.get_n(k);
                const P mass_bar = given.get_mass(k) + dot(momentum_bar, points[k].v) + inner(affine_bar, points[k].c);
                bars[k].v = bars[k].v + mass * momentum_bar;
                bars[k].c = bars[k].c + mass * affine_bar;
                T* to = particles_.at(fixed_mass, t + static_cast<std::size_t>(k * lane_count));
                store<T>(to, load<T>(to) + mass_bar);
            }
        });
    }
}

template <class T>
template <class F>
inline void MlsMpmReverse<T>::start_tiles(const MlsState<T>& record, F&& f) {
    const std::size_t size = record.order->size;
    for (std::size_t c = 0; c < record.ranges.size(); ++c) {
        const CellRange limits = inside(record.box, record.ranges[c]);
        SeenRange<Pack<T>> ignored;
        MlsTile<T, 0> tile;
        for (std::size_t t = run_.chunk_begin(c); t < run_.chunk_begin(c + 1); t += tile_size) {
            ParticlePoint<P> points[tile_packs], bars[tile_packs];
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                points[k] = run_.load_start(p);
                locate(tile, k, points[k].x, run_.inverse_spacing_, model_.axis_, record.box, limits, ignored);
                bars[k] = load_moving<T, 0>(bars_.data(), size, p);
                for (std::size_t a = 0; a < 3; ++a) {
                    bars[k].v[static_cast<int>(a)] = load<T>(&v_bar_[a * size + p]);
                }
                for (std::size_t e = 0; e < 9; ++e) {
                    bars[k].c.e[e / 3][e % 3] = load<T>(&c_bar_[e * size + p]);
                }
            }
            f(c, t, tile, points, bars);
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                store_moving<T, 0>(bars_.data(), size, p, bars[k]);
                for (std::size_t a = 0; a < 3; ++a) {
                    store<T>(&v_bar_[a * size + p], bars[k].v[static_cast<int>(a)]);
                }
                for (std::size_t e = 0; e < 9; ++e) {
                    store<T>(&c_bar_[e * size + p], bars[k].c.e[e / 3][e % 3]);
                }
            }
        }
    }
}

}  // namespace mphygs
