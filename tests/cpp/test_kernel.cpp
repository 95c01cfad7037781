// The quadratic B-spline: partition of unity, linear reproduction, slopes, and the block tables.
#include <gtest/gtest.h>

#include <algorithm>

#include "mphygs/transfers/spline_tables.hpp"
#include "random_numbers.hpp"

namespace mphygs {
namespace {

TEST(Kernel, SumsToOneAndReproducesLinearFunctions) {
    for (int n = 0; n <= 20; ++n) {
        const double s = -0.5 + n / 20.0;
        const SplineWeights<double> w = spline_weights(s);
        EXPECT_NEAR(w.value[0] + w.value[1] + w.value[2], 1.0, 1e-15);
        EXPECT_NEAR(w.value[2] - w.value[0], s, 1e-15);
        EXPECT_NEAR(w.slope[0] + w.slope[1] + w.slope[2], 0.0, 1e-15);
        EXPECT_NEAR(w.slope[2] - w.slope[0], 1.0, 1e-15);
        // Quadratics: sum_i N_i (i - s)^2 is constant for a quadratic B-spline.
        EXPECT_NEAR(w.value[0] + w.value[2] - s * s, 0.25, 1e-15);
        for (const double value : w.value) {
            EXPECT_GE(value, 0.0);
        }
    }
}

TEST(Kernel, SlopesAreTheDerivativesOfTheValues) {
    const double h = 1e-6;
    for (const double s : {-0.4, -0.1, 0.0, 0.3}) {
        const SplineWeights<double> w = spline_weights(s), plus = spline_weights(s + h), minus = spline_weights(s - h);
        for (int i = 0; i < 3; ++i) {
            EXPECT_NEAR(w.slope[i], (plus.value[i] - minus.value[i]) / (2 * h), 1e-9);
        }
    }
}

TEST(Kernel, NeighbouringSpansMeetSmoothly) {
    const SplineWeights<double> left = spline_weights(0.5), right = spline_weights(-0.5);
    EXPECT_EQ(left.value[0], 0.0);
    EXPECT_EQ(right.value[2], 0.0);
    for (int i = 0; i < 2; ++i) {
        EXPECT_EQ(left.value[i + 1], right.value[i]);
        EXPECT_EQ(left.slope[i + 1], right.slope[i]);
    }
}

TEST(Kernel, WeightsOfAPointReproduceALinearFieldAndItsGradient) {
    const double s[3] = {0.31, -0.47, 0.12}, spacing[3] = {0.01, 0.02, 0.005};
    double value[27], gradient[27][3];
    point_weights(s, spacing, value, gradient);
    const double a[3] = {3, -2, 5};
    double field = 0, slope[3] = {0, 0, 0}, one = 0;
    for (int i = 0; i < 27; ++i) {
        const double x[3] = {(i / 9 - 1) * spacing[0], ((i / 3) % 3 - 1) * spacing[1], (i % 3 - 1) * spacing[2]};
        const double f = a[0] * x[0] + a[1] * x[1] + a[2] * x[2];
        one += value[i];
        field += value[i] * f;
        for (int j = 0; j < 3; ++j) {
            slope[j] += gradient[i][j] * f;
        }
    }
    EXPECT_NEAR(one, 1.0, 1e-15);
    EXPECT_NEAR(field, a[0] * s[0] * spacing[0] + a[1] * s[1] * spacing[1] + a[2] * s[2] * spacing[2], 1e-15);
    for (int j = 0; j < 3; ++j) {
        EXPECT_NEAR(slope[j], a[j], 1e-12);
    }
}

/// Tables of eight random points, and a field on a little grid of nodes.
template <class T>
struct BlockOf {
    static constexpr std::size_t stride = 40;
    GradientTable<T> gradient{};
    ValueTable<T> value{};
    double n[8][27], dn[8][27][3];
    Rows rows;
    std::vector<T> field;
    /// common: whether the tables are read, or their factors.
    BlockOf(test::Random& random, bool common) {
        const double spacing[3] = {0.1, 0.2, 0.15};
        gradient.common = common;
        for (int q = 0; q < 8; ++q) {
            const double s[3] = {random.between(-0.5, 0.5), random.between(-0.5, 0.5), random.between(-0.5, 0.5)};
            point_weights(s, spacing, n[q], dn[q]);
            set_point(q, s, spacing, gradient, value);
        }
        for (int r = 0; r < 9; ++r) {
            rows[r] = 4 * r;
        }
        const std::vector<double> numbers = random.numbers(6 * stride, -1, 1);
        field.assign(numbers.begin(), numbers.end());
    }
};
using Block = BlockOf<double>;

class Tables : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Kernel, Tables, testing::Bool());

TEST_P(Tables, GatherReadsValuesAndGradientsOfAField) {
    test::Random random(5);
    const Block b(random, GetParam());
    const Mat3<Pack<double>> g = gather_gradient<double>(b.field.data(), Block::stride, b.rows, b.gradient);
    const Vec3<Pack<double>> v = gather_value<double>(b.field.data(), Block::stride, b.rows, b.value);
    for (int q = 0; q < 8; ++q) {
        for (std::size_t c = 0; c < 3; ++c) {
            double value = 0, slope[3] = {0, 0, 0};
            for (int a = 0; a < 27; ++a) {
                const double x = b.field[c * Block::stride + static_cast<std::size_t>(node_of<double>(b.rows, a))];
                value += b.n[q][a] * x;
                for (int j = 0; j < 3; ++j) {
                    slope[j] += b.dn[q][a][j] * x;
                }
            }
            EXPECT_NEAR(v[static_cast<int>(c)][q], value, 1e-14);
            for (int j = 0; j < 3; ++j) {
                EXPECT_NEAR(g[static_cast<int>(c)][j][q], slope[j], 1e-12);
            }
        }
    }
}

TEST_P(Tables, ScatterIsTheTransposeOfGather) {
    test::Random random(6);
    const Block b(random, GetParam());
    Mat3<Pack<double>> stress;
    Vec3<Pack<double>> force;
    for (int i = 0; i < 3; ++i) {
        force[i] = random.pack(-1, 1);
        for (int j = 0; j < 3; ++j) {
            stress[i][j] = random.pack(-1, 1);
        }
    }
    std::vector<double> by_gradient(3 * Block::stride, 0.0), by_value(3 * Block::stride, 0.0);
    scatter_gradient<double>(stress, by_gradient.data(), Block::stride, b.rows, b.gradient);
    scatter_value<double>(force, by_value.data(), Block::stride, b.rows, b.value);
    const Mat3<Pack<double>> g = gather_gradient<double>(b.field.data(), Block::stride, b.rows, b.gradient);
    const Vec3<Pack<double>> v = gather_value<double>(b.field.data(), Block::stride, b.rows, b.value);
    double left[2] = {0, 0};
    for (std::size_t i = 0; i < by_gradient.size(); ++i) {
        left[0] += b.field[i] * by_gradient[i];
        left[1] += b.field[i] * by_value[i];
    }
    EXPECT_NEAR(left[0], sum_lanes<double>(inner(g, stress)), 1e-11);
    EXPECT_NEAR(left[1], sum_lanes<double>(dot(v, force)), 1e-13);
    // The fourth lane of a row belongs to no node of the block.
    for (std::size_t i = 3; i < 36; i += 4) {
        EXPECT_EQ(by_gradient[i], 0.0);
        EXPECT_EQ(by_value[i], 0.0);
    }
}

TEST_P(Tables, TwoFieldsAtOnceAreEachOfThem) {
    test::Random random(7);
    const BlockOf<float> b(random, GetParam());
    constexpr std::size_t size = 3 * Block::stride;
    const Mat3<PackPair> both = gather_gradient_pair(b.field.data(), size, Block::stride, b.rows, b.gradient);
    Mat3<PackPair> stress;
    Mat3<Pack<float>> one[2];
    std::vector<float> sums[2], pair[2];
    for (std::size_t k = 0; k < 2; ++k) {
        const Mat3<Pack<float>> g = gather_gradient<float>(b.field.data() + k * size, Block::stride, b.rows, b.gradient);
        for (int i = 0; i < 9; ++i) {
            const Pack<float> half = k == 0 ? lower(both[i / 3][i % 3]) : upper(both[i / 3][i % 3]);
            for (int q = 0; q < 8; ++q) {
                EXPECT_NEAR(half[q], g[i / 3][i % 3][q], 1e-4);  // of slopes up to 20
                one[k][i / 3][i % 3][q] = static_cast<float>(random.between(-1, 1));
            }
        }
        sums[k].assign(size, 0.0f);
        pair[k].assign(size, 0.0f);
        scatter_gradient<float>(one[k], sums[k].data(), Block::stride, b.rows, b.gradient);
    }
    for (int i = 0; i < 9; ++i) {
        stress[i / 3][i % 3] = join(one[0][i / 3][i % 3], one[1][i / 3][i % 3]);
    }
    scatter_gradient_pair(stress, pair[0].data(), pair[1].data(), Block::stride, b.rows, b.gradient);
    for (std::size_t i = 0; i < size; ++i) {
        EXPECT_NEAR(pair[0][i], sums[0][i], 1e-4);
        EXPECT_NEAR(pair[1][i], sums[1][i], 1e-4);
    }
    EXPECT_GT(*std::max_element(sums[1].begin(), sums[1].end()), 1.0f);
}

}  // namespace
}  // namespace mphygs
