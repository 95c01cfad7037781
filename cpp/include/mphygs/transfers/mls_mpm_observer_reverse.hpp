// Adjoint of MlsObserver: from the bars of the momentum that particles are given to those of targets and of what was read.
//
// All is linear but for the places where the rows' particles took their velocities: after the sweep of a substep those
// particles give their bars to the grid at n once more, beside all others.
#pragma once

#include "mphygs/transfers/mls_mpm_forces_reverse.hpp"
#include "mphygs/transfers/mls_mpm_observer.hpp"
#include "mphygs/transfers/mls_mpm_rows_reverse.hpp"

namespace mphygs {

template <class T>
class MlsObserverReverse {
  public:
    using Forward = MlsObserver<T, 0>;
    using Sum = Vector<double, 4>;

    MlsObserverReverse(const MlsMpm<T>& model, Forward& forward, const Fields<T>& fields)
        : target_bar(fields.target.size(), 0.0), model_(model), forward_(forward), asked_(static_cast<std::size_t>(model.chunk_count_)) {
        if (forward.active()) {
            for (std::vector<double>& sums : asked_) {
                sums.assign(4 * forward.inputs_.observer->channel_count(), 0.0);
            }
            seen_bar_.assign(8 * forward.carriers_.size(), 0.0);
        }
    }

    /// Particles of one tile of chunk c: bars of their momentum -> of their mass, and of what is asked for.
    void reverse_given(std::size_t c, const MlsOrder<T>& order, std::size_t first, const MlsTile<T, 0>& given, const MlsTile<T, 0>& bars,
                       MlsParticleBars<T>& particles) {
        alignas(64) T gained[1][3][tile_size];
        if (!forward_.gains(order, first, gained)) {
            return;
        }
        for (std::size_t q = 0; q < tile_size; ++q) {
            const auto [begin, end] = forward_.reach(order, first + q);
            if (begin == end) {
                continue;
            }
            T work{};
            double momentum[4] = {};
            for (std::size_t a = 0; a < 3; ++a) {
                work += bars.q[0][a][q] * gained[0][a][q];
                momentum[a] = static_cast<double>(given.mass[0][q] * bars.q[0][a][q]);
            }
            *particles.at(fixed_mass, first + q) += work;
            const Sum bar = read<Sum>(momentum);
            for (std::size_t r = begin; r < end; ++r) {
                double* to = &asked_[c][4 * static_cast<std::size_t>(forward_.inputs_.observer->reach_channel[r])];
                write(to, read<Sum>(to) + static_cast<double>(forward_.reach_weight_[r]) * bar);
            }
        }
    }

    /// Bars of what is asked for at substep n, summed -> of the targets, and of what the carriers were seen to do.
    void reverse_ask(int n) {
        const Observer& o = *forward_.inputs_.observer;
        const std::size_t frame = static_cast<std::size_t>(forward_.table_.frame[static_cast<std::size_t>(n)]), count = o.channel_count();
        const TargetBasis b = forward_.basis(n);
        const double dt = forward_.table_.dt[static_cast<std::size_t>(n)];
        std::fill(seen_bar_.begin(), seen_bar_.end(), 0.0);
        for (std::size_t i = 0; i < count; ++i) {
            Sum asked{};
            for (std::vector<double>& sums : asked_) {
                asked += read<Sum>(&sums[4 * i]);
                write(&sums[4 * i], Sum{});
            }
            const double share = dt * o.share[frame * count + i];
            if (share == 0.0) {
                continue;
            }
            const Sum place = (share * o.stiffness) * asked, rate = (share * o.damping) * asked;
            for (std::size_t k = 0; k < 4; ++k) {
                const Sum bar = b.value[k] * place + b.rate[k] * rate;
                for (int a = 0; a < 3; ++a) {
                    target_bar[((frame * count + i) * 4 + k) * 3 + static_cast<std::size_t>(a)] += bar[a];
                }
            }
            for (std::size_t r = static_cast<std::size_t>(o.row_begin[i]); r < static_cast<std::size_t>(o.row_begin[i + 1]); ++r) {
                double* to = &seen_bar_[8 * forward_.row_carrier_[r]];
                write(to, read<Sum>(to) - o.row_weight[r] * place);
                write(to + 4, read<Sum>(to + 4) - o.row_weight[r] * rate);
            }
        }
    }

    /// Bars of the carriers' places and velocities at the start -> of the run's: bars as what moves, velocity_bar (3, size).
    void reverse_begin(Buffer<T>& bars, std::vector<T>& velocity_bar) const {
        for (std::size_t e = 0; e < forward_.place_.size(); ++e) {
            for (std::size_t a = 0; forward_.known(e) && a < 3; ++a) {
                const double* bar = &seen_bar_[8 * forward_.carrier_[e]];
                bars[slot_of(a, moving_numbers, forward_.place_[e])] += static_cast<T>(bar[a]);
                velocity_bar[a * forward_.order_->size + forward_.place_[e]] += static_cast<T>(bar[4 + a]);
            }
        }
    }

    /// The same after a substep of length h: bars of what moves and of the grid's velocities before it. private_grid(c):
    /// where chunk c's go.
    template <class F>
    void reverse_advance(const MlsState<T>& record, T h, Team& team, const F& private_grid, Buffer<T>& bars) const {
        const T inverse_spacing = static_cast<T>(1.0 / model_.geometry_.spacing);
        const std::vector<std::size_t>& chunk_of = forward_.chunk_of_;
        team.each(model_.chunk_count_, [&](int chunk) {
            const auto [begin, end] = std::equal_range(chunk_of.begin(), chunk_of.end(), static_cast<std::size_t>(chunk));
            for (auto own = begin; own != end; ++own) {
                const std::size_t i = static_cast<std::size_t>(own - chunk_of.begin());
                MlsTile<T, 0> tile{};
                alignas(64) T velocity[3][tile_size] = {};
                forward_.stand(tile, i, record.moving, record.box, record.ranges);
                for (std::size_t q = 0; q < tile_size; ++q) {
                    const std::size_t e = i * tile_size + q;
                    for (std::size_t a = 0; forward_.known(e) && a < 3; ++a) {
                        const double* bar = &seen_bar_[8 * forward_.carrier_[e]];
                        tile.q[0][a][q] = static_cast<T>(bar[4 + a] + static_cast<double>(h) * bar[a]);
                        velocity[a][q] = forward_.seen_[8 * forward_.carrier_[e] + 4 + a];
                    }
                }
                TileSlope<T> slope;
                reverse_gather_rows<T>(tile, velocity, record.grid.data(), private_grid(static_cast<std::size_t>(chunk)), model_.axis_,
                                       record.box, slope);
                for (std::size_t q = 0; q < tile_size; ++q) {
                    const std::size_t e = i * tile_size + q;
                    for (std::size_t k = 0; forward_.known(e) && k < 3; ++k) {
                        const std::size_t a = static_cast<std::size_t>(model_.axis_[k]);
                        bars[slot_of(a, moving_numbers, forward_.place_[e])] +=
                            static_cast<T>(seen_bar_[8 * forward_.carrier_[e] + a]) + inverse_spacing * slope.by[k][q];
                    }
                }
            }
        });
    }

    std::vector<double> target_bar;  // (F, M, 4, 3)

  private:
    const MlsMpm<T>& model_;
    Forward& forward_;
    std::vector<std::vector<double>> asked_;  // of each chunk: (channels, 4)
    std::vector<double> seen_bar_;            // (carriers, 8)
};

}  // namespace mphygs
