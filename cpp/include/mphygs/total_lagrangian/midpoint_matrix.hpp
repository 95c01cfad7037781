// The linear system of an implicit step, and its factors.
//
// The map v -> Phi(v) of which the midpoint's velocity is the fixed point (see `midpoint.hpp`) has the derivative P B, with
// P what the holds leave of a velocity. (I - P B) d = b is the saddle
//   [ A  C^T ] [   d    ]   [ M b ]
//   [ C   0  ] [ lambda ] = [ C b ],   A = M (I - B) = M - S + h/2 D + h^2/4 K
// with M the lumped mass and S what nodes share of it (`consistent_mass.hpp`).
// A couples nodes that share a cell only: it is summed from what the points of every cell make of its nodes' motion. Without
// the holds it has an inverse, for nodes have mass: the rows of a hold or joint are eliminated after all of their nodes.
// A sheet resists being stretched (L / t)^2 times as much as being bent. When it has turned by a small angle, old factors take
// a part of its bending for stretching. So they turn with it: with Q the turn of every node since they were made, and Q_r that
// of a row, the mean of its nodes', A is taken for Q A Q^T and C for Q_r C Q^T, which is exact where all has turned alike.
#pragma once

#include <Eigen/Sparse>
#include <array>
#include <cmath>

#include "mphygs/model.hpp"
#include "mphygs/numerics/sparse_factors.hpp"
#include "mphygs/small.hpp"

namespace mphygs {

/// The 27 nodes of a cell, or of a place's pattern.
using CellNodes = std::array<std::int32_t, 27>;
/// What the motion of these nodes does to each of them: row a, column 3 (3 b + k) + i is of node a's component i by
/// node b's component k.
template <class T>
using CellMatrix = Eigen::Matrix<T, 27, 243>;
/// The turn of every node since the body was at rest.
using NodeTurns = std::vector<Mat3<double>>;
/// The rotation nearest to a sum of such; none where they cancel.
Mat3<double> nearest_turn(const Mat3<double>& sum);

class MidpointMatrix {
  public:
    /// node: of every weight of the geometry's rows; cells: the nodes of every cell in use, in the order that `add` numbers them
    /// in; mass: (N,) [kg], lumped; shared: (N, N) what nodes of a cell share of it.
    MidpointMatrix(const Geometry& geometry, const std::vector<std::int32_t>& node, const std::vector<CellNodes>& cells, std::vector<double> mass,
                   const Eigen::SparseMatrix<double>& shared);

    /// A as it is without forces.
    void clear();
    /// Adds to A what one cell's points make, or one node's own acceleration (row i, column k).
    template <class T>
    void add(std::size_t cell, const CellMatrix<T>& block);
    void add(int node, const Eigen::Matrix3d& block);
    /// False where a front is singular.
    bool factorise();
    /// Operations of a factorisation, and numbers in the factors.
    double work() const { return solver_.work(); }
    double entries() const { return solver_.entries(); }

    /// Where the body stands as the factors are made, and where they are used from here on.
    void made_at(NodeTurns turns);
    void used_at(const NodeTurns& turns);

    /// (I - P B)^-1 b, one column after the other, (3 N, K); its transpose on one column.
    Eigen::MatrixXd solve(const Eigen::MatrixXd& b) const;
    Eigen::VectorXd solve_transposed(const Eigen::VectorXd& b) const;

    /// (3 N,) mass of every number of a velocity, over the whole: squares weighted by it sum to a mean.
    const Eigen::VectorXd& weight() const { return weight_; }
    double size(const Eigen::VectorXd& v) const { return std::sqrt((v.array() * weight_.array() * v.array()).sum()); }

  private:
    Eigen::Index nodes3() const { return mass_.size(); }
    /// Of the first number of A in a column for a node's motion that is a node's: those of its three components follow.
    Eigen::Index entry(int row_node, Eigen::Index column) const;

    /// Q^T of the nodes' three numbers in each column, or Q; the same of the rows'.
    static Eigen::MatrixXd turned(const NodeTurns& turns, const Eigen::MatrixXd& x, bool back);

    Eigen::VectorXd mass_, weight_;  // (3 N,)
    NodeTurns made_, turns_, row_turns_;                     // at the factors' making; since then, of nodes and of rows; empty: none
    std::vector<std::int32_t> row_begin_, row_node_;         // of the holds and joints
    std::vector<double> row_weight_;
    // Where in the three columns of a cell's node b its node a's numbers begin, 27 b + a; -1 where a has no mass: it stays.
    using CellPlaces = std::array<std::int32_t, 27 * 27>;
    std::vector<CellNodes> cells_;
    std::vector<CellPlaces> places_;
    std::vector<double> still_;           // of every entry of the saddle: what it has without forces
    Eigen::SparseMatrix<double> rows_;    // C, (3 R, 3 N)
    Eigen::SparseMatrix<double> matrix_;  // the saddle
    SparseFactors solver_;
};

}  // namespace mphygs
