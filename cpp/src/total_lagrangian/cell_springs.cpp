// The shapes that a cell's points do not see.
#include "mphygs/total_lagrangian/cell_springs.hpp"

#include <Eigen/Dense>

namespace mphygs {

void flat_shapes(const double (&share)[27], const double (&slopes)[24][27], double (&shape)[cell_shapes][27]) {
    double root[27];
    Eigen::Matrix<double, 27, 10> polynomials;
    Eigen::Matrix<double, 24, 27> weighed;
    for (int a = 0; a < 27; ++a) {
        const double x = a / 9 - 1, y = (a / 3) % 3 - 1, z = a % 3 - 1;
        root[a] = std::max(std::sqrt(share[a]), 1e-9);
        polynomials.row(a) << 1, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x;
        polynomials.row(a) *= root[a];
        for (int i = 0; i < 24; ++i) {
            weighed(i, a) = slopes[i][a] / root[a];
        }
    }
    // In coordinates of length root[a] u_a: what has least slope (and the constant), and of that what no polynomial is.
    const Eigen::MatrixXd flat =
        Eigen::JacobiSVD<Eigen::MatrixXd>(weighed, Eigen::ComputeFullV).matrixV().rightCols<cell_shapes + 1>();
    const Eigen::Matrix<double, 27, 10> q =
        polynomials.householderQr().householderQ() * Eigen::Matrix<double, 27, 10>::Identity();
    const Eigen::MatrixXd beside = flat - q * (q.transpose() * flat);
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(beside, Eigen::ComputeThinU);
    for (int k = 0; k < cell_shapes; ++k) {
        const bool something = svd.singularValues()[k] > 0.1;  // else it is next to a polynomial
        for (int a = 0; a < 27; ++a) {
            shape[k][a] = something ? root[a] * svd.matrixU()(a, k) : 0.0;
        }
    }
}

}  // namespace mphygs
