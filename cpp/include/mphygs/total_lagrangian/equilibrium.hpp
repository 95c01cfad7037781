// The stress-free shape of an object that is published in equilibrium.
//
// Inverse statics on the published shape: find the map X(Y) = Y + w(Y) to the stress-free state so
// that, with F = (I + grad w)^-1, the Cauchy stress balances the loads on the published shape:
//   R_a = sum_q V_q sigma(F_q) grad N_a - f_a + C^T mu = 0,  C w = 0.
// Newton's method with a direct factorisation; derivatives by the implicit-function theorem.
// Source of the inverse formulation: Govindjee & Mihalic, "Computational methods for inverse finite
// elastostatics", 1996.
#pragma once

#include <memory>
#include <vector>

#include "mphygs/numerics/sparse_factors.hpp"
#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

class Equilibrium {
  public:
    /// Throws std::invalid_argument where nothing holds the object.
    explicit Equilibrium(std::shared_ptr<const TotalLagrangian<double>> model);

    struct Solution {
        std::vector<double> map;            // w, (N, 3) [m]
        std::vector<double> deformation0;   // F, (B, 9, 8)
        std::vector<double> volume_ratio;   // stress-free over published volume, (B, 8)
        int iterations = 0;
        double last_step = 0;               // [m]
        double springs = 0;                 // stiffness of what holds the shapes of a cell that its points cannot see [Pa]
    };

    /// fields: mu, lambda, effect are read; volume: (B, 8) published volume [m^3];
    /// load: (N, 3) external force on the nodes [N]; start: w to begin with, or empty.
    /// With the softest springs that Newton's method can do with in so many iterations.
    /// Throws SimulationError where it does not converge with the stiffest.
    Solution solve(const Fields<double>& fields, const std::vector<double>& volume, const std::vector<double>& load,
                   const std::vector<double>& start, double tolerance = 1e-9, int iterations = 40);

    /// Derivatives of (deformation0, volume_ratio) at the last solution, per direction.
    struct Direction {
        Fields<double> fields;
        std::vector<double> load;
    };
    std::vector<Solution> tangent(const std::vector<Direction>& directions);

    /// Gradient by mu, lambda, effect and load of a loss with the given derivatives.
    Direction adjoint(const std::vector<double>& deformation0_bar, const std::vector<double>& volume_ratio_bar);

  private:
    struct Assembly;
    void assemble(const std::vector<double>& w, bool matrix, Eigen::VectorXd& residual);
    void fill(Solution& s) const;
    /// From w_ on, with the springs as they are. False where it does not converge; s is filled where it does.
    bool newton(double tolerance, int iterations, Solution& s);
    void factorise();
    /// The factors of the matrix at the last solution, unless that is what they are.
    void factorise_here();

    std::shared_ptr<const TotalLagrangian<double>> model_;
    Fields<double> fields_;
    std::vector<double> volume_, load_, w_;
    Eigen::VectorXd unknown_;
    double node_spring_ = 0;  // [N/m]
    double unseen_ = 0;       // of the springs on what a cell's points cannot see [Pa]
    bool factors_are_here_ = false;
    Eigen::SparseMatrix<double> matrix_;
    std::vector<std::int32_t> position_;  // of every block's 81 x 81 entries in the matrix's values
    SparseFactors solver_;
};

}  // namespace mphygs
