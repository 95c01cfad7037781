// The implicit step of the nodes: the midpoint rule.
//
// With v_m = (v_n + v_n+1) / 2 and u_m = u_n + h/2 v_m the middle of a step is a fixed point,
//   v_m = Phi(v_m) = hold(v_n + h/2 a(u_m, v_m, t_m)),   u_n+1 = u_n + h v_m,   v_n+1 = 2 v_m - v_n,
// where a are the accelerations of an explicit substep, effects, loads and observer among them, and hold is what the holds
// leave of a velocity: C (u_n + h v_m) = hold at n+1. Of v_n+1 the part that the holds prescribe is the hold's mean velocity
// in the step: reflected at the middle it would change its sign from step to step. Nothing that follows depends on it. The
// second step of a pair does not reflect, and what nodes share of their mass asks for it: the first leaves it as it is.
// Newton's method with old factors that turn with the body, made faster by Anderson's, and with new ones where the iterations that
// are left would cost more than these. It ends at a small share of what moves, or at what round-off makes of a correction: a slender
// body makes a deflection of what is rounded in its strains, and how large that is shows where places differ in their last digit.
// Where its corrections do not get smaller it goes on with factors of its own at every velocity, and with as much of a correction
// as forces still drive along it: with a definite matrix that is downhill in the step's potential. A sheet that turns is compressed
// on the way, and its own matrix one of buckling, or nearly: then it is that of the step's start, where forces are in balance.
#pragma once

#include "mphygs/total_lagrangian/holds.hpp"
#include "mphygs/total_lagrangian/hook.hpp"

namespace mphygs {

template <class T, int K>
inline void TotalLagrangianRun<T, K>::prepare_midpoint() {
    if (midpoint_) {
        return;
    }
    std::vector<double> mass(mass_.begin(), mass_.begin() + static_cast<std::ptrdiff_t>(model_.node_count()));
    midpoint_ = std::make_unique<MidpointState<T>>(
        MidpointMatrix(model_.geometry_, model_.constraint_node_, model_.coupled_nodes(), std::move(mass), shared_mass_.template cast<double>()), model_.rows_.size());
    midpoint_->assembly = model_.midpoint_assembly(*inputs_.primal, schedule_, *team_);
}

template <class T, int K>
inline Eigen::VectorXd TotalLagrangianRun<T, K>::by_node(const std::vector<T>& from) const {
    Eigen::VectorXd x(static_cast<Eigen::Index>(3 * model_.node_count()));
    for (Eigen::Index i = 0; i < x.size(); ++i) {
        x[i] = static_cast<double>(from[at(0, static_cast<std::size_t>(i % 3), static_cast<std::size_t>(i / 3))]);
    }
    return x;
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::by_component(const Eigen::VectorXd& from, std::vector<T>& to) const {
    to.assign(size_, T{});
    for (Eigen::Index i = 0; i < from.size(); ++i) {
        to[at(0, static_cast<std::size_t>(i % 3), static_cast<std::size_t>(i / 3))] = static_cast<T>(from[i]);
    }
}

/// Phi of a velocity, left in the velocity, with the displacement as at the start.
template <class T, int K>
inline void TotalLagrangianRun<T, K>::midpoint_map(const Eigen::VectorXd& x, int n, int frame, double time, double dt) {
    MidpointState<T>& m = *midpoint_;
    const SubstepRule rule = this->rule(n);
    const double span = rule.span * dt, elapsed = rule.elapsed * dt, middle = time + rule.at * dt;
    by_component(x, m.middle);
    m.place.resize(size_);
    for (std::size_t i = 0; i < size_; ++i) {
        m.place[i] = m.u0[i] + static_cast<T>(span) * m.middle[i];
    }
    stand_at_middle();
    refresh_uniforms(middle, elapsed);
    team_->each(static_cast<int>(model_.chunks_.size()), [&](int c) { chunk_forces(static_cast<std::size_t>(c), middle, elapsed); });
    reduce_forces();
    place_forces(middle);
    hook_forces(middle, elapsed);
    known_forces(frame);
    actuate(index(frame), target_basis(n, frame, dt).value, n);
    share_inertia(span);
    if (ask(n, frame, dt)) {
        spread_pulls(span);
    }
    update_nodes(middle, span);
    add_pulls();
    m.history1 = history_;
    u_ = m.u0;
    for (std::size_t i = 0; i < size_; ++i) {
        v_[i] = inverse_mass_[i % stride_] == T{} ? T{} : m.v0[i] + (v_[i] - m.middle[i]);
    }
    if (constraint_[0].row_count() > 0) {
        hold_lanes<0, 1>(n, rule.reach * dt);
    }
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::stand_at_middle() {
    u_ = midpoint_->place;
    v_ = midpoint_->middle;
    history_ = midpoint_->history0;
}

template <class T, int K>
inline NodeTurns TotalLagrangianRun<T, K>::turns_at_middle() const {
    NodeTurns sums(model_.node_count());
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const Mat3<Pack<T>> gradient = gather_gradient<T>(midpoint_->place.data(), stride_, rows, model_.gradients_[static_cast<std::size_t>(model_.table_[b])]);
        Mat3<double> own = 8.0 * Mat3<double>::identity();
        for (int q = 0; q < 8; ++q) {
            for (int i = 0; i < 9; ++i) {
                own[i / 3][i % 3] += static_cast<double>(gradient[i / 3][i % 3][q]);
            }
        }
        for (int a = 0; a < 27; ++a) {
            Mat3<double>& sum = sums[static_cast<std::size_t>(node_of<T>(rows, a))];
            sum = sum + own;
        }
    }
    for (Mat3<double>& sum : sums) {
        sum = nearest_turn(sum);
    }
    return sums;
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::refresh_midpoint(double time, double elapsed, double span) {
    midpoint_->refresh(time, elapsed, span);
    midpoint_->matrix.made_at(turns_at_middle());
}

/// Finds the middle of a step: velocity, forces, what the holds give and what the effects remember then.
template <class T, int K>
inline void TotalLagrangianRun<T, K>::solve_midpoint(int n, int frame, double time, double dt) {
    using Tolerance = MidpointTolerance<T>;
    constexpr int most = 200, patience = 30;
    constexpr double overshoot = 0.9, shortest = 1e-3, nearly_singular = 0.1;
    constexpr double few = 10.0;  // times round-off, which is not alike each time
    prepare_midpoint();
    MidpointState<T>& m = *midpoint_;
    const SubstepRule rule = this->rule(n);
    m.take(rule.second);
    m.u0 = u_;
    m.v0 = m.start = v_;
    for (std::size_t i = 0; rule.second && i < size_; ++i) {
        m.u0[i] = static_cast<T>(rule.last) * u_[i] - static_cast<T>(rule.before) * past_u_[i];
        m.v0[i] = static_cast<T>(rule.last) * v_[i] - static_cast<T>(rule.before) * past_v_[i];
    }
    if (schedule_.paired && !rule.second) {
        past_u_ = u_;
        past_v_ = v_;
    }
    m.history0 = history_;
    m.mixed.forget();
    const std::vector<T> start_u = u_, start_v = v_;
    const double infinite = std::numeric_limits<double>::infinity();
    const auto rest_at = [&](const Eigen::VectorXd& at) -> Eigen::VectorXd {
        midpoint_map(at, n, frame, time, dt);
        return by_node(v_) - at;
    };
    const auto refresh = [&](std::vector<T> place, std::vector<T> velocity) {
        place.swap(m.place);
        velocity.swap(m.middle);
        try {
            refresh_midpoint(time + rule.at * dt, rule.elapsed * dt, rule.span * dt);
        } catch (SimulationError& error) {
            error.frame = frame + 1;
            error.shorter = true;
            throw;
        }
        place.swap(m.place);  // the middle stays what it was last taken to be
        velocity.swap(m.middle);
    };
    // What a correction becomes of places that are rounded in their last digit.
    const auto round_off = [&](Eigen::VectorXd at, const Eigen::VectorXd& rest) {
        const double digit = Tolerance::round_off / (rule.span * dt), least = model_.geometry_.spacing[0];
        const Eigen::VectorXd place = by_node(m.place);
        for (Eigen::Index i = 0; i < at.size(); ++i) {
            at[i] += (i % 2 == 0 ? digit : -digit) * (std::abs(place[i]) + least);
        }
        const Eigen::VectorXd there = rest_at(at);
        return dt * m.matrix.size(m.matrix.solve(there - rest));
    };
    const auto work = [&](const Eigen::VectorXd& a, const Eigen::VectorXd& b) { return (a.array() * m.matrix.weight().array() * b.array()).sum(); };
    Eigen::VectorXd x = by_node(v_) + m.ahead(), best = by_node(v_), way, rest_there;
    by_component(x, m.middle);
    m.place.resize(size_);
    for (std::size_t i = 0; i < size_; ++i) {
        m.place[i] = m.u0[i] + static_cast<T>(rule.span * dt) * m.middle[i];
    }
    if (m.begin_step(rule.span * dt)) {
        m.matrix.used_at(turns_at_middle());
    } else {
        refresh(m.place, m.middle);
    }
    bool of_start = false;                             // whether `way` is of the start's matrix
    int quick = 0, since = 0;                          // iterations that old factors did, and since these were made
    double first = 0;                                  // size of the first correction by these
    bool untried = false;                              // whether all of `way` has just been gone
    bool fast = true;                                  // else from `best` along `way`, as far as forces drive along it
    double least = infinite, share = 1.0, drive = 0.0;  // size of the correction at `best`; share of `way`; what drives there
    for (int i = 0; i < most; ++i) {
        const Eigen::VectorXd rest = rest_at(x);
        bool good = rest.allFinite();
        if (!fast) {
            if (way.size() > 0 && !(good && work(way, rest) >= -overshoot * drive)) {
                share *= 0.5;
                if (share < shortest) {
                    break;
                }
                if (share < nearly_singular && !of_start) {
                    refresh(start_u, start_v);
                    way = m.matrix.solve(rest_there);
                    drive = work(way, rest_there);
                    of_start = true;
                    share = 1.0;
                    if (!(drive > 0.0)) {
                        break;
                    }
                }
                x = best + share * way;
                continue;
            }
            refresh(m.place, m.middle);
        }
        m.spend(1.0);
        Eigen::VectorXd d = good ? Eigen::VectorXd(m.matrix.solve(rest)) : rest;
        of_start = !fast && good && !(work(d, rest) > 0.0);
        if (of_start) {
            refresh(start_u, start_v);
            d = m.matrix.solve(rest);
        }
        const double size = dt * m.matrix.size(d), moves = dt * m.matrix.size(x);
        good = good && std::isfinite(size);
        const bool better = good && size <= 0.9 * least;
        // Newton's own step has been gone, or no matrix leads downhill.
        const bool no_smaller = good && ((untried && !better) || (!fast && !(work(d, rest) > 0.0)));
        if (good && (!better || no_smaller) && size > Tolerance::tight * moves + few * m.noise) {
            m.noise = std::max(m.noise, round_off(x, rest));
        }
        if (good && (size <= Tolerance::tight * moves + few * m.noise || (no_smaller && size <= Tolerance::half_digits() * moves))) {
            m.impulse = lambda_rows_;
            return;
        }
        if (fast && better && ++quick < patience) {
            best = x;
            least = size;
            untried = false;
            // As far as they have come so far in as many iterations, how many more are there?
            first = since == 0 ? size : first;
            const double aim = Tolerance::tight * moves + few * m.noise;
            const double left = since == 0 ? 0.0 : since * std::log(size / aim) / std::log(first / size);
            ++since;
            if (m.renewal_pays(left)) {
                refresh(m.place, m.middle);
                d = m.matrix.solve(rest);
                m.mixed.forget();
                since = 0;
            }
            if (since > 0 || work(d, rest) > 0.0) {
                x = m.mixed.next(x, d);
                continue;
            }
        }
        if (fast) {
            fast = false;
            quick = 0;
            m.mixed.forget();
            if (untried) {  // Newton's own step was too long
                untried = false;
                share = 0.5;
                x = best + share * way;
                continue;
            }
            share = 1.0;
            least = infinite;
            way.resize(0);
            by_component(best, v_);  // as it is, but for the holds
            if (constraint_[0].row_count() > 0) {
                hold_lanes<0, 1>(n, rule.reach * dt);
            }
            x = by_node(v_);
            continue;
        }
        if (!good || !(work(d, rest) > 0.0)) {
            break;
        }
        best = x;
        way = d;
        rest_there = rest;
        drive = work(d, rest);
        fast = untried = share == 1.0 && size < 0.1 * moves && better;
        least = size;
        share = 1.0;
        x = best + way;
    }
    SimulationError error("the implicit step of " + std::to_string(dt) + " s does not converge before output frame " +
                          std::to_string(frame + 1) + " (t = " + std::to_string(time) +
                          " s); shorter steps may, or the material inverts");
    error.frame = frame + 1;
    error.shorter = true;
    throw error;
}

/// From the middle of a step to its end.
template <class T, int K>
inline void TotalLagrangianRun<T, K>::finish_midpoint(int n, int frame, double dt) {
    MidpointState<T>& m = *midpoint_;
    const SubstepRule rule = this->rule(n);
    const auto tell = [&] {
        std::vector<double> impulse = m.impulse;
        for (double& x : impulse) {
            x *= rule.impulses;
        }
        sums_.add(0, n, frame, impulse.data(), turns(0, n).data());
    };
    m.keep_change(by_node(m.middle) - by_node(m.start));
    history_ = m.history1;
    if (rule.second) {
        v_ = m.middle;
        u_ = m.place;
        if (constraint_[0].row_count() > 0 && sums_.wanted()) {
            tell();
        }
        return;
    }
    const T h = static_cast<T>(rule.length * dt);
    for (std::size_t i = 0; i < size_; ++i) {
        v_[i] = inverse_mass_[i % stride_] == T{} ? T{} : T(2) * m.middle[i] - m.v0[i];
        u_[i] = -h * m.middle[i];
    }
    if (constraint_[0].row_count() > 0) {
        if (!schedule_.paired) {
            hold_lanes<0, 1>(n, dt, false);
        }
        if (sums_.wanted()) {
            tell();
        }
    }
    for (std::size_t i = 0; i < size_; ++i) {
        u_[i] = m.u0[i] + h * m.middle[i];
    }
}

}  // namespace mphygs
