// Feedback from measured targets in MLS-MPM: what the channels ask for, and what it gives to particles.
//
// Particle p gets m_p dt a_p more momentum before its scatter, with a_p of observer.hpp: the grid gains what the
// particles are given, and weighs it by mass as it does all momentum. Held particles follow their hold.
// A pass gathers at n and scatters at n + 1 in one sweep, while a channel reads particles of many tiles at n + 1: those
// that the rows name are moved ahead of the sweep, once more with all others.
#pragma once

#include <algorithm>

#include "mphygs/team.hpp"
#include "mphygs/transfers/mls_mpm_forces.hpp"
#include "mphygs/transfers/mls_mpm_lanes.hpp"

namespace mphygs {

template <class T, int K>
class MlsObserver {
  public:
    using S = PackScalar<T, K>;
    using Q = Quad<T>;
    static constexpr int lanes = K + 1;

    MlsObserver(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const StepTable& table, const Schedule& schedule)
        : model_(model), inputs_(inputs), table_(table), steps_(schedule.steps) {
        if (!inputs.observer) {
            return;
        }
        const Observer& o = *inputs.observer;
        carriers_ = o.row_carrier;
        std::sort(carriers_.begin(), carriers_.end());
        carriers_.erase(std::unique(carriers_.begin(), carriers_.end()), carriers_.end());
        for (const std::int32_t id : o.row_carrier) {
            row_carrier_.push_back(static_cast<std::size_t>(std::lower_bound(carriers_.begin(), carriers_.end(), id) - carriers_.begin()));
        }
        row_weight_.assign(o.row_weight.begin(), o.row_weight.end());
        reach_weight_.assign(o.reach_weight.begin(), o.reach_weight.end());
        seen_.assign(static_cast<std::size_t>(lanes) * 8 * carriers_.size(), T{});
        wanted_.assign(static_cast<std::size_t>(lanes) * 4 * o.channel_count(), T{});
        int before = 0;
        for (const int steps : steps_) {
            first_.push_back(first_.empty() ? 0 : first_.back() + before);
            before = steps;
        }
    }

    bool active() const { return inputs_.observer != nullptr; }

    /// Before substep 0: velocity: (lanes, 3, size) [m/s].
    void begin(const std::shared_ptr<const MlsOrder<T>>& order, const Buffer<T>& moving, const std::vector<T>& velocity, Team& team) {
        follow(order);
        for (std::size_t e = 0; e < place_.size(); ++e) {
            for (std::size_t l = 0; known(e) && l < static_cast<std::size_t>(lanes); ++l) {
                for (std::size_t c = 0; c < 3; ++c) {
                    T* to = seen(l, carrier_[e]) + c;
                    to[0] = moving[l * moving_numbers * order->size + slot_of(c, moving_numbers, place_[e])];
                    to[4] = velocity[(3 * l + c) * order->size + place_[e]];
                }
            }
        }
        ask(0, team);
    }

    /// Before substep n + 1, from state n: moving and grid as they are there, h: the length of substep n [s].
    void advance(int n, const std::shared_ptr<const MlsOrder<T>>& order, const Buffer<T>& moving, const Buffer<T>& grid, const Box& box,
                 const std::vector<CellRange>& ranges, T h, Team& team) {
        follow(order);
        team.each(static_cast<int>(chunk_of_.size()), [&](int i) {
            const std::size_t at = static_cast<std::size_t>(i) * tile_size;
            MlsTile<T, K> tile;
            stand(tile, static_cast<std::size_t>(i), moving, box, ranges);
            gather_tile<T, K>(tile, grid.data(), 4 * box.nodes(), model_.axis_, box);
            for (std::size_t e = 0; e < tile_size; ++e) {
                for (std::size_t l = 0; known(at + e) && l < static_cast<std::size_t>(lanes); ++l) {
                    for (std::size_t c = 0; c < 3; ++c) {
                        T* to = seen(l, carrier_[at + e]) + c;
                        const T v = tile.q[l][c][e];
                        to[0] = moving[l * moving_numbers * order->size + slot_of(c, moving_numbers, place_[at + e])] + h * v;
                        to[4] = v;
                    }
                }
            }
        });
        ask(n + 1, team);
    }

    /// Adds what the tile's particles are given to their momentum; their masses are in the tile.
    void give(MlsTile<T, K>& tile, const MlsOrder<T>& order, std::size_t first) const {
        alignas(64) T gained[lanes][3][tile_size];
        if (!gains(order, first, gained)) {
            return;
        }
        for (std::size_t l = 0; l < static_cast<std::size_t>(lanes); ++l) {
            for (std::size_t c = 0; c < 3; ++c) {
                for (std::size_t q = 0; q < tile_size; ++q) {
                    tile.q[l][c][q] += tile.mass[0][q] * gained[l][c][q] + (l > 0 ? tile.mass[l][q] * gained[0][c][q] : T{});
                }
            }
        }
    }

  private:
    template <class U>
    friend class MlsObserverReverse;

    /// Velocity that a tile's particles gain in the substep, dt a [m/s]; false: none of them gains any.
    bool gains(const MlsOrder<T>& order, std::size_t first, T (*gained)[3][tile_size]) const {
        bool any = false;
        const std::size_t channels = inputs_.observer->channel_count();
        for (std::size_t q = 0; q < tile_size; ++q) {
            const auto [begin, end] = reach(order, first + q);
            any |= begin < end;
            for (std::size_t l = 0; l < static_cast<std::size_t>(lanes); ++l) {
                Q sum{};
                const T* from = wanted_.data() + 4 * l * channels;
                for (std::size_t r = begin; r < end; ++r) {
                    sum += reach_weight_[r] * read<Q>(from + 4 * static_cast<std::size_t>(inputs_.observer->reach_channel[r]));
                }
                for (int c = 0; c < 3; ++c) {
                    gained[l][c][q] = sum[c];
                }
            }
        }
        return any;
    }

    /// Which of the reach's entries are those of a particle; none of a held one or of padding.
    std::pair<std::size_t, std::size_t> reach(const MlsOrder<T>& order, std::size_t p) const {
        const std::size_t id = static_cast<std::size_t>(order.id[p]);
        if (id >= model_.particle_count() || order.hold[p] >= 0) {
            return {0, 0};
        }
        const std::vector<std::int32_t>& begin = inputs_.observer->reach_begin;
        return {static_cast<std::size_t>(begin[id]), static_cast<std::size_t>(begin[id + 1])};
    }

    /// Where the rows' particles lie, in tiles of one chunk each.
    void follow(const std::shared_ptr<const MlsOrder<T>>& order) {
        if (order == order_) {
            return;
        }
        order_ = order;
        place_.clear();
        carrier_.clear();
        chunk_of_.clear();
        std::vector<std::size_t> number(model_.particle_count(), carriers_.size());
        for (std::size_t k = 0; k < carriers_.size(); ++k) {
            number[static_cast<std::size_t>(carriers_[k])] = k;
        }
        const std::size_t tiles = order->size / tile_size;
        for (int c = 0; c < model_.chunk_count_; ++c) {
            const std::size_t begin = tile_size * part_begin(tiles, model_.chunk_count_, c);
            const std::size_t end = tile_size * part_begin(tiles, model_.chunk_count_, c + 1);
            for (std::size_t p = begin; p < end; ++p) {
                const std::size_t id = static_cast<std::size_t>(order->id[p]);
                if (id < number.size() && number[id] < carriers_.size()) {
                    place_.push_back(p);
                    carrier_.push_back(number[id]);
                }
            }
            while (place_.size() % tile_size != 0) {  // as the last one, and not known
                place_.push_back(place_.back());
                carrier_.push_back(carriers_.size());
            }
            chunk_of_.resize(place_.size() / tile_size, static_cast<std::size_t>(c));
        }
    }
    bool known(std::size_t e) const { return carrier_[e] < carriers_.size(); }
    /// Displacement [m] and, four on, velocity [m/s] of a carrier before the substep.
    T* seen(std::size_t l, std::size_t carrier) { return &seen_[8 * (l * carriers_.size() + carrier)]; }

    /// Stands tile i of the rows' particles on the grid.
    void stand(MlsTile<T, K>& tile, std::size_t i, const Buffer<T>& moving, const Box& box, const std::vector<CellRange>& ranges) const {
        CellRange inside;
        for (std::size_t k = 0; k < 3; ++k) {
            inside.low[k] = k == 0 ? ranges[chunk_of_[i]].low[0] : box.low[k] + 1;
            inside.high[k] = k == 0 ? ranges[chunk_of_[i]].high[0] : box.low[k] + box.count[k] - 2;
        }
        SeenRange<Pack<T>> ignored;
        for (int k = 0; k < tile_packs; ++k) {
            Vec3<S> x{};
            for (int q = 0; q < lane_count; ++q) {
                const std::size_t p = place_[i * tile_size + static_cast<std::size_t>(k * lane_count + q)];
                for (std::size_t c = 0; c < 3; ++c) {
                    for (int l = 0; l < lanes; ++l) {
                        const T u = moving[static_cast<std::size_t>(l) * moving_numbers * order_->size + slot_of(c, moving_numbers, p)];
                        lane_of(x[static_cast<int>(c)], l)[q] = l == 0 ? order_->rest[slot_of(c, rest_numbers, p)] + u : u;
                    }
                }
            }
            locate(tile, k, x, static_cast<T>(1.0 / model_.geometry_.spacing), model_.axis_, box, inside, ignored);
        }
    }

    TargetBasis basis(int n) const {
        const std::size_t frame = static_cast<std::size_t>(table_.frame[static_cast<std::size_t>(n)]);
        return {n - first_[frame], steps_[frame], table_.dt[static_cast<std::size_t>(n)]};
    }

    /// What every channel asks for at substep n, times dt [m/s].
    void ask(int n, Team& team) {
        const Observer& o = *inputs_.observer;
        const std::size_t count = o.channel_count(), from = static_cast<std::size_t>(table_.frame[static_cast<std::size_t>(n)]) * count;
        const TargetBasis b = basis(n);
        const T h = static_cast<T>(table_.dt[static_cast<std::size_t>(n)]);
        constexpr std::size_t together = 16;
        team.each(static_cast<int>((count + together - 1) / together), [&](int group) {
            const std::size_t first = static_cast<std::size_t>(group) * together;
            for (std::size_t i = first; i < std::min(count, first + together); ++i) {
                const T share = static_cast<T>(o.share[from + i]);
                for (std::size_t l = 0; l < static_cast<std::size_t>(lanes); ++l) {
                    const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
                    Q place{}, rate{};
                    for (std::size_t k = 0; share != T{} && fields && !fields->target.empty() && k < 4; ++k) {
                        const T* coefficient = &fields->target[((from + i) * 4 + k) * 3];
                        const T padded[4] = {coefficient[0], coefficient[1], coefficient[2], T{}};
                        const Q c = read<Q>(padded);
                        place += static_cast<T>(b.value[k]) * c;
                        rate += static_cast<T>(b.rate[k]) * c;
                    }
                    const std::size_t end = share == T{} ? 0 : static_cast<std::size_t>(o.row_begin[i + 1]);
                    for (std::size_t r = static_cast<std::size_t>(o.row_begin[i]); r < end; ++r) {
                        const T* u = seen(l, row_carrier_[r]);
                        place -= row_weight_[r] * read<Q>(u);
                        rate -= row_weight_[r] * read<Q>(u + 4);
                    }
                    write(&wanted_[4 * (l * count + i)], (h * share) * (static_cast<T>(o.stiffness) * place + static_cast<T>(o.damping) * rate));
                }
            }
        });
    }

    const MlsMpm<T>& model_;
    Inputs<T, K> inputs_;
    const StepTable& table_;
    std::vector<int> steps_, first_;                        // of every output interval: substeps, the first one
    std::vector<std::int32_t> carriers_;                    // particles that rows name, each once
    std::vector<std::size_t> row_carrier_;                  // their numbers among these
    std::vector<T> row_weight_, reach_weight_;
    std::vector<T> seen_;                                   // (lanes, carriers, 8)
    std::vector<T> wanted_;                                 // (lanes, channels, 4) [m/s]
    std::shared_ptr<const MlsOrder<T>> order_;
    std::vector<std::size_t> place_, carrier_, chunk_of_;   // of entries of tiles: particle, carrier; of tiles: chunk
};

}  // namespace mphygs
