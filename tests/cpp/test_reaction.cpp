// What holds exert: the balance of momentum, the tangent against differences, the adjoint against
// the tangent, and the same motion to the bit whether reactions are asked for or not.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <ostream>
#include <string>

#include "bar_scene.hpp"
#include "mphygs/physics/reaction.hpp"

namespace mphygs {
namespace {

using F = Fields<double>;

/// Substeps weigh in as a mean of the interval before a frame and of the one after it.
Schedule asking(Schedule schedule, unsigned seed = 0) {
    test::Random random(seed + 1);
    for (int i = 0; i < 2 * schedule.total_steps(); ++i) {
        schedule.reaction_weight.push_back(random.between(0.05, 0.3));
    }
    return schedule;
}

const Schedule plain{{3, 4}, {1e-4, 8e-5}, 0.01};

struct Case {
    std::string name;
    std::vector<int> effects;
    bool two_grids = false;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

std::vector<Case> cases() {
    std::vector<int> every;
    for (int i = 0; i < Registry::count; ++i) {
        every.push_back(i);
    }
    return {{"none", {}}, {"every_effect", every}, {"two_grids", {}, true}, {"every_effect_on_two_grids", every, true}};
}

class Reaction : public testing::TestWithParam<Case> {
  protected:
    test::Bar bar(const Schedule& schedule) const {
        Settings settings;
        settings.active = test::only_active(GetParam().effects);
        test::BarOptions options = test::smaller;
        options.two_grids = GetParam().two_grids;
        test::Bar b = test::make_bar(options, schedule, settings);
        Geometry g = b.model->geometry();
        for (int h = 0; h < g.hold_count; ++h) {
            g.hold_centre.insert(g.hold_centre.end(), {0.11, -0.19, 0.03});
        }
        b.model = std::make_shared<TotalLagrangian<double>>(g, b.model->settings());
        test::stir(b, 21);
        return b;
    }
};
INSTANTIATE_TEST_SUITE_P(Effects, Reaction, testing::ValuesIn(cases()), [](const auto& info) { return info.param.name; });

/// A random direction of usual size in every field that a reaction depends on.
std::vector<F> directions(const test::Bar& bar) {
    std::vector<F> all;
    test::Random random(22);
    F value = bar.fields;
    const double sizes[F::count] = {3e4, 3e4, 1e-8, 1e-5, 1e-2, 0, 1e-4, 0, 1.0, 1e-4, 0.1, 1e-3, 1e-5};
    for (std::size_t i = 0; i < F::count; ++i) {
        const std::string name = F::names[i];
        if (value.all()[i]->empty() || sizes[i] == 0 || name == "place_mass") {
            continue;
        }
        F d;
        *d.all()[i] = random.numbers(value.all()[i]->size(), -sizes[i], sizes[i]);
        all.push_back(std::move(d));
    }
    const std::size_t softness = [] {
        std::size_t k = 0, found = 0;
        Registry::each([&](auto tag, int) {
            using E = typename decltype(tag)::type;
            found = E::info.site == Site::hold ? k : found;
            k += static_cast<std::size_t>(E::info.parameter_count());
        });
        return found;
    }();
    F d;
    d.effect.assign(value.effect.size(), 0.0);
    d.effect[softness] = 1e-5;
    all.push_back(std::move(d));
    return all;
}

F moved(const F& value, const F& direction, double step) {
    F result = value, d = direction;
    for (std::size_t i = 0; i < F::count; ++i) {
        for (std::size_t n = 0; n < d.all()[i]->size(); ++n) {
            (*result.all()[i])[n] += step * (*d.all()[i])[n];
        }
    }
    return result;
}

double dot(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

TEST_P(Reaction, AskingForItLeavesTheMotionToTheBit) {
    const test::Bar b = bar(plain);
    const std::vector<F> all = directions(b);
    for (const std::size_t count : {std::size_t(1), all.size()}) {
        const std::vector<F> some(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(count));
        const auto with = b.model->tangent(b.fields, some, asking(plain)), without = b.model->tangent(b.fields, some, plain);
        for (std::size_t k = 0; k < with.size(); ++k) {
            EXPECT_EQ(with[k].displacement, without[k].displacement);
            EXPECT_EQ(with[k].velocity, without[k].velocity);
            EXPECT_EQ(with[k].reaction.size(), 3 * 6 * static_cast<std::size_t>(b.model->geometry().hold_count));
            EXPECT_TRUE(without[k].reaction.empty());
        }
    }
}

TEST_P(Reaction, AdjointIsTheTransposeOfTheTangent) {
    const Schedule schedule = asking(plain);
    const test::Bar b = bar(plain);
    const std::vector<F> all = directions(b);
    const auto t = b.model->tangent(b.fields, all, schedule);
    test::Random random(23);
    Trajectory<double> seed;
    seed.reaction = random.numbers(t[0].reaction.size(), -1, 1);
    F gradient = b.model->adjoint(b.fields, schedule, seed);
    for (std::size_t i = 0; i < all.size(); ++i) {
        F direction = all[i];
        const double by_tangent = dot(seed.reaction, t[i + 1].reaction);
        double by_adjoint = 0;
        for (std::size_t k = 0; k < F::count; ++k) {
            by_adjoint += dot(*gradient.all()[k], *direction.all()[k]);
        }
        EXPECT_NEAR(by_adjoint, by_tangent, 1e-9 * std::abs(by_tangent) + 1e-13) << i;
    }
    EXPECT_NE(dot(seed.reaction, t[1].reaction), 0.0);
}

TEST_P(Reaction, TangentAgreesWithCentralDifferences) {
    const Schedule schedule = asking(plain);
    const test::Bar b = bar(plain);
    const std::vector<F> all = directions(b);
    const auto t = b.model->tangent(b.fields, all, schedule);
    const auto alone = b.model->tangent(b.fields, {all[0]}, schedule);
    for (std::size_t n = 0; n < t[1].reaction.size(); ++n) {
        EXPECT_NEAR(alone[1].reaction[n], t[1].reaction[n], 1e-9 * std::abs(t[1].reaction[n]) + 1e-12);
        EXPECT_NEAR(alone[0].reaction[n], t[0].reaction[n], 1e-9 * std::abs(t[0].reaction[n]) + 1e-12);
    }
    for (std::size_t i = 0; i < all.size(); ++i) {
        double best = std::numeric_limits<double>::infinity();
        for (const double h : {3e-3, 1e-4, 3e-6}) {
            const auto at = [&](double step) { return b.model->simulate(moved(b.fields, all[i], step), schedule).reaction; };
            const std::vector<double> p = at(-2 * h), q = at(-h), r = at(h), s = at(2 * h);
            double error = 0, size = 0;
            for (std::size_t n = 0; n < p.size(); ++n) {
                const double difference = (8 * (r[n] - q[n]) - (s[n] - p[n])) / (12 * h);
                error += (t[i + 1].reaction[n] - difference) * (t[i + 1].reaction[n] - difference);
                size += difference * difference;
            }
            if (size > 0) {
                best = std::min(best, std::sqrt(error / size));
            }
        }
        if (std::isfinite(best)) {  // a hold that is not soft has no softness to change
            EXPECT_LT(best, 1e-6) << i;
        }
    }
}

TEST(Reactions, AreWhatTheFreeNodesLoseOfTheirMomentum) {
    // Without ties and other forces the impulse of the hold is the change of the momentum, less that by weight.
    Settings settings;
    settings.active = test::only_active({});
    test::Bar b = test::make_bar({}, plain, settings);
    Geometry g = b.model->geometry();
    g.hold_centre = {0.11, -0.19, 0.03};
    const TotalLagrangian<double> model(g, settings);
    test::stir(b, 24);
    b.fields.node_force.clear();
    Schedule schedule = plain;
    schedule.reaction_weight = {0, 1.0 / 3, 0, 1.0 / 3, 0, 1.0 / 3, 0, 0.25, 0, 0.25, 0, 0.25, 0, 0.25};  // means of intervals
    const Trajectory<double> t = model.simulate(b.fields, schedule);
    const std::vector<double> mass = model.node_mass(b.fields);
    const std::size_t nodes = mass.size();
    for (std::size_t f = 0; f < 2; ++f) {
        const double span = schedule.steps[f] * schedule.dt[f];
        for (std::size_t c = 0; c < 3; ++c) {
            double change = 0, total = 0;
            for (std::size_t n = 0; n < nodes; ++n) {
                change += mass[n] * (t.velocity[(f + 1) * 3 * nodes + 3 * n + c] - t.velocity[f * 3 * nodes + 3 * n + c]);
                total += mass[n];
            }
            const double force = change / span - total * b.fields.gravity[c];
            EXPECT_NEAR(t.reaction[6 * (f + 1) + c], force, 1e-8 * std::abs(force)) << f << c;
        }
    }
}

TEST(Reactions, NeedTheCentresOfTheHolds) {
    Settings settings;
    settings.active = test::only_active({});
    const test::Bar b = test::make_bar({}, plain, settings);
    EXPECT_THROW(b.model->simulate(b.fields, asking(plain)), std::invalid_argument);
    Schedule short_one = asking(plain);
    short_one.reaction_weight.pop_back();
    EXPECT_THROW(b.model->simulate(b.fields, short_one), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
