// Implicit steps: exact where the motion is a polynomial, of second order elsewhere, without damping, and as long as wanted.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using test::Bar;
using test::BarOptions;

Schedule steps_of(int frames, int steps, double dt, bool implicit) {
    Schedule s{std::vector<int>(static_cast<std::size_t>(frames), steps), std::vector<double>(static_cast<std::size_t>(frames), dt)};
    s.implicit = implicit;
    return s;
}

double distance(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    }
    return std::sqrt(sum);
}

/// The last frame's numbers.
std::vector<double> last(const std::vector<double>& all, std::size_t size) { return {all.end() - static_cast<std::ptrdiff_t>(size), all.end()}; }

/// Held at the bottom, pushed sideways: a swing.
Bar swing(const BarOptions& o, const Schedule& schedule, double speed, Settings settings = {}) {
    Bar bar = test::make_bar(o, schedule, settings);
    const std::vector<double>& x = bar.model->node_positions();
    for (std::size_t n = 0; n < bar.model->node_count(); ++n) {
        const double z = std::max(0.0, x[3 * n + 2] - 0.05);
        bar.fields.velocity0.insert(bar.fields.velocity0.end(), {speed * z * z, 0.0, 0.0});
    }
    return bar;
}

double kinetic(const Bar& bar, const Trajectory<double>& t, std::size_t frame) {
    const std::vector<double> mass = bar.model->node_mass(bar.fields);
    double sum = 0;
    for (std::size_t i = 0; i < 3 * mass.size(); ++i) {
        const double v = t.velocity[frame * 3 * mass.size() + i];
        sum += 0.5 * mass[i / 3] * v * v;
    }
    return sum;
}

TEST(Implicit, AStiffBodyFallsExactly) {
    BarOptions o;
    o.held = false;
    o.young[0] = o.young[1] = 1e9;
    const double dt = 5e-3;
    const int steps = 20;
    Bar bar = test::make_bar(o, steps_of(1, steps, dt, true));
    bar.fields.gravity = {0.3, -0.7, -9.81};
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const std::size_t size = 3 * bar.model->node_count();
    for (std::size_t i = 0; i < size; ++i) {
        const double g = bar.fields.gravity[i % 3];
        EXPECT_NEAR(t.velocity[size + i], g * steps * dt, 1e-8);
        EXPECT_NEAR(t.displacement[size + i], g * dt * dt * steps * steps / 2, 1e-9);
    }
}

TEST(Implicit, AFreeBodyKeepsItsLinearAndAngularMomentum) {
    BarOptions o;
    o.held = false;
    Bar bar = test::make_bar(o, steps_of(20, 1, 4e-4, true));
    test::stir(bar, 41);
    bar.fields.gravity.assign(3, 0.0);
    bar.fields.node_force.clear();
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const std::vector<double> mass = bar.model->node_mass(bar.fields);
    const std::vector<double>& rest = bar.model->node_positions();
    double momenta[2][6] = {};
    for (const std::size_t frame : {std::size_t{0}, std::size_t{20}}) {
        double* m = momenta[frame > 0];
        for (std::size_t n = 0; n < mass.size(); ++n) {
            const double* u = &t.displacement[(frame * mass.size() + n) * 3];
            const double* v = &t.velocity[(frame * mass.size() + n) * 3];
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
                m[c] += mass[n] * v[c];
                m[3 + c] += mass[n] * ((rest[3 * n + a] + u[a]) * v[b] - (rest[3 * n + b] + u[b]) * v[a]);
            }
        }
    }
    for (int i = 0; i < 6; ++i) {
        EXPECT_NEAR(momenta[1][i], momenta[0][i], 1e-11) << i;
    }
    EXPECT_GT(std::abs(momenta[0][4]), 1e-7);
}

TEST(Implicit, AStepHalfAsLongHasAQuarterOfTheError) {
    const double time = 0.01;
    const auto end = [&](int steps, bool implicit) {
        const Bar bar = swing(test::slender, steps_of(1, steps, time / steps, implicit), 400);
        return last(bar.model->simulate(bar.fields, bar.schedule).displacement, 3 * bar.model->node_count());
    };
    const std::vector<double> fine = end(1280, true), coarse = end(2000, false), finer = end(4000, false);
    std::vector<double> explicit_limit(fine.size());  // of the first order: by extrapolation
    for (std::size_t i = 0; i < fine.size(); ++i) {
        explicit_limit[i] = 2 * finer[i] - coarse[i];
    }
    const double size = distance(fine, std::vector<double>(fine.size(), 0.0));
    EXPECT_LT(distance(fine, explicit_limit), 1e-4 * size);
    const double a = distance(end(80, true), fine), b = distance(end(160, true), fine), c = distance(end(320, true), fine);
    EXPECT_LT(a, 0.3 * size);
    EXPECT_NEAR(a / b, 4.0, 0.8);
    EXPECT_NEAR(b / c, 4.0, 0.4);
}

/// Kinetic and elastic energy at an output frame [J].
double energy(const Bar& bar, const Trajectory<double>& t, std::size_t frame) {
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count();
    std::vector<std::int32_t> cell;
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        for (int q = 0; q < 8; ++q) {
            cell.insert(cell.end(), &g.cell[3 * b], &g.cell[3 * b] + 3);
        }
    }
    const PointWeights w = bar.model->weights(g.points, cell);
    double total = kinetic(bar, t, frame);
    for (std::size_t p = 0; p < bar.volume.size(); ++p) {
        Mat3<double> f = Mat3<double>::identity();
        for (std::size_t a = 0; a < 27; ++a) {
            const std::size_t n = static_cast<std::size_t>(w.node[27 * p + a]);
            for (int i = 0; i < 9; ++i) {
                f[i / 3][i % 3] += t.displacement[(frame * nodes + n) * 3 + static_cast<std::size_t>(i / 3)] *
                                   w.gradient[(27 * p + a) * 3 + static_cast<std::size_t>(i % 3)];
            }
        }
        total += bar.volume[p] * elastic_energy(bar.model->settings().law, f, bar.fields.mu[p], bar.fields.lambda[p]);
    }
    return total;
}

TEST(Implicit, OverAThousandStepsTheEnergyDriftsByLessThanAHundredThousandth) {
    const std::size_t steps = 1000;
    const Bar bar = swing(test::slender, steps_of(static_cast<int>(steps), 1, 1e-3, true), 20);
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const double first = energy(bar, t, 0);
    double drift = 0, away = 0;
    for (std::size_t f = 1; f <= 100; ++f) {
        drift += (energy(bar, t, steps + 1 - f) - energy(bar, t, f)) / 100;
        away = std::max(away, std::abs(energy(bar, t, f) / first - 1));
    }
    EXPECT_LT(std::abs(drift) / first, 1e-5);
    EXPECT_LT(away, 1e-3);
}

TEST(Implicit, AHoldThatMovesLeavesNoAlternation) {
    BarOptions o;
    o.young[0] = o.young[1] = 1e8;
    const double dt = 4e-3, swing_rate = 20, far = 0.02;
    const int frames = 60;
    Bar bar = test::make_bar(o, steps_of(frames, 1, dt, true));
    const auto place = [&](int n) { return far * std::pow(1 - std::cos(swing_rate * n * dt), 2); };
    for (int n = 0; n <= frames; ++n) {
        bar.fields.pose[static_cast<std::size_t>(12 * n + 9)] = place(n);
    }
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const std::size_t nodes = bar.model->node_count();
    double alternation = 0;
    for (std::size_t n = 0; n < nodes; ++n) {
        const auto v = [&](int f) { return t.velocity[(static_cast<std::size_t>(f) * nodes + n) * 3]; };
        for (int f = 2; f + 2 < frames; ++f) {
            // What changes its sign from step to step, and nothing that is smooth.
            alternation = std::max(alternation, std::abs(v(f - 2) - 4 * v(f - 1) + 6 * v(f) - 4 * v(f + 1) + v(f + 2)) / 16);
        }
    }
    EXPECT_LT(alternation, 1e-3 * far * swing_rate);
}

TEST(Implicit, AStiffBarOnAShakenHoldFollowsTheExplicitRun) {
    BarOptions o = test::slender;
    o.young[0] = o.young[1] = 1e9;
    const double rate = 25, far = 0.02, frame = 1.0 / 60;
    const int frames = 6;
    const auto run = [&](int steps, bool implicit) {
        Bar bar = test::make_bar(o, steps_of(frames, steps, frame / steps, implicit));
        bar.fields.gravity = {0, 0, -9.81};
        for (int n = 0; n <= frames * steps; ++n) {
            const double s = rate * frame * n / steps, angle = 0.3 * (1 - std::cos(s));
            double* pose = &bar.fields.pose[static_cast<std::size_t>(12 * n)];
            const Mat3<double> r = test::rotation_about(0, 1, 0, angle);
            for (int i = 0; i < 9; ++i) {
                pose[i] = r[i / 3][i % 3];
            }
            pose[9] = far * (1 - std::cos(s));
        }
        return bar.model->simulate(bar.fields, bar.schedule).displacement;
    };
    const std::vector<double> coarse = run(4, true), finer = run(8, true), reference = run(5000, false);
    const double size = distance(reference, std::vector<double>(reference.size(), 0.0));
    EXPECT_LT(distance(coarse, reference), 5e-3 * size);
    EXPECT_LT(distance(finer, reference), 0.5 * distance(coarse, reference));
}

class ImplicitEffects : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Each, ImplicitEffects, testing::Range(0, Registry::count),
                         [](const auto& info) { return std::string(Registry::infos[info.param]->name); });

TEST_P(ImplicitEffects, FollowTheExplicitRun) {
    const double time = 1e-3;
    const auto end = [&](int steps, bool implicit) {
        Settings settings;
        settings.active = test::only_active({GetParam()});
        Bar bar = test::make_bar(test::slender, steps_of(1, steps, time / steps, implicit), settings);
        const std::vector<double> still = bar.fields.pose;
        test::stir(bar, 21);
        bar.fields.pose = still;
        // As smooth as the steps can show, and at rest where it is held.
        const std::vector<double>& x = bar.model->node_positions();
        for (std::size_t i = 0; i < x.size(); ++i) {
            const double z = std::max(0.0, x[i / 3 * 3 + 2] - 0.055);
            bar.fields.displacement0[i] = (i % 3 == 1 ? 2.0 : 1.0) * z * z;
            bar.fields.velocity0[i] = (i % 3 == 0 ? 300.0 : -200.0) * z * z;
        }
        std::fill(bar.fields.deformation0.begin(), bar.fields.deformation0.end(), 0.0);
        for (std::size_t i = 0; i < bar.fields.deformation0.size(); ++i) {
            bar.fields.deformation0[i] = i / 8 % 9 % 4 == 0 ? 1.0 : 0.0;
        }
        std::fill(bar.fields.node_force.begin(), bar.fields.node_force.end(), 0.0);
        return last(bar.model->simulate(bar.fields, bar.schedule).displacement, 3 * bar.model->node_count());
    };
    const std::vector<double> rough = end(800, false), better = end(1600, false);
    std::vector<double> limit(rough.size());
    for (std::size_t i = 0; i < rough.size(); ++i) {
        limit[i] = 2 * better[i] - rough[i];
    }
    const double size = distance(limit, std::vector<double>(limit.size(), 0.0));
    const double coarse = distance(end(25, true), limit), fine = distance(end(50, true), limit);
    EXPECT_LT(fine, 5e-3 * size);
    // A hold that gives way carries at the end of a step what it gives, and what yields does so at its middle: of the first
    // order.
    const EffectInfo& info = *Registry::infos[GetParam()];
    EXPECT_LT(fine, (info.site == Site::hold || info.history_count > 0 ? 0.6 : 0.35) * coarse);
}

TEST(Implicit, AStepThatCannotBeTakenIsToldInOneLine) {
    Bar bar = test::make_bar({}, steps_of(2, 1, 1e-2, true));
    bar.fields.velocity0 = test::Random(3).numbers(3 * bar.model->node_count(), -300, 300);
    try {
        bar.model->simulate(bar.fields, bar.schedule);
        FAIL() << "expected a SimulationError";
    } catch (const SimulationError& error) {
        EXPECT_NE(std::string(error.what()).find("implicit step"), std::string::npos) << error.what();
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
    }
}

}  // namespace
}  // namespace mphygs
