// MLS-MPM transfer: motion, derivatives, failures.
#include <gtest/gtest.h>

#include "mls_mpm_case.hpp"

namespace mphygs {
namespace {

using test::mls_case;
using test::MlsCase;

/// Keeps one field of a direction; the others are absent.
template <class T>
Fields<T> only(Fields<T> d, std::size_t field) {
    for (std::size_t i = 0; i < Fields<T>::count; ++i) {
        if (i != field) {
            d.all()[i]->clear();
        }
    }
    return d;
}

/// The adjoint against the tangent, field by field; `expected`: fields whose derivative must not vanish.
void compare_derivatives(MlsCase<double> c, const std::vector<std::string>& expected, double tolerance = 1e-10) {
    const MlsMpm<double> model = c.model();
    const auto trajectory = model.simulate(c.fields, c.schedule);
    const auto bar = test::random_bar(trajectory, 3);
    Fields<double> gradient = model.adjoint(c.fields, c.schedule, bar);
    Fields<double> direction = test::random_direction(c.fields, 5);
    std::vector<Fields<double>> directions;
    for (std::size_t i = 0; i < Fields<double>::count; ++i) {
        directions.push_back(only(direction, i));
    }
    const auto tangents = model.tangent(c.fields, directions, c.schedule);
    for (std::size_t i = 0; i < Fields<double>::count; ++i) {
        const std::vector<double>& g = *gradient.all()[i];
        const std::vector<double>& d = *direction.all()[i];
        double by_adjoint = 0, size = 0;
        for (std::size_t k = 0; k < g.size(); ++k) {
            by_adjoint += g[k] * d[k];
            size += std::abs(g[k] * d[k]);
        }
        const double by_tangent = test::product(bar, tangents[i + 1]);
        EXPECT_NEAR(by_adjoint, by_tangent, tolerance * (size + 1e-6)) << Fields<double>::names[i];
        for (const std::string& name : expected) {
            if (name == Fields<double>::names[i]) {
                EXPECT_GT(std::abs(by_tangent), 1e-9) << name;
            }
        }
    }
}

TEST(MlsMpm, AdjointIsTheTransposeOfTheTangent) {
    compare_derivatives(mls_case<double>({3, 4, 6}, {5, 4}, true), {"mu", "lambda", "stress_volume", "mass", "deformation0", "gravity",
                                                                    "displacement0", "velocity0", "node_force", "pose"});
}

/// Without known forces and effects, tiles of free particles take the hot path.
TEST(MlsMpm, AdjointOfTheHotPath) {
    for (const bool hold : {false, true}) {
        auto c = mls_case<double>({4, 5, 9}, {6, 7}, hold);
        c.fields.node_force.clear();
        compare_derivatives(c, {"mu", "lambda", "stress_volume", "mass", "deformation0", "gravity", "displacement0", "velocity0"});
    }
}

/// An effect at its null goes the general way, a tangent node by node: both must agree with the hot path.
template <class T>
void compare_paths(double tolerance) {
    auto c = mls_case<T>({4, 5, 9}, {20}, true);
    c.fields.node_force.clear();
    const auto hot = c.model().simulate(c.fields, c.schedule);
    const auto tangent = c.model().tangent(c.fields, {Fields<T>{}}, c.schedule)[0];
    c.settings.active[test::effect_index("gravity")] = true;
    c.fields.effect.assign(c.fields.effect.size(), T{});
    const auto general = c.model().simulate(c.fields, c.schedule);
    EXPECT_NE(hot.position, std::vector<T>(hot.position.size()));
    for (std::size_t i = 0; i < hot.position.size(); ++i) {
        EXPECT_NEAR(hot.position[i], general.position[i], tolerance * 0.01);
        EXPECT_NEAR(hot.position[i], tangent.position[i], tolerance * 0.01);
        EXPECT_NEAR(hot.velocity[i], general.velocity[i], tolerance);
        EXPECT_NEAR(hot.velocity[i], tangent.velocity[i], tolerance);
    }
    for (std::size_t i = 0; i < hot.deformation.size(); ++i) {
        EXPECT_NEAR(hot.deformation[i], tangent.deformation[i], tolerance);
    }
}
TEST(MlsMpm, AllPathsAgree) {
    compare_paths<double>(1e-12);
    compare_paths<float>(3e-5);
}

TEST(MlsMpm, AdjointOfTheCorotatedLaw) {
    auto c = mls_case<double>({3, 4, 5}, {4, 3}, false);
    c.settings.law = Law::fixed_corotated;
    compare_derivatives(c, {"mu", "lambda", "deformation0", "velocity0"});
}

class EveryEffect : public testing::TestWithParam<std::size_t> {};

TEST_P(EveryEffect, AdjointIsTheTransposeOfTheTangent) {
    const EffectInfo& info = *Registry::infos[GetParam()];
    auto c = mls_case<double>({3, 4, 6}, {4, 3}, true);
    c.settings.active[GetParam()] = true;
    if (info.site == Site::hold) {
        EXPECT_THROW(c.model(), std::invalid_argument);
        return;
    }
    if (std::string(info.name) == "plasticity") {
        c.fields.effect[test::parameter_of(GetParam())] = 500.0;
    }
    if (std::string(info.name) == "contact") {
        const std::size_t at = test::parameter_of(GetParam());
        const double plane[] = {0.012, 0.0, 0.0, 1.0, 0.3, 1e7};
        std::copy(std::begin(plane), std::end(plane), c.fields.effect.begin() + static_cast<std::ptrdiff_t>(at));
    }
    std::vector<std::string> expected = {"mu", "velocity0"};
    expected.push_back(info.site == Site::point ? "place_effect" : info.site == Site::mass ? "place_mass" : "effect");
    compare_derivatives(c, expected);
    // The effect acts: without it the motion is another.
    const auto with = c.model().simulate(c.fields, c.schedule);
    c.settings.active[GetParam()] = false;
    const auto without = c.model().simulate(c.fields, c.schedule);
    double change = 0;
    for (std::size_t i = 0; i < with.velocity.size(); ++i) {
        change = std::max(change, std::abs(with.velocity[i] - without.velocity[i]));
    }
    EXPECT_GT(change, 1e-9);
}

INSTANTIATE_TEST_SUITE_P(Registry, EveryEffect, testing::Range(std::size_t(0), static_cast<std::size_t>(Registry::count)),
                         [](const auto& info) { return std::string(Registry::infos[info.param]->name); });

TEST(MlsMpm, AllEffectsTogether) {
    auto c = mls_case<double>({3, 4, 6}, {4, 3}, true);
    for (std::size_t i = 0; i < Registry::count; ++i) {
        c.settings.active[i] = Registry::infos[i]->site != Site::hold && !Registry::infos[i]->threshold;
    }
    compare_derivatives(c, {"effect", "place_effect", "place_mass", "mu", "pose", "mass"});
}

TEST(MlsMpm, TangentAgreesWithCentralDifferences) {
    auto c = mls_case<double>({3, 3, 5}, {5, 4}, true);
    c.settings.active[test::effect_index("viscosity")] = true;
    c.settings.active[test::effect_index("air_drag")] = true;
    const MlsMpm<double> model = c.model();
    const auto bar = test::random_bar(model.simulate(c.fields, c.schedule), 11);
    Fields<double> direction = test::random_direction(c.fields, 12);
    for (std::size_t i = 0; i < Fields<double>::count; ++i) {
        if (direction.all()[i]->empty()) {
            continue;
        }
        const auto at = [&](double step) {
            Fields<double> moved = c.fields;
            for (std::size_t k = 0; k < direction.all()[i]->size(); ++k) {
                (*moved.all()[i])[k] += step * (*direction.all()[i])[k];
            }
            return test::product(bar, model.simulate(moved, c.schedule));
        };
        const double step = 1e-4;
        const double differences = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step);
        const double tangent = test::product(bar, model.tangent(c.fields, {only(direction, i)}, c.schedule)[1]);
        EXPECT_NEAR(tangent, differences, 2e-6 * std::abs(differences) + 1e-8) << Fields<double>::names[i];
    }
}

TEST(MlsMpm, FreeFall) {
    auto c = mls_case<double>({4, 4, 4}, {50}, false);
    c.fields.deformation0.clear();
    c.fields.displacement0.clear();
    c.fields.node_force.clear();
    const double v[3] = {0.3, -0.2, 0.5}, h = 2e-4, n = 50;
    for (std::size_t i = 0; i < c.fields.velocity0.size(); ++i) {
        c.fields.velocity0[i] = v[i % 3];
    }
    const auto t = c.model().simulate(c.fields, c.schedule);
    const std::size_t size = t.position.size() / 2;
    for (std::size_t i = 0; i < size; ++i) {
        const double g = c.fields.gravity[i % 3];
        EXPECT_NEAR(t.position[size + i] - t.position[i], h * n * v[i % 3] + h * h * g * n * (n + 1) / 2, 1e-12);
        EXPECT_NEAR(t.velocity[size + i], v[i % 3] + h * n * g, 1e-11);
    }
    for (std::size_t i = 0; i < 3 * size; ++i) {
        EXPECT_NEAR(t.deformation[3 * size + i], i % 9 % 4 == 0 ? 1 : 0, 1e-10);
    }
}

/// Momentum and angular momentum of the particles, with the affine part left out of the latter.
TEST(MlsMpm, MomentumIsConserved) {
    auto c = mls_case<double>({4, 5, 6}, {40}, false);
    c.fields.gravity.assign(3, 0.0);
    c.fields.node_force.clear();
    const auto t = c.model().simulate(c.fields, c.schedule);
    const std::size_t count = c.geometry.particle_count();
    double scale = 0;
    for (std::size_t i = 0; i < count; ++i) {
        scale += c.fields.mass[i] * 0.5;
    }
    for (std::size_t k = 0; k < 3; ++k) {
        double before = 0, after = 0;
        for (std::size_t i = 0; i < count; ++i) {
            before += c.fields.mass[i] * t.velocity[3 * i + k];
            after += c.fields.mass[i] * t.velocity[3 * (count + i) + k];
        }
        EXPECT_NEAR(before, after, 1e-13 * scale);
    }
}

/// A spinning free body keeps its rate: APIC, and C_0 from the initial velocities.
TEST(MlsMpm, RotationIsKept) {
    auto c = mls_case<double>({6, 6, 6}, {100}, false);
    c.fields.gravity.assign(3, 0.0);
    c.fields.node_force.clear();
    c.fields.deformation0.clear();
    c.fields.displacement0.clear();
    c.fields.mass.assign(c.geometry.particle_count(), 1.25e-4);
    c.fields.mu.assign(c.geometry.particle_count(), 2e5);
    c.fields.lambda.assign(c.geometry.particle_count(), 2e5);
    c.schedule.dt = {1e-4};
    const double rate = 2.0;
    const std::size_t count = c.geometry.particle_count();
    double centre[2] = {0, 0};
    for (std::size_t i = 0; i < count; ++i) {
        centre[0] += c.geometry.points[3 * i] / static_cast<double>(count);
        centre[1] += c.geometry.points[3 * i + 1] / static_cast<double>(count);
    }
    for (std::size_t i = 0; i < count; ++i) {
        c.fields.velocity0[3 * i] = -rate * (c.geometry.points[3 * i + 1] - centre[1]);
        c.fields.velocity0[3 * i + 1] = rate * (c.geometry.points[3 * i] - centre[0]);
        c.fields.velocity0[3 * i + 2] = 0;
    }
    const auto t = c.model().simulate(c.fields, c.schedule);
    double turned = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const double* f = &t.deformation[9 * (count + i)];
        turned += std::atan2(f[3] - f[1], f[0] + f[4]) / static_cast<double>(count);
    }
    EXPECT_NEAR(turned, rate * 0.01, 0.01 * rate * 0.01);
}

TEST(MlsMpm, SameBitsAtAnyThreadCount) {
    auto c = mls_case<float>({12, 12, 24}, {7, 6}, true);
    c.settings.active[test::effect_index("viscosity")] = true;
    const auto one = c.model().simulate(c.fields, c.schedule);
    const auto bar = test::random_bar(one, 2);
    const Fields<float> gradient_one = c.model().adjoint(c.fields, c.schedule, bar);
    const auto tangent_one = c.model().tangent(c.fields, {test::random_direction(c.fields, 4)}, c.schedule);
    c.settings.threads = 3;
    const auto three = c.model().simulate(c.fields, c.schedule);
    Fields<float> gradient_three = c.model().adjoint(c.fields, c.schedule, bar);
    EXPECT_EQ(one.position, three.position);
    EXPECT_EQ(one.deformation, three.deformation);
    Fields<float> copy = gradient_one;
    for (std::size_t i = 0; i < Fields<float>::count; ++i) {
        EXPECT_EQ(*copy.all()[i], *gradient_three.all()[i]) << Fields<float>::names[i];
    }
    EXPECT_EQ(tangent_one[1].position, c.model().tangent(c.fields, {test::random_direction(c.fields, 4)}, c.schedule)[1].position);
}

TEST(MlsMpm, GradientDoesNotDependOnTheCheckpoints) {
    auto c = mls_case<double>({4, 5, 6}, {9, 11}, true);
    c.settings.active[test::effect_index("relaxation")] = true;
    const auto bar = test::random_bar(c.model().simulate(c.fields, c.schedule), 2);
    long recomputed = -1;
    Fields<double> full = c.model().adjoint(c.fields, c.schedule, bar, {}, &recomputed);
    EXPECT_EQ(recomputed, 0);
    c.settings.memory_budget = 600000;  // a few records
    Fields<double> tight = c.model().adjoint(c.fields, c.schedule, bar, {}, &recomputed);
    EXPECT_GT(recomputed, 0);
    for (std::size_t i = 0; i < Fields<double>::count; ++i) {
        EXPECT_EQ(*full.all()[i], *tight.all()[i]) << Fields<double>::names[i];
    }
    // A loss that sees the trajectory first.
    const auto loss = [&](const ParticleTrajectory<double>& t) {
        EXPECT_EQ(t.position, c.model().simulate(c.fields, c.schedule).position);
        EXPECT_EQ(t.velocity, c.model().simulate(c.fields, c.schedule).velocity);
        return bar;
    };
    Fields<double> called = c.model().gradient(c.fields, c.schedule, loss);
    EXPECT_EQ(full.mu, called.mu);
    EXPECT_EQ(full.velocity0, called.velocity0);
}

TEST(MlsMpm, HeldParticlesFollowTheirHold) {
    auto c = mls_case<double>({4, 4, 6}, {400}, true);
    c.fields.velocity0.assign(c.fields.velocity0.size(), 0.0);
    c.fields.displacement0.clear();
    c.fields.deformation0.clear();
    c.settings.active[test::effect_index("mass_damping")] = true;
    c.fields.effect[test::parameter_of(test::effect_index("mass_damping"))] = 5;
    const auto t = c.model().simulate(c.fields, c.schedule);
    const double* pose = &c.fields.pose[12 * 400];
    const std::size_t count = c.geometry.particle_count();
    for (std::size_t i = 0; i < count; ++i) {
        for (std::size_t k = 0; c.geometry.hold[i] == 0 && k < 3; ++k) {
            double place = pose[9 + k];
            for (std::size_t j = 0; j < 3; ++j) {
                place += pose[3 * k + j] * c.geometry.points[3 * i + j];
            }
            EXPECT_NEAR(t.position[3 * (count + i) + k], place, 3e-4);
        }
    }
}

/// Young's modulus that beam theory sees in the static deflection of a cantilever of 20 x 20 x 80
/// mm, over the true one.
double modulus_seen(double spacing) {
    const double s = spacing / 2, width = 0.02, length = 0.08, held = 0.02, young = 1e5, nu = 0.3, g = 0.5;
    MlsCase<float> c;
    c.geometry.spacing = spacing;
    c.geometry.hold_count = 1;
    for (double x = s / 2; x < width; x += s) {
        for (double y = s / 2; y < width; y += s) {
            for (double z = s / 2 - held; z < length; z += s) {
                c.geometry.points.insert(c.geometry.points.end(), {x, y, z});
                c.geometry.part.push_back(0);
                c.geometry.hold.push_back(z < 0 ? 0 : -1);
            }
        }
    }
    const std::size_t count = c.geometry.particle_count(), damping = test::effect_index("mass_damping");
    const double mu = young / (2 * (1 + nu));
    c.settings.active.assign(Registry::count, false);
    c.settings.active[damping] = true;
    c.fields.mu.assign(count, static_cast<float>(mu));
    c.fields.lambda.assign(count, static_cast<float>(young * nu / ((1 + nu) * (1 - 2 * nu))));
    c.fields.stress_volume.assign(count, static_cast<float>(s * s * s));
    c.fields.mass.assign(count, static_cast<float>(1000 * s * s * s));
    c.fields.gravity = {static_cast<float>(g), 0, 0};
    c.fields.effect.assign(Registry::parameter_count, 0.0f);
    c.fields.effect[test::parameter_of(damping)] = 64;  // critical for the slowest swing, of 32 radians a second
    const double dt = 0.028 * spacing;
    c.schedule.steps = {static_cast<int>(0.22 / dt)};
    c.schedule.dt = {dt};
    for (int n = 0; n <= c.schedule.steps[0]; ++n) {
        c.fields.pose.insert(c.fields.pose.end(), {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0});
    }
    const auto t = c.model().simulate(c.fields, c.schedule);
    double moved = 0, tips = 0;
    for (std::size_t i = 0; i < count; ++i) {
        if (c.geometry.points[3 * i + 2] > length - s) {
            moved += static_cast<double>(t.position[3 * (count + i)]) - c.geometry.points[3 * i];
            tips += 1;
        }
    }
    const double z = length - s / 2, load = 1000 * width * width * g, inertia = std::pow(width, 4) / 12;
    const double bending = load / (24 * young * inertia) * (std::pow(z, 4) - 4 * length * std::pow(z, 3) + 6 * length * length * z * z);
    const double shear = load / (5.0 / 6.0 * mu * width * width) * (length * z - z * z / 2);
    return (bending + shear) * tips / moved;
}
TEST(MlsMpm, TheClampKeepsTheModulusUnderRefinement) {
    const double coarse = modulus_seen(0.02 / 2), fine = modulus_seen(0.02 / 3);
    EXPECT_NEAR(coarse, 1, 0.08);
    EXPECT_NEAR(fine, 1, 0.03);
    EXPECT_NEAR(coarse, fine, 0.06);
}

TEST(MlsMpm, ADistantJourneyStaysOnTheGrid) {
    auto c = mls_case<double>({3, 3, 3}, {2000}, false);
    for (std::size_t i = 0; i < c.fields.velocity0.size(); ++i) {
        c.fields.velocity0[i] = i % 3 == 0 ? 20.0 : 0.0;
    }
    c.fields.node_force.clear();
    const auto t = c.model().simulate(c.fields, c.schedule);
    const std::size_t size = t.position.size() / 2;
    EXPECT_GT(t.position[size], 7.0);  // 800 cells away
}

TEST(MlsMpm, TheDampingRateIsThatOfTheEffectAlone) {
    auto c = mls_case<double>({6, 6, 12}, {1}, false);
    c.fields.node_force.clear();
    c.fields.deformation0.clear();
    const std::size_t damping = test::effect_index("mass_damping");
    c.settings.active[damping] = true;
    double& alpha = c.fields.effect[test::parameter_of(damping)];
    alpha = 0;
    EXPECT_NEAR(c.model().largest_rates(c.fields)[1], 0, 1e-6);
    alpha = 7;
    EXPECT_NEAR(c.model().largest_rates(c.fields)[1], 7, 0.1);
}

/// Just below the limit of symplectic Euler the run is stable, well above it is not.
TEST(MlsMpm, LargestRatesBoundTheSubstep) {
    auto c = mls_case<double>({6, 6, 12}, {1}, false);
    c.fields.node_force.clear();
    c.fields.deformation0.clear();
    c.settings.active[test::effect_index("viscosity")] = true;
    const auto rates = c.model().largest_rates(c.fields);
    const double wave = (3e4 + 2 * 2e4) / 1000.0 / 1e-4;  // c^2 / h^2 of the stiff part
    EXPECT_GT(rates[0], 2 * wave);
    EXPECT_LT(rates[0], 30 * wave);
    EXPECT_GT(rates[1], 0.0);
    c.settings.active.assign(c.settings.active.size(), false);
    for (double& v : c.fields.velocity0) {
        v *= 1e-3;
    }
    c.fields.displacement0.clear();
    const auto spread = [&](double factor) {
        c.schedule.steps = {300};
        c.schedule.dt = {factor * 2 / std::sqrt(rates[0])};
        ParticleTrajectory<double> t;
        try {
            t = c.model().simulate(c.fields, c.schedule);
        } catch (const SimulationError&) {
            return 1e300;
        }
        double largest = 0;
        for (std::size_t i = t.deformation.size() / 2; i < t.deformation.size(); ++i) {
            largest = std::max(largest, std::abs(t.deformation[i] - (i % 9 % 4 == 0 ? 1 : 0)));
        }
        return largest;
    };
    EXPECT_LT(spread(0.9), 0.1);
    EXPECT_GT(spread(2.0), 0.5);
}

TEST(MlsMpm, AnUnstableRunSaysWhere) {
    auto c = mls_case<float>({4, 4, 6}, {20, 200}, false);
    c.schedule.dt = {2e-4, 4e-3};
    c.fields.mu.assign(c.fields.mu.size(), 1e7f);
    c.fields.lambda.assign(c.fields.lambda.size(), 1e7f);
    try {
        c.model().simulate(c.fields, c.schedule);
        FAIL() << "no error";
    } catch (const SimulationError& e) {
        EXPECT_GE(e.frame, 1);
        EXPECT_GE(e.part, 0);
        EXPECT_NE(std::string(e.what()).find("part"), std::string::npos);
    }
}

TEST(MlsMpm, AParticleThatLeavesIsAnError) {
    auto c = mls_case<double>({3, 3, 3}, {10}, false);
    c.fields.node_force[3 * 13 + 1] = 1e6;  // throws particle 13 out of its cell at once
    try {
        c.model().simulate(c.fields, c.schedule);
        FAIL() << "no error";
    } catch (const SimulationError& e) {
        EXPECT_EQ(e.frame, 1);
        EXPECT_EQ(e.part, c.geometry.part[13]);
    }
    c.fields.node_force[3 * 13 + 1] = std::nan("");
    EXPECT_THROW(c.model().simulate(c.fields, c.schedule), SimulationError);
    c.fields.node_force[3 * 13 + 1] = 0;
    c.fields.displacement0[5] = 1e9;
    EXPECT_THROW(c.model().simulate(c.fields, c.schedule), SimulationError);
}

TEST(MlsMpm, WrongInputIsNamed) {
    const auto good = mls_case<double>({3, 3, 3}, {2}, true);
    const auto message = [](auto&& f) -> std::string {
        try {
            f();
        } catch (const std::invalid_argument& e) {
            return e.what();
        }
        return "";
    };
    auto c = good;
    c.fields.mu.pop_back();
    EXPECT_NE(message([&] { c.model().simulate(c.fields, c.schedule); }).find("mu has 26"), std::string::npos);
    c = good;
    c.geometry.hold[0] = 4;
    EXPECT_NE(message([&] { c.model(); }).find("hold 4"), std::string::npos);
    c = good;
    c.settings.hold_relaxation = 0.5;
    EXPECT_NE(message([&] { c.model(); }).find("hold_relaxation"), std::string::npos);
    c = good;
    c.geometry.place_particle = {-1, 27};
    EXPECT_NE(message([&] { c.model(); }).find("place 1"), std::string::npos);
    c = good;
    EXPECT_NE(message([&] { c.model().adjoint(c.fields, c.schedule, {{1.0}, {}, {}}); }).find("position"), std::string::npos);
}

}  // namespace
}  // namespace mphygs
