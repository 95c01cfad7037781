// Anderson's acceleration of an iteration x <- x + d(x): for a linear d it is GMRES.
// Source: Walker and Ni, "Anderson acceleration for fixed-point iterations", 2011.
#pragma once

#include <Eigen/Dense>
#include <vector>

namespace mphygs {

class Anderson {
  public:
    /// weight: of the squares of d's numbers; memory: differences that are kept.
    explicit Anderson(Eigen::VectorXd weight, std::size_t memory = 12) : weight_(std::move(weight)), memory_(memory) {}

    void forget();
    /// The next x, from this one and the correction d that the iteration makes of it.
    Eigen::VectorXd next(const Eigen::VectorXd& x, const Eigen::VectorXd& d);

  private:
    double product(const Eigen::VectorXd& a, const Eigen::VectorXd& b) const { return (a.array() * weight_.array() * b.array()).sum(); }

    Eigen::VectorXd weight_, x_, d_;
    std::size_t memory_;
    std::vector<Eigen::VectorXd> dx_, dd_;  // changes of x and of d, those of d orthonormal
};

}  // namespace mphygs
