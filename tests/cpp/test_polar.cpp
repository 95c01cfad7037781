// The polar rotation and its derivative.
#include <gtest/gtest.h>

#include <cmath>

#include "mphygs/numerics/polar.hpp"
#include "random_numbers.hpp"

namespace mphygs {
namespace {

using M = Mat3<double>;

/// A symmetric positive matrix with the given principal stretches.
M stretch(test::Random& random, double a, double b, double c) {
    const M q = test::rotation_about(random.between(-1, 1), random.between(-1, 1), 1.1, random.between(-3, 3));
    M d;
    d[0][0] = a;
    d[1][1] = b;
    d[2][2] = c;
    return q * d * transpose(q);
}

TEST(Polar, FindsTheRotationOfARotatedStretch) {
    test::Random random(1);
    for (const double largest : {1.0, 1.5, 3.0, 8.0}) {
        for (int n = 0; n < 10; ++n) {
            const M u = stretch(random, largest, 1.0, 1.0 / largest);
            const M r = test::rotation_about(random.between(-1, 1), 0.3, random.between(-1, 1), random.between(-3.1, 3.1));
            const M found = polar_rotation(r * u);
            for (int i = 0; i < 9; ++i) {
                EXPECT_NEAR(found[i / 3][i % 3], r[i / 3][i % 3], 1e-13) << largest;
            }
        }
    }
}

TEST(Polar, FloatPacksAreOrthogonalToRoundOff) {
    test::Random random(2);
    Mat3<Pack<float>> f = Mat3<Pack<float>>::identity();
    for (int i = 0; i < 9; ++i) {
        for (int q = 0; q < lane_count; ++q) {
            f[i / 3][i % 3][q] += static_cast<float>(random.between(-0.3, 0.3));
        }
    }
    const Mat3<Pack<float>> r = polar_rotation(f);
    const Mat3<Pack<float>> one = r * transpose(r);
    for (int i = 0; i < 9; ++i) {
        for (int q = 0; q < lane_count; ++q) {
            EXPECT_NEAR(one[i / 3][i % 3][q], i % 4 == 0 ? 1.0 : 0.0, 1e-6);
        }
    }
}

TEST(Polar, DerivativeThroughTheIterationAgreesWithCentralDifferences) {
    test::Random random(3);
    for (int n = 0; n < 5; ++n) {
        const M f = random.deformation(0.3);
        const M direction = random.deformation(1.0);
        using D = Dual<double, 1>;
        Mat3<D> dual;
        for (int i = 0; i < 9; ++i) {
            dual[i / 3][i % 3] = D(f[i / 3][i % 3]);
            dual[i / 3][i % 3].d[0] = direction[i / 3][i % 3];
        }
        const Mat3<D> r = polar_rotation(dual);
        const double h = 1e-6;
        const M plus = polar_rotation(f + h * direction), minus = polar_rotation(f - h * direction);
        double size = 0;
        for (int i = 0; i < 9; ++i) {
            EXPECT_NEAR(r[i / 3][i % 3].d[0], (plus[i / 3][i % 3] - minus[i / 3][i % 3]) / (2 * h), 1e-8);
            size += std::abs(r[i / 3][i % 3].d[0]);
        }
        EXPECT_GT(size, 1e-2);
    }
}

}  // namespace
}  // namespace mphygs
