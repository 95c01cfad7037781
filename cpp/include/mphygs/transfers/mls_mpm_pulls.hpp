// What feedback from measured targets gives to the particles of an MLS-MPM run.
//
// The forces at n + 1 pull by what is off at n + 1, which the sweep that gives them finds as it goes. So the few particles
// that channels read are gathered ahead of it, from the grid at n, as the sweep will gather them.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>

#include "mphygs/observer_rows.hpp"
#include "mphygs/transfers/mls_mpm_forces.hpp"
#include "mphygs/transfers/mls_mpm_lanes.hpp"
#include "mphygs/transfers/mls_mpm_rows_reverse.hpp"

namespace mphygs {

template <class T, int K>
class MlsPulls {
  public:
    using S = PackScalar<T, K>;
    static constexpr int lanes = K + 1;
    static constexpr std::size_t quad = ObserverRows<T>::quad;

    MlsPulls(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const Schedule& schedule, const StepTable& table)
        : model_(model), inputs_(inputs), schedule_(schedule), table_(table), groups_(inputs.observer->reach_begin.size() - 1),
          stride_((groups_ + lane_count - 1) / lane_count * lane_count),
          rows_(*inputs.observer, stride_, [&](std::size_t n) { return n < groups_ ? static_cast<std::int32_t>(n) : -1; }) {
        given_.resize(static_cast<std::size_t>(lanes) * 3 * model.padded_);
        for (int l = 0; l < lanes; ++l) {
            pulled_[l].resize(3 * stride_);
        }
        int first = 0;
        for (const int steps : schedule.steps) {
            first_step_.push_back(first);
            first += steps;
        }
    }

    /// Moves to the forces of substep n; false where nothing pulls then, and nothing is given.
    bool enter(int n) {
        const std::size_t interval = static_cast<std::size_t>(table_.frame[static_cast<std::size_t>(n)]);
        n_ = n;
        if (interval != interval_) {
            interval_ = interval;
            pulling_ = rows_.pulls(interval);
            for (int l = 0; l < lanes; ++l) {
                const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
                rows_.aim(interval, fields ? fields->target : std::vector<T>{}, aims_[l]);
            }
        }
        return pulling_;
    }
    bool pulling() const { return pulling_; }

    /// Finds the particles in another order. begin(c): first particle of chunk c.
    template <class F>
    void follow(const std::shared_ptr<const MlsOrder<T>>& order, std::size_t chunks, const F& begin) {
        if (order == order_) {
            return;
        }
        order_ = order;
        const std::size_t count = model_.particle_count();
        std::vector<std::size_t> place(count);
        group_.assign(order->size, -1);
        for (std::size_t p = 0; p < order->size; ++p) {
            const std::size_t i = static_cast<std::size_t>(order->id[p]);
            if (i < count) {
                place[i] = p;
                group_[p] = order->hold[p] < 0 ? inputs_.observer->reach_row_of(i) : -1;  // holds have their own velocity
            }
        }
        const std::vector<std::size_t>& read = rows_.read_carriers();
        std::vector<std::vector<Seen>> of_chunk(chunks);
        for (std::size_t k = 0; k < read.size(); ++k) {
            std::size_t c = 0;
            while (begin(c + 1) <= place[read[k]]) {
                ++c;
            }
            of_chunk[c].push_back({place[read[k]], k});
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

    /// What channels read at n + 1, from particles and grid at n; h: length of substep n.
    void see(const T* moving, const T* grid, const Box& box, T h) {
        MlsTile<T, K> tile;
        for (const Tile& t : tiles_) {
            gather(t, moving, grid, box, tile);
            each_of(t, [&](std::size_t q, const Seen& seen) {
                for (int l = 0; l < lanes; ++l) {
                    const std::size_t lane = static_cast<std::size_t>(l) * moving_numbers * model_.padded_;
                    for (std::size_t c = 0; c < 3; ++c) {
                        const T v = tile.q[l][c][q], u = moving[lane + slot_of(c, moving_numbers, seen.place)] + h * v;
                        blend_of(l)[quad * seen.number + c] = rows_.stiffness() * u + rows_.damping() * v;
                    }
                }
            });
        }
    }
    /// The same of the initial state. velocity: (lanes, 3, size).
    void see_start(const T* moving, const std::vector<T>& velocity) {
        for (const Tile& t : tiles_) {
            each_of(t, [&](std::size_t, const Seen& seen) {
                for (int l = 0; l < lanes; ++l) {
                    const std::size_t lane = static_cast<std::size_t>(l);
                    for (std::size_t c = 0; c < 3; ++c) {
                        blend_of(l)[quad * seen.number + c] =
                            rows_.stiffness() * moving[lane * moving_numbers * model_.padded_ + slot_of(c, moving_numbers, seen.place)] +
                            rows_.damping() * velocity[(3 * lane + c) * model_.padded_ + seen.place];
                    }
                }
            });
        }
    }

    /// Turns what was seen into what every particle is given.
    void spread(Team& team) {
        const auto factors = rows_.factors(basis());
        std::vector<const T*> asked;
        std::vector<T*> pulled;
        for (int l = 0; l < lanes; ++l) {
            rows_.ask(interval_, factors, aims_[l], blend_of(l), asked_[l]);
            asked.push_back(asked_[l].data());
            pulled.push_back(pulled_[l].data());
        }
        rows_.pull(team, dt(), asked, pulled);
        const std::size_t size = model_.padded_;
        for (int l = 0; l < lanes; ++l) {
            for (std::size_t c = 0; c < 3; ++c) {
                T* to = &given_[(3 * static_cast<std::size_t>(l) + c) * size];
                const T* from = &pulled_[l][c * stride_];
                for (std::size_t p = 0; p < size; ++p) {
                    to[p] = group_[p] < 0 ? T{} : from[group_[p]];
                }
            }
        }
    }

    /// Velocity that a substep's pulls give to eight particles [m/s].
    Vec3<S> given(std::size_t first) const {
        Vec3<S> g;
        for (int l = 0; l < lanes; ++l) {
            for (std::size_t c = 0; c < 3; ++c) {
                lane_of(g[static_cast<int>(c)], l) = load<T>(values(first, c, l));
            }
        }
        return g;
    }
    const T* values(std::size_t first, std::size_t c, int l = 0) const {
        return &given_[(3 * static_cast<std::size_t>(l) + c) * model_.padded_ + first];
    }

    /// From the bars of what was given, (3, size), to target_bar and to those of what was seen.
    void reverse(const std::vector<T>& given_bar, std::vector<double>& target_bar) {
        std::fill(pulled_[0].begin(), pulled_[0].end(), T{});
        for (std::size_t c = 0; c < 3; ++c) {
            for (std::size_t p = 0; p < model_.padded_; ++p) {
                if (group_[p] >= 0) {
                    pulled_[0][c * stride_ + static_cast<std::size_t>(group_[p])] += given_bar[c * model_.padded_ + p];
                }
            }
        }
        rows_.pull_bar(dt(), pulled_[0].data(), asked_[0]);
        rows_.ask_bar(interval_, basis(), asked_[0], target_bar, seen_bar_);
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
            each_of(t, [&](std::size_t q, const Seen& seen) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const T bar = seen_bar_[quad * seen.number + c], u_bar = rows_.stiffness() * bar;
                    bars[slot_of(c, moving_numbers, seen.place)] += u_bar;
                    tile.q[0][c][q] = rows_.damping() * bar + h * u_bar;
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
    void unsee_start(T* bars, std::vector<T>& velocity_bar) const {
        for (const Tile& t : tiles_) {
            each_of(t, [&](std::size_t, const Seen& seen) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const T bar = seen_bar_[quad * seen.number + c];
                    bars[slot_of(c, moving_numbers, seen.place)] += rows_.stiffness() * bar;
                    velocity_bar[c * model_.padded_ + seen.place] += rows_.damping() * bar;
                }
            });
        }
    }

  private:
    struct Seen {
        std::size_t place, number;  // among the particles, and among those that channels read
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
    T dt() const { return static_cast<T>(table_.dt[static_cast<std::size_t>(n_)]); }
    TargetBasis basis() const {
        return {n_ - first_step_[interval_], schedule_.steps[interval_], table_.dt[static_cast<std::size_t>(n_)]};
    }
    std::vector<T>& blend_of(int l) {
        blend_[l].resize(quad * rows_.read_carriers().size());
        return blend_[l];
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
    Inputs<T, K> inputs_;
    const Schedule& schedule_;
    const StepTable& table_;
    std::size_t groups_, stride_;  // of particles that are pulled alike; padded to whole packs
    ObserverRows<T> rows_;
    std::vector<int> first_step_;  // of every output interval
    std::shared_ptr<const MlsOrder<T>> order_;
    std::vector<std::int32_t> group_;  // of every particle, in order; -1: none
    std::vector<Tile> tiles_;
    int n_ = 0;
    std::size_t interval_ = static_cast<std::size_t>(-1);
    bool pulling_ = false;
    std::vector<T> aims_[lanes], blend_[lanes], asked_[lanes], pulled_[lanes];  // see ObserverRows
    std::vector<T> given_;     // (lanes, 3, size) [m/s]
    std::vector<T> seen_bar_;  // (particles that channels read, quad)
};

}  // namespace mphygs
