// A substep of the particles of one chunk.
#pragma once

#include "mphygs/mls_mpm/run.hpp"

namespace mphygs {

template <class T, int K>
inline void MlsMpmRun<T, K>::advance_chunk(std::size_t c, T h, const Box& next, bool forces, bool output, CellRange& range) {
    SeenRange<Pack<T>> seen;
    const CellRange now = limits(c, state_.box, 0), then = limits(c, next, 1);
    SeenRange<Pack<T>> ignored;
    MlsTile<T, K> tile;
    T* out = forces ? grids_.private_grid(c) : nullptr;
    const std::size_t n = size();
    SeenRange<Wide<T>> seen_wide;
    const bool plain = K == 0 && forces_.plain();
    for (std::size_t t = chunk_begin(c); t < chunk_begin(c + 1); t += tile_size) {
        if constexpr (K == 0) {
            if (plain && forces_.plain_tile(*state_.order, t) && !tile_reacts(*state_.order, t)) {
                stand_tile(tile, *state_.order, *from_, state_.box, t, now);
                gather_rows<T>(tile, state_.grid.data(), model_.axis_, state_.box);
                const PlainPass<T> pass = plain_pass(h, forces);
                const long failed = mphygs::plain_tile<T>(tile, t, pass, from_->data(), state_.moving.data(), output ? velocity_.data() : nullptr,
                                                            *state_.order, model_.axis_, next, then, seen_wide);
                failed_[c] = failed_[c] < 0 ? failed : failed_[c];
                if (forces) {
                    pull_tile(tile, t);
                    forces_.each_held_of_tile(*state_.order, t, [&](std::size_t p, std::size_t hold, std::size_t id) {
                        for (std::size_t a = 0; a < 3; ++a) {
                            give_held(tile, p - t, hold, id, a, state_.moving[slot_of(a, moving_numbers, p)]);
                        }
                    });
                    scatter_rows<T>(tile, out, model_.axis_, next);
                }
                continue;
            }
        }
        ParticlePoint<S> points[tile_packs];
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            points[k] = load_moving<T, K>(from_->data(), n, p);
            locate(tile, k, placed<T, K>(*state_.order, p, points[k].x), inverse_spacing_, model_.axis_, state_.box, now, ignored);
        }
        gather_tile<T, K>(tile, state_.grid.data(), 4 * state_.box.nodes(), model_.axis_, state_.box);
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            ParticlePoint<S>& point = points[k];
            point.v = tile.get_q(k);
            point.c = affine_velocity(tile.get_n(k));
            if (reacts(*state_.order, p)) {
                const S mass = forces_.fixed(*state_.order, fixed_mass, p);
                sum_held(taken_[c], *state_.order, p, now_, point.x, mass * point.v, mass * point.c);
            }
            for (int a = 0; a < 3; ++a) {
                point.x[a] = point.x[a] + h * point.v[a];
            }
            point.f = strained(point.f, point.c, constant<S>(h));
            store_moving<T, K>(state_.moving.data(), n, p, point);
            complete<T, K>(*state_.order, p, point);
            for (int l = 0; output && l < lanes; ++l) {
                for (std::size_t a = 0; a < 3; ++a) {
                    store<T>(&velocity_[(3 * static_cast<std::size_t>(l) + a) * n + p], lane_of(point.v[static_cast<int>(a)], l));
                }
            }
            const PackMask<T> bad = locate(tile, k, point.x, inverse_spacing_, model_.axis_, next, then, seen);
            if (any(bad) && failed_[c] < 0) {
                int q = 0;
                while (bad[q] == 0) {
                    ++q;
                }
                failed_[c] = static_cast<long>(p) + q;
            }
            if (forces) {
                give(tile, k, p, point, state_.history.data(), c);
            }
        }
        if (forces) {
            scatter_tile<T, K>(tile, out, grids_.lane_stride(c), model_.axis_, next);
        }
    }
    range = seen.range();
    range.cover(seen_wide.range());
}

}  // namespace mphygs
