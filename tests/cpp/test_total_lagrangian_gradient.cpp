// Rollouts of the total-Lagrangian transfer with each effect in turn: the adjoint is the transpose
// of the tangent, the tangent follows central differences, for every field there is.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <ostream>
#include <string>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using F = Fields<double>;
const Schedule schedule{{3, 4}, {1e-4, 8e-5}, 0.01};

struct Case {
    std::string name;
    std::vector<int> effects;
    Law law = Law::neo_hookean;
    bool prestressed = true;
    bool two_grids = false;
    bool springs = false;
};

void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

std::vector<Case> cases() {
    std::vector<Case> all;
    all.push_back({"none", {}});
    all.push_back({"none_fixed_corotated", {}, Law::fixed_corotated});
    all.push_back({"none_stress_free", {}, Law::neo_hookean, false});
    std::vector<int> every;
    for (int i = 0; i < Registry::count; ++i) {
        all.push_back({Registry::infos[i]->name, {i}});
        every.push_back(i);
    }
    all.push_back({"every_effect_together", every});
    all.push_back({"every_effect_stress_free", every, Law::fixed_corotated, false});
    all.push_back({"none_on_two_grids", {}, Law::neo_hookean, true, true});
    all.push_back({"none_with_springs", {}, Law::neo_hookean, true, false, true});
    all.push_back({"every_effect_with_springs", every, Law::fixed_corotated, false, true, true});
    all.push_back({"every_effect_on_two_grids", every, Law::neo_hookean, true, true});
    return all;
}

class Gradient : public testing::TestWithParam<Case> {
  protected:
    test::Bar bar() const {
        Settings settings;
        settings.law = GetParam().law;
        settings.active = test::only_active(GetParam().effects);
        test::BarOptions options = test::smaller;
        options.two_grids = GetParam().two_grids;
        options.springs = GetParam().springs;
        test::Bar b = test::make_bar(options, schedule, settings);
        test::stir(b, 21);
        if (!GetParam().prestressed) {
            b.fields.deformation0.clear();
        }
        return b;
    }
    bool active(int effect) const {
        for (const int i : GetParam().effects) {
            if (i == effect) {
                return true;
            }
        }
        return false;
    }
};
INSTANTIATE_TEST_SUITE_P(Effects, Gradient, testing::ValuesIn(cases()), [](const auto& info) { return info.param.name; });

struct NamedDirection {
    std::string name;
    F fields;
    bool expected = true;  // the trajectory must depend on it
};

/// A random direction of usual size in every field, and one for every parameter of an active effect.
std::vector<NamedDirection> directions(const test::Bar& bar) {
    std::vector<NamedDirection> all;
    test::Random random(22);
    F value = bar.fields;
    const double sizes[F::count] = {3e4, 3e4, 1e-8, 1e-5, 1e-2, 0, 1e-4, 0, 1.0, 1e-4, 0.1, 1e-3, 1e-5};
    for (std::size_t i = 0; i < F::count; ++i) {
        const std::string name = F::names[i];
        if (value.all()[i]->empty() || name == "effect" || name == "place_effect") {
            continue;
        }
        NamedDirection d{name, {}};
        *d.fields.all()[i] = random.numbers(value.all()[i]->size(), -sizes[i], sizes[i]);
        all.push_back(std::move(d));
    }
    const std::vector<bool>& active = bar.model->settings().active;
    std::size_t k = 0, at_place = 0;
    Registry::each([&](auto tag, int i) {
        using E = typename decltype(tag)::type;
        for (int p = 0; p < E::info.parameter_count(); ++p, ++k) {
            const bool point = E::info.site == Site::point;
            at_place += point;
            if (!active[static_cast<std::size_t>(i)] || E::info.site == Site::mass) {
                continue;
            }
            const double size = std::min(E::info.parameters[p].scale, std::abs(bar.fields.effect[k]) + 1e-3 * E::info.parameters[p].scale);
            NamedDirection d{std::string(E::info.name) + "." + E::info.parameters[p].name, {}};
            if (point) {
                d.fields.place_effect.assign(bar.fields.place_effect.size(), 0.0);
                const std::size_t stride = bar.fields.place_effect.size() / bar.model->geometry().place_count();
                d.fields.place_effect[stride + at_place - 1] = size;  // of the second place
            } else {
                d.fields.effect.assign(bar.fields.effect.size(), 0.0);
                d.fields.effect[k] = size;
            }
            all.push_back(std::move(d));
        }
    });
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

std::vector<Trajectory<double>> tangents(const test::Bar& bar, const std::vector<NamedDirection>& all) {
    std::vector<F> fields;
    for (const NamedDirection& d : all) {
        fields.push_back(d.fields);
    }
    return bar.model->tangent(bar.fields, fields, bar.schedule);
}

TEST_P(Gradient, AdjointIsTheTransposeOfTheTangent) {
    const test::Bar b = bar();
    const std::vector<NamedDirection> all = directions(b);
    const std::vector<Trajectory<double>> t = tangents(b, all);
    ASSERT_EQ(t.size(), all.size() + 1);
    test::Random random(23);
    Trajectory<double> seed;
    seed.displacement = random.numbers(t[0].displacement.size(), -1e3, 1e3);
    seed.velocity = random.numbers(t[0].velocity.size(), -1, 1);
    F gradient = b.model->adjoint(b.fields, b.schedule, seed);
    for (std::size_t i = 0; i < all.size(); ++i) {
        F direction = all[i].fields;
        const double by_tangent = dot(seed.displacement, t[i + 1].displacement) + dot(seed.velocity, t[i + 1].velocity);
        double by_adjoint = 0;
        for (std::size_t k = 0; k < F::count; ++k) {
            if (!direction.all()[k]->empty()) {
                ASSERT_EQ(gradient.all()[k]->size(), direction.all()[k]->size()) << all[i].name;
            }
            by_adjoint += dot(*gradient.all()[k], *direction.all()[k]);
        }
        EXPECT_NEAR(by_adjoint, by_tangent, 1e-10 * std::abs(by_tangent)) << all[i].name;
        EXPECT_NE(by_tangent, 0.0) << all[i].name;
    }
}

TEST_P(Gradient, TangentAgreesWithCentralDifferences) {
    const test::Bar b = bar();
    const std::vector<NamedDirection> all = directions(b);
    const std::vector<Trajectory<double>> t = tangents(b, all);
    for (std::size_t i = 0; i < all.size(); ++i) {
        const auto at = [&](double step) { return b.model->simulate(moved(b.fields, all[i].fields, step), b.schedule); };
        // Displacement and velocity, each as a whole. A wide difference may straddle a kink (contact,
        // yield) and a narrow one drowns in round-off: one of three has to do.
        double best[2] = {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
        for (const double h : {1e-4, 3e-3, 3e-6}) {
            if (std::max(best[0], best[1]) < 1e-6) {
                break;
            }
            const Trajectory<double> p = at(-2 * h), q = at(-h), r = at(h), s = at(2 * h);
            for (const int kind : {0, 1}) {
                const auto member = kind == 0 ? &Trajectory<double>::displacement : &Trajectory<double>::velocity;
                const std::vector<double>& slopes = t[i + 1].*member;
                double error = 0, size = 0;
                for (std::size_t n = 0; n < slopes.size(); ++n) {
                    const double difference = (8 * ((r.*member)[n] - (q.*member)[n]) - ((s.*member)[n] - (p.*member)[n])) / (12 * h);
                    error += (slopes[n] - difference) * (slopes[n] - difference);
                    size += difference * difference;
                }
                EXPECT_GT(size, 0.0) << all[i].name;
                best[kind] = std::min(best[kind], std::sqrt(error / size));
            }
        }
        EXPECT_LT(best[0], 1e-6) << all[i].name << ", displacement";
        EXPECT_LT(best[1], 1e-6) << all[i].name << ", velocity";
    }
}

TEST_P(Gradient, AnActiveEffectChangesTheMotion) {
    if (GetParam().effects.empty()) {
        GTEST_SKIP() << "no effect is active";
    }
    const test::Bar b = bar();
    Settings plain = b.model->settings();
    plain.active = test::only_active({});
    const TotalLagrangian<double> without(b.model->geometry(), plain);
    const Trajectory<double> x = b.model->simulate(b.fields, b.schedule), y = without.simulate(b.fields, b.schedule);
    double change = 0;
    for (std::size_t i = 0; i < x.velocity.size(); ++i) {
        change = std::max(change, std::abs(x.velocity[i] - y.velocity[i]));
    }
    EXPECT_GT(change, 1e-9);
}

TEST_P(Gradient, AnEffectAtItsNullLeavesTheMotion) {
    test::Bar b = bar();
    Settings plain = b.model->settings();
    plain.active = test::only_active({});
    const TotalLagrangian<double> without(b.model->geometry(), plain);
    b.fields.effect = test::fields_at_rest<double>({}, b.model->geometry(), b.schedule).effect;
    std::fill(b.fields.place_mass.begin(), b.fields.place_mass.end(), 0.0);
    std::vector<double> null_at_place;
    Registry::each([&](auto tag, int) {
        using E = typename decltype(tag)::type;
        for (int p = 0; p < E::info.parameter_count() && E::info.site == Site::point; ++p) {
            null_at_place.push_back(E::info.parameters[p].null);
        }
    });
    for (std::size_t i = 0; i < b.fields.place_effect.size(); ++i) {
        b.fields.place_effect[i] = null_at_place[i % null_at_place.size()];
    }
    const Trajectory<double> x = b.model->simulate(b.fields, b.schedule), y = without.simulate(b.fields, b.schedule);
    for (std::size_t i = 0; i < x.velocity.size(); ++i) {
        EXPECT_NEAR(x.velocity[i], y.velocity[i], 1e-12);
    }
}

TEST(Gradients, NodesThatCarryNoMassStayAndHaveNoGradient) {
    Settings settings;
    settings.active = test::only_active({});
    test::Bar b = test::make_bar({}, schedule, settings);
    test::stir(b, 24);
    b.fields.deformation0.clear();
    const Geometry& g = b.model->geometry();
    for (std::size_t k = 0; k < g.block_count(); ++k) {
        if (g.cell[3 * k] == 0 && g.cell[3 * k + 1] == 0 && g.cell[3 * k + 2] >= 3) {  // an empty edge
            std::fill_n(&b.fields.mass[8 * k], 8, 0.0);
            std::fill_n(&b.fields.stress_volume[8 * k], 8, 0.0);
        }
    }
    const std::vector<double> mass = b.model->node_mass(b.fields);
    const long empty = std::count(mass.begin(), mass.end(), 0.0);
    ASSERT_GT(empty, 0);
    test::Random random(25);
    NamedDirection d{"velocity0, gravity", {}};
    d.fields.velocity0 = random.numbers(b.fields.velocity0.size(), -1, 1);
    d.fields.gravity = {1, 2, 3};
    const std::vector<Trajectory<double>> t = tangents(b, {d});
    Trajectory<double> seed{random.numbers(t[0].displacement.size(), -1e3, 1e3), random.numbers(t[0].velocity.size(), -1, 1)};
    const F gradient = b.model->adjoint(b.fields, schedule, seed);
    const double by_tangent = dot(seed.displacement, t[1].displacement) + dot(seed.velocity, t[1].velocity);
    const double by_adjoint = dot(gradient.velocity0, d.fields.velocity0) + dot(gradient.gravity, d.fields.gravity);
    EXPECT_NEAR(by_adjoint, by_tangent, 1e-10 * std::abs(by_tangent));
}

}  // namespace
}  // namespace mphygs
