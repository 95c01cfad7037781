// Turning the scene turns the motion; a rigid turn is no strain.
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

/// The scene turned by 90 degrees about x: (x, y, z) -> (x, -z, y).
template <class V>
std::vector<V> turned(const std::vector<V>& triples) {
    std::vector<V> r(triples.size());
    for (std::size_t i = 0; i < triples.size(); i += 3) {
        r[i] = triples[i];
        r[i + 1] = -triples[i + 2];
        r[i + 2] = triples[i + 1];
    }
    return r;
}

TEST(Turning, TurningTheWholeSceneTurnsTheMotion) {
    Settings settings;
    std::vector<int> active;
    for (int i = 0; i < Registry::count; ++i) {
        const std::string name = Registry::infos[i]->name;
        if (name == "viscosity" || name == "air_drag" || name == "relaxation" || name == "stiffening") {
            active.push_back(i);
        }
    }
    settings.active = test::only_active(active);
    Bar bar = test::make_bar({}, {{20, 20}, {1e-4, 1e-4}}, settings);
    test::stir(bar, 51);
    bar.fields.deformation0.clear();
    bar.fields.pose = test::fields_at_rest<double>({}, bar.model->geometry(), bar.schedule).pose;

    Geometry g = bar.model->geometry();
    g.origin = {g.origin[0], -g.origin[2], g.origin[1]};
    g.spacing = {g.spacing[0], g.spacing[2], g.spacing[1]};
    g.cell = turned(g.cell);
    g.points = turned(g.points);
    g.surface_cell = turned(g.surface_cell);
    g.surface_points = turned(g.surface_points);
    g.place_cell = turned(g.place_cell);
    g.places = turned(g.places);
    g.row_node = turned(g.row_node);
    g.row_target = turned(g.row_target);
    const TotalLagrangian<double> other(g, settings);

    const std::size_t nodes = bar.model->node_count();
    ASSERT_EQ(other.node_count(), nodes);
    std::vector<std::size_t> partner(nodes);  // of each node of the turned scene
    const std::vector<double> positions = turned(bar.model->node_positions());
    for (std::size_t n = 0; n < nodes; ++n) {
        double best = 1e9;
        for (std::size_t m = 0; m < nodes; ++m) {
            double distance = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                distance += std::abs(positions[3 * m + c] - other.node_positions()[3 * n + c]);
            }
            if (distance < best) {
                best = distance;
                partner[n] = m;
            }
        }
        ASSERT_LT(best, 1e-12);
    }
    const auto to_other = [&](const std::vector<double>& field) {
        const std::vector<double> t = turned(field);
        std::vector<double> r(t.size());
        for (std::size_t f = 0; f < t.size() / (3 * nodes); ++f) {
            for (std::size_t n = 0; n < nodes; ++n) {
                for (std::size_t c = 0; c < 3; ++c) {
                    r[(f * nodes + n) * 3 + c] = t[(f * nodes + partner[n]) * 3 + c];
                }
            }
        }
        return r;
    };
    Fields<double> fields = bar.fields;
    fields.gravity = turned(fields.gravity);
    fields.displacement0 = to_other(fields.displacement0);
    fields.velocity0 = to_other(fields.velocity0);
    fields.node_force = to_other(fields.node_force);
    const Trajectory<double> x = bar.model->simulate(bar.fields, bar.schedule), y = other.simulate(fields, bar.schedule);
    const std::vector<double> u = to_other(x.displacement), v = to_other(x.velocity);
    for (std::size_t i = 0; i < u.size(); ++i) {
        EXPECT_NEAR(y.displacement[i], u[i], 1e-14);
        EXPECT_NEAR(y.velocity[i], v[i], 1e-10);
    }
}

TEST(Turning, ARigidlyTurnedFreeBodyStaysAsItIs) {
    Bar bar = test::make_bar(free_bar(), {{50}, {1e-4}});
    const Mat3<double> r = test::rotation_about(1, 2, 3, 1.0);
    const std::vector<double>& x = bar.model->node_positions();
    for (std::size_t n = 0; n < bar.model->node_count(); ++n) {
        const Vec3<double> p{{x[3 * n], x[3 * n + 1], x[3 * n + 2]}};
        const Vec3<double> u = r * p - p;
        bar.fields.displacement0.insert(bar.fields.displacement0.end(), u.e, u.e + 3);
    }
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    for (std::size_t i = 0; i < bar.fields.displacement0.size(); ++i) {
        EXPECT_NEAR(t.displacement[bar.fields.displacement0.size() + i], bar.fields.displacement0[i], 1e-12);
    }
}

}  // namespace
}  // namespace mphygs
