// What tendons, pressures and known loads that change with time give to the particles of an MLS-MPM run.
#pragma once

#include <algorithm>
#include <memory>

#include "mphygs/mls_mpm/ahead.hpp"
#include "mphygs/physics/observer.hpp"

namespace mphygs {

template <class T, int K>
class MlsActuation {
  public:
    using S = PackScalar<T, K>;
    static constexpr int lanes = K + 1;

    MlsActuation(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const Schedule& schedule, const StepTable& table)
        : model_(model), loads_(model.geometry_.actuation), inputs_(inputs), schedule_(schedule), table_(table), ahead_(model), step_(loads_) {
        given_.resize(static_cast<std::size_t>(lanes) * 3 * model.padded_);
        for (int l = 0; l < lanes; ++l) {
            seen_[l].resize(step_.seen.size());
        }
        first_step_ = schedule.first_steps();
    }

    /// Moves to the forces of substep n.
    void enter(int n) { n_ = n; }

    /// Finds the particles in another order. begin(c): first particle of chunk c.
    template <class F>
    void follow(const std::shared_ptr<const MlsOrder<T>>& order, std::size_t chunks, const F& begin) {
        if (order == ahead_.order()) {
            return;
        }
        std::vector<std::size_t> place(model_.particle_count());
        for (std::size_t p = 0; p < order->size; ++p) {
            const std::size_t i = static_cast<std::size_t>(order->id[p]);
            if (i < place.size()) {
                place[i] = p;
            }
        }
        pushed_.clear();
        for (const std::int32_t i : loads_.pushed_carriers()) {
            pushed_.push_back(place[static_cast<std::size_t>(i)]);
        }
        std::fill(given_.begin(), given_.end(), T{});
        ahead_.follow(order, loads_.read_carriers(), place, chunks, begin);
    }

    /// Where particles are at n + 1, from particles and grid at n; h: length of substep n.
    void see(const T* moving, const T* grid, const Box& box, T h) { ahead_.see(moving, grid, box, h, keep()); }
    /// The same of the initial state. velocity: (lanes, 3, size).
    void see_start(const T* moving, const std::vector<T>& velocity) { ahead_.see_start(moving, velocity, keep()); }

    /// Turns what was seen into what every particle is given. posed: by the holds' poses, else they are at rest.
    void spread(bool posed = true) {
        const TargetBasis basis = this->basis();
        for (int l = 0; l < lanes; ++l) {
            const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
            if (!fields && posed) {
                continue;  // no direction at all; at rest it stands in the state alone
            }
            step_.seen.assign(seen_[l].begin(), seen_[l].end());
            step_.channels_of(fields ? &fields->channel : nullptr, interval(), basis.value);
            step_.poses.clear();
            const std::size_t holds = posed && !fields->pose.empty() ? static_cast<std::size_t>(model_.geometry_.hold_count) : 0;
            for (std::size_t i = 0; i < 12 * holds; ++i) {
                step_.poses.push_back(static_cast<double>(fields->pose[pose_at(i / 12) + i % 12]));
            }
            l == 0 ? step_.value() : step_.change();
            T* to = &given_[3 * static_cast<std::size_t>(l) * model_.padded_];
            for (std::size_t i = 0; i < step_.pushed.size(); ++i) {
                // A held particle has its hold's velocity, whatever pushes it.
                to[i % 3 * model_.padded_ + pushed_[i / 3]] = held(i / 3) ? T{} : static_cast<T>(dt() * step_.pushed[i]);
            }
        }
    }

    /// Adds the momentum that a substep's loads give to eight particles [kg m/s]; apart, so that the code around it stays as it
    /// is without loads.
    [[gnu::noinline]] void give(std::size_t first, Vec3<S>& momentum) const {
        for (int l = 0; l < lanes; ++l) {
            for (std::size_t c = 0; c < 3; ++c) {
                Pack<T>& to = lane_of(momentum[static_cast<int>(c)], l);
                to = to + load<T>(values(first, c, l));
            }
        }
    }
    const T* values(std::size_t first, std::size_t c, int l = 0) const {
        return &given_[(3 * static_cast<std::size_t>(l) + c) * model_.padded_ + first];
    }

    /// From the bars of what was given, (3, size), to those of channels, poses and of what was seen.
    void reverse(const std::vector<T>& given_bar, std::vector<double>& channel_bar, std::vector<double>& pose_bar) {
        for (std::size_t i = 0; i < step_.pushed.size(); ++i) {
            step_.pushed[i] = held(i / 3) ? 0.0 : dt() * static_cast<double>(given_bar[i % 3 * model_.padded_ + pushed_[i / 3]]);
        }
        step_.reverse();
        step_.add_channels_bar(interval(), basis().value, channel_bar);
        for (std::size_t i = 0; i < step_.poses.size(); ++i) {
            pose_bar[pose_at(i / 12) + i % 12] += step_.poses[i];
        }
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
        return [this](int l, std::size_t number, std::size_t c, T u, T) { seen_[l][3 * number + c] = u; };
    }
    auto bar() const {
        return [this](std::size_t number, std::size_t c, T& u_bar, T&) { u_bar = static_cast<T>(step_.seen[3 * number + c]); };
    }
    /// First of the twelve numbers of a hold's pose before the substep.
    std::size_t pose_at(std::size_t hold) const {
        return (hold * static_cast<std::size_t>(table_.count() + 1) + static_cast<std::size_t>(n_)) * 12;
    }
    bool held(std::size_t pushed) const { return ahead_.order()->hold[pushed_[pushed]] >= 0; }
    std::size_t interval() const { return static_cast<std::size_t>(table_.frame[static_cast<std::size_t>(n_)]); }
    double dt() const { return table_.dt[static_cast<std::size_t>(n_)]; }
    TargetBasis basis() const { return {n_ - first_step_[interval()], schedule_.steps[interval()], dt()}; }

    const MlsMpm<T>& model_;
    const Actuation& loads_;
    Inputs<T, K> inputs_;
    const Schedule& schedule_;
    const StepTable& table_;
    MlsAhead<T, K> ahead_;
    ActuationStep step_;
    std::vector<int> first_step_;      // of every output interval
    std::vector<std::size_t> pushed_;  // where they are among the particles, in order
    int n_ = 0;
    std::vector<T> seen_[lanes];  // (particles that are read, 3) [m]
    std::vector<T> given_;        // (lanes, 3, size) [kg m/s]
};

}  // namespace mphygs
