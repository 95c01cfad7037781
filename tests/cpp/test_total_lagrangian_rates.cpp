// The largest rates of a model, and its forces at rest.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using test::Bar;
using test::BarOptions;

BarOptions free_bar() {
    BarOptions o;
    o.held = false;
    return o;
}

TEST(LargestRates, BoundTheStableStep) {
    Settings settings;
    for (int i = 0; i < Registry::count; ++i) {
        const std::string name = Registry::infos[i]->name;
        settings.active = test::only_active(name == "relaxation" ? std::vector<int>{i} : std::vector<int>{});
        if (name != "relaxation" && i > 0) {
            continue;
        }
        Bar bar = test::make_bar(free_bar(), {{400}, {1e-4}}, settings);
        const Slots slots = make_slots(settings.active);
        if (name == "relaxation") {
            const std::size_t k = static_cast<std::size_t>(slots[static_cast<std::size_t>(i)].parameter);
            bar.fields.effect[k] = 3.0;  // the branch carries three times the spring
            bar.fields.effect[k + 1] = 2e-3;  // slow beside the fastest mode, quick beside the iteration
        }
        const double fastest = std::sqrt(bar.model->largest_rates(bar.fields, 200)[0]);
        test::Random random(61);
        bar.fields.velocity0 = random.numbers(3 * bar.model->node_count(), -1e-6, 1e-6);
        bar.schedule.dt[0] = 2 / fastest * 0.97;
        EXPECT_NO_THROW(bar.model->simulate(bar.fields, bar.schedule)) << name;
        bar.schedule.dt[0] = 2 / fastest * 1.1;
        EXPECT_THROW(bar.model->simulate(bar.fields, bar.schedule), SimulationError) << name;
    }
}

TEST(LargestRates, ARelaxingBranchCountsAsASpringWhateverWasTriedBefore) {
    for (int i = 0; i < Registry::count; ++i) {
        if (std::string(Registry::infos[i]->name) != "relaxation") {
            continue;
        }
        Settings settings;
        settings.active = test::only_active({i});
        Bar bar = test::make_bar(free_bar(), {{1}, {1e-4}}, settings);
        const std::size_t k = static_cast<std::size_t>(make_slots(settings.active)[static_cast<std::size_t>(i)].parameter);
        bar.fields.effect[k + 1] = 0.1;
        const double alone = bar.model->largest_rates(bar.fields, 200)[0];
        bar.fields.effect[k] = 3.0;
        EXPECT_NEAR(bar.model->largest_rates(bar.fields, 200)[0], 4 * alone, 2e-3 * 4 * alone);
    }
}

TEST(LargestRates, DampingIsFound) {
    Settings settings;
    for (int i = 0; i < Registry::count; ++i) {
        if (std::string(Registry::infos[i]->name) == "mass_damping") {
            settings.active = test::only_active({i});
            Bar bar = test::make_bar(free_bar(), {{1}, {1e-4}}, settings);
            bar.fields.effect[static_cast<std::size_t>(make_slots(settings.active)[static_cast<std::size_t>(i)].parameter)] = 7.0;
            EXPECT_NEAR(bar.model->largest_rates(bar.fields)[1], 7.0, 1e-9);
        }
    }
}

TEST(RestForces, AreThoseOfBodySurfaceAndPlace) {
    Settings settings;
    std::vector<int> active;
    for (int i = 0; i < Registry::count; ++i) {
        const std::string name = Registry::infos[i]->name;
        if (name == "gravity" || name == "tether" || name == "wind") {
            active.push_back(i);
        }
    }
    ASSERT_EQ(active.size(), 3u);
    settings.active = test::only_active(active);
    Bar bar = test::make_bar({}, {{1}, {1e-4}}, settings);
    test::stir(bar, 71);
    const std::vector<double> f = bar.model->rest_forces(bar.fields);
    double sum[3] = {0, 0, 0}, expected[3], mass = 0;
    for (std::size_t i = 0; i < f.size(); ++i) {
        sum[i % 3] += f[i];
    }
    for (const double m : bar.fields.mass) {
        mass += m;
    }
    const Slots slots = make_slots(settings.active);
    const Geometry& g = bar.model->geometry();
    const double* gravity = &bar.fields.effect[static_cast<std::size_t>(slots[static_cast<std::size_t>(active[0])].parameter)];
    const double* wind = &bar.fields.effect[static_cast<std::size_t>(slots[static_cast<std::size_t>(active[2])].parameter)];
    const double speed = std::sqrt(wind[0] * wind[0] + wind[1] * wind[1] + wind[2] * wind[2]);
    const double area = 4 * g.spacing[0] * g.spacing[1];
    for (std::size_t c = 0; c < 3; ++c) {
        expected[c] = mass * gravity[c] + 0.6 * wind[3] * area * speed * wind[c];
        for (std::size_t p = 0; p < 2; ++p) {
            const double* q = &bar.fields.place_effect[4 * p];  // tether: k, anchor
            expected[c] += q[0] * (q[1 + c] - g.places[3 * p + c]);
        }
        EXPECT_NEAR(sum[c], expected[c], 1e-9 * std::abs(expected[c]));
    }
}

}  // namespace
}  // namespace mphygs
