// Feedback from measured targets: a Luenberger observer, or nudging.
//
// Channels are measured points, h_i(u) = sum_k w_ik u_k with carriers k (grid nodes or particles). Every carrier n gets
//   a_n = sum_i G_ni share_i [ stiffness e_i + damping de_i/dt ],  e_i = y_i(t) - h_i(u),  de_i/dt = dy_i/dt - h_i(v),
// at the start of the substep, whatever its mass; G_ni is a number, or a matrix where a pull to one side turns the body. Targets y are cubic polynomials in the share s of each output interval.
// Its rates are far below the elastic ones: they do not count in the stable substep.
// Sources: Luenberger, "Observing the state of a linear system", 1964; Hoke and Anthes, "The initialization of numerical
// models by a dynamic-initialization technique", 1976.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

namespace mphygs {

struct Observer {
    std::vector<std::int32_t> row_begin, row_carrier;      // (M + 1,), carriers of each channel
    std::vector<double> row_weight;                        // their weights w [-]
    std::vector<std::int32_t> reach_row;                   // (N,) row of G of each carrier, -1: not pulled; none: its own
    std::vector<std::int32_t> reach_begin, reach_channel;  // (rows of G + 1,), channels that pull each
    std::vector<double> reach_weight;                      // how much of each, G [-]: a number, or 3 x 3 by rows
    double stiffness = 0;                                  // omega^2 [1/s^2]
    double damping = 0;                                    // 2 zeta omega [1/s]
    std::vector<double> share;                             // (F, M) 0 in gaps

    std::size_t channel_count() const { return row_begin.empty() ? 0 : row_begin.size() - 1; }
    /// Numbers to each G: 1 or 9.
    std::size_t reach_size() const {
        const std::size_t count = reach_channel.size();
        return count > 0 && reach_weight.size() == 9 * count ? 9 : 1;
    }

    std::int32_t reach_row_of(std::size_t carrier) const {
        return reach_row.empty() ? static_cast<std::int32_t>(carrier) : reach_row[carrier];
    }

    /// Throws std::invalid_argument, one line, where sizes or numbers are wrong. target: numbers of Fields::target.
    void check(std::size_t carriers, std::size_t frames, std::size_t target) const {
        rows(row_begin, row_carrier, row_weight.size(), channel_count(), carriers, "row");
        const std::size_t pulled = reach_row.empty() || reach_begin.empty() ? carriers : reach_begin.size() - 1;
        rows(reach_begin, reach_channel, reach_weight.size() / reach_size(), pulled, channel_count(), "reach");
        require(reach_row.empty() || reach_row.size() == carriers, "reach_row must be (" + std::to_string(carriers) + ",)");
        for (const std::int32_t r : reach_row) {
            require(r >= -1 && r < static_cast<std::int32_t>(pulled), "reach_row names a row out of range");
        }
        require(share.size() == frames * channel_count(), "share must be (intervals, channels)");
        require(target == 12 * frames * channel_count(), "fields' target must be (intervals, channels, 4, 3)");
        require(stiffness >= 0 && damping >= 0, "stiffness and damping must be 0 or more");
    }

  private:
    static void require(bool good, const std::string& what) {
        if (!good) {
            throw std::invalid_argument("observer: " + what);
        }
    }
    static void rows(const std::vector<std::int32_t>& begin, const std::vector<std::int32_t>& index,
                     std::size_t weights, std::size_t count, std::size_t columns, const std::string& name) {
        require(begin.size() == count + 1 && begin.front() == 0, name + "_begin must be (" + std::to_string(count + 1) + ",) from 0 on");
        for (std::size_t i = 0; i < count; ++i) {
            require(begin[i] <= begin[i + 1], name + "_begin must not fall");
        }
        require(static_cast<std::size_t>(begin.back()) == index.size() && index.size() == weights,
                name + "_begin must end with the number of weights");
        for (const std::int32_t k : index) {
            require(k >= 0 && static_cast<std::size_t>(k) < columns, name + " names a number out of range");
        }
    }
};

/// Where a substep stands in its output interval: powers of the share s, and their derivatives by time [1/s].
struct TargetBasis {
    double value[4], rate[4];
    /// within: how much of the substep is over.
    TargetBasis(int step, int steps, double dt, double within = 0.0) {
        const double s = (static_cast<double>(step) + within) / steps, span = steps * dt;
        value[0] = 1;
        rate[0] = 0;
        for (int k = 1; k < 4; ++k) {
            value[k] = value[k - 1] * s;
            rate[k] = k * value[k - 1] / span;
        }
    }
};

}  // namespace mphygs
