// Dual numbers against central differences and against known derivatives.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "mphygs/physics/lanes.hpp"
#include "scalar_functions.hpp"

namespace mphygs {
namespace {

using test::scalar_functions;

TEST(Dual, EveryOperationAgreesWithCentralDifferences) {
    const double x = 0.7, y = 1.3;
    for (const auto& function : scalar_functions<double>()) {
        using D = Dual<double, 2>;
        D a(x), b(y);
        a.d[0] = 1;
        b.d[1] = 1;
        const auto dual = test::scalar_function<D>(function.name);
        const D result = dual(a, b);
        const double h = 1e-6;
        EXPECT_DOUBLE_EQ(result.v, function.f(x, y)) << function.name;
        EXPECT_NEAR(result.d[0], (function.f(x + h, y) - function.f(x - h, y)) / (2 * h), 1e-8) << function.name;
        EXPECT_NEAR(result.d[1], (function.f(x, y + h) - function.f(x, y - h)) / (2 * h), 1e-8) << function.name;
        EXPECT_TRUE(result.d[0] != 0 || result.d[1] != 0) << function.name;
    }
}

TEST(Dual, PacksCarryTheSameDerivativesInEveryLane) {
    using P = Pack<double>;
    using D = Dual<P, 1>;
    for (const auto& function : scalar_functions<double>()) {
        P x{};
        for (int i = 0; i < lane_count; ++i) {
            x[i] = 0.5 + 0.1 * i;
        }
        D a(x), b(P{} + 1.3);
        a.d[0] = P{} + 1;
        const D result = test::scalar_function<D>(function.name)(a, b);
        for (int i = 0; i < lane_count; ++i) {
            using E = Dual<double, 1>;
            E one(x[i]), two(1.3);
            one.d[0] = 1;
            const E expected = test::scalar_function<E>(function.name)(one, two);
            EXPECT_NEAR(result.v[i], expected.v, 1e-14) << function.name;
            EXPECT_NEAR(result.d[0][i], expected.d[0], 1e-13) << function.name;
        }
    }
}

TEST(Dual, ConstantHasNoDerivativeAndValueDropsIt) {
    using D = Dual<Pack<double>, 3>;
    const D c = constant<D>(2.5);
    for (int k = 0; k < 3; ++k) {
        EXPECT_EQ(sum_lanes<double>(c.d[k]), 0.0);
    }
    EXPECT_EQ(value_of(c)[5], 2.5);
    EXPECT_EQ(constant<double>(2.5), 2.5);
}

TEST(Dual, LanesOfAScalarAreItsValueAndItsDerivatives) {
    Dual<double, 2> x(3.0);
    lane_of(x, 2) = 5.0;
    EXPECT_EQ(lane_of(x, 0), 3.0);
    EXPECT_EQ(x.d[1], 5.0);
    Mat3<Dual<double, 2>> m;
    set_lane(m, 1, Mat3<double>::identity());
    EXPECT_EQ(m[2][2].d[0], 1.0);
    const Mat3<double> slice = get_lane<double>(m, 1);
    EXPECT_EQ(slice[1][1], 1.0);
    EXPECT_EQ(slice[1][0], 0.0);
}

}  // namespace
}  // namespace mphygs
