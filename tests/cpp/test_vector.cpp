// Vectors in halves do what the compiler's own do, on any processor: the halves here are always of four lanes.
#include "mphygs/numerics/vector.hpp"

#include <gtest/gtest.h>

#include <cstdint>

#include "mphygs/numerics/pack.hpp"

namespace {

using namespace mphygs;

using Eight = Halves<Vector<float, 4>>;
using Sixteen = Halves<Eight>;
using Doubles = Halves<Halves<Vector<double, 2>>>;

template <class V>
V ramp(double first, double step) {
    typename VectorOf<V>::element lanes[VectorOf<V>::count];
    for (int i = 0; i < VectorOf<V>::count; ++i) {
        lanes[i] = static_cast<typename VectorOf<V>::element>(first + step * i);
    }
    return read<V>(lanes);
}

template <class V>
class VectorTest : public testing::Test {};
using Kinds = testing::Types<Eight, Sixteen, Doubles, Pack<float>, Pack<double>, PackPair>;
TYPED_TEST_SUITE(VectorTest, Kinds);

TYPED_TEST(VectorTest, ArithmeticIsLaneByLane) {
    using V = TypeParam;
    using T = typename VectorOf<V>::element;
    const V a = ramp<V>(1, 0.5), b = ramp<V>(-3, 0.25);
    V sum = a;
    sum += b;
    sum *= T(2);
    const V product = T(3) - a * b / T(4);
    for (int i = 0; i < VectorOf<V>::count; ++i) {
        EXPECT_EQ(sum[i], (a[i] + b[i]) * 2);
        EXPECT_EQ(product[i], 3 - a[i] * b[i] / 4);
        EXPECT_EQ((-a)[i], -a[i]);
        EXPECT_EQ(fill<V>(T(7))[i], T(7));
    }
}

TYPED_TEST(VectorTest, ChoosesByLane) {
    using V = TypeParam;
    using T = typename VectorOf<V>::element;
    const V a = ramp<V>(-2, 1), b = ramp<V>(2, -1);
    const V least = choose(a < b, a, b), kept = choose((a >= T(0)) & ~(b == T(0)), a, V{});
    for (int i = 0; i < VectorOf<V>::count; ++i) {
        EXPECT_EQ(least[i], std::min<T>(a[i], b[i]));
        EXPECT_EQ(kept[i], a[i] >= 0 && b[i] != 0 ? a[i] : T(0));
    }
}

TYPED_TEST(VectorTest, OneLaneIsWrittenAndTheOthersStay) {
    using V = TypeParam;
    using T = typename VectorOf<V>::element;
    for (int written = 0; written < VectorOf<V>::count; ++written) {
        V v = ramp<V>(1, 1);
        v[written] = T(-5);
        for (int i = 0; i < VectorOf<V>::count; ++i) {
            EXPECT_EQ(std::as_const(v)[i], i == written ? T(-5) : T(1 + i));
        }
        v[written] += T(8);
        v[written] -= T(2);
        EXPECT_EQ(std::as_const(v)[written], T(1));
    }
}

TYPED_TEST(VectorTest, ConvertsToWholeNumbersOfEitherWidth) {
    using V = TypeParam;
    constexpr int count = VectorOf<V>::count;
    using Mask = typename VectorOf<V>::mask;
    const V v = ramp<V>(-3.75, 1.5);
    const Mask whole = convert<Mask>(v);
    const auto narrow = convert<Vector<std::int32_t, count>>(v);
    const V back = convert<V>(whole);
    for (int i = 0; i < count; ++i) {
        const auto expected = static_cast<std::int32_t>(v[i]);
        EXPECT_EQ(whole[i], expected);
        EXPECT_EQ(narrow[i], expected);
        EXPECT_EQ(back[i], static_cast<double>(expected));
    }
}

TYPED_TEST(VectorTest, FunctionsAreThoseOfPlainNumbers) {
    using V = TypeParam;
    using T = typename VectorOf<V>::element;
    const V v = ramp<V>(0.03, 0.7);
    const double digits = sizeof(T) == 4 ? 3e-7 : 1e-15;
    const V log = logarithm(v), exp = exponential(v - T(2)), root = square_root(v), sin = sine(v), cos = cosine(v);
    for (int i = 0; i < VectorOf<V>::count; ++i) {
        const double x = v[i], y = static_cast<T>(v[i] - T(2));
        EXPECT_NEAR(log[i], std::log(x), digits * (1 + std::abs(std::log(x))));
        EXPECT_NEAR(exp[i], std::exp(y), digits * std::exp(y));
        EXPECT_NEAR(root[i], std::sqrt(x), digits * std::sqrt(x));
        EXPECT_NEAR(sin[i], std::sin(x), digits);
        EXPECT_NEAR(cos[i], std::cos(x), digits);
    }
    EXPECT_TRUE(std::isnan(logarithm(-v)[VectorOf<V>::count - 1]));
}

template <int... lanes, class V>
void expect_shuffled(const V& a, const V& b) {
    const int from[] = {lanes...};
    const V found = shuffle<lanes...>(a, b);
    for (int i = 0; i < VectorOf<V>::count; ++i) {
        EXPECT_EQ(found[i], from[i] < VectorOf<V>::count ? a[from[i]] : b[from[i] - VectorOf<V>::count]) << "lane " << i;
    }
}

template <class V>
void expect_eight_shuffled() {
    const V a = ramp<V>(0, 1), b = ramp<V>(100, 1);
    expect_shuffled<0, 8, 1, 9, 4, 12, 5, 13>(a, b);
    expect_shuffled<4, 5, 6, 7, 12, 13, 14, 15>(a, b);
    expect_shuffled<0, 0, 0, 0, 1, 1, 1, 1>(a, b);
    expect_shuffled<0, 1, 2, 11, 4, 5, 6, 15>(a, b);
    expect_shuffled<15, 3, 14, 2, 9, 5, 8, 4>(a, b);
}
TEST(Vector, ShufflesEightLanes) {
    expect_eight_shuffled<Eight>();
    expect_eight_shuffled<Doubles>();
    expect_eight_shuffled<Pack<float>>();
    expect_eight_shuffled<Pack<double>>();
}

template <class V>
void expect_sixteen_shuffled() {
    const V a = ramp<V>(0, 1), b = ramp<V>(100, 1);
    expect_shuffled<0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29>(a, b);
    expect_shuffled<8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31>(a, b);
    expect_shuffled<3, 3, 3, 3, 7, 7, 7, 7, 11, 11, 11, 11, 15, 15, 15, 15>(a, b);
    expect_shuffled<0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3>(a, b);
}
TEST(Vector, ShufflesSixteenLanes) {
    expect_sixteen_shuffled<Sixteen>();
    expect_sixteen_shuffled<Halves<Vector<double, 8>>>();
    expect_sixteen_shuffled<PackPair>();
}

}  // namespace
