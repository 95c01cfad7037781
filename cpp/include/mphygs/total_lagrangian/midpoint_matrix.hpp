// The linear system of an implicit step, and its factors.
//
// The map v -> Phi(v) of which the midpoint's velocity is the fixed point (see `midpoint.hpp`) has the derivative P B, with
// P what the holds leave of a velocity. (I - P B) d = b is the saddle
//   [ A  C^T ] [   d    ]   [ M b ]
//   [ C   0  ] [ lambda ] = [ C b ],   A = M (I - B) = M + h/2 D + h^2/4 K.
// A couples nodes that share a cell only, so that one derivative of the forces tells many columns at once: those of nodes
// no two of which have a neighbour in common (Curtis, Powell and Reid, 1974).
#pragma once

#include <Eigen/Sparse>
#include <cmath>

#include "mphygs/model.hpp"
#include "mphygs/numerics/sparse_factors.hpp"

namespace mphygs {

class MidpointMatrix {
  public:
    /// node_index: (N, 3) on the grids; node: of every weight of the geometry's rows; cells: the 27 nodes of every cell in
    /// use, one after the other; mass: (N,) [kg].
    MidpointMatrix(const Geometry& geometry, const std::vector<std::int32_t>& node_index, const std::vector<std::int32_t>& node,
                   const std::vector<std::int32_t>& cells, std::vector<double> mass);

    /// Nodes of one colour have no neighbour in common.
    std::size_t colours() const { return nodes_of_.size(); }
    const std::vector<int>& nodes_of(std::size_t colour) const { return nodes_of_[colour]; }
    /// The sum of A's columns that belong to one component of a colour's nodes, (N, 3).
    void put(std::size_t colour, int component, const std::vector<double>& sum);
    /// False where a front is singular.
    bool factorise();
    /// Operations of a factorisation, and numbers in the factors.
    double work() const { return solver_.work(); }
    double entries() const { return solver_.entries(); }

    /// (I - P B)^-1 b, one column after the other, (3 N, K); its transpose on one column.
    Eigen::MatrixXd solve(const Eigen::MatrixXd& b) const;
    Eigen::VectorXd solve_transposed(const Eigen::VectorXd& b) const;

    /// (3 N,) mass of every number of a velocity, over the whole: squares weighted by it sum to a mean.
    const Eigen::VectorXd& weight() const { return weight_; }
    double size(const Eigen::VectorXd& v) const { return std::sqrt((v.array() * weight_.array() * v.array()).sum()); }

  private:
    Eigen::Index nodes3() const { return mass_.size(); }

    Eigen::VectorXd mass_, weight_;  // (3 N,)
    std::vector<std::vector<int>> nodes_of_;
    Eigen::SparseMatrix<double> rows_;    // C, (3 R, 3 N)
    Eigen::SparseMatrix<double> matrix_;  // the saddle
    SparseFactors solver_;
};

}  // namespace mphygs
