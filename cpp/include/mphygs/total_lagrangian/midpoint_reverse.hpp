// Adjoint of an implicit step: with the bar of the middle's velocity b, the fixed point's is eta = b + (d Phi / d v)^T eta.
// It is found with the transposed factors, and what eta does to all inputs follows from one reversal of Phi.
#pragma once

#include "mphygs/total_lagrangian/midpoint.hpp"
#include "mphygs/total_lagrangian/reverse_loads.hpp"

namespace mphygs {

/// What the pushes of nodes that share mass say of the masses.
template <class T>
inline void TotalLagrangianReverse<T>::reverse_shared_mass(const std::vector<T>& start, const std::vector<T>& middle, double rate) {
    const auto add = [&](const std::vector<SharedPoints<T>>& all, std::vector<double>& to) {
        for (const SharedPoints<T>& points : all) {
            for (std::size_t c = 0; c < 3; ++c) {
                std::array<T, 27> bar, change;
                for (std::size_t a = 0; a < 27; ++a) {
                    const std::size_t i = run_.at(0, c, static_cast<std::size_t>(points.node[a]));
                    bar[a] = fbar_[i];
                    change[a] = middle[i] - start[i];
                }
                for (std::size_t q = 0; q < static_cast<std::size_t>(points.count); ++q) {
                    to[points.first + q] += rate * points.product(q, bar, change);
                }
            }
        }
    };
    add(model_.shared_points_, mass_bar_);
    if (model_.sites_.mass) {
        place_mass_bar_.resize(model_.places_.size());
        add(model_.shared_places_, place_mass_bar_);
    }
}

template <class T>
inline void TotalLagrangianReverse<T>::reverse_midpoint(int n, const Record& r) {
    using Tolerance = MidpointTolerance<T>;
    constexpr int most = 100, patience = 25, slow_step = 8;
    constexpr double few = 10.0;  // times round-off, which is not alike each time
    const SubstepRule rule = run_.rule(n);
    const double dt = step_dt_[index(n)], middle = step_time_[index(n)] + rule.at * dt;
    const double elapsed = rule.elapsed * dt;
    const T h = static_cast<T>(rule.length * dt), span = static_cast<T>(rule.span * dt);
    MidpointState<T>& m = *run_.midpoint_;
    m.take(rule.second);
    const std::vector<T>& begin = rule.second ? r.begin_u : r.u;
    m.history0 = r.history;
    m.middle = r.middle;
    for (std::size_t i = 0; i < run_.size_; ++i) {
        m.place[i] = begin[i] + span * r.middle[i];
    }
    run_.stand_at_middle();
    const std::vector<T> end = ubar_;
    still_without_mass();
    std::fill(ubar_.begin(), ubar_.end(), T{});
    std::vector<T> wanted(run_.size_), reflected(run_.size_);
    if (rule.second) {  // u_n+1 = u* + span v, v_n+1 = v
        for (std::size_t i = 0; i < run_.size_; ++i) {
            wanted[i] = span * end[i] + vbar_[i];
        }
    } else {  // u_n+1 = u_n + h v_m, v_n+1 = 2 v_m - v_n but, of single steps, where the holds prescribe it
        if (!schedule_.paired) {
            reverse_hold(n, r, r.prescribed, dt, false);
        }
        reflected = vbar_;
        for (std::size_t i = 0; i < run_.size_; ++i) {
            wanted[i] = h * (end[i] - ubar_[i]) + T(2) * reflected[i];
        }
    }
    const Eigen::VectorXd b = run_.by_node(wanted);
    const std::vector<Pack<T>> history_bar = history_bar_;
    hook_told_ = {};
    hook_answer_ = {};
    // Phi backwards: leaves the bars of v_n and u_n and returns b + (d Phi / d v)^T eta.
    std::vector<T> eta, start, kept;
    const auto reversed = [&](const Eigen::VectorXd& x) {
        run_.by_component(x, eta);
        vbar_ = eta;
        std::fill(ubar_.begin(), ubar_.end(), T{});
        history_bar_ = history_bar;
        reverse_hold(n, r, r.reactions, rule.reach * dt, true);
        still_without_mass();
        start = vbar_;
        kept = ubar_;
        reverse_accelerations(n, r, middle, elapsed, rule.span * dt);
        std::vector<T> sum(run_.size_);
        for (std::size_t i = 0; i < run_.size_; ++i) {
            sum[i] = wanted[i] + span * (ubar_[i] - kept[i]) + (vbar_[i] - start[i]);
        }
        push_each_other<T>(
            run_.shared_mass_, [&](std::size_t n, std::size_t c) { return fbar_[run_.at(0, c, n)] / span; },
            [&](std::size_t n, std::size_t c, T bar) {
                sum[run_.at(0, c, n)] += bar;
                start[run_.at(0, c, n)] -= bar;
            });
        return run_.by_node(sum);
    };
    if (m.begin_step(rule.span * dt)) {
        m.matrix.used_at(run_.turns_at_middle());
    } else {
        run_.refresh_midpoint(middle, elapsed, rule.span * dt);
    }
    if (trial_.of.empty()) {
        trial_ = this->sums_like_own();
    }
    this->swap_sums(trial_);  // of trial steps nothing is kept
    // Bars weigh as what they are multiplied with: an inverse mass.
    Eigen::VectorXd weight = m.matrix.weight().unaryExpr([](double w) { return w > 0.0 ? 1.0 / w : 0.0; });
    const auto size = [&](const Eigen::VectorXd& x) { return std::sqrt((x.array() * weight.array() * x.array()).sum()); };
    Anderson mixed(weight, 20);
    Eigen::VectorXd x = m.matrix.solve_transposed(b);
    // Phi backwards is affine: what a multiple of x changes beside the same multiple of that change is round-off, of terms that cancel.
    const auto round_off = [&](const Eigen::VectorXd& at, const Eigen::VectorXd& mapped) {
        const double more = 0.1;
        const Eigen::VectorXd further = reversed((1.0 + more) * at), none = reversed(Eigen::VectorXd::Zero(at.size()));
        return size(m.matrix.solve_transposed(further - (1.0 + more) * mapped + more * none));
    };
    double before = std::numeric_limits<double>::infinity();
    bool fresh = false;
    int i = 0;
    for (;; ++i) {
        m.spend(1.0);
        const Eigen::VectorXd at = x, mapped = reversed(at), d = m.matrix.solve_transposed(mapped - at);
        const double now = size(d), moves = size(x + d), rate = std::isfinite(before) ? std::min(1.0, now / before) : std::min(1.0, now / moves);
        before = now;
        x = mixed.next(x, d);
        const auto done = [&] { return now == 0.0 || now * rate <= Tolerance::linear * moves || now <= few * m.bar_noise * moves; };
        if (done()) {
            break;
        }
        if (rate > 0.5 && i > 0) {
            m.bar_noise = std::max(m.bar_noise, round_off(at, mapped) / moves);
            if (done()) {
                break;
            }
        }
        if (!x.allFinite() || i == most) {
            throw SimulationError("the adjoint of the implicit step does not converge at t = " + std::to_string(step_time_[index(n)]) + " s");
        }
        if (!fresh && (i == patience || (i > slow_step && rate > 0.5))) {
            run_.refresh_midpoint(middle, elapsed, rule.span * dt);
            fresh = true;
            mixed.forget();
        }
    }
    this->swap_sums(trial_);
    reversed(x);
    reverse_shared_mass(rule.second ? r.begin_v : r.v, r.middle, 1.0 / (rule.span * dt));
    for (std::size_t k = 0; k < run_.size_; ++k) {
        ubar_[k] += end[k];
        vbar_[k] = start[k] - reflected[k];
    }
    if (rule.second) {  // u* = last u_n - before u_n-1, v* likewise
        const T last = static_cast<T>(rule.last), before = static_cast<T>(rule.before);
        past_u_bar_.resize(run_.size_);
        past_v_bar_.resize(run_.size_);
        for (std::size_t k = 0; k < run_.size_; ++k) {
            past_u_bar_[k] = -before * ubar_[k];
            past_v_bar_[k] = -before * vbar_[k];
            ubar_[k] *= last;
            vbar_[k] *= last;
        }
    } else if (schedule_.paired) {
        for (std::size_t k = 0; k < run_.size_; ++k) {
            ubar_[k] += past_u_bar_[k];
            vbar_[k] += past_v_bar_[k];
        }
    }
}

}  // namespace mphygs
