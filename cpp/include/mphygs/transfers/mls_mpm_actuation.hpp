// What tendons, pressures and known loads that change with time give to the particles of an MLS-MPM run.
#pragma once

#include <algorithm>
#include <memory>

#include "mphygs/observer.hpp"
#include "mphygs/transfers/mls_mpm_ahead.hpp"

namespace mphygs {

template <class T, int K>
class MlsActuation {
  public:
    using S = PackScalar<T, K>;
    static constexpr int lanes = K + 1;

    MlsActuation(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const Schedule& schedule, const StepTable& table)
        : model_(model), loads_(model.geometry_.actuation), inputs_(inputs), schedule_(schedule), table_(table), ahead_(model) {
        given_.resize(static_cast<std::size_t>(lanes) * 3 * model.padded_);
        number_.assign(model.particle_count(), 0);
        for (std::size_t k = 0; k < loads_.read_carriers().size(); ++k) {
            number_[static_cast<std::size_t>(loads_.read_carriers()[k])] = k;
        }
        for (int l = 0; l < lanes; ++l) {
            seen_[l].assign(3 * loads_.read_carriers().size(), 0.0);
        }
        int first = 0;
        for (const int steps : schedule.steps) {
            first_step_.push_back(first);
            first += steps;
        }
    }

    /// Moves to the forces of substep n.
    void enter(int n) { n_ = n; }

    /// Finds the particles in another order. begin(c): first particle of chunk c.
    template <class F>
    void follow(const std::shared_ptr<const MlsOrder<T>>& order, std::size_t chunks, const F& begin) {
        if (order == ahead_.order()) {
            return;
        }
        place_.assign(model_.particle_count(), 0);
        for (std::size_t p = 0; p < order->size; ++p) {
            const std::size_t i = static_cast<std::size_t>(order->id[p]);
            if (i < place_.size()) {
                place_[i] = p;
            }
        }
        std::fill(given_.begin(), given_.end(), T{});
        ahead_.follow(order, loads_.read_carriers(), place_, chunks, begin);
    }

    /// Where particles are at n + 1, from particles and grid at n; h: length of substep n.
    void see(const T* moving, const T* grid, const Box& box, T h) { ahead_.see(moving, grid, box, h, keep()); }
    /// The same of the initial state. velocity: (lanes, 3, size).
    void see_start(const T* moving, const std::vector<T>& velocity) { ahead_.see_start(moving, velocity, keep()); }

    /// Turns what was seen into what every particle is given. posed: by the holds' poses, else they are at rest.
    void spread(bool posed = true) {
        const TargetBasis basis = this->basis();
        loads_.channels_at(&inputs_.primal->channel, interval(), basis.value, channels_[0]);
        gather(0);
        const auto pose = pose_of(*inputs_.primal);
        loads_.place_points(posed ? &pose : nullptr, points_[0]);
        loads_.forces(points_[0], channels_[0], force_);
        give(0);
        if constexpr (lanes > 1) {
            for (int l = 1; l < lanes; ++l) {
                const Fields<T>* direction = inputs_.direction[l - 1];
                if (!direction && posed) {
                    continue;  // no direction at all; at rest it stands in the state alone
                }
                loads_.channels_at(direction ? &direction->channel : nullptr, interval(), basis.value, channels_[l]);
                gather(l);
                if (direction && !direction->pose.empty()) {
                    loads_.move_points(pose_of(*direction), points_[l]);
                }
                loads_.forces_change(points_[0], channels_[0], points_[l], channels_[l], force_);
                give(l);
            }
        }
    }

    /// Momentum that a substep's loads give to eight particles [kg m/s].
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

    /// From the bars of what was given, (3, size), to those of channels, poses and of what was seen. pose(hold): its first number.
    template <class F>
    void reverse(const std::vector<T>& given_bar, std::vector<double>& channel_bar, std::vector<double>& pose_bar, const F& pose) {
        const TargetBasis basis = this->basis();
        std::vector<double> force_bar, points_bar, channels_bar;
        const double h = dt();
        loads_.gather(
            [&](std::size_t i, std::size_t c) { return held(i) ? 0.0 : h * static_cast<double>(given_bar[c * model_.padded_ + place_[i]]); }, true,
            force_bar);
        loads_.forces_bar(points_[0], channels_[0], force_bar, points_bar, channels_bar);
        loads_.channels_bar(channels_bar, interval(), basis.value, channel_bar);
        loads_.pose_bar(points_bar, [&](std::size_t hold, std::size_t i, double bar) { pose_bar[pose(hold) + i] += bar; });
        seen_bar_.assign(seen_[0].size(), 0.0);
        loads_.scatter(points_bar, false, [&](std::size_t i, std::size_t c, double bar) { seen_bar_[3 * number_[i] + c] += bar; });
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
        return [this](int l, std::size_t number, std::size_t c, T u, T) { seen_[l][3 * number + c] = static_cast<double>(u); };
    }
    auto bar() const {
        return [this](std::size_t number, std::size_t c, T& u_bar, T&) { u_bar = static_cast<T>(seen_bar_[3 * number + c]); };
    }
    auto pose_of(const Fields<T>& fields) const {
        return [this, &fields](std::size_t hold, std::size_t i) {
            const std::size_t row = hold * static_cast<std::size_t>(table_.count() + 1) + static_cast<std::size_t>(n_);
            return static_cast<double>(fields.pose[12 * row + i]);
        };
    }
    void gather(int l) {
        loads_.gather([&](std::size_t i, std::size_t c) { return seen_[l][3 * number_[i] + c]; }, false, points_[l]);
    }
    /// Momentum of a lane's forces, which stand at the points; what was given before is taken away.
    void give(int l) {
        const double h = dt();
        T* to = &given_[3 * static_cast<std::size_t>(l) * model_.padded_];
        for (const bool first : {true, false}) {
            loads_.scatter(force_, true, [&](std::size_t i, std::size_t c, double x) {
                T& number = to[c * model_.padded_ + place_[i]];
                number = first || held(i) ? T{} : number + static_cast<T>(h * x);
            });
        }
    }
    /// A held particle has its hold's velocity, whatever pushes it.
    bool held(std::size_t particle) const { return ahead_.order()->hold[place_[particle]] >= 0; }
    std::size_t interval() const { return static_cast<std::size_t>(table_.frame[static_cast<std::size_t>(n_)]); }
    double dt() const { return table_.dt[static_cast<std::size_t>(n_)]; }
    TargetBasis basis() const { return {n_ - first_step_[interval()], schedule_.steps[interval()], dt()}; }

    const MlsMpm<T>& model_;
    const Actuation& loads_;
    Inputs<T, K> inputs_;
    const Schedule& schedule_;
    const StepTable& table_;
    MlsAhead<T, K> ahead_;
    std::vector<int> first_step_;        // of every output interval
    std::vector<std::size_t> place_;     // of every particle, in order
    std::vector<std::size_t> number_;    // of every particle that is read, among those
    int n_ = 0;
    std::vector<double> seen_[lanes], seen_bar_;             // (particles that are read, 3) [m]
    std::vector<double> points_[lanes], channels_[lanes], force_;  // see Actuation
    std::vector<T> given_;                                   // (lanes, 3, size) [kg m/s]
};

}  // namespace mphygs
