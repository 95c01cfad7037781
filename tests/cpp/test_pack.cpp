// The pack's own functions against the standard library's, and the loops on it.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "random_numbers.hpp"

namespace mphygs {
namespace {

template <class T>
class PackFunctions : public testing::Test {};
using Scalars = testing::Types<float, double>;
TYPED_TEST_SUITE(PackFunctions, Scalars);

TYPED_TEST(PackFunctions, LogarithmFollowsTheStandardOneOverTheWholeRange) {
    using T = TypeParam;
    const double tolerance = 4 * static_cast<double>(std::numeric_limits<T>::epsilon());
    const int last = std::numeric_limits<T>::max_exponent - 2;
    test::Random random(1);
    for (int exponent = -last; exponent <= last; ++exponent) {
        Pack<T> x{};
        for (int i = 0; i < lane_count; ++i) {
            x[i] = std::ldexp(static_cast<T>(random.between(1.0, 2.0)), exponent);
        }
        const Pack<T> y = logarithm(x);
        for (int i = 0; i < lane_count; ++i) {
            const double exact = std::log(static_cast<double>(x[i]));
            EXPECT_NEAR(static_cast<double>(y[i]), exact, tolerance * std::max(1.0, std::abs(exact))) << x[i];
        }
    }
}

TYPED_TEST(PackFunctions, LogarithmIsRelativelyExactNearOne) {
    using T = TypeParam;
    // Small strains live here: an absolute error of one epsilon would be a relative one of 1e-3.
    for (int shift = 3; shift < std::numeric_limits<T>::digits - 3; ++shift) {
        for (const T sign : {T(-1), T(1)}) {
            const T x = T(1) + sign * std::ldexp(T(1.25), -shift);
            const T y = logarithm(broadcast<T>(x))[0];
            EXPECT_NEAR(static_cast<double>(y) / std::log(static_cast<double>(x)), 1.0,
                        4 * static_cast<double>(std::numeric_limits<T>::epsilon()))
                << x;
        }
    }
}

TYPED_TEST(PackFunctions, LogarithmOfAnInvertedElementIsNotANumber) {
    using T = TypeParam;
    Pack<T> x = broadcast<T>(2);
    x[1] = T(0);
    x[4] = T(-3);
    x[6] = std::numeric_limits<T>::quiet_NaN();
    const Pack<T> y = logarithm(x);
    for (const int i : {1, 4, 6}) {
        EXPECT_TRUE(std::isnan(y[i])) << i;
    }
    EXPECT_NEAR(static_cast<double>(y[0]), std::log(2.0), 1e-6);
}

TYPED_TEST(PackFunctions, ExponentialFollowsTheStandardOneOverTheWholeRange) {
    using T = TypeParam;
    const double low = sizeof(T) == 4 ? -87.0 : -708.0, high = sizeof(T) == 4 ? 88.0 : 709.0;
    const double tolerance = 8 * static_cast<double>(std::numeric_limits<T>::epsilon());
    for (int n = 0; n <= 4000; ++n) {
        const T x = static_cast<T>(low + (high - low) * n / 4000.0);
        const T y = exponential(broadcast<T>(x))[n % lane_count];
        EXPECT_NEAR(static_cast<double>(y) / std::exp(static_cast<double>(x)), 1.0, tolerance) << x;
    }
    EXPECT_EQ(exponential(Pack<T>{})[0], T(1));
    EXPECT_TRUE(std::isfinite(exponential(broadcast<T>(T(1e4)))[0]));
    EXPECT_TRUE(std::isnan(exponential(broadcast<T>(std::numeric_limits<T>::quiet_NaN()))[0]));
}

TYPED_TEST(PackFunctions, LaneFunctionsActOnEveryLane) {
    using T = TypeParam;
    Pack<T> x{};
    for (int i = 0; i < lane_count; ++i) {
        x[i] = T(0.25) * static_cast<T>(i + 1);
    }
    const Pack<T> root = square_root(x), s = sine(x), c = cosine(x);
    for (int i = 0; i < lane_count; ++i) {
        EXPECT_EQ(root[i], std::sqrt(static_cast<T>(x[i])));
        EXPECT_EQ(s[i], std::sin(static_cast<T>(x[i])));
        EXPECT_EQ(c[i], std::cos(static_cast<T>(x[i])));
    }
}

TYPED_TEST(PackFunctions, LoadStoreBroadcastSelectAndSum) {
    using T = TypeParam;
    T numbers[lane_count + 1];  // one off the alignment: blocks start anywhere
    for (int i = 0; i <= lane_count; ++i) {
        numbers[i] = static_cast<T>(i);
    }
    const Pack<T> x = load<T>(numbers + 1);
    EXPECT_EQ(sum_lanes<T>(x), T(36));
    T back[lane_count];
    store<T>(back, x);
    const Pack<T> chosen = select(x > broadcast<T>(4), x, broadcast<T>(-1));
    for (int i = 0; i < lane_count; ++i) {
        EXPECT_EQ(back[i], static_cast<T>(i + 1));
        EXPECT_EQ(chosen[i], i + 1 > 4 ? static_cast<T>(i + 1) : T(-1));
    }
}

}  // namespace
}  // namespace mphygs
