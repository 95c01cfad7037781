// Holds and ties as linear constraints on node displacements, C u = hold or 0, solved every substep.
//
// The face of a held body is imposed where it is: on a plane z = z0 the spline's trace has the
// coefficients sum_k N_k(z0) u_ijk, and a rigid motion is reproduced when each equals the motion
// of its Greville point (x_i, y_j, z0). v = v* - M^-1 C^T lambda, A lambda = C v* - w with
// A = C M^-1 C^T (+ compliance / dt^2 between the rows of one hold: its displacement is the
// compliance times the force that it carries), dense and inverted once.
#pragma once

#include <algorithm>
#include <type_traits>
#include <vector>

#include "mphygs/model.hpp"
#include "mphygs/numerics/vector.hpp"

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
        strips<N>([&]<class V>(int column, V) { multiply<N, V>(by_row_, x + column, b + column); });
    }
    /// x = C^T y. y: (rows, N), x: (nodes(), N)
    template <int N>
    void transposed(const double* y, double* x) const {
        strips<N>([&]<class V>(int column, V) { multiply<N, V>(by_node_, y + column, x + column); });
    }
    /// lambda = (A + softness 1 1^T)^-1 b, softness = compliance / dt^2 [1/kg], per hold. b, lambda: (rows, N)
    template <int N>
    void solve(const double* b, double softness, double* lambda) const {
        strips<N>([&]<class V>(int column, V) {
            std::size_t r = 0;
            for (; r + 4 <= rows_; r += 4) {
                inverse_rows<N, V, 4>(r, b + column, lambda + column);
            }
            for (; r < rows_; ++r) {
                inverse_rows<N, V, 1>(r, b + column, lambda + column);
            }
        });
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
    /// Rows of a sparse matrix: where each begins, columns, numbers.
    struct Sparse {
        std::vector<std::size_t> begin = {0}, column;
        std::vector<double> weight;
    };
    Sparse by_row_, by_node_;            // C and its transpose; nodes by their place among nodes_
    std::vector<std::int32_t> nodes_, hold_;
    std::vector<double> inverse_;        // A^-1, (rows, rows)
    std::vector<double> inverse_ones_;   // A^-1 1_h, (holds, rows)
    std::vector<double> hold_gram_;      // 1_g^T A^-1 1_h, (holds, holds)

    /// Calls f with each strip of the N columns: its first one and a vector as wide. Several sums go on at once: one
    /// alone waits for each of its additions.
    template <int N, class F>
    static void strips(const F& f) {
        constexpr int wide = register_bytes / sizeof(double), width = N % wide == 0 ? wide : N % 4 == 0 ? 4 : 1;
        for (int column = 0; column < N; column += width) {
            f(column, Strip<width>{});
        }
    }
    template <int width>
    using Strip = std::conditional_t<width == 1, double, Vector<double, width == 1 ? 2 : width>>;
    template <class V>
    static V read(const double* p) {
        if constexpr (std::is_same_v<V, double>) {
            return *p;
        } else {
            return mphygs::read<V>(p);
        }
    }
    template <class V>
    static void write(double* p, const V& v) {
        if constexpr (std::is_same_v<V, double>) {
            *p = v;
        } else {
            mphygs::write(p, v);
        }
    }
    /// y = matrix x for one strip of columns.
    template <int N, class V>
    static void multiply(const Sparse& matrix, const double* x, double* y) {
        const std::size_t count = matrix.begin.size() - 1;
        const std::size_t *begin = matrix.begin.data(), *from = matrix.column.data();
        const double* weight = matrix.weight.data();
        for (std::size_t r = 0; r < count; ++r) {
            V sum[4] = {};
            std::size_t w = begin[r];
            const std::size_t end = begin[r + 1];
            for (; w + 4 <= end; w += 4) {
#pragma GCC unroll 4
                for (std::size_t i = 0; i < 4; ++i) {
                    sum[i] += weight[w + i] * read<V>(&x[from[w + i] * N]);
                }
            }
            for (; w < end; ++w) {
                sum[0] += weight[w] * read<V>(&x[from[w] * N]);
            }
            write(&y[r * N], (sum[0] + sum[1]) + (sum[2] + sum[3]));
        }
    }
    /// `Count` rows of A^-1 b from row r on, for one strip of columns.
    template <int N, class V, std::size_t Count>
    void inverse_rows(std::size_t r, const double* b, double* lambda) const {
        V sum[Count] = {};
        for (std::size_t s = 0; s < rows_; ++s) {
            const V from = read<V>(&b[s * N]);
#pragma GCC unroll 4
            for (std::size_t i = 0; i < Count; ++i) {
                sum[i] += inverse_[(r + i) * rows_ + s] * from;
            }
        }
#pragma GCC unroll 4
        for (std::size_t i = 0; i < Count; ++i) {
            write(&lambda[(r + i) * N], sum[i]);
        }
    }
    /// From A^-1 b to (A + softness 1 1^T)^-1 b, for (rows, columns) numbers.
    void give_way(double softness, int columns, double* lambda) const;
};

}  // namespace mphygs
