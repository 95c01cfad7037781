// What an implicit step keeps of a run: the state at its start and at its middle, the factors, the iteration.
#pragma once

#include <cmath>
#include <limits>
#include <memory>

#include "mphygs/numerics/anderson.hpp"
#include "mphygs/total_lagrangian/midpoint_matrix.hpp"
#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

/// Derivatives of a step's forces by the nodes' motion, as columns of its matrix.
template <class T>
class MidpointColumns {
  public:
    virtual ~MidpointColumns() = default;
    /// At a displacement and a velocity (component, node, padded), from what the effects remember; time: at the middle.
    /// span: of the rule [s].
    virtual void fill(const std::vector<T>& displacement, const std::vector<T>& velocity, const std::vector<Pack<T>>& history, double time,
                      double dt, double span, MidpointMatrix& to) = 0;
};

/// When an iteration is at its end. Shares are of what moves; a correction is never asked to be below what round-off leaves
/// of strains: in float32 derivatives and motion are as exact as those of an explicit run.
template <class T>
struct MidpointTolerance {
    static constexpr double round_off = std::numeric_limits<T>::epsilon();
    static constexpr double tight = round_off > 1e-10 ? 1e-5 : 1e-11, loose = 100 * tight;
    static constexpr double linear = round_off > 1e-10 ? 1e-6 : 1e-12, linear_loose = 1000 * linear;
    // Of the nodes' distances: a slender body makes a deflection of what is rounded in its strains.
    static constexpr double noise_loose = 1000 * round_off;
    /// Half of the digits, of what moves: from here Newton's own step squares what is left, which is then less than round-off.
    /// Where a step by factors made on the spot does not make a correction smaller, round-off is what it is.
    static double half_digits() { return std::sqrt(round_off); }
};

template <class T>
struct MidpointState {
    explicit MidpointState(MidpointMatrix of) : matrix(std::move(of)), mixed(matrix.weight()) {}

    MidpointMatrix matrix;
    Anderson mixed;
    std::unique_ptr<MidpointColumns<T>> columns;
    std::vector<T> u0, v0;                     // at the start of the step
    std::vector<T> place, middle;              // displacement and velocity at its middle
    std::vector<Pack<T>> history0, history1;  // before it and after it
    std::vector<double> impulse;               // (3, rows) half of what every row of the holds gives [N s]
    Eigen::VectorXd ahead;                     // how the last step's velocity changed, none at the start
    // Of what is rounded: a cell's strains vanish at rest, but with prestress every one of them is a difference of ones.
    double length = 0;                         // [m]
    double factors_dt = 0;                     // step that the factors belong to [s], 0: there are none
    bool stale = true;                         // whether the next step needs factors of its own

    /// Factors of the first or the second kind of substep from here on, each kept while the other is used.
    void take(bool second) {
        if (second != second_) {
            if (!other_) {
                other_ = std::make_unique<Factors>(Factors{matrix, 0.0, true});
            }
            std::swap(matrix, other_->matrix);
            std::swap(factors_dt, other_->dt);
            std::swap(stale, other_->stale);
            second_ = second;
        }
    }
    /// Whether the factors serve for a step: they lead to the solution of one that is nearly as long.
    bool factors_serve(double dt) const { return std::abs(factors_dt - dt) < 0.05 * dt; }
    /// Factors of the matrix at the middle as it stands.
    void refresh(double time, double dt, double span) {
        columns->fill(place, middle, history0, time, dt, span, matrix);
        if (!matrix.factorise()) {
            throw SimulationError("the implicit step's matrix is singular at t = " + std::to_string(time) +
                                  " s: the material has inverted, or a load softens it without bound");
        }
        factors_dt = dt;
        stale = false;
    }

  private:
    struct Factors {
        MidpointMatrix matrix;
        double dt;
        bool stale;
    };
    std::unique_ptr<Factors> other_;
    bool second_ = false;
};

}  // namespace mphygs
