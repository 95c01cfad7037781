// An effect from a folder outside the package joins the registry and acts.
#include <gtest/gtest.h>

#include <string>

#include "mphygs/registry.hpp"

namespace mphygs {
namespace {

TEST(ExampleEffect, JoinsTheRegistryLast) {
    ASSERT_EQ(std::string(Registry::infos[Registry::count - 1]->name), "restoring");
}

TEST(ExampleEffect, PullsTowardsTheLevel) {
    std::vector<bool> active(Registry::count, false);
    active.back() = true;
    const Slots slots = make_slots(active);
    EXPECT_TRUE(active_sites(slots).body);
    std::vector<double> parameters(Registry::parameter_count, 0.0), uniforms(Registry::total_uniform_count, 0.0);
    parameters[static_cast<std::size_t>(slots.back().parameter)] = 50.0;
    parameters[static_cast<std::size_t>(slots.back().parameter) + 1] = 0.25;
    all_uniforms(slots, parameters.data(), 0.0, 1e-3, uniforms.data());
    BodyPoint<double> p;
    p.position = {{1.0, 2.0, 0.75}};
    const Vec3<double> a = evaluate_body(slots, uniforms.data(), p);
    EXPECT_EQ(a[0], 0.0);
    EXPECT_EQ(a[1], 0.0);
    EXPECT_DOUBLE_EQ(a[2], -25.0);
}

}  // namespace
}  // namespace mphygs
