// One answer: at any memory budget, on any number of threads, and in float as in double.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "actuation_scene.hpp"
#include "bar_scene.hpp"

namespace mphygs {
namespace {

using F = Fields<double>;
const Schedule schedule{{3, 4}, {1e-4, 8e-5}, 0.01};

/// The same bits: what a gradient costs in memory, and on how many threads, never shows in it.
class SameBits : public testing::Test {
  protected:
    static F gradient_of(std::size_t budget, int threads, long* recomputed) {
        Settings settings;
        std::vector<int> every;
        for (int i = 0; i < Registry::count; ++i) {
            every.push_back(i);
        }
        settings.active = test::only_active(every);
        settings.memory_budget = budget;
        settings.threads = threads;
        test::BarOptions options;
        options.cells[0] = options.cells[1] = 4;
        options.cells[2] = 9;  // 144 blocks: two chunks
        test::Bar b = test::make_bar(options, schedule, settings);
        test::stir(b, 31);
        Geometry loaded = b.model->geometry();
        loaded.actuation = test::loads(static_cast<int>(b.model->node_count()), true);
        b.model = std::make_shared<TotalLagrangian<double>>(std::move(loaded), settings);
        b.fields.channel = test::courses<double>(2);
        test::Random random(32);
        const std::size_t size = (schedule.steps.size() + 1) * 3 * b.model->node_count();
        const Trajectory<double> seed{random.numbers(size, -1e3, 1e3), random.numbers(size, -1, 1)};
        return b.model->adjoint(b.fields, schedule, seed, {}, recomputed);
    }
    static void expect_same(F a, F b) {
        for (std::size_t i = 0; i < F::count; ++i) {
            EXPECT_EQ(*a.all()[i], *b.all()[i]) << F::names[i];
            // Only an observer has targets; test_observer.cpp has theirs.
            EXPECT_EQ(a.all()[i]->empty(), std::string(F::names[i]) == "target") << F::names[i];
        }
    }
};

TEST_F(SameBits, AtAnyMemoryBudget) {
    long roomy = -1, tight = -1;
    const F large = gradient_of(std::size_t(1) << 30, 1, &roomy), small = gradient_of(1, 1, &tight);
    expect_same(large, small);
    EXPECT_EQ(roomy, 0);
    EXPECT_GT(tight, 0);
}

TEST_F(SameBits, AtAnyNumberOfThreads) { expect_same(gradient_of(std::size_t(1) << 30, 1, nullptr), gradient_of(std::size_t(1) << 30, 2, nullptr)); }

TEST(Float, FollowsDouble) {
    Settings settings;
    settings.active = test::only_active({});
    test::Bar b = test::make_bar({}, schedule, settings);
    b.fields.gravity = {0, 2, -9};
    const TotalLagrangian<float> narrow(b.model->geometry(), settings);
    Fields<float> f = test::fields_at_rest<float>({}, b.model->geometry(), schedule);
    f.gravity = {0, 2, -9};
    test::Random random(1);
    const std::vector<double> v0 = random.numbers(3 * b.model->node_count(), -0.5, 0.5);
    b.fields.velocity0 = v0;
    f.velocity0.assign(v0.begin(), v0.end());
    const Trajectory<double> x = b.model->simulate(b.fields, schedule);
    const Trajectory<float> y = narrow.simulate(f, schedule);
    const std::vector<double> seed = random.numbers(x.displacement.size(), -1, 1);
    F g = b.model->adjoint(b.fields, schedule, {seed, {}});
    Fields<float> h = narrow.adjoint(f, schedule, {std::vector<float>(seed.begin(), seed.end()), {}});
    for (std::size_t i = 0; i < x.velocity.size(); ++i) {
        EXPECT_NEAR(x.velocity[i], static_cast<double>(y.velocity[i]), 2e-5);
    }
    for (std::size_t i = 0; i < F::count; ++i) {
        double error = 0, size = 0;
        for (std::size_t n = 0; n < g.all()[i]->size(); ++n) {
            const double a = (*g.all()[i])[n], c = static_cast<double>((*h.all()[i])[n]);
            error += (a - c) * (a - c);
            size += a * a;
        }
        EXPECT_LE(std::sqrt(error), 1e-4 * std::sqrt(size)) << F::names[i];
    }
}

}  // namespace
}  // namespace mphygs
