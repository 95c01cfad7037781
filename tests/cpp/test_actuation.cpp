// Tendons, pressures and known forces: closed forms, derivatives three ways in both transfers, paths, bits, errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "actuation_scene.hpp"
#include "bar_scene.hpp"
#include "mls_mpm_case.hpp"

namespace mphygs {
namespace {

using Numbers = std::vector<double>;

/// A cube's closed surface of side 2 about (1, 1, 1), outward, one channel; no carriers. Points 8 to 43 stand amidst the sides.
Actuation cube() {
    Actuation a;
    for (int p = 0; p < 8; ++p) {
        a.place.insert(a.place.end(), {2.0 * (p / 4), 2.0 * (p / 2 % 2), 2.0 * (p % 2)});
    }
    a.hold.assign(44, -1);
    a.row_begin.assign(45, 0);
    for (const int corner : {0, 1, 3, 0, 3, 2, 4, 7, 5, 4, 6, 7, 0, 5, 1, 0, 4, 5, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3}) {
        a.triangle.push_back(corner);
    }
    for (std::size_t i = 0; i < 36; ++i) {
        a.triangle_middle.push_back(static_cast<std::int32_t>(8 + i));
        const std::size_t one = static_cast<std::size_t>(a.triangle[i]), two = static_cast<std::size_t>(a.triangle[i / 3 * 3 + (i + 1) % 3]);
        for (std::size_t c = 0; c < 3; ++c) {
            a.place.push_back(0.5 * (a.place[3 * one + c] + a.place[3 * two + c]));
        }
    }
    a.triangle_channel.assign(12, 0);
    a.path_begin = {0};
    a.channel_count = 1;
    a.settle(0, 0);
    return a;
}

TEST(Actuation, PressureOnAClosedSurfaceHasNoResultantHoweverItIsTurnedAndStrained) {
    const Actuation a = cube();
    test::Random random(3);
    Numbers force, channel{7.0};
    a.forces(a.place, channel, force);
    double outward = 0;
    for (std::size_t p = 0; p < 44; ++p) {
        for (std::size_t c = 0; c < 3; ++c) {
            outward += force[3 * p + c] * (a.place[3 * p + c] - 1.0);
        }
    }
    EXPECT_NEAR(outward, -7.0 * 3 * 8.0, 1e-12);  // -p 3 V, the virial of a pressure
    Numbers moved = a.place, f = random.numbers(9, -1, 1);
    for (std::size_t p = 0; p < 8; ++p) {
        for (std::size_t c = 0; c < 3; ++c) {
            moved[3 * p + c] = f[3 * c] * a.place[3 * p] + f[3 * c + 1] * a.place[3 * p + 1] + f[3 * c + 2] * a.place[3 * p + 2];
        }
    }
    moved[4] += 0.3;  // and one corner dented
    for (std::size_t i = 0; i < 36; ++i) {
        const std::size_t one = static_cast<std::size_t>(a.triangle[i]), two = static_cast<std::size_t>(a.triangle[i / 3 * 3 + (i + 1) % 3]);
        for (std::size_t c = 0; c < 3; ++c) {
            moved[3 * (8 + i) + c] = 0.5 * (moved[3 * one + c] + moved[3 * two + c]);
        }
    }
    a.forces(moved, channel, force);
    double size = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        double sum = 0, torque = 0;
        for (std::size_t p = 0; p < 44; ++p) {
            sum += force[3 * p + c];
            size += std::abs(force[3 * p + c]);
            torque += moved[3 * p + (c + 1) % 3] * force[3 * p + (c + 2) % 3] - moved[3 * p + (c + 2) % 3] * force[3 * p + (c + 1) % 3];
        }
        EXPECT_NEAR(sum, 0.0, 1e-12);
        EXPECT_NEAR(torque, 0.0, 1e-11);
    }
    EXPECT_GT(size, 1.0);
}

TEST(Actuation, ATendonPullsItsEndsTogetherAndPressesOnItsBend) {
    Actuation a;
    a.place = {0, 0, 0, 2, 0, 0, 2, 3, 0};
    a.hold.assign(3, -1);
    a.row_begin.assign(4, 0);
    a.path_begin = {0, 3};
    a.path_point = {0, 1, 2};
    a.path_channel = {0};
    a.channel_count = 1;
    a.settle(0, 0);
    Numbers force;
    a.forces(a.place, {5.0}, force);
    const Numbers expected{5, 0, 0, -5, 5, 0, 0, -5, 0};
    for (std::size_t i = 0; i < 9; ++i) {
        EXPECT_NEAR(force[i], expected[i], 1e-14);
    }
}

TEST(Actuation, TangentFollowsDifferencesAndTheAdjointIsItsTranspose) {
    Actuation a = test::loads(30, false);
    a.settle(30, 0);
    test::Random random(4);
    const Numbers c{0.7, 30.0, 0.1, 0.2, 0.3, 0.4};
    const Numbers dx = random.numbers(36, -1e-2, 1e-2), dc = random.numbers(6, -1, 1), f_bar = random.numbers(36, -1, 1);
    Numbers df, x_bar, c_bar;
    a.forces_change(a.place, c, dx, dc, df);
    a.forces_bar(a.place, c, f_bar, x_bar, c_bar);
    const auto dot = [](const Numbers& p, const Numbers& q) {
        double sum = 0;
        for (std::size_t i = 0; i < p.size(); ++i) {
            sum += p[i] * q[i];
        }
        return sum;
    };
    EXPECT_NEAR(dot(f_bar, df), dot(x_bar, dx) + dot(c_bar, dc), 1e-13);
    const auto at = [&](double h) {
        Numbers x = a.place, b = c, f;
        for (std::size_t i = 0; i < x.size(); ++i) {
            x[i] += h * dx[i];
        }
        for (std::size_t i = 0; i < b.size(); ++i) {
            b[i] += h * dc[i];
        }
        a.forces(x, b, f);
        return f;
    };
    const double h = 1e-4;
    const Numbers p = at(-2 * h), q = at(-h), r = at(h), s = at(2 * h);
    for (std::size_t i = 0; i < df.size(); ++i) {
        EXPECT_NEAR(df[i], (8 * (r[i] - q[i]) - (s[i] - p[i])) / (12 * h), 1e-8 * (1.0 + std::abs(df[i])));
    }
}

template <class F>
F moved_by(const F& value, F direction, double step) {
    F result = value;
    for (std::size_t i = 0; i < F::count; ++i) {
        for (std::size_t n = 0; n < direction.all()[i]->size(); ++n) {
            (*result.all()[i])[n] += step * (*direction.all()[i])[n];
        }
    }
    return result;
}

double inner(Fields<double> a, Fields<double> b) {
    double sum = 0;
    for (std::size_t i = 0; i < Fields<double>::count; ++i) {
        for (std::size_t n = 0; n < std::min(a.all()[i]->size(), b.all()[i]->size()); ++n) {
            sum += (*a.all()[i])[n] * (*b.all()[i])[n];
        }
    }
    return sum;
}

/// Random directions of single fields, of a share of their size, and one of all of them.
std::vector<Fields<double>> directions_of(const Fields<double>& fields, std::initializer_list<const char*> names) {
    Fields<double> all = test::random_direction(fields, 12), together;
    std::vector<Fields<double>> found;
    for (const std::string name : names) {
        for (std::size_t i = 0; i < Fields<double>::count; ++i) {
            if (name == Fields<double>::names[i]) {
                found.emplace_back();
                for (double& x : *all.all()[i]) {
                    x *= name == "pose" ? 1e-3 : 0.1;
                }
                *found.back().all()[i] = *together.all()[i] = *all.all()[i];
            }
        }
    }
    found.push_back(together);
    return found;
}

/// run(fields), tangent(directions) and adjoint(bar) of a model; bars and trajectories by dot(bar, trajectory).
template <class Run, class Tangent, class Adjoint, class Dot>
void agree(const Fields<double>& fields, const std::vector<Fields<double>>& directions, const Run& run, const Tangent& tangent,
           const Adjoint& adjoint, const Dot& dot) {
    const auto lanes = tangent(directions);
    const Fields<double> gradient = adjoint();
    for (std::size_t d = 0; d < directions.size(); ++d) {
        const double by_tangent = dot(lanes[d + 1]), alone = dot(tangent(std::vector<Fields<double>>{directions[d]})[1]);
        const auto at = [&](double step) { return dot(run(moved_by(fields, directions[d], step))); };
        const double h = 1e-3, differences = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h);
        EXPECT_NE(by_tangent, 0.0) << d;
        EXPECT_NEAR(by_tangent, inner(gradient, directions[d]), 1e-9 * std::abs(by_tangent)) << d;
        EXPECT_NEAR(by_tangent, alone, 1e-10 * std::abs(by_tangent)) << d;
        EXPECT_NEAR(by_tangent, differences, 1e-5 * std::abs(by_tangent)) << d;
    }
}

struct Loaded {
    std::shared_ptr<TotalLagrangian<double>> model;
    Fields<double> fields;
    Schedule schedule{{6, 5}, {1e-4, 8e-5}, 0.01};
};

Loaded loaded_bar() {
    Loaded l;
    test::Bar bar = test::make_bar({}, l.schedule, {});
    test::stir(bar, 21);
    Geometry g = bar.model->geometry();
    g.actuation = test::loads(static_cast<int>(bar.model->node_count()), true);
    l.model = std::make_shared<TotalLagrangian<double>>(std::move(g), Settings{});
    l.fields = bar.fields;
    l.fields.channel = test::courses<double>(2);
    return l;
}

TEST(TotalLagrangianActuation, AdjointTangentsAndDifferencesAgree) {
    const Loaded l = loaded_bar();
    const auto like = l.model->simulate(l.fields, l.schedule);
    test::Random random(5);
    Trajectory<double> bar{random.numbers(like.displacement.size(), -1e3, 1e3), random.numbers(like.velocity.size(), -1, 1)};
    const auto directions = directions_of(l.fields, {"mu", "mass", "displacement0", "velocity0", "node_force", "pose", "channel"});
    agree(
        l.fields, directions, [&](const auto& f) { return l.model->simulate(f, l.schedule); },
        [&](const auto& d) { return l.model->tangent(l.fields, d, l.schedule); },
        [&] { return l.model->adjoint(l.fields, l.schedule, bar); },
        [&](const Trajectory<double>& t) {
            double sum = 0;
            for (std::size_t i = 0; i < t.displacement.size(); ++i) {
                sum += bar.displacement[i] * t.displacement[i] + bar.velocity[i] * t.velocity[i];
            }
            return sum;
        });
}

TEST(TotalLagrangianActuation, LeavesTheBitsWhereNothingActs) {
    const Loaded l = loaded_bar();
    Fields<double> without = l.fields, still = l.fields;
    without.channel.clear();
    std::fill(still.channel.begin(), still.channel.end(), 0.0);
    Geometry bare = l.model->geometry();
    bare.actuation = {};
    const TotalLagrangian<double> plain(bare, {});
    const auto expected = plain.simulate(without, l.schedule);
    EXPECT_EQ(l.model->simulate(without, l.schedule).velocity, expected.velocity);
    EXPECT_EQ(l.model->simulate(still, l.schedule).displacement, expected.displacement);
    EXPECT_NE(l.model->simulate(l.fields, l.schedule).displacement, expected.displacement);
    Fields<double> taut = without;
    taut.channel.assign(24, 0.0);
    taut.channel[0] = 1e3;  // [N] over some centimetres: stiffer than the bar
    EXPECT_GT(l.model->largest_rates(taut)[0], 1.5 * plain.largest_rates(without)[0]);
    EXPECT_EQ(l.model->largest_rates(without)[0], plain.largest_rates(without)[0]);
}

TEST(TotalLagrangianActuation, RefusesWhatDoesNotFit) {
    const Loaded l = loaded_bar();
    Fields<double> fields = l.fields;
    fields.channel.pop_back();
    EXPECT_THROW(l.model->simulate(fields, l.schedule), std::invalid_argument);
    for (int fault = 0; fault < 4; ++fault) {
        Geometry g = l.model->geometry();
        switch (fault) {
            case 0: g.actuation.row_carrier[0] = 1 << 20; break;
            case 1: g.actuation.hold[0] = 3; break;
            case 2: g.actuation.path_point[1] = 99; break;
            default: g.actuation.force_channel[0] = 4;
        }
        EXPECT_THROW(TotalLagrangian<double>(g, {}), std::invalid_argument) << fault;
    }
}

template <class T>
test::MlsCase<T> loaded_particles(bool hold) {
    auto c = test::mls_case<T>({4, 5, 9}, {6, 7}, hold);
    c.geometry.actuation = test::loads(static_cast<int>(c.geometry.particle_count()), hold);
    for (double& x : c.geometry.actuation.place) {
        x = std::abs(x) - 0.08;  // about the block
    }
    c.fields.channel = test::courses<T>(2);
    return c;
}

/// On the hot path, held or not, and on the general one.
TEST(MlsActuation, AdjointTangentsAndDifferencesAgree) {
    for (const int path : {0, 1, 2}) {
        auto c = loaded_particles<double>(path > 0);
        if (path < 2) {
            c.fields.node_force.clear();
        } else {
            c.settings.active[test::effect_index("viscosity")] = true;
        }
        const auto model = c.model();
        const auto bar = test::random_bar(model.simulate(c.fields, c.schedule), 3);
        auto directions = directions_of(c.fields, {"mu", "mass", "deformation0", "displacement0", "velocity0", "channel"});
        if (path > 0) {
            directions.push_back(directions_of(c.fields, {"pose"})[0]);
        }
        SCOPED_TRACE(path);
        agree(
            c.fields, directions, [&](const auto& f) { return model.simulate(f, c.schedule); },
            [&](const auto& d) { return model.tangent(c.fields, d, c.schedule); },
            [&] { return model.adjoint(c.fields, c.schedule, bar); },
            [&](const ParticleTrajectory<double>& t) { return test::product(bar, t); });
    }
}

TEST(MlsActuation, AllPathsAgreeAndNothingActsWithoutChannels) {
    auto c = loaded_particles<double>(true);
    c.fields.node_force.clear();
    const auto hot = c.model().simulate(c.fields, c.schedule);
    auto effects = c;
    effects.settings.active[test::effect_index("gravity")] = true;
    effects.fields.effect.assign(effects.fields.effect.size(), 0.0);
    const auto general = effects.model().simulate(effects.fields, c.schedule);
    Fields<double> without = c.fields;
    without.channel.clear();
    auto bare = c;
    bare.geometry.actuation = {};
    const auto free = c.model().simulate(without, c.schedule);
    EXPECT_EQ(free.position, bare.model().simulate(without, c.schedule).position);
    EXPECT_EQ(c.model().largest_rates(without), bare.model().largest_rates(without));
    Fields<double> taut = without;
    taut.channel.assign(24, 0.0);
    taut.channel[0] = 1e3;
    EXPECT_GT(c.model().largest_rates(taut)[0], 1.5 * c.model().largest_rates(without)[0]);
    const auto single = loaded_particles<float>(true);
    auto light = single.fields;
    light.node_force.clear();
    const auto rough = single.model().simulate(light, single.schedule);
    double change = 0;
    for (std::size_t i = 0; i < hot.position.size(); ++i) {
        EXPECT_NEAR(hot.position[i], general.position[i], 1e-14);
        EXPECT_NEAR(hot.position[i], static_cast<double>(rough.position[i]), 2e-6);
        change = std::max(change, std::abs(hot.position[i] - free.position[i]));
    }
    EXPECT_GT(change, 1e-5);
}

}  // namespace
}  // namespace mphygs
