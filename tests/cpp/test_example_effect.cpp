// An effect from a folder outside the package joins the registry and acts.
#include <gtest/gtest.h>

#include <string>

#include "mphygs/physics/registry.hpp"

namespace mphygs {
namespace {

/// Number of the effect in the registry, -1 where it is not.
int number_of(const std::string& name) {
    for (int i = 0; i < Registry::count; ++i) {
        if (name == Registry::infos[i]->name) {
            return i;
        }
    }
    return -1;
}

TEST(ExampleEffect, JoinsTheRegistryBehindTheBuiltInOnes) {
    EXPECT_GT(number_of("restoring"), number_of("wind"));
    EXPECT_GT(number_of("dashpot"), number_of("wind"));
}

TEST(ExampleLaw, JoinsTheLawsBehindTheBuiltInOnes) {
    EXPECT_EQ(std::string(AllLaws::names[AllLaws::count - 1]), "saint-venant-kirchhoff");
    EXPECT_EQ(std::string(AllLaws::names[static_cast<int>(usual_law)]), "neo-hookean");
}

TEST(ExampleEffect, PullsTowardsTheLevel) {
    const auto own = static_cast<std::size_t>(number_of("restoring"));
    std::vector<bool> active(Registry::count, false);
    active[own] = true;
    const Slots slots = make_slots(active);
    EXPECT_TRUE(active_sites(slots).body);
    std::vector<double> parameters(Registry::parameter_count, 0.0), uniforms(Registry::total_uniform_count, 0.0);
    parameters[static_cast<std::size_t>(slots[own].parameter)] = 50.0;
    parameters[static_cast<std::size_t>(slots[own].parameter) + 1] = 0.25;
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
