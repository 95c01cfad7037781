// Holds as constraints: what a solve leaves behind.
#include <gtest/gtest.h>

#include "mphygs/physics/constraint.hpp"
#include "random_numbers.hpp"

namespace mphygs {
namespace {

/// Two holds of three rows each on twelve nodes, with overlapping nodes within a hold.
struct Example {
    Geometry geometry;
    std::vector<std::int32_t> node;
    std::vector<double> inverse_mass;
    explicit Example(test::Random& random) {
        geometry.hold_count = 2;
        geometry.row_begin = {0};
        for (int r = 0; r < 6; ++r) {
            for (int k = 0; k < 3; ++k) {
                node.push_back(r / 3 * 6 + r % 3 + k);
                geometry.row_weight.push_back(random.between(0.2, 1.0));
            }
            geometry.row_begin.push_back(static_cast<std::int32_t>(node.size()));
            geometry.row_hold.push_back(r / 3);
        }
        inverse_mass = random.numbers(12, 10, 100);
    }
};

/// C v
void apply(const Constraint& c, const std::vector<double>& v, std::vector<double>& result) {
    std::vector<double> held;
    for (const std::int32_t n : c.nodes()) {
        held.push_back(v[static_cast<std::size_t>(n)]);
    }
    c.apply<1>(held.data(), result.data());
}

/// v - M^-1 C^T lambda
std::vector<double> after(const Example& e, const Constraint& c, std::vector<double> v, const std::vector<double>& lambda) {
    std::vector<double> pull(c.nodes().size());
    c.transposed<1>(lambda.data(), pull.data());
    for (std::size_t k = 0; k < pull.size(); ++k) {
        const std::size_t n = static_cast<std::size_t>(c.nodes()[k]);
        v[n] -= e.inverse_mass[n] * pull[k];
    }
    return v;
}

TEST(Constraint, ARigidHoldReachesItsTarget) {
    test::Random random(1);
    const Example e(random);
    const Constraint c(e.geometry, e.node, e.inverse_mass);
    ASSERT_EQ(c.row_count(), 6u);
    const std::vector<double> v = random.numbers(12, -1, 1), target = random.numbers(6, -1, 1);
    std::vector<double> b(6), lambda(6), reached(6);
    apply(c, v, b);
    for (std::size_t r = 0; r < 6; ++r) {
        b[r] -= target[r];
    }
    c.solve<1>(b.data(), 0.0, lambda.data());
    apply(c, after(e, c, v, lambda), reached);
    for (std::size_t r = 0; r < 6; ++r) {
        EXPECT_NEAR(reached[r], target[r], 1e-13);
    }
}

TEST(Constraint, ACompliantHoldGivesWayByItsComplianceTimesItsForce) {
    test::Random random(2);
    const Example e(random);
    const Constraint c(e.geometry, e.node, e.inverse_mass);
    const double dt = 1e-3, compliance = 2e-3;
    const std::vector<double> v = random.numbers(12, -1, 1);
    std::vector<double> b(6), lambda(6), reached(6), force(2);
    apply(c, v, b);  // target velocity zero
    c.solve<1>(b.data(), compliance / (dt * dt), lambda.data());
    apply(c, after(e, c, v, lambda), reached);
    c.sum_per_hold(lambda.data(), force.data());
    for (std::size_t r = 0; r < 6; ++r) {
        const double displacement = dt * reached[r];                      // of the hold, in this substep
        const double pull = force[static_cast<std::size_t>(c.hold_of_row()[r])] / dt;  // of the object on its hold [N]
        EXPECT_NEAR(displacement, compliance * pull, 1e-12);
        EXPECT_GT(std::abs(displacement), 1e-6);
    }
}

TEST(Constraint, NoComplianceIsTheLimitOfASmallOne) {
    test::Random random(3);
    const Example e(random);
    const Constraint c(e.geometry, e.node, e.inverse_mass);
    const std::vector<double> b = random.numbers(6, -1, 1);
    std::vector<double> rigid(6), soft(6);
    c.solve<1>(b.data(), 0.0, rigid.data());
    c.solve<1>(b.data(), 1e-9, soft.data());
    for (std::size_t r = 0; r < 6; ++r) {
        EXPECT_NEAR(soft[r], rigid[r], 1e-7);
    }
}

TEST(Constraint, ATieStaysClosedBesideACompliantHold) {
    test::Random random(6);
    Example e(random);
    e.geometry.row_hold[5] = -1;
    const Constraint c(e.geometry, e.node, e.inverse_mass);
    const double dt = 1e-3, compliance = 2e-3;
    const std::vector<double> v = random.numbers(12, -1, 1);
    std::vector<double> b(6), lambda(6), reached(6), force(2);
    apply(c, v, b);
    c.solve<1>(b.data(), compliance / (dt * dt), lambda.data());
    apply(c, after(e, c, v, lambda), reached);
    EXPECT_NEAR(reached[5], 0.0, 1e-12);
    EXPECT_GT(std::abs(reached[4]), 1e-3);
    c.sum_per_hold(lambda.data(), force.data());
    EXPECT_NEAR(force[1], lambda[3] + lambda[4], 1e-15);  // the tie pulls at no hold
    EXPECT_GT(std::abs(lambda[5]), 0.0);
}

TEST(Constraint, RowsThatDependOnEachOtherAreHeldTogether) {
    test::Random random(4);
    Example e(random);
    // The second row repeats the first, as where two held faces meet.
    for (std::size_t k = 0; k < 3; ++k) {
        e.node[3 + k] = e.node[k];
        e.geometry.row_weight[3 + k] = e.geometry.row_weight[k];
    }
    const Constraint c(e.geometry, e.node, e.inverse_mass);
    const std::vector<double> v = random.numbers(12, -1, 1);
    std::vector<double> b(6), lambda(6), reached(6);
    apply(c, v, b);
    c.solve<1>(b.data(), 0.0, lambda.data());
    apply(c, after(e, c, v, lambda), reached);
    for (std::size_t r = 0; r < 6; ++r) {
        EXPECT_NEAR(reached[r], 0.0, 1e-10);
    }
    EXPECT_NEAR(lambda[0], lambda[1], 1e-10);
}

TEST(Constraint, TransposedIsTheTransposeOfApply) {
    test::Random random(5);
    const Example e(random);
    const Constraint c(e.geometry, e.node, e.inverse_mass);
    const std::vector<double> x = random.numbers(12, -1, 1), y = random.numbers(6, -1, 1);
    std::vector<double> cx(6);
    apply(c, x, cx);
    double left = 0, right = 0;
    for (std::size_t r = 0; r < 6; ++r) {
        left += cx[r] * y[r];
    }
    std::vector<double> pull(c.nodes().size());
    c.transposed<1>(y.data(), pull.data());
    for (std::size_t k = 0; k < pull.size(); ++k) {
        right += x[static_cast<std::size_t>(c.nodes()[k])] * pull[k];
    }
    EXPECT_NEAR(left, right, 1e-14);
}

TEST(Constraint, WithoutRowsThereIsNothingToSolve) {
    const Constraint c(Geometry{}, {}, {1.0, 2.0});
    EXPECT_EQ(c.row_count(), 0u);
    c.solve<1>(nullptr, 1.0, nullptr);
    c.apply<1>(nullptr, nullptr);
    c.transposed<1>(nullptr, nullptr);
}

}  // namespace
}  // namespace mphygs
