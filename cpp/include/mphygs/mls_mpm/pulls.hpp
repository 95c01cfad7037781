// What feedback from measured targets gives to the particles of an MLS-MPM run.
#pragma once

#include <algorithm>
#include <memory>

#include "mphygs/mls_mpm/ahead.hpp"
#include "mphygs/physics/observer_rows.hpp"

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
          rows_(*inputs.observer, stride_, [&](std::size_t n) { return n < groups_ ? static_cast<std::int32_t>(n) : -1; }),
          ahead_(model) {
        given_.resize(static_cast<std::size_t>(lanes) * 3 * model.padded_);
        for (int l = 0; l < lanes; ++l) {
            pulled_[l].resize(3 * stride_);
        }
        first_step_ = schedule.first_steps();
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
        if (order == ahead_.order()) {
            return;
        }
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
        ahead_.follow(order, rows_.read_carriers(), place, chunks, begin);
    }

    /// What channels read at n + 1, from particles and grid at n; h: length of substep n.
    void see(const T* moving, const T* grid, const Box& box, T h) {
        ahead_.see(moving, grid, box, h, keep());
    }
    /// The same of the initial state. velocity: (lanes, 3, size).
    void see_start(const T* moving, const std::vector<T>& velocity) { ahead_.see_start(moving, velocity, keep()); }

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
        ahead_.unsee(moving, grid, box, h, inverse_spacing, bars, grid_of, bar());
    }
    /// `see_start` backwards. velocity_bar: (3, size).
    void unsee_start(T* bars, std::vector<T>& velocity_bar) const { ahead_.unsee_start(bars, velocity_bar, bar()); }

  private:
    auto keep() {
        return [this](int l, std::size_t number, std::size_t c, T u, T v) {
            blend_of(l)[quad * number + c] = rows_.stiffness() * u + rows_.damping() * v;
        };
    }
    auto bar() const {
        return [this](std::size_t number, std::size_t c, T& u_bar, T& v_bar) {
            const T bar = seen_bar_[quad * number + c];
            u_bar = rows_.stiffness() * bar;
            v_bar = rows_.damping() * bar;
        };
    }
    T dt() const { return static_cast<T>(table_.dt[static_cast<std::size_t>(n_)]); }
    TargetBasis basis() const {
        return {n_ - first_step_[interval_], schedule_.steps[interval_], table_.dt[static_cast<std::size_t>(n_)]};
    }
    std::vector<T>& blend_of(int l) {
        blend_[l].resize(quad * rows_.read_carriers().size());
        return blend_[l];
    }

    const MlsMpm<T>& model_;
    Inputs<T, K> inputs_;
    const Schedule& schedule_;
    const StepTable& table_;
    std::size_t groups_, stride_;  // of particles that are pulled alike; padded to whole packs
    ObserverRows<T> rows_;
    std::vector<int> first_step_;  // of every output interval
    MlsAhead<T, K> ahead_;
    std::vector<std::int32_t> group_;  // of every particle, in order; -1: none
    int n_ = 0;
    std::size_t interval_ = static_cast<std::size_t>(-1);
    bool pulling_ = false;
    std::vector<T> aims_[lanes], blend_[lanes], asked_[lanes], pulled_[lanes];  // see ObserverRows
    std::vector<T> given_;     // (lanes, 3, size) [m/s]
    std::vector<T> seen_bar_;  // (particles that channels read, quad)
};

}  // namespace mphygs
