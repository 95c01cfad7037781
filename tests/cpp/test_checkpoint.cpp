// The reverse sweep visits every step once, backwards, from the right state, within its budget.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "mphygs/numerics/checkpoint.hpp"

namespace mphygs {
namespace {

constexpr std::size_t state_bytes = 100, record_bytes = 150;

struct Count {
    long computed = 0;
    long most_held = 0;  // states and records alive at once
};

/// A chain whose state is the number of steps taken; keeps count of what is alive.
Count sweep(int steps, std::size_t budget) {
    struct Kept {
        int state;
        std::shared_ptr<int> token;
    };
    Count count;
    int state = 0;
    int next = steps - 1;
    const auto alive = std::make_shared<int>();
    const auto keep = [&] {
        Kept kept{state, alive};
        count.most_held = std::max(count.most_held, alive.use_count() - 1);
        return kept;
    };
    const auto step = [&](int n) {
        EXPECT_EQ(n, state) << "step from the wrong state";
        ++state;
        ++count.computed;
    };
    const long reported = reverse_all(
        steps, state_bytes, record_bytes, budget, keep, 
        [&](const Kept& k) {
            EXPECT_LT(next, steps - 1) << "restored in the first sweep";
            state = k.state;
        },
        step,
        [&](int n) {
            const Kept record = keep();
            step(n);
            return record;
        },
        [&](int n, const Kept& record) {
            EXPECT_EQ(n, next) << "steps must be reversed in order";
            EXPECT_EQ(record.state, n) << "the record of another step";
            --next;
        });
    EXPECT_EQ(next, -1) << "every step must be reversed";
    EXPECT_EQ(reported, count.computed);
    return count;
}

TEST(Checkpoint, ReversesEveryStepInOrderWithAnyBudget) {
    for (const int steps : {0, 1, 2, 3, 7, 16, 100, 1001}) {
        for (const std::size_t budget : {std::size_t(0), std::size_t(1), std::size_t(400), std::size_t(1500), std::size_t(20000), std::size_t(1) << 30}) {
            const Count count = sweep(steps, budget);
            EXPECT_GE(count.computed, steps);
        }
    }
}

TEST(Checkpoint, WithRoomForEverythingNothingIsComputedTwice) {
    EXPECT_EQ(sweep(1000, 2 * 1000 * record_bytes).computed, 1000);
}

TEST(Checkpoint, WithRoomForEveryLeafEachStepIsComputedAtMostTwice) {
    // 100 records and 150 states: 10,000 steps are 100 leaves.
    EXPECT_LE(sweep(10000, 200 * record_bytes).computed, 2 * 10000);
}

TEST(Checkpoint, ASmallerBudgetCostsMoreSteps) {
    long before = 0;
    for (const std::size_t budget : {std::size_t(1) << 24, std::size_t(1) << 17, std::size_t(1) << 14, std::size_t(1) << 12, std::size_t(1)}) {
        const long computed = sweep(2000, budget).computed;
        EXPECT_GE(computed, before) << budget;
        before = computed;
    }
    // Bisection, at worst: every halving costs at most one more forward pass.
    EXPECT_LE(before, 2000 * (static_cast<long>(std::log2(2000)) + 2));
}

TEST(Checkpoint, StaysNearItsBudget) {
    for (const std::size_t budget : {std::size_t(3000), std::size_t(30000), std::size_t(300000)}) {
        const Count count = sweep(5000, budget);
        const long leaf = static_cast<long>(budget / 2 / record_bytes), slots = static_cast<long>(budget / 2 / state_bytes);
        EXPECT_LE(count.most_held, leaf + slots + 2) << budget;
    }
}

}  // namespace
}  // namespace mphygs
