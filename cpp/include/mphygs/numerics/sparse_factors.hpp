// Direct solver for sparse systems: LU by fronts along an elimination tree.
//
// Unknowns that belong together, the three numbers of a node or the rows of a joint with the nodes that they need, are one
// vertex of a graph; an order of the graph's vertices gives a tree of dense fronts (Duff and Reid, "The multifrontal solution
// of indefinite sparse symmetric linear equations", 1983). Rows are exchanged within what a front eliminates, which is
// enough for stiffness matrices whose constraints stand in one vertex with nodes that can carry them. Which entries are zero
// is analysed once; the same analysis serves for all values. One thread, in a fixed order: the same bits always.
#pragma once

#include <Eigen/Dense>
#include <Eigen/Sparse>
#include <vector>

namespace mphygs {

class SparseFactors {
  public:
    /// matrix: of a symmetric pattern; vertices: every unknown in one of them; last: of every vertex, whether it comes after
    /// all that it shares entries with, empty: none.
    void analyse(const Eigen::SparseMatrix<double>& matrix, const std::vector<std::vector<int>>& vertices, std::vector<bool> last = {});
    /// Of a matrix with the pattern that was analysed. False where a front is singular.
    bool factorise(const Eigen::SparseMatrix<double>& matrix);
    /// Of one right-hand side, and of several, one a column, for which the factors are read once.
    Eigen::VectorXd solve(const Eigen::VectorXd& right) const;
    Eigen::MatrixXd solve_all(const Eigen::MatrixXd& right) const;
    Eigen::VectorXd solve_transposed(const Eigen::VectorXd& right) const;
    /// Of a factorisation [floating-point operations].
    double work() const { return work_; }
    /// Numbers in the factors: a solution takes two operations of each.
    double entries() const;

  private:
    /// Numbers that stand together, and do where they are added.
    struct Run {
        int from, to, length;
    };
    struct Front {
        int first = 0, pivots = 0;            // of the unknowns in the order of elimination
        std::vector<int> boundary;            // unknowns in the order of elimination
        std::vector<Run> in_parent;           // of the boundary to rows of the parent's front, none across the end of its pivots
        int parent = -1;
        std::vector<int> children;
        int first_entry = 0, entries = 0;     // runs of the matrix's entries that are added here
        // Where L and U of the pivots over F21 U^-1, (p + b, p), and (L^-1 P F12)^T, (b, p), are: both are solved for along the
        // boundary, which is long. And where (b, b), what it leaves of the boundary, is until its parent takes it.
        std::size_t factors = 0, left = 0;
    };
    template <class Numbers>
    struct Parts;
    auto exchanged(const Front& front) const { return Eigen::Map<const Eigen::VectorXi>(exchanged_.data() + front.first, front.pivots); }
    template <class Right>
    Right solved(const Right& right) const;

    std::vector<Front> fronts_;
    std::vector<int> order_;                  // unknown eliminated k-th
    std::vector<Run> entry_;                  // front by front: from the matrix's values to the front's factors
    std::vector<int> exchanged_;              // front by front: row of the pivots that is taken k-th
    std::size_t size_ = 0, left_ = 0, widest_ = 0;  // of the factors; of the room for what fronts leave, and for the largest F12
    Eigen::VectorXd factors_, room_;  // aligned always alike: sums are in an order that depends on it
    double work_ = 0;
};

}  // namespace mphygs
