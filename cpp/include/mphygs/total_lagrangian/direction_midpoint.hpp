// The implicit step of a run's directions: the derivative of the midpoint's fixed point, all directions at once.
#pragma once

#include "mphygs/total_lagrangian/directions.hpp"
#include "mphygs/total_lagrangian/midpoint.hpp"

namespace mphygs {

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::enter(const Eigen::MatrixXd& x) {
    std::fill(v_.begin(), v_.end(), W{});
    T* to = reinterpret_cast<T*>(v_.data());
    for (Eigen::Index k = 0; k < x.cols(); ++k) {
        T* lane = to + (static_cast<std::size_t>(k) / width * slab_) * width + static_cast<std::size_t>(k) % width;
        for (Eigen::Index i = 0; i < x.rows(); ++i) {
            lane[static_cast<std::size_t>(i) * width] = static_cast<T>(x(i, k));
        }
    }
}

template <class T, int L>
inline Eigen::MatrixXd TotalLagrangianDirections<T, L>::velocities() const {
    Eigen::MatrixXd x(static_cast<Eigen::Index>(3 * model_.node_count()), static_cast<Eigen::Index>(directions_.size()));
    const T* from = reinterpret_cast<const T*>(v_.data());
    for (Eigen::Index k = 0; k < x.cols(); ++k) {
        const T* lane = from + (static_cast<std::size_t>(k) / width * slab_) * width + static_cast<std::size_t>(k) % width;
        for (Eigen::Index i = 0; i < x.rows(); ++i) {
            x(i, k) = static_cast<double>(lane[static_cast<std::size_t>(i) * width]);
        }
    }
    return x;
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::still_without_mass() {
    for (std::size_t n = 0; n < model_.node_count(); ++n) {
        for (std::size_t s = 0; s < slabs_ && value_.inverse_mass_[n] == T{}; ++s) {
            std::fill_n(&v_[s * slab_ + 3 * n], 3, W{});
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::share_inertia(double span) {
    const T share = static_cast<T>(1.0 / span);
    for (std::size_t s = 0; s < slabs_; ++s) {
        push_each_other<W>(
            value_.shared_mass_,
            [&](std::size_t n, std::size_t c) { return v_[s * slab_ + 3 * n + c] - v0_[s * slab_ + 3 * n + c]; },
            [&](std::size_t n, std::size_t c, const W& force) { f_[s * slab_ + 3 * n + c] += share * force; });
    }
    const MidpointState<T>& m = *value_.midpoint_;
    for (std::size_t k = 0; k < shared_mass_.size(); ++k) {
        T* to = reinterpret_cast<T*>(&f_[k / width * slab_]) + k % width;
        push_each_other<T>(
            shared_mass_[k],
            [&](std::size_t n, std::size_t c) { return m.middle[value_.at(0, c, n)] - m.v0[value_.at(0, c, n)]; },
            [&](std::size_t n, std::size_t c, T force) { to[(3 * n + c) * width] += share * force; });
    }
}

/// The derivative of the midpoint's map along changes x of its velocity and along the directions, left in the velocity.
template <class T, int L>
inline void TotalLagrangianDirections<T, L>::midpoint_map(const Eigen::MatrixXd& x, int n, int frame, double middle, double dt, bool last) {
    const SubstepRule rule = value_.rule(n);
    const double span = rule.span * dt, elapsed = rule.elapsed * dt;
    const bool pulls = value_.observer_ && value_.pulling_;
    enter(x);
    for (std::size_t i = 0; i < v_.size(); ++i) {
        u_[i] = u0_[i] + static_cast<T>(span) * v_[i];
    }
    history_ = history0_;
    for (std::size_t a = 0; a < added_.size(); ++a) {
        added_[a].forces = added0_[a].forces;
    }
    team_->each(static_cast<int>(model_.chunks_.size()), [&](int c) { chunk_forces(static_cast<std::size_t>(c), middle, elapsed); });
    reduce_forces();
    place_forces(middle);
    hook_forces(middle, elapsed);
    known_forces(frame);
    actuate(n, frame, dt);
    share_inertia(span);
    if (pulls) {
        ask(n, frame, dt);
        spread_pulls(span);
    }
    const std::vector<W> before = v_;
    accelerate(middle, span);
    if (pulls) {
        add_pulls();
    }
    lighten(span);
    for (std::size_t i = 0; i < v_.size(); ++i) {
        v_[i] = v0_[i] + (v_[i] - before[i]);
    }
    u_ = u0_;
    still_without_mass();
    hold(n, frame, rule.reach * dt, true, last);
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::midpoint_step(int n, int frame, double time, double dt) {
    using Tolerance = MidpointTolerance<T>;
    constexpr int most = 100, patience = 25;
    constexpr double few = 10.0;  // times round-off, which is not alike each time
    value_.solve_midpoint(n, frame, time, dt);
    value_.stand_at_middle();
    MidpointState<T>& m = *value_.midpoint_;
    const SubstepRule rule = value_.rule(n);
    const double middle = time + rule.at * dt;
    u0_ = u_;
    v0_ = v_;
    for (std::size_t i = 0; rule.second && i < u_.size(); ++i) {
        u0_[i] = static_cast<T>(rule.last) * u_[i] - static_cast<T>(rule.before) * past_u_[i];
        v0_[i] = static_cast<T>(rule.last) * v_[i] - static_cast<T>(rule.before) * past_v_[i];
    }
    if (schedule_.paired && !rule.second) {
        past_u_ = u_;
        past_v_ = v_;
    }
    history0_ = history_;
    refresh(middle, rule.elapsed * dt);
    added0_ = added_;
    m.matrix.used_at(value_.turns_at_middle());
    Eigen::MatrixXd x = velocities();
    const std::size_t count = directions_.size();
    std::vector<Anderson> mixed(count, Anderson(m.matrix.weight(), 20));
    std::vector<double> before(count, std::numeric_limits<double>::infinity());
    // The map is b + L x: what a multiple of x changes beside the same multiple of that change is round-off, of terms that
    // cancel, as those of a modulus and of the rest shape that goes with it do where nothing moves.
    const auto round_off = [&](const Eigen::MatrixXd& at, const Eigen::MatrixXd& mapped) {
        const double more = 0.1;
        const auto map = [&](const Eigen::MatrixXd& of) {
            midpoint_map(of, n, frame, middle, dt, false);
            return velocities();
        };
        const Eigen::MatrixXd further = map((1.0 + more) * at), none = map(Eigen::MatrixXd::Zero(at.rows(), at.cols()));
        const Eigen::MatrixXd left = m.matrix.solve(further - (1.0 + more) * mapped + more * none);
        m.noises.resize(count);
        for (std::size_t k = 0; k < count; ++k) {
            m.noises[k] = std::max(m.noises[k], m.matrix.size(left.col(static_cast<Eigen::Index>(k))));
        }
    };
    bool fresh = false, settled = false;
    int i = 0;
    for (;; ++i) {
        midpoint_map(x, n, frame, middle, dt, settled);
        if (settled) {
            break;
        }
        m.spend(static_cast<double>(count));
        const Eigen::MatrixXd mapped = velocities(), d = m.matrix.solve(mapped - x), at = x;
        settled = true;
        bool stalled = false;
        for (std::size_t k = 0; k < count; ++k) {
            const Eigen::Index column = static_cast<Eigen::Index>(k);
            const double size = m.matrix.size(d.col(column)), moves = m.matrix.size(x.col(column) + d.col(column));
            // A correction says how far x was off; what is left after it is as much smaller again.
            const double rate = std::isfinite(before[k]) ? std::min(1.0, size / before[k]) : 1.0;
            const bool good = size * rate <= Tolerance::linear * moves || (!m.noises.empty() && size <= few * m.noises[k]);
            settled = settled && good;
            stalled = stalled || (!good && rate > 0.5);
            before[k] = size;
            x.col(column) = mixed[k].next(x.col(column), d.col(column));
        }
        if (stalled && i > 0) {
            round_off(at, mapped);
        }
        if (!x.allFinite() || i == most) {
            SimulationError error("the derivatives of the implicit step do not converge before output frame " + std::to_string(frame + 1) +
                                  " (t = " + std::to_string(time) + " s)");
            error.frame = frame + 1;
            error.shorter = true;
            throw error;
        }
        if (i == patience && !fresh) {
            value_.refresh_midpoint(middle, rule.elapsed * dt, rule.span * dt);
            fresh = true;
            for (Anderson& a : mixed) {
                a.forget();
            }
        }
    }
    enter(x);
    if (rule.second) {
        still_without_mass();
        for (std::size_t k = 0; k < v_.size(); ++k) {
            u_[k] = u0_[k] + static_cast<T>(rule.span * dt) * v_[k];
        }
        value_.finish_midpoint(n, frame, dt);
        return;
    }
    const T h = static_cast<T>(rule.length * dt);
    const std::vector<W> mean = v_;
    for (std::size_t k = 0; k < v_.size(); ++k) {
        v_[k] = T(2) * mean[k] - v0_[k];
        u_[k] = -h * mean[k];
    }
    still_without_mass();
    value_.finish_midpoint(n, frame, dt);
    if (!schedule_.paired) {
        hold(n, frame, dt, false, false);
    }
    for (std::size_t k = 0; k < v_.size(); ++k) {
        u_[k] = u0_[k] + h * mean[k];
    }
}

}  // namespace mphygs
