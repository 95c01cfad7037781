// The stress-free shape of a hanging bar: it stays still, and its derivatives are right.
#include <gtest/gtest.h>

#include <cmath>

#include "bar_scene.hpp"
#include "mphygs/total_lagrangian/equilibrium.hpp"

namespace mphygs {
namespace {

using test::Bar;

struct Hanging {
    Bar bar;
    std::vector<double> load;
    explicit Hanging(const std::vector<int>& effects = {}, Law law = Law::neo_hookean, bool two_grids = false, test::BarOptions o = {}) {
        const Schedule schedule{{400, 400}, {2.5e-4, 2.5e-4}};
        o.two_grids = two_grids;
        o.held_along_top = true;
        o.young[0] = 3e4;
        o.young[1] = 1.5e4;
        Settings settings;
        settings.law = law;
        settings.active = test::only_active(effects);
        bar = test::make_bar(o, schedule, settings);
        bar.fields.gravity = {1.0, -0.5, -9.5};
        const std::vector<double> mass = bar.model->node_mass(bar.fields);
        for (const double m : mass) {
            for (const double g : bar.fields.gravity) {
                load.push_back(m * g);
            }
        }
    }
};

double largest(const std::vector<double>& x) {
    double m = 0;
    for (const double e : x) {
        m = std::max(m, std::abs(e));
    }
    return m;
}

/// How far any of the material gets [m]: combinations of nodes that its points do not see swing without meaning.
double farthest(const Bar& bar) {
    std::vector<std::int32_t> cell;
    for (std::size_t b = 0; b < bar.model->geometry().block_count(); ++b) {
        for (int q = 0; q < 8; ++q) {
            cell.insert(cell.end(), &bar.model->geometry().cell[3 * b], &bar.model->geometry().cell[3 * b] + 3);
        }
    }
    const PointWeights w = bar.model->weights(bar.model->geometry().points, cell);
    const std::vector<double> u = bar.model->simulate(bar.fields, bar.schedule).displacement;
    const std::size_t nodes = bar.model->node_count();
    double most = 0;
    for (std::size_t from = 0; from < u.size(); from += 3 * nodes) {
        for (std::size_t p = 0; p < cell.size() / 3; ++p) {
            for (std::size_t c = 0; c < 3; ++c) {
                double sum = 0;
                for (std::size_t a = 27 * p; a < 27 * (p + 1); ++a) {
                    sum += w.value[a] * u[from + 3 * static_cast<std::size_t>(w.node[a]) + c];
                }
                most = std::max(most, std::abs(sum));
            }
        }
    }
    return most;
}

TEST(Equilibrium, AHangingBarStaysStill) {
    for (const auto& [law, two_grids] :
         {std::pair(Law::neo_hookean, false), std::pair(Law::fixed_corotated, false), std::pair(Law::neo_hookean, true)}) {
        Hanging h({}, law, two_grids);
        Equilibrium equilibrium(h.bar.model);
        const Equilibrium::Solution s = equilibrium.solve(h.bar.fields, h.bar.volume, h.load, {}, 1e-12);
        EXPECT_GT(largest(s.map), 1e-4);  // it carries a weight that would move it
        EXPECT_LE(s.iterations, 12);
        h.bar.fields.deformation0 = s.deformation0;
        for (std::size_t i = 0; i < h.bar.volume.size(); ++i) {
            h.bar.fields.stress_volume[i] = h.bar.volume[i] * s.volume_ratio[i];
        }
        EXPECT_LT(farthest(h.bar), 1e-6);  // 0.2 s
        // And without it the bar swings: the test is not about a bar that cannot move.
        h.bar.fields.deformation0.clear();
        h.bar.fields.stress_volume = h.bar.volume;
        EXPECT_GT(farthest(h.bar), 1e-4);
    }
}

TEST(Equilibrium, UnloadedItIsTheShapeItself) {
    Hanging h;
    std::fill(h.load.begin(), h.load.end(), 0.0);
    Equilibrium equilibrium(h.bar.model);
    const Equilibrium::Solution s = equilibrium.solve(h.bar.fields, h.bar.volume, h.load, {});
    EXPECT_LT(largest(s.map), 1e-14);
    for (const double ratio : s.volume_ratio) {
        EXPECT_NEAR(ratio, 1.0, 1e-12);
    }
}

TEST(Equilibrium, SpringsOfNodesThatTouchNothingOnlyHold) {
    // As soft as the springs themselves and softer still, the shape moves the less under a weight that is as much lighter.
    Hanging h;
    Equilibrium equilibrium(h.bar.model);
    Fields<double> fields = h.bar.fields;
    std::vector<double> load = h.load;
    const auto yielding = [&] {
        const Equilibrium::Solution s = equilibrium.solve(fields, h.bar.volume, load, {});
        double sum = 0, weight = 0;
        for (std::size_t i = 0; i < load.size(); ++i) {
            sum -= load[i] * s.map[i];
            weight += std::abs(load[i]);
        }
        return sum / weight;  // [m]
    };
    const double first = yielding();
    double before = first;
    EXPECT_GT(first, 0.0);
    for (int n = 0; n < 40; ++n) {  // down to 1e-6 Pa
        for (std::vector<double>* numbers : {&fields.mu, &fields.lambda, &load}) {
            for (double& x : *numbers) {
                x *= 0.55;
            }
        }
        const double now = yielding();
        EXPECT_LE(now, before * (1 + 1e-9)) << "softer by " << std::pow(0.55, n + 1);
        EXPECT_GT(now, 0.0);
        before = now;
    }
    EXPECT_LT(before, 0.9 * first);  // the last ones stand on the springs
}

TEST(Equilibrium, StartsFromAnEarlierSolution) {
    Hanging h;
    Equilibrium equilibrium(h.bar.model);
    const Equilibrium::Solution s = equilibrium.solve(h.bar.fields, h.bar.volume, h.load, {});
    const Equilibrium::Solution again = equilibrium.solve(h.bar.fields, h.bar.volume, h.load, s.map);
    EXPECT_LT(again.iterations, s.iterations);
    for (std::size_t i = 0; i < s.map.size(); ++i) {
        EXPECT_NEAR(again.map[i], s.map[i], 1e-9);
    }
}

std::vector<int> indices(const std::vector<std::string>& names) {
    std::vector<int> found;
    for (int i = 0; i < Registry::count; ++i) {
        for (const std::string& name : names) {
            if (name == Registry::infos[i]->name) {
                found.push_back(i);
            }
        }
    }
    return found;
}

/// A hanging bar with the effects that store energy, and one direction in each of its inputs.
struct Differentiated : Hanging {
    std::vector<std::pair<std::string, Equilibrium::Direction>> directions;
    explicit Differentiated(bool two_grids) : Hanging(indices({"fibre", "stiffening"}), Law::neo_hookean, two_grids, test::smaller) {
        test::Random random(81);
        const Slots slots = make_slots(bar.model->settings().active);
        for (const int i : indices({"fibre", "stiffening"})) {
            bar.fields.effect[static_cast<std::size_t>(slots[static_cast<std::size_t>(i)].parameter)] = 3e3;
        }
        const auto add = [&](const std::string& name, auto&& set) {
            Equilibrium::Direction d;
            set(d);
            directions.emplace_back(name, d);
        };
        const std::size_t points = bar.volume.size();
        add("mu", [&](auto& d) { d.fields.mu = random.numbers(points, -1e3, 1e3); });
        add("lambda", [&](auto& d) { d.fields.lambda = random.numbers(points, -1e3, 1e3); });
        add("load", [&](auto& d) { d.load = random.numbers(load.size(), -1e-3, 1e-3); });
        for (const int i : indices({"fibre", "stiffening"})) {
            add(Registry::infos[i]->name, [&](auto& d) {
                d.fields.effect.assign(bar.fields.effect.size(), 0.0);
                d.fields.effect[static_cast<std::size_t>(slots[static_cast<std::size_t>(i)].parameter)] = 1e3;
            });
        }
    }
    Equilibrium::Solution solve(Equilibrium& equilibrium) const { return equilibrium.solve(bar.fields, bar.volume, load, {}, 1e-13); }
    Equilibrium::Solution moved(const Equilibrium::Direction& d, double step) const {
        Fields<double> f = bar.fields;
        std::vector<double> l = load;
        const auto add = [step](std::vector<double>& to, const std::vector<double>& by) {
            for (std::size_t i = 0; i < by.size(); ++i) {
                to[i] += step * by[i];
            }
        };
        add(f.mu, d.fields.mu);
        add(f.lambda, d.fields.lambda);
        add(f.effect, d.fields.effect);
        add(l, d.load);
        Equilibrium other(bar.model);
        return other.solve(f, bar.volume, l, {}, 1e-13);
    }
    std::vector<Equilibrium::Direction> list() const {
        std::vector<Equilibrium::Direction> all;
        for (const auto& d : directions) {
            all.push_back(d.second);
        }
        return all;
    }
};

class EquilibriumDerivatives : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Grids, EquilibriumDerivatives, testing::Bool(), [](const auto& info) { return info.param ? "two" : "one"; });

TEST_P(EquilibriumDerivatives, TangentAgreesWithCentralDifferences) {
    const Differentiated d(GetParam());
    Equilibrium equilibrium(d.bar.model);
    d.solve(equilibrium);
    const std::vector<Equilibrium::Solution> t = equilibrium.tangent(d.list());
    ASSERT_EQ(t.size(), d.directions.size());
    for (std::size_t k = 0; k < t.size(); ++k) {
        const double h = 1e-2;
        const auto a = d.moved(d.directions[k].second, -2 * h), b = d.moved(d.directions[k].second, -h);
        const auto c = d.moved(d.directions[k].second, h), e = d.moved(d.directions[k].second, 2 * h);
        for (const auto member : {&Equilibrium::Solution::map, &Equilibrium::Solution::deformation0, &Equilibrium::Solution::volume_ratio}) {
            double error = 0, size = 0;
            for (std::size_t i = 0; i < (t[k].*member).size(); ++i) {
                const double difference = (8 * ((c.*member)[i] - (b.*member)[i]) - ((e.*member)[i] - (a.*member)[i])) / (12 * h);
                error += std::pow((t[k].*member)[i] - difference, 2);
                size += difference * difference;
            }
            EXPECT_GT(size, 0.0) << d.directions[k].first;
            EXPECT_LT(std::sqrt(error), 1e-6 * std::sqrt(size)) << d.directions[k].first;
        }
    }
}

TEST_P(EquilibriumDerivatives, AdjointIsTheTransposeOfTheTangent) {
    const Differentiated d(GetParam());
    Equilibrium equilibrium(d.bar.model);
    const Equilibrium::Solution s = d.solve(equilibrium);
    const std::vector<Equilibrium::Solution> t = equilibrium.tangent(d.list());
    test::Random random(82);
    const std::vector<double> deformation_bar = random.numbers(s.deformation0.size(), -1, 1);
    const std::vector<double> ratio_bar = random.numbers(s.volume_ratio.size(), -1, 1);
    const Equilibrium::Direction g = equilibrium.adjoint(deformation_bar, ratio_bar);
    const auto dot = [](const std::vector<double>& a, const std::vector<double>& b) {
        double sum = 0;
        for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
            sum += a[i] * b[i];
        }
        return sum;
    };
    for (std::size_t k = 0; k < t.size(); ++k) {
        const Equilibrium::Direction& x = d.directions[k].second;
        const double by_tangent = dot(deformation_bar, t[k].deformation0) + dot(ratio_bar, t[k].volume_ratio);
        const double by_adjoint = dot(g.fields.mu, x.fields.mu) + dot(g.fields.lambda, x.fields.lambda) +
                                  dot(g.fields.effect, x.fields.effect) + dot(g.load, x.load);
        EXPECT_NEAR(by_adjoint, by_tangent, 1e-9 * std::abs(by_tangent)) << d.directions[k].first;
        EXPECT_NE(by_tangent, 0.0) << d.directions[k].first;
    }
}

TEST(Equilibrium, TwoHeldFacesThatMeetAreHeldTogether) {
    test::BarOptions o;
    o.young[0] = o.young[1] = 3e4;
    Geometry g = test::bar_geometry(o);
    test::hold_plane(g, o, 0, -0.5);  // the same face again: every row depends on another
    const Schedule schedule{{1}, {1e-4}};
    Fields<double> fields = test::fields_at_rest<double>(o, g, schedule);
    const std::vector<double> volume = test::bar_volumes(o, g);
    const auto twice = std::make_shared<TotalLagrangian<double>>(g, Settings{});
    const auto once = std::make_shared<TotalLagrangian<double>>(test::bar_geometry(o), Settings{});
    std::vector<double> load;
    for (const double m : once->node_mass(fields)) {
        load.insert(load.end(), {m * 1.0, 0.0, m * -9.5});
    }
    Equilibrium a(twice), b(once);
    const Equilibrium::Solution x = a.solve(fields, volume, load, {}), y = b.solve(fields, volume, load, {});
    for (std::size_t i = 0; i < x.map.size(); ++i) {
        EXPECT_NEAR(x.map[i], y.map[i], 1e-9);
    }
}

TEST(Equilibrium, WhereSofterSpringsFailTheStiffersAnswerStands) {
    // As soft as the springs themselves, under as much load as it just carries with the stiffest of them.
    Hanging h({}, Law::neo_hookean, true);
    for (std::vector<double>* numbers : {&h.bar.fields.mu, &h.bar.fields.lambda, &h.load}) {
        for (double& x : *numbers) {
            x *= 1e-7;
        }
    }
    const auto under = [&](Equilibrium& equilibrium, double factor) {
        std::vector<double> load = h.load;
        for (double& x : load) {
            x *= factor;
        }
        return equilibrium.solve(h.bar.fields, h.bar.volume, load, {}, 1e-12);
    };
    Equilibrium light(h.bar.model), heavy(h.bar.model), more(h.bar.model), less(h.bar.model);
    const double softest = under(light, 1).springs, step = 1e-3;
    const Equilibrium::Solution s = under(heavy, 90), a = under(less, 90 - step), b = under(more, 90 + step);
    EXPECT_EQ(softest, 1e-5);
    for (const Equilibrium::Solution* x : {&s, &a, &b}) {
        ASSERT_EQ(x->springs, 0.05);
    }
    // Its derivatives are those of what it found.
    Equilibrium::Direction d;
    d.load = h.load;
    const Equilibrium::Solution t = heavy.tangent({d}).front();
    double error = 0, size = 0;
    for (std::size_t i = 0; i < t.deformation0.size(); ++i) {
        const double difference = (b.deformation0[i] - a.deformation0[i]) / (2 * step);
        error += std::pow(t.deformation0[i] - difference, 2);
        size += difference * difference;
    }
    EXPECT_GT(size, 0.0);
    EXPECT_LT(std::sqrt(error), 1e-4 * std::sqrt(size));
}

TEST(Equilibrium, AnObjectThatNothingHoldsIsRefused) {
    test::BarOptions o;
    o.held = false;
    const Bar bar = test::make_bar(o, {{1}, {1e-4}});
    EXPECT_THROW(Equilibrium{bar.model}, std::invalid_argument);
}

TEST(Equilibrium, AnObjectTooSoftForItsWeightSaysSo) {
    Hanging h;
    for (double& f : h.load) {
        f *= 300;
    }
    Equilibrium equilibrium(h.bar.model);
    EXPECT_THROW(equilibrium.solve(h.bar.fields, h.bar.volume, h.load, {}), SimulationError);
    EXPECT_THROW(equilibrium.solve(h.bar.fields, {}, h.load, {}), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
