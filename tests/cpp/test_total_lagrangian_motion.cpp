// What a rollout must do: conserve, fall, turn with the scene, follow its hold, and fail loudly.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>

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
            Bar bar = test::make_bar({}, schedule, settings);  // held at the bottom, pushed sideways
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

TEST(Motion, TheHoldIsFollowedExactly) {
    const int steps = 30;
    Bar bar = test::make_bar({}, {{10, 20}, {1e-4, 5e-5}});
    bar.fields.gravity = {0, 0, -9.81};
    for (int n = 0; n <= steps; ++n) {  // turning about z while rising
        const Mat3<double> r = test::rotation_about(0, 0, 1, 0.01 * n / steps);
        double* pose = &bar.fields.pose[static_cast<std::size_t>(12 * n)];
        for (int i = 0; i < 9; ++i) {
            pose[i] = r[i / 3][i % 3];
        }
        pose[11] = 1e-3 * n / steps;
    }
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count();
    std::map<std::array<int, 3>, std::size_t> node;
    for (std::size_t n = 0; n < nodes; ++n) {
        std::array<int, 3> index{};
        for (std::size_t c = 0; c < 3; ++c) {
            index[c] = static_cast<int>(std::lround((bar.model->node_positions()[3 * n + c] - g.origin[c]) / g.spacing[c]));
        }
        node[index] = n;
    }
    const double* pose = &bar.fields.pose[12 * steps];
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (std::size_t c = 0; c < 3; ++c) {
            double u = 0, target = pose[9 + c] - g.row_target[3 * r + c];
            for (std::size_t k = 0; k < 3; ++k) {
                target += pose[3 * c + k] * g.row_target[3 * r + k];
            }
            for (std::size_t w = static_cast<std::size_t>(g.row_begin[r]); w < static_cast<std::size_t>(g.row_begin[r + 1]); ++w) {
                u += g.row_weight[w] * t.displacement[(2 * nodes + node.at({g.row_node[3 * w], g.row_node[3 * w + 1], g.row_node[3 * w + 2]})) * 3 + c];
            }
            EXPECT_NEAR(u, target, 1e-15);
        }
    }
}

TEST(Motion, ACompliantHoldSinksByItsComplianceTimesTheWeight) {
    Settings settings;
    int index = 0;
    std::vector<int> active;
    Registry::each([&](auto tag, int i) {
        const std::string name = decltype(tag)::type::info.name;
        if (name == "hold_compliance" || name == "mass_damping") {
            active.push_back(i);
        }
        index = i;
    });
    settings.active = test::only_active(active);
    Bar bar = test::make_bar({}, {{4000}, {1e-4}}, settings);
    const Slots slots = make_slots(settings.active);
    const double compliance = 1e-3;
    Registry::each([&](auto tag, int i) {
        const std::string name = decltype(tag)::type::info.name;
        const std::size_t k = static_cast<std::size_t>(slots[static_cast<std::size_t>(i)].parameter);
        if (name == "hold_compliance") {
            bar.fields.effect[k] = compliance;
        } else if (name == "mass_damping") {
            bar.fields.effect[k] = 60;  // settles within the 0.4 s of the run
        }
    });
    bar.fields.gravity = {0, 0, -9.81};
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    double weight = 0;
    for (const double m : bar.fields.mass) {
        weight += 9.81 * m;
    }
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count();
    double u = 0;  // of the first row
    for (std::size_t n = 0; n < nodes; ++n) {
        for (std::size_t w = 0; w < static_cast<std::size_t>(g.row_begin[1]); ++w) {
            double distance = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                distance += std::abs(bar.model->node_positions()[3 * n + c] - g.origin[c] - g.row_node[3 * w + c] * g.spacing[c]);
            }
            u += distance < 1e-9 ? g.row_weight[w] * t.displacement[(nodes + n) * 3 + 2] : 0.0;
        }
    }
    EXPECT_NEAR(u, -compliance * weight, 1e-3 * compliance * weight);
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

TEST(Motion, TurningTheWholeSceneTurnsTheMotion) {
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

TEST(Motion, ARigidlyTurnedFreeBodyStaysAsItIs) {
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

TEST(Motion, AnUnstableRunNamesTheFrameAndThePart) {
    BarOptions o;
    o.young[1] = 1e10;  // the upper part; the other is stable at this step
    Settings settings;
    settings.displacement_limit = 1.0;
    Bar bar = test::make_bar(o, {std::vector<int>(200, 1), std::vector<double>(200, 1e-4)}, settings);
    bar.fields.velocity0.assign(3 * bar.model->node_count(), 0.0);
    bar.fields.velocity0[3 * bar.model->node_count() - 1] = 0.1;  // a push at the far end
    int frame = -1;
    try {
        bar.model->simulate(bar.fields, bar.schedule);
        FAIL() << "an unstable run must throw";
    } catch (const SimulationError& error) {
        frame = error.frame;
        EXPECT_GT(frame, 0);
        EXPECT_LT(frame, 200);
        EXPECT_EQ(error.part, 1);
        EXPECT_NE(std::string(error.what()).find("frame " + std::to_string(frame)), std::string::npos) << error.what();
        EXPECT_NE(std::string(error.what()).find("part 1"), std::string::npos) << error.what();
    }
    Trajectory<double> bar_of;
    bar_of.displacement.assign(201 * 3 * bar.model->node_count(), 0.0);
    try {
        bar.model->adjoint(bar.fields, bar.schedule, bar_of);
        FAIL() << "the gradient of an unstable run must throw";
    } catch (const SimulationError& error) {
        EXPECT_EQ(error.frame, frame);
        EXPECT_EQ(error.part, 1);
    }
}

TEST(Motion, ProgressIsToldEveryFrameAndMayStop) {
    const Bar bar = test::make_bar({}, {{2, 2, 2}, {1e-4, 1e-4, 1e-4}});
    std::vector<int> frames;
    bar.model->simulate(bar.fields, bar.schedule, [&](int f) {
        frames.push_back(f);
        return true;
    });
    EXPECT_EQ(frames, (std::vector<int>{1, 2, 3}));
    EXPECT_THROW(bar.model->simulate(bar.fields, bar.schedule, [](int f) { return f < 2; }), SimulationError);
}

TEST(Motion, AWrongSizeIsNamed) {
    const Bar bar = test::make_bar({}, {{2}, {1e-4}});
    const auto message = [&](auto&& change) {
        Fields<double> f = bar.fields;
        Schedule s = bar.schedule;
        change(f, s);
        try {
            bar.model->simulate(f, s);
        } catch (const std::invalid_argument& error) {
            return std::string(error.what());
        }
        return std::string("nothing was thrown");
    };
    EXPECT_NE(message([](auto& f, auto&) { f.mu.pop_back(); }).find("mu has 159 numbers, expected 160"), std::string::npos);
    EXPECT_NE(message([](auto& f, auto&) { f.gravity.clear(); }).find("gravity"), std::string::npos);
    EXPECT_NE(message([](auto& f, auto&) { f.pose.pop_back(); }).find("pose"), std::string::npos);
    EXPECT_NE(message([](auto& f, auto&) { f.velocity0.assign(5, 0.0); }).find("velocity0"), std::string::npos);
    EXPECT_NE(message([](auto&, auto& s) { s.dt[0] = 0; }).find("dt"), std::string::npos);
    EXPECT_THROW(TotalLagrangian<double>(Geometry{}, Settings{}), std::invalid_argument);
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
