// Vectors and matrices of three.
#include <gtest/gtest.h>

#include <cmath>

#include "random_numbers.hpp"

namespace mphygs {
namespace {

using M = Mat3<double>;

void expect_equal(const M& a, const M& b, double tolerance) {
    for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(a[i / 3][i % 3], b[i / 3][i % 3], tolerance) << i;
    }
}

TEST(Small, InverseAndCofactor) {
    test::Random random(1);
    for (int n = 0; n < 20; ++n) {
        const M a = random.deformation(0.4);
        const M c = cofactor(a);
        const double j = determinant(a, c);
        expect_equal(a * inverse(a), M::identity(), 1e-14);
        expect_equal(c, j * transpose(inverse(a)), 1e-14);  // cof A = det A A^-T
        const double by_sarrus = a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) +
                                 a[0][1] * (a[1][2] * a[2][0] - a[1][0] * a[2][2]) +
                                 a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
        EXPECT_NEAR(j, by_sarrus, 1e-14);
    }
}

TEST(Small, ProductsTransposeTraceAndInner) {
    test::Random random(2);
    const M a = random.deformation(1), b = random.deformation(1);
    const Vec3<double> x{{1, -2, 3}}, y{{0.5, 0.25, -1}};
    const M c = a * b;
    EXPECT_NEAR(c[1][2], a[1][0] * b[0][2] + a[1][1] * b[1][2] + a[1][2] * b[2][2], 1e-15);
    EXPECT_NEAR(inner(a, b), trace(transpose(a) * b), 1e-15);
    EXPECT_NEAR(dot(y, a * x), dot(transpose(a) * y, x), 1e-15);
    expect_equal(transpose(a * b), transpose(b) * transpose(a), 1e-15);
    expect_equal(a + b - b, a, 1e-15);
    const Vec3<double> z = 2.0 * (x + y) - x;
    EXPECT_DOUBLE_EQ(z[2], 1.0);
    EXPECT_DOUBLE_EQ(dot(x, y), -3.0);
}

TEST(Small, DerivativeOfTheDeterminantIsTheCofactor) {
    test::Random random(3);
    const M a = random.deformation(0.3);
    const M c = cofactor(a);
    for (int i = 0; i < 9; ++i) {
        Mat3<Dual<double, 1>> f;
        for (int k = 0; k < 9; ++k) {
            f[k / 3][k % 3] = Dual<double, 1>(a[k / 3][k % 3]);
        }
        f[i / 3][i % 3].d[0] = 1;
        EXPECT_NEAR(determinant(f, cofactor(f)).d[0], c[i / 3][i % 3], 1e-15);
    }
}

}  // namespace
}  // namespace mphygs
