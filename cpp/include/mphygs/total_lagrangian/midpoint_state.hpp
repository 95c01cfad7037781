// What an implicit step keeps of a run: the state at its start and at its middle, the factors, the iteration.
#pragma once

#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "mphygs/numerics/anderson.hpp"
#include "mphygs/total_lagrangian/midpoint_cost.hpp"
#include "mphygs/total_lagrangian/midpoint_matrix.hpp"
#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

/// Sums a step's matrix from the derivatives of its forces by the nodes' motion.
template <class T>
class MidpointAssembly {
  public:
    virtual ~MidpointAssembly() = default;
    /// At a displacement and a velocity (component, node, padded), from what the effects remember, empty: nothing yet;
    /// time: at the middle; span: of the rule [s].
    virtual void assemble(const std::vector<T>& displacement, const std::vector<T>& velocity, const std::vector<Pack<T>>& history, double time,
                          double dt, double span, MidpointMatrix& to) = 0;
};

/// When an iteration is at its end. Shares are of what moves; a correction is never asked to be below what round-off leaves
/// of strains: in float32 derivatives and motion are as exact as those of an explicit run.
template <class T>
struct MidpointTolerance {
    static constexpr double round_off = std::numeric_limits<T>::epsilon();
    static constexpr double tight = round_off > 1e-10 ? 1e-5 : 1e-11;
    static constexpr double linear = round_off > 1e-10 ? 1e-6 : 1e-12;
    /// Half of the digits, of what moves: from here Newton's own step squares what is left, which is then less than round-off.
    /// Where a step by factors made on the spot does not make a correction smaller, round-off is what it is.
    static double half_digits() { return std::sqrt(round_off); }
};

template <class T>
struct MidpointState {
    /// blocks: of eight points.
    MidpointState(MidpointMatrix of, std::size_t blocks)
        : matrix(std::move(of)), mixed(matrix.weight()), cost_(midpoint_cost(blocks, matrix)) {}

    MidpointMatrix matrix;
    Anderson mixed;
    std::unique_ptr<MidpointAssembly<T>> assembly;
    std::vector<T> u0, v0;                     // what the step begins with
    std::vector<T> start;                      // velocity at its start
    std::vector<T> place, middle;              // displacement and velocity at its middle
    std::vector<Pack<T>> history0, history1;  // before it and after it
    std::vector<double> impulse;               // (3, rows) half of what every row of the holds gives [N s]
    // What round-off makes of a correction, as far as it was measured since the factors were made: of a step [m], of its adjoint
    // as a share of what moves, and of every direction.
    double noise = 0, bar_noise = 0;
    std::vector<double> noises;
    /// Which of a pair the substeps from here on are: what is expected of them.
    void take(bool second) { second_ = second; }
    /// Before a step: false where it needs factors of its own. Factors serve steps that are nearly as long, as long as a step
    /// costs no more than the mean of all steps since they were made, their making among it: that mean is least then.
    bool begin_step(double span) {
        ++use_.steps;
        use_.step = 0;
        return !use_.stale && std::abs(use_.span - span) < 0.05 * span;
    }
    /// How the velocity is expected to change from the start to the middle: as in the last step of the kind, and as much more
    /// or less as that was more than the one before.
    Eigen::VectorXd ahead() const {
        const auto& [last, before] = changes_[second_];
        return last.size() == 0 ? Eigen::VectorXd::Zero(matrix.weight().size()).eval() : before.size() == 0 ? last : (2.0 * last - before).eval();
    }
    void keep_change(Eigen::VectorXd change) {
        auto& [last, before] = changes_[second_];
        before = std::exchange(last, std::move(change));
    }
    void forget_changes() { changes_ = {}; }
    /// So many iterations of a step.
    void spend(double iterations) {
        use_.step += iterations * cost_.iteration;
        use_.all += iterations * cost_.iteration;
        use_.stale = use_.stale || use_.step * use_.steps > use_.all;
    }
    /// Whether factors of where an iteration is now, after which it takes two more, cost less than so many iterations.
    bool renewal_pays(double iterations) const { return (iterations - 2.0) * cost_.iteration > cost_.renewal; }
    /// Factors of the matrix at the middle as it stands, so long after forces were last asked for.
    void refresh(double time, double elapsed, double span) {
        assembly->assemble(place, middle, history0, time, elapsed, span, matrix);
        if (!matrix.factorise()) {
            throw SimulationError("the implicit step's matrix is singular at t = " + std::to_string(time) +
                                  " s: the material has inverted, or a load softens it without bound");
        }
        use_ = {span, cost_.renewal, 0.0, 1.0, false};
        noise = bar_noise = 0.0;
        noises.clear();
    }

  private:
    /// What factors are for, and what was spent on them and with them [operations].
    struct Use {
        double span = 0;           // of the rule that they belong to [s]
        double all = 0, step = 0;  // since they were made, and in the present step
        double steps = 0;          // since then, the present one among them
        bool stale = true;         // whether the next step needs its own
    };
    MidpointCost cost_;
    Use use_;
    bool second_ = false;
    std::array<std::array<Eigen::VectorXd, 2>, 2> changes_;  // of the velocity from the start to the middle, by kind: the last, the one before
};

}  // namespace mphygs
