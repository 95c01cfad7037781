// Direct solver for the sparse systems of slender bodies: dense blocks along level sets.
//
// A breadth-first search from the held rows cuts the unknowns into levels that couple only to their
// neighbours; the matrix is then block tridiagonal and is factorised with dense kernels:
//   D_i <- D_i - L_i D_(i-1)^-1 U_(i-1).
// Pivoting stays inside a block, which is enough for stiffness matrices with their constraints in
// the first levels, or in one level with all that they tie. Stems, leaves and beams have levels of a few hundred unknowns.
#pragma once

#include <Eigen/Dense>
#include <Eigen/Sparse>
#include <vector>

namespace mphygs {

class BlockTridiagonal {
  public:
    /// Levels of a matrix with a symmetric pattern, starting at the given unknowns; unknowns that
    /// are not connected to them start levels of their own.
    /// together: groups of unknowns; the rest of a group enters the level in which its first one stands.
    void analyse(const Eigen::SparseMatrix<double>& matrix, const std::vector<int>& start,
                 const std::vector<std::vector<int>>& together = {});
    /// False where a block is singular.
    bool factorise(const Eigen::SparseMatrix<double>& matrix);
    Eigen::VectorXd solve(const Eigen::VectorXd& right) const;
    Eigen::VectorXd solve_transposed(const Eigen::VectorXd& right) const;
    /// Of several right-hand sides, one a column: the factors are read once.
    Eigen::MatrixXd solve_all(const Eigen::MatrixXd& right) const;
    bool analysed() const { return !levels_.empty(); }

  private:
    std::vector<std::vector<int>> levels_;
    std::vector<int> level_of_, place_of_;
    std::vector<Eigen::PartialPivLU<Eigen::MatrixXd>> diagonal_;
    std::vector<Eigen::MatrixXd> lower_, upper_;  // L_i and U_i as they are in the matrix
};

}  // namespace mphygs
