// The start of a run: affine velocities from a field of initial ones, and the first scatter.
#pragma once

#include "mphygs/mls_mpm/run.hpp"

namespace mphygs {

template <class T, int K>
inline void MlsMpmRun<T, K>::begin() {
    if (table_.count() == 0) {
        return;
    }
    const Box box = reach();
    start_affine_.assign(static_cast<std::size_t>(lanes) * 9 * size(), T{});
    for (int round = 0; round <= start_rounds(); ++round) {
        start_round(box, round > 0, round == start_rounds());
    }
    for (std::vector<T>* done : {&start_velocity_, &start_affine_}) {
        done->clear();
        done->shrink_to_fit();
    }
}

template <class T, int K>
inline void MlsMpmRun<T, K>::start_round(const Box& box, bool improve, bool real) {
    if (real) {
        forces_.refresh(0);
        if (pulls_ && pulls_->enter(0)) {
            follow(state_.order);
            pulls_->see_start(state_.moving.data(), start_velocity_);
            pulls_->spread(*team_);
        }
        if (actuation_) {
            actuation_->enter(0);
            follow_loads(state_.order);
            actuation_->see_start(state_.moving.data(), start_velocity_);
            actuation_->spread();
        }
    }
    grids_.prepare(box, state_.ranges);
    team_->each(model_.chunk_count_, [&](int c) { start_chunk(static_cast<std::size_t>(c), box, improve, real); });
    grids_.reduce(box, state_.ranges, *team_, state_.grid);
    state_.box = box;
    if (real) {
        react(given_, 0, 1.0);
    }
}

template <class T, int K>
inline ParticlePoint<typename MlsMpmRun<T, K>::S> MlsMpmRun<T, K>::load_start(std::size_t p) const {
    ParticlePoint<S> point = load_particles(p, state_.moving);
    const std::size_t n = size();
    for (int l = 0; l < lanes; ++l) {
        const std::size_t lane = static_cast<std::size_t>(l);
        for (std::size_t c = 0; c < 3; ++c) {
            lane_of(point.v[static_cast<int>(c)], l) = load<T>(&start_velocity_[(3 * lane + c) * n + p]);
        }
        for (std::size_t k = 0; k < 9; ++k) {
            lane_of(point.c.e[k / 3][k % 3], l) = load<T>(&start_affine_[(9 * lane + k) * n + p]);
        }
    }
    return point;
}

template <class T, int K>
inline void MlsMpmRun<T, K>::start_chunk(std::size_t c, const Box& box, bool improve, bool real) {
    const CellRange inside = limits(c, box, 0);
    SeenRange<Pack<T>> seen;
    MlsTile<T, K> tile;
    const std::size_t n = size();
    for (std::size_t t = chunk_begin(c); t < chunk_begin(c + 1); t += tile_size) {
        ParticlePoint<S> points[tile_packs];
        for (int k = 0; k < tile_packs; ++k) {
            points[k] = load_start(t + static_cast<std::size_t>(k * lane_count));
            locate(tile, k, points[k].x, inverse_spacing_, model_.axis_, box, inside, seen);
        }
        if (improve) {
            gather_tile<T, K>(tile, state_.grid.data(), 4 * box.nodes(), model_.axis_, box);
        }
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            if (improve) {
                points[k].c = affine_velocity(tile.get_n(k));
                for (int l = 0; l < lanes; ++l) {
                    for (std::size_t e = 0; e < 9; ++e) {
                        store<T>(&start_affine_[(9 * static_cast<std::size_t>(l) + e) * n + p], lane_of(points[k].c.e[e / 3][e % 3], l));
                    }
                }
            }
            if (real) {
                give(tile, k, p, points[k], state_.history.data(), c);
            } else {
                give_velocity(tile, k, p, points[k]);
            }
        }
        scatter_tile<T, K>(tile, grids_.private_grid(c), grids_.lane_stride(c), model_.axis_, box);
    }
}

template <class T, int K>
inline void MlsMpmRun<T, K>::give_velocity(MlsTile<T, K>& tile, int pack, std::size_t p, const ParticlePoint<S>& point) const {
    const S mass = forces_.fixed(*state_.order, fixed_mass, p);
    tile.set_mass(pack, mass);
    tile.set_q(pack, mass * point.v);
    tile.set_n(pack, (static_cast<T>(model_.geometry_.spacing) * mass) * point.c);
}

}  // namespace mphygs
