// Springs on what the points of a sparsely filled cell do not see: what they hold and what they leave alone.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "bar_scene.hpp"
#include "mphygs/total_lagrangian/cell_springs.hpp"

namespace mphygs {
namespace {

constexpr double spacing[3] = {0.01, 0.012, 0.011};
const Rows rows = {0, 3, 6, 9, 12, 15, 18, 21, 24};

struct Cell {
    ValueTable<double> value{};
    GradientTable<double> gradient{};
};

/// A cell whose material is a box of 0.2 to 0.6 of its edges in a corner, or all of it.
Cell cell(bool full) {
    Cell c;
    const double gauss = 0.5 / std::sqrt(3.0), size[3] = {0.6, 0.2, 0.5};
    for (int q = 0; q < 8; ++q) {
        double s[3];
        for (int i = 0; i < 3; ++i) {
            const double side = q >> i & 1 ? gauss : -gauss;
            s[i] = full ? side : size[i] * side + 0.5 * (size[i] - 1.0);
        }
        set_point(q, s, spacing, c.gradient, c.value);
    }
    return c;
}

TEST(CellSprings, LeaveQuadraticFieldsAlone) {
    for (const bool full : {false, true}) {
        const Cell c = cell(full);
        const CellSprings<double> springs(c.value, c.gradient, spacing, 0.3);
        test::Random random(31);
        const std::vector<double> k = random.numbers(10, -1, 1);
        double field[28] = {};
        for (int a = 0; a < 27; ++a) {
            const double x = a / 9 - 1, y = (a / 3) % 3 - 1, z = a % 3 - 1;
            field[a] = k[0] + k[1] * x + k[2] * y + k[3] * z + k[4] * x * x + k[5] * y * y + k[6] * z * z + k[7] * x * y +
                       k[8] * y * z + k[9] * z * x;
        }
        for (const double along : springs.along(field, rows)) {
            EXPECT_NEAR(along, 0.0, 1e-12);
        }
    }
}

TEST(CellSprings, HoldWhatHasNoSlopeAtThePoints) {
    const Cell c = cell(false);
    const CellSprings<double> springs(c.value, c.gradient, spacing, 0.3);
    Eigen::Matrix<double, 24, 27> slopes;
    for (int a = 0; a < 27; ++a) {
        for (int i = 0; i < 24; ++i) {
            slopes(i, a) = c.gradient.by_node[a][i % 3][i / 3];
        }
    }
    const Eigen::MatrixXd flat = Eigen::JacobiSVD<Eigen::MatrixXd>(slopes, Eigen::ComputeFullV).matrixV().rightCols<3>();
    EXPECT_LT((slopes * flat).cwiseAbs().maxCoeff(), 1e-9 * slopes.cwiseAbs().maxCoeff());
    double field[28] = {};
    for (int j = 0; j < 3; ++j) {
        double mean = 0, square = 0;
        for (int a = 0; a < 27; ++a) {
            const double share = sum_lanes<double>(c.value.by_node[a]) / 8;
            field[a] = flat(a, j);
            mean += share * field[a];
            square += share * field[a] * field[a];
        }
        double along = 0;
        for (const double x : springs.along(field, rows)) {
            along += x * x;
        }
        // Weighed as the masses are: all of it but the constant, less what a polynomial has.
        EXPECT_LE(along, (square - mean * mean) * (1 + 1e-9));
        EXPECT_GT(along, 0.05 * (square - mean * mean));
    }
}

TEST(CellSprings, PullsAreTheTransposeAndAddUp) {
    const Cell c = cell(false);
    const CellSprings<double> springs(c.value, c.gradient, spacing, 0.3);
    test::Random random(32);
    std::vector<double> field = random.numbers(28, -1, 1), to(28, 0.0);
    const auto along = springs.along(field.data(), rows);
    springs.add(along, rows, to.data());
    double work = 0, sum = 0;
    for (std::size_t a = 0; a < 27; ++a) {
        work += field[a] * to[a];
        sum += to[a];
    }
    double square = 0;
    for (const double x : along) {
        square += x * x;
    }
    EXPECT_NEAR(work, square, 1e-14);
    EXPECT_GT(work, 0.0);
    EXPECT_NEAR(sum, 0.0, 1e-14);  // no net force
    EXPECT_EQ(to[27], 0.0);
}

}  // namespace
}  // namespace mphygs
