// Recorded adjoints against dual numbers and against central differences.
#include <gtest/gtest.h>

#include "mphygs/numerics/polar.hpp"
#include "random_numbers.hpp"
#include "scalar_functions.hpp"

namespace mphygs {
namespace {

using P = Pack<double>;
using V = Var<P>;
using D = Dual<P, 2>;

TEST(Tape, EveryOperationHasTheAdjointOfItsTangent) {
    for (const auto& function : test::scalar_functions<V>()) {
        test::Random random(3);
        const P x = random.pack(0.5, 1.0), y = random.pack(1.0, 1.5), bar = random.pack(-1, 1);
        Tape<P>& tape = Tape<P>::current();
        tape.reset();
        const V a = V::input(x), b = V::input(y);
        const V result = function.f(a, b);
        tape.prepare();
        ASSERT_GE(result.i, 0) << function.name;
        tape.adjoint(result.i) += bar;
        tape.sweep();
        D da(x), db(y);
        da.d[0] = P{} + 1;
        db.d[1] = P{} + 1;
        const D tangent = test::scalar_function<D>(function.name)(da, db);
        for (int i = 0; i < lane_count; ++i) {
            EXPECT_NEAR(result.v[i], tangent.v[i], 1e-14) << function.name;
            EXPECT_NEAR(tape.adjoint(a.i)[i], bar[i] * tangent.d[0][i], 1e-13) << function.name;
            EXPECT_NEAR(tape.adjoint(b.i)[i], bar[i] * tangent.d[1][i], 1e-13) << function.name;
        }
    }
}

TEST(Tape, AgreesWithCentralDifferencesOfALongExpression) {
    const auto f = []<class S>(const S& a, const S& b) {
        S x = a;
        for (int i = 0; i < 20; ++i) {
            x = sine(x * b) + exponential(-(a * a)) / (1.0 + x * x);
        }
        return x;
    };
    test::Random random(4);
    const P x = random.pack(0.5, 1.0), y = random.pack(0.5, 1.0);
    Tape<P>& tape = Tape<P>::current();
    tape.reset();
    const V a = V::input(x), b = V::input(y);
    const V result = f(a, b);
    tape.prepare();
    tape.adjoint(result.i) += P{} + 1;
    tape.sweep();
    const double h = 1e-6;
    const P by_a = (f(P(x + h), y) - f(P(x - h), y)) / (2 * h), by_b = (f(x, P(y + h)) - f(x, P(y - h))) / (2 * h);
    for (int i = 0; i < lane_count; ++i) {
        EXPECT_NEAR(tape.adjoint(a.i)[i], by_a[i], 1e-8);
        EXPECT_NEAR(tape.adjoint(b.i)[i], by_b[i], 1e-8);
        EXPECT_GT(std::abs(tape.adjoint(b.i)[i]), 1e-6);
    }
}

TEST(Tape, ConstantsAreNotRecorded) {
    Tape<P>::current().reset();
    const V a(P{} + 2), b(P{} + 3);
    EXPECT_EQ((a * b + 1.0).i, -1);
    EXPECT_EQ(logarithm(a / b).i, -1);
    EXPECT_EQ(V::input(P{}).i, 0);
}

TEST(Tape, ResetForgetsWhatWasRecorded) {
    Tape<P>& tape = Tape<P>::current();
    for (int round = 0; round < 2; ++round) {
        tape.reset();
        const V a = V::input(P{} + 2);
        const V result = a * a;
        tape.prepare();
        tape.adjoint(result.i) += P{} + 1;
        tape.sweep();
        EXPECT_EQ(tape.adjoint(a.i)[0], 4.0);
    }
}

}  // namespace
}  // namespace mphygs
