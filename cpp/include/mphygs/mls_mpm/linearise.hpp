// What an acceleration makes of a field of velocities, for the largest rates.
#pragma once

#include "mphygs/mls_mpm/run.hpp"

namespace mphygs {

template <class T, int K>
inline void MlsMpmRun<T, K>::linearise(std::vector<T>& field, bool rates) {
    const Box box = reach();
    forces_.refresh(0);
    const T h = forces_.dt();
    const std::size_t numbers = 4 * box.nodes();
    field.resize(numbers, T{});
    state_.grid.assign(lanes * numbers + 4, T{});
    std::copy(field.begin(), field.end(), state_.grid.begin() + static_cast<std::ptrdiff_t>(numbers));
    grids_.prepare(box, state_.ranges);
    if (actuation_ && !rates) {
        actuation_->enter(0);
        follow_loads(state_.order);
        actuation_->see(state_.moving.data(), state_.grid.data(), box, T(1));
        actuation_->spread(false);
    } else {
        actuation_.reset();  // loads do not look at velocities
    }
    std::vector<T> history = state_.history;
    for (std::size_t c = 0; c < state_.ranges.size(); ++c) {
        const CellRange inside = limits(c, box, 0);
        SeenRange<Pack<T>> seen;
        MlsTile<T, K> tile;
        for (std::size_t t = chunk_begin(c); t < chunk_begin(c + 1); t += tile_size) {
            ParticlePoint<S> points[tile_packs];
            for (int k = 0; k < tile_packs; ++k) {
                points[k] = load_particles(t + static_cast<std::size_t>(k * lane_count), state_.moving);
                locate(tile, k, points[k].x, inverse_spacing_, model_.axis_, box, inside, seen);
            }
            gather_tile<T, K>(tile, state_.grid.data(), numbers, model_.axis_, box);
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                const Mat3<S> gradient = affine_velocity(tile.get_n(k));
                if (rates) {
                    points[k].v = tile.get_q(k);
                    points[k].c = gradient;
                } else {
                    points[k].f = points[k].f + gradient * points[k].f;
                }
                give(tile, k, p, points[k], history.data(), c);
                const S mass = tile.get_mass(k);
                tile.set_q(k, tile.get_q(k) - mass * points[k].v);
                tile.set_n(k, tile.get_n(k) - (static_cast<T>(model_.geometry_.spacing) * mass) * points[k].c);
            }
            scatter_tile<T, K>(tile, grids_.private_grid(c), grids_.lane_stride(c), model_.axis_, box);
        }
    }
    // The sum sets the planes that particles reach; what was read must not stay on the others.
    std::fill(state_.grid.begin(), state_.grid.end(), T{});
    grids_.reduce(box, state_.ranges, *team_, state_.grid);
    for (std::size_t i = 0; i < numbers; ++i) {
        field[i] = i % 4 == 3 ? T{} : state_.grid[numbers + i] / h;
    }
}

}  // namespace mphygs
