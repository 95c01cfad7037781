// Particles whose motion forces need before the sweep that gives them.
//
// The forces at n + 1 look at the state at n + 1, which the sweep that gives them finds as it goes. So the few particles
// that feedback and loads read are gathered ahead of it, from the grid at n, as the sweep will gather them.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>

#include "mphygs/mls_mpm/forces.hpp"
#include "mphygs/mls_mpm/lanes.hpp"
#include "mphygs/mls_mpm/rows_reverse.hpp"

namespace mphygs {

template <class T, int K>
class MlsAhead {
  public:
    using S = PackScalar<T, K>;
    static constexpr int lanes = K + 1;

    explicit MlsAhead(const MlsMpm<T>& model) : model_(model) {}

    /// Finds the particles `read` in another order, place: where each of all particles is. begin(c): first particle of chunk c.
    template <class N, class F>
    void follow(const std::shared_ptr<const MlsOrder<T>>& order, const std::vector<N>& read, const std::vector<std::size_t>& place,
                std::size_t chunks, const F& begin) {
        order_ = order;
        std::vector<std::vector<Seen>> of_chunk(chunks);
        for (std::size_t k = 0; k < read.size(); ++k) {
            const std::size_t at = place[static_cast<std::size_t>(read[k])];
            std::size_t c = 0;
            while (begin(c + 1) <= at) {
                ++c;
            }
            of_chunk[c].push_back({at, k});
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

    /// keep(lane, number, component, u, v): displacement and velocity at n + 1, from particles and grid at n; h: length of substep n.
    template <class F>
    void see(const T* moving, const T* grid, const Box& box, T h, const F& keep) {
        MlsTile<T, K> tile;
        for (const Tile& t : tiles_) {
            gather(t, moving, grid, box, tile);
            each_of(t, [&](std::size_t q, const Seen& seen) {
                for (int l = 0; l < lanes; ++l) {
                    const std::size_t lane = static_cast<std::size_t>(l) * moving_numbers * model_.padded_;
                    for (std::size_t c = 0; c < 3; ++c) {
                        const T v = tile.q[l][c][q], u = moving[lane + slot_of(c, moving_numbers, seen.place)] + h * v;
                        keep(l, seen.number, c, u, v);
                    }
                }
            });
        }
    }
    /// The same of the initial state. velocity: (lanes, 3, size).
    template <class F>
    void see_start(const T* moving, const std::vector<T>& velocity, const F& keep) {
        for (const Tile& t : tiles_) {
            each_of(t, [&](std::size_t, const Seen& seen) {
                for (int l = 0; l < lanes; ++l) {
                    const std::size_t lane = static_cast<std::size_t>(l);
                    for (std::size_t c = 0; c < 3; ++c) {
                        keep(l, seen.number, c, moving[lane * moving_numbers * model_.padded_ + slot_of(c, moving_numbers, seen.place)],
                             velocity[(3 * lane + c) * model_.padded_ + seen.place]);
                    }
                }
            });
        }
    }

    /// `see` backwards. bars: of what moves, at n; grid_of(c): bars of the grid at n that chunk c adds to;
    /// bar(number, component, u_bar, v_bar): writes the bars of what was seen.
    template <class F, class G>
    void unsee(const T* moving, const T* grid, const Box& box, T h, T inverse_spacing, T* bars, const F& grid_of, const G& bar) {
        MlsTile<T, 0> tile;
        for (const Tile& t : tiles_) {
            gather(t, moving, grid, box, tile);
            alignas(64) T velocity[3][tile_size];
            std::memcpy(velocity, tile.q[0], sizeof velocity);
            std::memset(tile.q, 0, sizeof tile.q);
            std::memset(tile.n, 0, sizeof tile.n);
            std::memset(tile.mass, 0, sizeof tile.mass);
            each_of(t, [&](std::size_t q, const Seen& seen) {
                for (std::size_t c = 0; c < 3; ++c) {
                    T u_bar{}, v_bar{};
                    bar(seen.number, c, u_bar, v_bar);
                    bars[slot_of(c, moving_numbers, seen.place)] += u_bar;
                    tile.q[0][c][q] = v_bar + h * u_bar;
                }
            });
            TileSlope<T> slope;
            reverse_gather_rows<T>(tile, velocity, grid, grid_of(t.chunk), model_.axis_, box, slope);
            each_of(t, [&](std::size_t q, const Seen& seen) {
                for (std::size_t c = 0; c < 3; ++c) {
                    bars[slot_of(static_cast<std::size_t>(model_.axis_[c]), moving_numbers, seen.place)] += inverse_spacing * slope.by[c][q];
                }
            });
        }
    }
    /// `see_start` backwards. velocity_bar: (3, size).
    template <class G>
    void unsee_start(T* bars, std::vector<T>& velocity_bar, const G& bar) const {
        for (const Tile& t : tiles_) {
            each_of(t, [&](std::size_t, const Seen& seen) {
                for (std::size_t c = 0; c < 3; ++c) {
                    T u_bar{}, v_bar{};
                    bar(seen.number, c, u_bar, v_bar);
                    bars[slot_of(c, moving_numbers, seen.place)] += u_bar;
                    velocity_bar[c * model_.padded_ + seen.place] += v_bar;
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
    std::shared_ptr<const MlsOrder<T>> order_;
    std::vector<Tile> tiles_;
};

}  // namespace mphygs
