// Particles whose motion forces need before the sweep that gives them.
//
// The forces at n + 1 look at the state at n + 1, which the sweep that gives them finds as it goes. So the few particles
// that feedback and loads read are gathered ahead of it, from the grid at n, as the sweep will gather them.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>

#include "mphygs/transfers/mls_mpm_forces.hpp"
#include "mphygs/transfers/mls_mpm_lanes.hpp"
#include "mphygs/transfers/mls_mpm_rows_reverse.hpp"

namespace mphygs {

template <class T, int K>
class MlsAhead {
  public:
    using S = PackScalar<T, K>;
    static constexpr int lanes = K + 1;

    static constexpr std::size_t quad = 4;  // x, y, z, and one that stays 0

    /// place, speed: what of displacement and velocity is asked for.
    MlsAhead(const MlsMpm<T>& model, T place, T speed) : model_(model), place_(place), speed_(speed) {}

    /// Finds particles in another order. read: where they are in it; begin(c): first particle of chunk c.
    template <class F>
    void follow(const std::shared_ptr<const MlsOrder<T>>& order, const std::vector<std::size_t>& read, std::size_t chunks, const F& begin) {
        order_ = order;
        for (int l = 0; l < lanes; ++l) {
            seen[l].resize(quad * read.size());
        }
        seen_bar.resize(quad * read.size());
        std::vector<std::vector<Seen>> of_chunk(chunks);
        for (std::size_t k = 0; k < read.size(); ++k) {
            std::size_t c = 0;
            while (begin(c + 1) <= read[k]) {
                ++c;
            }
            of_chunk[c].push_back({read[k], k});
        }
        tiles_.clear();
        for (std::size_t c = 0; c < chunks; ++c) {
            std::sort(of_chunk[c].begin(), of_chunk[c].end(), [](const Seen& a, const Seen& b) { return a.place < b.place; });
            for (std::size_t k = 0; k < of_chunk[c].size(); k += tile_size) {
                const auto from = of_chunk[c].begin() + static_cast<std::ptrdiff_t>(k);
                tiles_.push_back({c, {from, from + static_cast<std::ptrdiff_t>(std::min(tile_size, of_chunk[c].size() - k))}});
            }
        }
    }
    const std::shared_ptr<const MlsOrder<T>>& order() const { return order_; }

    /// place times displacement and speed times velocity, summed, at n + 1: (particles, quad) of every lane, and their bars.
    std::vector<T> seen[lanes], seen_bar;

    /// From particles and grid at n; h: length of substep n.
    void see(const T* moving, const T* grid, const Box& box, T h) {
        MlsTile<T, K> tile;
        for (const Tile& t : tiles_) {
            gather(t, moving, grid, box, tile);
            each_of(t, [&](std::size_t q, const Seen& one) {
                for (int l = 0; l < lanes; ++l) {
                    const std::size_t lane = static_cast<std::size_t>(l) * moving_numbers * model_.padded_;
                    for (std::size_t c = 0; c < 3; ++c) {
                        const T v = tile.q[l][c][q], u = moving[lane + slot_of(c, moving_numbers, one.place)] + h * v;
                        seen[l][quad * one.number + c] = place_ * u + speed_ * v;
                    }
                }
            });
        }
    }
    /// The same of the initial state. velocity: (lanes, 3, size).
    void see_start(const T* moving, const std::vector<T>& velocity) {
        for (const Tile& t : tiles_) {
            each_of(t, [&](std::size_t, const Seen& one) {
                for (int l = 0; l < lanes; ++l) {
                    const std::size_t lane = static_cast<std::size_t>(l);
                    for (std::size_t c = 0; c < 3; ++c) {
                        seen[l][quad * one.number + c] =
                            place_ * moving[lane * moving_numbers * model_.padded_ + slot_of(c, moving_numbers, one.place)] +
                            speed_ * velocity[(3 * lane + c) * model_.padded_ + one.place];
                    }
                }
            });
        }
    }

    /// `see` backwards. bars: of what moves, at n; grid_of(c): bars of the grid at n that chunk c adds to.
    template <class F>
    void unsee(const T* moving, const T* grid, const Box& box, T h, T inverse_spacing, T* bars, const F& grid_of) {
        MlsTile<T, 0> tile;
        for (const Tile& t : tiles_) {
            gather(t, moving, grid, box, tile);
            alignas(64) T velocity[3][tile_size];
            std::memcpy(velocity, tile.q[0], sizeof velocity);
            std::memset(tile.q, 0, sizeof tile.q);
            std::memset(tile.n, 0, sizeof tile.n);
            std::memset(tile.mass, 0, sizeof tile.mass);
            each_of(t, [&](std::size_t q, const Seen& one) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const T bar = seen_bar[quad * one.number + c], u_bar = place_ * bar;
                    bars[slot_of(c, moving_numbers, one.place)] += u_bar;
                    tile.q[0][c][q] = speed_ * bar + h * u_bar;
                }
            });
            TileSlope<T> slope;
            reverse_gather_rows<T>(tile, velocity, grid, grid_of(t.chunk), model_.axis_, box, slope);
            each_of(t, [&](std::size_t q, const Seen& one) {
                for (std::size_t c = 0; c < 3; ++c) {
                    bars[slot_of(static_cast<std::size_t>(model_.axis_[c]), moving_numbers, one.place)] += inverse_spacing * slope.by[c][q];
                }
            });
        }
    }
    /// `see_start` backwards. velocity_bar: (3, size).
    void unsee_start(T* bars, std::vector<T>& velocity_bar) const {
        for (const Tile& t : tiles_) {
            each_of(t, [&](std::size_t, const Seen& one) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const T bar = seen_bar[quad * one.number + c];
                    bars[slot_of(c, moving_numbers, one.place)] += place_ * bar;
                    velocity_bar[c * model_.padded_ + one.place] += speed_ * bar;
                }
            });
        }
    }

  private:
    struct Seen {
        std::size_t place, number;  // among the particles, and among those that are read
    };
    struct Tile {
        std::size_t chunk;
        std::vector<Seen> seen;
    };

    template <class F>
    static void each_of(const Tile& t, const F& f) {
        for (std::size_t q = 0; q < t.seen.size(); ++q) {
            f(q, t.seen[q]);
        }
    }

    /// Velocities of a tile's particles; places beyond its end repeat the last one.
    void gather(const Tile& t, const T* moving, const T* grid, const Box& box, MlsTile<T, K>& tile) const {
        CellRange inside;
        for (std::size_t c = 0; c < 3; ++c) {
            inside.low[c] = box.low[c] + 1;
            inside.high[c] = box.low[c] + box.count[c] - 2;
        }
        SeenRange<Pack<T>> ignored;
        const std::size_t size = model_.padded_;
        for (int k = 0; k < tile_packs; ++k) {
            Vec3<S> x;
            for (int q = 0; q < lane_count; ++q) {
                const std::size_t p = t.seen[std::min(static_cast<std::size_t>(k * lane_count + q), t.seen.size() - 1)].place;
                for (std::size_t c = 0; c < 3; ++c) {
                    for (int l = 0; l < lanes; ++l) {
                        lane_of(x[static_cast<int>(c)], l)[q] = moving[static_cast<std::size_t>(l) * moving_numbers * size + slot_of(c, moving_numbers, p)];
                    }
                    lane_of(x[static_cast<int>(c)], 0)[q] += order_->rest[slot_of(c, rest_numbers, p)];
                }
            }
            locate(tile, k, x, static_cast<T>(1.0 / model_.geometry_.spacing), model_.axis_, box, inside, ignored);
        }
        gather_tile<T, K>(tile, grid, 4 * box.nodes(), model_.axis_, box);
    }

    const MlsMpm<T>& model_;
    T place_, speed_;
    std::shared_ptr<const MlsOrder<T>> order_;
    std::vector<Tile> tiles_;
};

}  // namespace mphygs
