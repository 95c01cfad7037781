#include "mphygs/physics/reaction.hpp"

namespace mphygs {

namespace {

/// From the hold's centre to the target of a row, as a rotation of (9,) turns it [m].
std::array<double, 3> arm_of(const Geometry& g, std::size_t row, std::size_t hold, const double* turn) {
    std::array<double, 3> arm{};
    for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) {
            arm[i] += turn[3 * i + j] * (g.row_target[3 * row + j] - g.hold_centre[3 * hold + j]);
        }
    }
    return arm;
}

}  // namespace

void add_wrenches(const Geometry& g, const double* impulse, const double* turn, double share, bool forces, double* out) {
    const std::size_t rows = g.row_count();
    for (std::size_t r = 0; r < rows; ++r) {
        if (g.row_hold[r] < 0) {
            continue;  // a tie
        }
        const std::size_t h = static_cast<std::size_t>(g.row_hold[r]);
        const std::array<double, 3> arm = arm_of(g, r, h, turn + 9 * h);
        double* wrench = out + wrench_size * h;
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
            if (forces) {
                wrench[c] -= share * impulse[c * rows + r];
            }
            wrench[3 + c] -= share * (arm[a] * impulse[b * rows + r] - arm[b] * impulse[a * rows + r]);
        }
    }
}

void add_wrench_bars(const Geometry& g, const double* impulse, const double* turn, double share, const double* bar,
                     double* impulse_bar, double* turn_bar) {
    const std::size_t rows = g.row_count();
    for (std::size_t r = 0; r < rows; ++r) {
        if (g.row_hold[r] < 0) {
            continue;
        }
        const std::size_t h = static_cast<std::size_t>(g.row_hold[r]);
        const std::array<double, 3> arm = arm_of(g, r, h, turn + 9 * h);
        const double *force = bar + wrench_size * h, *torque = force + 3;
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
            impulse_bar[c * rows + r] -= share * (force[c] + torque[a] * arm[b] - torque[b] * arm[a]);
            const double arm_bar = -share * (impulse[a * rows + r] * torque[b] - impulse[b * rows + r] * torque[a]);
            for (std::size_t j = 0; j < 3; ++j) {
                turn_bar[9 * h + 3 * c + j] += arm_bar * (g.row_target[3 * r + j] - g.hold_centre[3 * h + j]);
            }
        }
    }
}

void add_momentum(int lanes, const double* momentum, const double* arm, const double* turn, double quarter, double* out,
                  std::size_t stride) {
    for (int l = 0; l < lanes; ++l) {
        const double *own = momentum + 3 * l, *shifted = arm + 3 * l;
        double* to = out + static_cast<std::size_t>(l) * stride;
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
            to[c] += own[c];
            to[3 + c] += arm[a] * own[b] - arm[b] * own[a] + quarter * turn[3 * static_cast<std::size_t>(l) + c];
            if (l > 0) {
                to[3 + c] += shifted[a] * momentum[b] - shifted[b] * momentum[a];
            }
        }
    }
}

ReactionSums::ReactionSums(int hold_count, const Schedule& schedule, std::size_t lanes) : schedule_(schedule) {
    if (wanted()) {
        size_ = (schedule.steps.size() + 1) * static_cast<std::size_t>(hold_count) * wrench_size;
        sums_.assign(lanes * size_, 0.0);
    }
}

ReactionSums::ReactionSums(const Geometry& geometry, const Schedule& schedule, std::size_t lanes)
    : ReactionSums(geometry.hold_count, schedule, lanes) {
    geometry_ = &geometry;
}

void ReactionSums::add(std::size_t lane, int n, int frame, const double* impulse, const double* turn, bool forces) {
    const std::size_t own = static_cast<std::size_t>(geometry_->hold_count) * wrench_size;
    for (std::size_t side = 0; side < 2; ++side) {
        const double weight = schedule_.reaction_weight[2 * static_cast<std::size_t>(n) + side];
        if (weight != 0.0) {
            const double share = weight / schedule_.dt[static_cast<std::size_t>(frame)];
            add_wrenches(*geometry_, impulse, turn, share, forces, &sums_[lane * size_ + (static_cast<std::size_t>(frame) + side) * own]);
        }
    }
}

void ReactionSums::add_sums(std::size_t lane, int n, int frame, const double* sums, double sign) {
    const std::size_t own = size_ / (schedule_.steps.size() + 1), at = static_cast<std::size_t>(frame);
    for (std::size_t side = 0; side < 2; ++side) {
        const double share = sign * schedule_.reaction_weight[2 * static_cast<std::size_t>(n) + side] / schedule_.dt[at];
        for (std::size_t i = 0; i < own; ++i) {
            sums_[lane * size_ + (at + side) * own + i] += share * sums[i];
        }
    }
}

std::vector<double> ReactionSums::of(std::size_t lane) const {
    const auto begin = sums_.begin() + static_cast<std::ptrdiff_t>(lane * size_);
    return {begin, begin + static_cast<std::ptrdiff_t>(size_)};
}

}  // namespace mphygs
