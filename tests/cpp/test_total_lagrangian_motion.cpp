// What a rollout must do: conserve mass, momentum and energy, and fall exactly.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
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

struct Momenta {
    std::array<double, 3> linear{}, angular{};
};

Momenta momenta(const Bar& bar, const Trajectory<double>& t, std::size_t frame) {
    Momenta m;
    const std::vector<double> mass = bar.model->node_mass(bar.fields);
    const std::vector<double>& rest = bar.model->node_positions();
    const std::size_t nodes = bar.model->node_count();
    for (std::size_t n = 0; n < nodes; ++n) {
        double x[3], p[3];
        for (std::size_t c = 0; c < 3; ++c) {
            x[c] = rest[3 * n + c] + t.displacement[(frame * nodes + n) * 3 + c];
            p[c] = mass[n] * t.velocity[(frame * nodes + n) * 3 + c];
            m.linear[c] += p[c];
        }
        for (std::size_t c = 0; c < 3; ++c) {
            m.angular[c] += x[(c + 1) % 3] * p[(c + 2) % 3] - x[(c + 2) % 3] * p[(c + 1) % 3];
        }
    }
    return m;
}

TEST(Motion, NodeMassesSumToTheMass) {
    const Bar bar = test::make_bar({}, {{1}, {1e-4}});
    double nodes = 0, points = 0;
    for (const double m : bar.model->node_mass(bar.fields)) {
        EXPECT_GE(m, 0);
        nodes += m;
    }
    for (const double m : bar.fields.mass) {
        points += m;
    }
    EXPECT_NEAR(nodes, points, 1e-14);
    EXPECT_NEAR(points, 1000 * 4 * 4.5 * 0.010 * 0.012 * 0.011, 1e-12);
}

TEST(Motion, WithoutLoadsNothingMoves) {
    const Bar bar = test::make_bar({}, {{50}, {1e-4}});
    for (const double u : bar.model->simulate(bar.fields, bar.schedule).displacement) {
        EXPECT_NEAR(u, 0.0, 1e-18);
    }
}

TEST(Motion, FreeFallIsExact) {
    const int steps = 40;
    const double dt = 1e-4;
    Bar bar = test::make_bar(free_bar(), {{steps}, {dt}});
    bar.fields.gravity = {0.3, -0.7, -9.81};
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const std::size_t size = 3 * bar.model->node_count();
    for (std::size_t i = 0; i < size; ++i) {
        const double g = bar.fields.gravity[i % 3];
        EXPECT_NEAR(t.velocity[size + i], g * steps * dt, 1e-12);
        EXPECT_NEAR(t.displacement[size + i], g * dt * dt * steps * (steps + 1) / 2, 1e-15);  // symplectic Euler
    }
}

TEST(Motion, AFreeBodyKeepsItsLinearAndAngularMomentum) {
    Settings settings;
    std::vector<int> internal;
    for (int i = 0; i < Registry::count; ++i) {
        const std::string name = Registry::infos[i]->name;
        if (name == "viscosity" || name == "relaxation" || name == "stiffening" || name == "fibre" || name == "plasticity" ||
            name == "eigenstrain") {
            internal.push_back(i);
        }
    }
    ASSERT_EQ(internal.size(), 6u);
    for (const bool effects : {false, true}) {
        settings.active = test::only_active(effects ? internal : std::vector<int>{});
        Bar bar = test::make_bar(free_bar(), {{20, 30}, {1e-4, 5e-5}}, settings);
        test::stir(bar, 41);
        bar.fields.gravity.assign(3, 0.0);
        bar.fields.node_force.clear();
        const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
        const Momenta first = momenta(bar, t, 0), last = momenta(bar, t, 2);
        double moved = 0;
        for (std::size_t i = 0; i < t.displacement.size() / 3; ++i) {
            moved = std::max(moved, std::abs(t.velocity[2 * t.velocity.size() / 3 + i] - t.velocity[i]));
        }
        EXPECT_GT(moved, 0.1);
        for (std::size_t c = 0; c < 3; ++c) {
            EXPECT_NEAR(last.linear[c], first.linear[c], 1e-14);
            EXPECT_NEAR(last.angular[c], first.angular[c], 1e-14);
            EXPECT_GT(std::abs(first.angular[c]), 1e-7);
        }
    }
}

/// Kinetic and elastic energy at an output frame [J].
double energy(const Bar& bar, const Trajectory<double>& t, std::size_t frame) {
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count();
    const std::vector<double> mass = bar.model->node_mass(bar.fields);
    double total = 0;
    for (std::size_t n = 0; n < nodes; ++n) {
        for (std::size_t c = 0; c < 3; ++c) {
            const double v = t.velocity[(frame * nodes + n) * 3 + c];
            total += 0.5 * mass[n] * v * v;
        }
    }
    std::vector<std::int32_t> cell;
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        for (int q = 0; q < 8; ++q) {
            cell.insert(cell.end(), &g.cell[3 * b], &g.cell[3 * b] + 3);
        }
    }
    const PointWeights w = bar.model->weights(g.points, cell);
    for (std::size_t p = 0; p < bar.volume.size(); ++p) {
        Mat3<double> f = Mat3<double>::identity();
        for (std::size_t a = 0; a < 27; ++a) {
            const std::size_t n = static_cast<std::size_t>(w.node[27 * p + a]);
            for (int i = 0; i < 3; ++i) {
                for (int j = 0; j < 3; ++j) {
                    f[i][j] += t.displacement[(frame * nodes + n) * 3 + static_cast<std::size_t>(i)] *
                               w.gradient[(27 * p + a) * 3 + static_cast<std::size_t>(j)];
                }
            }
        }
        total += bar.volume[p] * elastic_energy(bar.model->settings().law, f, bar.fields.mu[p], bar.fields.lambda[p]);
    }
    return total;
}

TEST(Motion, EnergyIsKeptAndItsErrorShrinksWithTheStep) {
    for (const Law law : {Law::neo_hookean, Law::fixed_corotated}) {
        Settings settings;
        settings.law = law;
        double error[2];
        for (const int refined : {0, 1}) {
            const int steps = 40 << refined;
            Schedule schedule{std::vector<int>(10, steps), std::vector<double>(10, 1e-4 / (1 << refined))};
            Bar bar = test::make_bar(test::slender, schedule, settings);  // held at the bottom, pushed sideways
            const std::vector<double>& x = bar.model->node_positions();
            for (std::size_t n = 0; n < bar.model->node_count(); ++n) {
                bar.fields.velocity0.insert(bar.fields.velocity0.end(), {20 * std::max(0.0, x[3 * n + 2] - 0.05), 0.0, 0.0});
            }
            const Trajectory<double> t = bar.model->simulate(bar.fields, schedule);
            const double first = energy(bar, t, 0);
            error[refined] = 0;
            for (std::size_t f = 1; f <= 10; ++f) {
                error[refined] = std::max(error[refined], std::abs(energy(bar, t, f) / first - 1));
            }
        }
        EXPECT_LT(error[0], 0.05);
        EXPECT_LT(error[1], 0.6 * error[0]);
    }
}

}  // namespace
}  // namespace mphygs
