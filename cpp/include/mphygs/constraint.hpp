// Holds and ties as linear constraints on node displacements, C u = hold or 0, solved every substep.
//
// The face of a held body is imposed where it is: on a plane z = z0 the spline's trace has the
// coefficients sum_k N_k(z0) u_ijk, and a rigid motion is reproduced when each equals the motion
// of its Greville point (x_i, y_j, z0). v = v* - M^-1 C^T lambda, A lambda = C v* - w with
// A = C M^-1 C^T (+ compliance / dt^2 between the rows of one hold: its displacement is the
// compliance times the force that it carries), dense and inverted once.
#pragma once

#include <algorithm>
#include <vector>

#include "mphygs/model.hpp"

namespace mphygs {

class Constraint {
  public:
    /// inverse_mass: (nodes,) [1/kg]; node: the node of every weight of `geometry`'s rows.
    Constraint(const Geometry& geometry, const std::vector<std::int32_t>& node, const std::vector<double>& inverse_mass);

    std::size_t row_count() const { return rows_; }
    /// The nodes that any row touches, ascending.
    const std::vector<std::int32_t>& nodes() const { return nodes_; }
    /// b = C x. x: (nodes(), N), b: (rows, N), columns side by side so that they are worked on together.
    template <int N>
    void apply(const double* x, double* b) const {
        for (std::size_t r = 0; r < rows_; ++r) {
            double sum[N] = {};
            for (std::size_t w = begin_[r]; w < begin_[r + 1]; ++w) {
                add<N>(weight_[w], &x[place_[w] * N], sum);
            }
            std::copy(sum, sum + N, &b[r * N]);
        }
    }
    /// x = C^T y. y: (rows, N), x: (nodes(), N)
    template <int N>
    void transposed(const double* y, double* x) const {
        std::fill(x, x + nodes_.size() * N, 0.0);
        for (std::size_t r = 0; r < rows_; ++r) {
            for (std::size_t w = begin_[r]; w < begin_[r + 1]; ++w) {
                add<N>(weight_[w], &y[r * N], &x[place_[w] * N]);
            }
        }
    }
    /// lambda = (A + softness 1 1^T)^-1 b, softness = compliance / dt^2 [1/kg], per hold. b, lambda: (rows, N)
    template <int N>
    void solve(const double* b, double softness, double* lambda) const {
        for (std::size_t r = 0; r < rows_; ++r) {
            double sum[N] = {};
            for (std::size_t s = 0; s < rows_; ++s) {
                add<N>(inverse_[r * rows_ + s], &b[s * N], sum);
            }
            std::copy(sum, sum + N, &lambda[r * N]);
        }
        if (softness != 0.0 && holds_ > 0) {
            give_way(softness, N, lambda);
        }
    }
    /// Sum over the rows of each hold, ties left out. x: (rows,), result: (holds,)
    void sum_per_hold(const double* x, double* result) const;
    const std::vector<std::int32_t>& hold_of_row() const { return hold_; }

  private:
    std::size_t rows_ = 0;
    std::size_t holds_ = 0;
    std::vector<std::size_t> begin_;
    std::vector<std::int32_t> nodes_, hold_;
    std::vector<std::size_t> place_;     // of every weight's node among nodes_
    std::vector<double> weight_;
    std::vector<double> inverse_;        // A^-1, (rows, rows)
    std::vector<double> inverse_ones_;   // A^-1 1_h, (holds, rows)
    std::vector<double> hold_gram_;      // 1_g^T A^-1 1_h, (holds, holds)

    template <int N>
    static void add(double factor, const double* from, double* to) {
        for (int c = 0; c < N; ++c) {
            to[c] += factor * from[c];
        }
    }
    /// From A^-1 b to (A + softness 1 1^T)^-1 b, for (rows, columns) numbers.
    void give_way(double softness, int columns, double* lambda) const;
};

}  // namespace mphygs
