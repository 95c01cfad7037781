// Holds and ties as linear constraints on node displacements, C u = hold or 0, solved every substep.
//
// The face of a held body is imposed where it is: on a plane z = z0 the spline's trace has the
// coefficients sum_k N_k(z0) u_ijk, and a rigid motion is reproduced when each equals the motion
// of its Greville point (x_i, y_j, z0). v = v* - M^-1 C^T lambda, A lambda = C v* - w with
// A = C M^-1 C^T (+ compliance / dt^2 between the rows of one hold: its displacement is the
// compliance times the force that it carries), dense and inverted once.
#pragma once

#include <vector>

#include "mphygs/model.hpp"

namespace mphygs {

class Constraint {
  public:
    /// inverse_mass: (nodes,) [1/kg]; node: the node of every weight of `geometry`'s rows.
    Constraint(const Geometry& geometry, const std::vector<std::int32_t>& node, const std::vector<double>& inverse_mass);

    std::size_t row_count() const { return rows_; }
    /// C x for one component. x: (nodes,)
    template <class T>
    void apply(const T* x, double* result) const {
        for (std::size_t r = 0; r < rows_; ++r) {
            double sum = 0;
            for (std::size_t w = begin_[r]; w < begin_[r + 1]; ++w) {
                sum += weight_[w] * static_cast<double>(x[node_[w]]);
            }
            result[r] = sum;
        }
    }
    /// f(node, sum over rows of weight * y_row) for the nodes of the constraint.
    template <class F>
    void transposed(const double* y, F&& f) const {
        for (std::size_t r = 0; r < rows_; ++r) {
            for (std::size_t w = begin_[r]; w < begin_[r + 1]; ++w) {
                f(node_[w], weight_[w] * y[r]);
            }
        }
    }
    /// lambda = (A + softness 1 1^T)^-1 b, softness = compliance / dt^2 [1/kg], per hold.
    void solve(const double* b, double softness, double* lambda) const;
    /// Sum over the rows of each hold. result: (holds,)
    void sum_per_hold(const double* x, double* result) const;
    const std::vector<std::int32_t>& hold_of_row() const { return hold_; }

  private:
    std::size_t rows_ = 0;
    std::size_t holds_ = 0;
    std::vector<std::size_t> begin_;
    std::vector<std::int32_t> node_, hold_;
    std::vector<double> weight_;
    std::vector<double> inverse_;        // A^-1, (rows, rows)
    std::vector<double> inverse_ones_;   // A^-1 1_h, (holds, rows)
    std::vector<double> hold_gram_;      // 1_g^T A^-1 1_h, (holds, holds)
};

}  // namespace mphygs
