// The quadratic B-spline: partition of unity, linear reproduction, slopes, and the block tables.
#include <gtest/gtest.h>

#include <algorithm>

#include "mphygs/total_lagrangian/direction_sums.hpp"
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

template <class T, int L>
void expect_directions_in_the_lanes(bool common) {
    using W = Vector<T, L>;
    constexpr std::size_t lanes = static_cast<std::size_t>(L), stride = Block::stride;
    test::Random random(7);
    BlockOf<T> b(random, common);
    std::vector<W> field(3 * stride), sums(3 * stride, W{}), value_sums(3 * stride, W{});
    for (W& x : field) {
        for (std::size_t l = 0; l < lanes; ++l) {
            x[l] = static_cast<T>(random.between(-1, 1));
        }
    }
    W gradient[3][point_axes], stress[3][point_axes];
    Vec3<W> value[lane_count], force[lane_count];
    gather_directions<W, T>(field.data(), b.rows, b.gradient, gradient);
    gather_direction_values<W, T>(field.data(), b.rows, b.value, value);
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t i = 0; i < point_axes; ++i) {
            for (std::size_t l = 0; l < lanes; ++l) {
                stress[c][i][l] = static_cast<T>(random.between(-1, 1));
                force[i % lane_count][static_cast<int>(c)][l] = stress[c][i][l];
            }
        }
    }
    scatter_directions<W, T>(stress, sums.data(), b.rows, b.gradient);
    scatter_direction_values<W, T>(force, value_sums.data(), b.rows, b.value);
    const T close = static_cast<T>(std::is_same_v<T, float> ? 1e-4 : 1e-11);  // of slopes up to 20
    for (std::size_t l = 0; l < lanes; ++l) {
        std::vector<T> alone(3 * stride), scattered(3 * stride, T{}), scattered_values(3 * stride, T{});
        Mat3<Pack<T>> own;
        Vec3<Pack<T>> own_force;
        for (std::size_t n = 0; n < stride; ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                alone[c * stride + n] = field[3 * n + c][l];
            }
        }
        for (int i = 0; i < 9; ++i) {
            for (int q = 0; q < lane_count; ++q) {
                own[i / 3][i % 3][q] = stress[i / 3][i % 3 * lane_count + q][l];
                own_force[i / 3][q] = force[q][i / 3][l];
            }
        }
        const Mat3<Pack<T>> g = gather_gradient<T>(alone.data(), stride, b.rows, b.gradient);
        const Vec3<Pack<T>> v = gather_value<T>(alone.data(), stride, b.rows, b.value);
        scatter_gradient<T>(own, scattered.data(), stride, b.rows, b.gradient);
        scatter_value<T>(own_force, scattered_values.data(), stride, b.rows, b.value);
        for (int i = 0; i < 9; ++i) {
            for (int q = 0; q < lane_count; ++q) {
                EXPECT_NEAR(gradient[i / 3][i % 3 * lane_count + q][l], g[i / 3][i % 3][q], close);
                EXPECT_NEAR(value[q][i / 3][l], v[i / 3][q], close);
            }
        }
        for (std::size_t n = 0; n < stride; ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                EXPECT_NEAR(sums[3 * n + c][l], scattered[c * stride + n], close);
                EXPECT_NEAR(value_sums[3 * n + c][l], scattered_values[c * stride + n], close);
            }
        }
        EXPECT_GT(*std::max_element(scattered.begin(), scattered.end()), T(1));
    }
}

TEST_P(Tables, DirectionsInTheLanesAreEachOfThem) {
    expect_directions_in_the_lanes<float, 4>(GetParam());
    expect_directions_in_the_lanes<float, register_lanes<float>>(GetParam());
    expect_directions_in_the_lanes<double, register_lanes<double>>(GetParam());
}

}  // namespace
}  // namespace mphygs
