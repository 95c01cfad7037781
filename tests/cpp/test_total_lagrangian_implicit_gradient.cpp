// Derivatives of implicit steps: the adjoint is the transpose of the tangent, the tangent follows central differences, with
// every effect, loads that follow the object, an observer, the reactions of the holds and the caller's own effects.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>

#include "actuation_scene.hpp"
#include "bar_scene.hpp"
#include "mphygs/numerics/team.hpp"
#include "mphygs/total_lagrangian/midpoint_state.hpp"

namespace mphygs {
namespace {

template <class T>
using F = Fields<T>;

const Schedule schedule = [] {
    Schedule s{{2, 3}, {4e-4, 3e-4}, 0.01};
    s.implicit = true;
    return s;
}();

struct Case {
    std::string name;
    std::vector<int> effects;
    Law law = Law::neo_hookean;
    bool prestressed = true, two_grids = false, springs = false, loads = false, observed = false, reacting = false, hooked = false;
    bool curved = false, paired = false;
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
    all.push_back({"every_effect_on_two_grids", every, Law::neo_hookean, true, true});
    all.push_back({"every_effect_with_springs", every, Law::fixed_corotated, false, true, true});
    all.push_back({"loads", {}, Law::neo_hookean, true, false, false, true});
    all.push_back({"observed", {}, Law::neo_hookean, true, false, false, false, true});
    all.push_back({"reacting", {}, Law::neo_hookean, true, false, false, false, false, true});
    all.push_back({"hooked", {}, Law::neo_hookean, true, false, false, false, false, false, true});
    all.push_back({.name = "none_curved", .effects = {}, .curved = true});
    all.push_back({.name = "none_in_pairs", .effects = {}, .paired = true});
    all.push_back({.name = "reacting_in_pairs", .effects = {}, .reacting = true, .paired = true});
    all.push_back({.name = "everything_curved_in_pairs", .effects = every, .springs = true, .loads = true, .observed = true, .reacting = true,
                   .hooked = true, .curved = true, .paired = true});
    all.push_back({"everything", every, Law::neo_hookean, true, true, true, true, true, true, true});
    return all;
}

/// A spring to where each point was, and a stress along its deformation; the derivative by their strength adds up here, as
/// it does with a caller.
struct OwnForces {
    double strength = 40, strength_bar = 0, strength_slope = 0;
    std::vector<double> rest;
    PointHook<double> hook;

    OwnForces() = default;
    OwnForces(const OwnForces&) = delete;

    void prepare(const Geometry& g) {
        rest = g.points;
        hook.forward = [this](const PointState<double>& s) {
            PointForces<double> out;
            const std::size_t points = rest.size() / 3;
            out.force.resize(s.position.size());
            out.stress.resize(s.deformation.size());
            for (int l = 0; l < s.lanes; ++l) {
                for (std::size_t i = 0; i < 3 * points; ++i) {
                    const std::size_t at = static_cast<std::size_t>(l) * 3 * points + i;
                    out.force[at] = -strength * (s.position[at] - (l == 0 ? rest[i] : 0.0)) - 0.01 * strength * s.velocity[at];
                    if (l > 0) {
                        out.force[at] += strength_slope * (-(s.position[i] - rest[i]) - 0.01 * s.velocity[i]);
                    }
                }
                for (std::size_t i = 0; i < 9 * points; ++i) {
                    const double x = s.deformation[i];
                    out.stress[static_cast<std::size_t>(l) * 9 * points + i] =
                        l == 0 ? 500 * x * x : 1000 * x * s.deformation[static_cast<std::size_t>(l) * 9 * points + i];
                }
            }
            return out;
        };
        hook.reverse = [this](const PointState<double>& s, const PointForces<double>& bar) {
            PointState<double> out;
            for (std::size_t i = 0; i < rest.size(); ++i) {
                out.position.push_back(-strength * bar.force[i]);
                out.velocity.push_back(-0.01 * strength * bar.force[i]);
                strength_bar += bar.force[i] * (-(s.position[i] - rest[i]) - 0.01 * s.velocity[i]);
            }
            for (std::size_t i = 0; i < bar.stress.size(); ++i) {
                out.deformation.push_back(1000 * s.deformation[i] * bar.stress[i]);
            }
            return out;
        };
    }
};

struct Scene {
    test::Bar bar;
    Observer observer;
    OwnForces own;
    bool observed = false, hooked = false;
    const Observer* seen() const { return observed ? &observer : nullptr; }
    const PointHook<double>* hook() const { return hooked ? &own.hook : nullptr; }
    Trajectory<double> run(const F<double>& fields) const { return bar.model->simulate(fields, bar.schedule, {}, hook(), seen()); }
};

/// Every node somewhere else, and the points where their splines put them.
void bend(Geometry& g, const TotalLagrangian<double>& straight) {
    std::map<std::array<std::int32_t, 3>, Eigen::Vector3d> place;
    const std::vector<std::int32_t>& index = straight.node_index();
    for (std::size_t n = 0; n < straight.node_count(); ++n) {
        const double* x = &straight.node_positions()[3 * n];
        const double y = x[1] + 0.2, z = x[2] - 0.05;
        const Eigen::Vector3d bent(x[0] + 6 * z * z, x[1] + 4 * y * z, x[2] - 5 * y * y);
        place[{index[3 * n], index[3 * n + 1], index[3 * n + 2]}] = bent;
        g.curved_node.insert(g.curved_node.end(), &index[3 * n], &index[3 * n] + 3);
        g.curved_position.insert(g.curved_position.end(), bent.data(), bent.data() + 3);
    }
    const auto carry = [&](std::vector<double>& points, const std::vector<std::int32_t>& cells, std::size_t each) {
        for (std::size_t p = 0; p < points.size() / 3; ++p) {
            const std::int32_t* cell = &cells[3 * (p / each)];
            CurvedCell curved;
            for (int a = 0; a < 27; ++a) {
                Eigen::Map<Eigen::Vector3d>{curved.node[a]} = place.at({cell[0] + a / 9 - 1, cell[1] + (a / 3) % 3 - 1, cell[2] + a % 3 - 1});
            }
            double s[3];
            for (std::size_t i = 0; i < 3; ++i) {
                s[i] = (points[3 * p + i] - g.origin[i]) / g.spacing[i] - cell[i];
            }
            double x[3], jacobian[3][3];
            curved.at(s, x, jacobian);
            std::copy_n(x, 3, &points[3 * p]);
        }
    };
    carry(g.points, g.cell, 8);
    carry(g.surface_points, g.surface_cell, 8);
    carry(g.places, g.place_cell, 1);
}

void make(const Case& c, Scene& s) {
    Schedule own = schedule;
    own.steps = {1, 2};  // one step after another, and one frame
    if (c.paired) {
        own.steps = {2, 4};
        own.paired = true;
    }
    Settings settings;
    settings.law = c.law;
    settings.active = test::only_active(c.effects);
    test::BarOptions options = test::smaller;
    options.two_grids = c.two_grids;
    options.springs = c.springs;
    s.bar = test::make_bar(options, own, settings);
    test::stir(s.bar, 21);
    if (!c.prestressed) {
        s.bar.fields.deformation0.clear();
    }
    const int nodes = static_cast<int>(s.bar.model->node_count());
    Geometry g = s.bar.model->geometry();
    if (c.curved) {
        bend(g, *s.bar.model);
    }
    if (c.loads) {
        g.actuation = test::loads(nodes, true);
        s.bar.fields.channel = test::courses<double>(2);
    }
    if (c.reacting) {
        g.hold_centre = {0.1, -0.2, 0.05};
        test::Random random(6);
        s.bar.schedule.reaction_weight = random.numbers(2 * static_cast<std::size_t>(own.total_steps()), 0.1, 0.5);
    }
    s.bar.model = std::make_shared<TotalLagrangian<double>>(std::move(g), settings);
    s.observed = c.observed;
    if (c.observed) {
        test::Random random(5);
        Observer& o = s.observer;
        o.row_begin = o.reach_begin = {0};
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 4; ++k) {
                o.row_carrier.push_back((i * 11 + 5 * k) % nodes);
                o.row_weight.push_back(random.between(0.1, 0.4));
            }
            o.row_begin.push_back(static_cast<std::int32_t>(o.row_carrier.size()));
        }
        for (int n = 0; n < nodes; ++n) {
            for (int i = n % 2; i < 3; ++i) {
                o.reach_channel.push_back(i);
                o.reach_weight.push_back(random.between(0.1, 0.5));
            }
            o.reach_begin.push_back(static_cast<std::int32_t>(o.reach_channel.size()));
        }
        o.stiffness = 1e5;
        o.damping = 300;
        o.share.assign(6, 1.0);
        o.share[4] = 0.0;
        s.bar.fields.target = random.numbers(72, -2e-3, 2e-3);
    }
    s.hooked = c.hooked;
    s.own.prepare(s.bar.model->geometry());
}

/// Random changes of usual size of every field that the scene has.
F<double> direction_of(const F<double>& value, unsigned seed) {
    test::Random random(seed);
    F<double> from = value, d;
    const double sizes[F<double>::count] = {3e4, 3e4, 1e-8, 1e-5, 1e-2, 0, 1e-4, 0, 1.0, 1e-4, 0.1, 1e-3, 1e-5, 1e-3, 1e-2};
    for (std::size_t i = 0; i < F<double>::count; ++i) {
        const std::string name = F<double>::names[i];
        const std::vector<double>& x = *from.all()[i];
        *d.all()[i] = random.numbers(x.size(), -sizes[i], sizes[i]);
        for (std::size_t k = 0; k < x.size() && (name == "effect" || name == "place_effect" || name == "channel"); ++k) {
            (*d.all()[i])[k] = random.between(-0.05, 0.05) * x[k];
        }
    }
    return d;
}

F<double> moved(const F<double>& value, const F<double>& direction, double step) {
    F<double> result = value, d = direction;
    for (std::size_t i = 0; i < F<double>::count; ++i) {
        for (std::size_t n = 0; n < d.all()[i]->size(); ++n) {
            (*result.all()[i])[n] += step * (*d.all()[i])[n];
        }
    }
    return result;
}

template <class A, class B>
double dot(const std::vector<A>& a, const std::vector<B>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
        sum += static_cast<double>(a[i]) * static_cast<double>(b[i]);
    }
    return sum;
}

class ImplicitGradient : public testing::TestWithParam<Case> {};
INSTANTIATE_TEST_SUITE_P(Effects, ImplicitGradient, testing::ValuesIn(cases()), [](const auto& info) { return info.param.name; });

TEST_P(ImplicitGradient, AdjointIsTheTransposeOfTheTangent) {
    Scene s;
    make(GetParam(), s);
    std::vector<F<double>> directions;
    for (unsigned k = 0; k < 5; ++k) {
        directions.push_back(direction_of(s.bar.fields, 30 + k));
    }
    s.own.strength_slope = s.hooked ? 3.0 : 0.0;
    const auto t = s.bar.model->tangent(s.bar.fields, directions, s.bar.schedule, {}, s.hook(), {}, s.seen());
    test::Random random(23);
    Trajectory<double> seed;
    seed.displacement = random.numbers(t[0].displacement.size(), -1e3, 1e3);
    seed.velocity = random.numbers(t[0].velocity.size(), -1, 1);
    if (!s.bar.schedule.reaction_weight.empty()) {
        seed.reaction = random.numbers(t[0].reaction.size(), -1, 1);
    }
    F<double> gradient = s.bar.model->adjoint(s.bar.fields, s.bar.schedule, seed, {}, nullptr, s.hook(), s.seen());
    for (std::size_t k = 0; k < directions.size(); ++k) {
        const Trajectory<double>& slope = t[k + 1];
        const double by_tangent =
            dot(seed.displacement, slope.displacement) + dot(seed.velocity, slope.velocity) + dot(seed.reaction, slope.reaction);
        double by_adjoint = s.own.strength_slope * s.own.strength_bar, whole = 0;
        for (std::size_t i = 0; i < F<double>::count; ++i) {
            const double part = dot(*gradient.all()[i], *directions[k].all()[i]);
            by_adjoint += part;
            whole += std::abs(part);
        }
        EXPECT_NEAR(by_adjoint, by_tangent, 1e-9 * whole) << k;
        EXPECT_GT(whole, 0.0);
    }
}

TEST_P(ImplicitGradient, TangentAgreesWithCentralDifferences) {
    Scene s;
    make(GetParam(), s);
    const F<double> direction = direction_of(s.bar.fields, 31);
    s.own.strength_slope = s.hooked ? 3.0 : 0.0;
    const auto t = s.bar.model->tangent(s.bar.fields, {direction}, s.bar.schedule, {}, s.hook(), {}, s.seen());
    const Trajectory<double> value = s.run(s.bar.fields);
    const double strength = s.own.strength;
    double best[3] = {1, 1, 1};
    for (const double h : {3e-4, 3e-3, 3e-5}) {  // one of them has to do
        if (*std::max_element(best, best + 3) < 1e-6) {
            break;
        }
        const auto at = [&](double step) {
            s.own.strength = strength + step * s.own.strength_slope;
            return s.run(moved(s.bar.fields, direction, step));
        };
        const Trajectory<double> p = at(-2 * h), q = at(-h), r = at(h), u = at(2 * h);
        const auto compare = [&](auto member, double& error) {
            double wrong = 0, size = 0;
            for (std::size_t n = 0; n < (t[1].*member).size(); ++n) {
                const double difference = (8 * ((r.*member)[n] - (q.*member)[n]) - ((u.*member)[n] - (p.*member)[n])) / (12 * h);
                wrong += std::pow((t[1].*member)[n] - difference, 2);
                size += difference * difference;
            }
            error = std::min(error, size > 0 ? std::sqrt(wrong / size) : 0.0);
        };
        compare(&Trajectory<double>::displacement, best[0]);
        compare(&Trajectory<double>::velocity, best[1]);
        compare(&Trajectory<double>::reaction, best[2]);
    }
    EXPECT_LT(best[0], 1e-6) << "displacement";
    EXPECT_LT(best[1], 1e-6) << "velocity";
    EXPECT_LT(best[2], 1e-6) << "reaction";
    double away = 0;
    for (std::size_t i = 0; i < value.displacement.size(); ++i) {
        away = std::max(away, std::abs(value.displacement[i] - t[0].displacement[i]));
    }
    EXPECT_LT(away, 1e-12);  // the run itself, beside its directions
}

TEST_P(ImplicitGradient, MatrixIsTheDerivativeOfAStepsVelocity) {
    Scene s;
    make(GetParam(), s);
    Geometry g = s.bar.model->geometry();
    g.row_begin = {0};  // nothing is held: what forces do to velocities is seen as it is
    g.row_node.clear();
    g.row_weight.clear();
    g.row_target.clear();
    g.row_hold.clear();
    g.hold_count = 0;
    g.hold_centre.clear();
    g.actuation = {};
    const TotalLagrangian<double> model(g, s.bar.model->settings());
    F<double> fields = s.bar.fields;
    fields.pose.clear();
    fields.channel.clear();
    fields.target.clear();
    fields.node_force.clear();
    const std::size_t size = 3 * model.node_count(), padded = model.padded_nodes();
    test::Random random(41);
    fields.displacement0 = random.numbers(size, -1e-4, 1e-4);
    fields.velocity0 = random.numbers(size, -0.1, 0.1);
    const double span = 2e-4, time = 0.01;
    const Schedule one{{1}, {span}, time};
    F<double> direction;
    direction.velocity0 = random.numbers(size, -1, 1);
    for (const double v : direction.velocity0) {
        direction.displacement0.push_back(span * v);
    }
    // An explicit step makes of v + e at u + span e what the matrix is of: e + B e.
    const auto t = model.tangent(fields, {direction}, one);
    Eigen::VectorXd e(static_cast<Eigen::Index>(size)), left(e.size());
    for (Eigen::Index i = 0; i < e.size(); ++i) {
        e[i] = direction.velocity0[static_cast<std::size_t>(i)];
        left[i] = 2 * e[i] - t[1].velocity[size + static_cast<std::size_t>(i)];
    }
    // Beside the forces of an explicit step nodes of an implicit one push each other by what they share of their mass.
    const std::vector<double> mass = model.node_mass(fields);
    const SharedMass<double> shared = model.shared_mass(fields);
    EXPECT_EQ(shared.nonZeros() > 0, !g.curved_node.empty());
    push_each_other<double>(
        shared, [&](std::size_t n, std::size_t c) { return direction.velocity0[3 * n + c]; },
        [&](std::size_t n, std::size_t c, double force) {
            if (mass[n] > 0.0) {
                left[static_cast<Eigen::Index>(3 * n + c)] -= force / mass[n];
            }
        });
    Team alone;
    MidpointMatrix matrix(g, model.constraint_node(), model.coupled_nodes(), mass, shared);
    std::vector<double> u(3 * padded), v(3 * padded);
    for (std::size_t i = 0; i < size; ++i) {
        u[i % 3 * padded + i / 3] = fields.displacement0[i];
        v[i % 3 * padded + i / 3] = fields.velocity0[i];
    }
    model.midpoint_assembly(fields, one, alone)->assemble(u, v, {}, time, span, span, matrix);
    ASSERT_TRUE(matrix.factorise());
    EXPECT_LT((matrix.solve(left) - e).norm(), 1e-9 * e.norm());
    EXPECT_GT((left - e).norm(), 1e-3 * e.norm());  // forces are seen
}

TEST(MidpointMatrix, OfABodyThatHasTurnedSinceIsThatMadeThere) {
    const Mat3<double> none = Mat3<double>::identity();
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, -2, 3).normalized()).toRotationMatrix();
    Mat3<double> turned;
    for (int i = 0; i < 9; ++i) {
        turned[i / 3][i % 3] = turn(i / 3, i % 3);
    }
    test::BarOptions options = test::smaller;
    options.two_grids = true;  // joined, and held below
    Settings settings;
    settings.active = test::only_active({});
    test::Bar bar = test::make_bar(options, schedule, settings);
    const std::size_t nodes = bar.model->node_count(), padded = bar.model->padded_nodes();
    std::vector<double> still(3 * padded), away(3 * padded);
    for (std::size_t n = 0; n < nodes; ++n) {
        const Eigen::Vector3d x = Eigen::Map<const Eigen::Vector3d>(&bar.model->node_positions()[3 * n]), u = turn * x - x;
        for (std::size_t c = 0; c < 3; ++c) {
            away[c * padded + n] = u[static_cast<Eigen::Index>(c)];
        }
    }
    const std::vector<double> mass = bar.model->node_mass(bar.fields);
    const auto assembly = [&](const std::vector<double>& place) {
        Team alone;
        MidpointMatrix matrix(bar.model->geometry(), bar.model->constraint_node(), bar.model->coupled_nodes(), mass,
                              bar.model->shared_mass(bar.fields));
        const double span = 5e-3;
        bar.model->midpoint_assembly(bar.fields, schedule, alone)->assemble(place, still, {}, 0.0, span, span, matrix);
        EXPECT_TRUE(matrix.factorise());
        return matrix;
    };
    const MidpointMatrix there = assembly(away);
    MidpointMatrix before = assembly(still);
    test::Random random(5);
    const std::vector<double> numbers = random.numbers(3 * nodes, -1, 1);
    const Eigen::VectorXd b = Eigen::Map<const Eigen::VectorXd>(numbers.data(), static_cast<Eigen::Index>(numbers.size()));
    const Eigen::MatrixXd x = there.solve(b), y = there.solve_transposed(b);
    EXPECT_GT((before.solve(b) - x).norm(), 0.1 * x.norm());
    before.made_at(NodeTurns(nodes, none));
    before.used_at(NodeTurns(nodes, turned));
    // Rows of holds and joints give way by 1e-9 of what nodes do.
    EXPECT_LT((before.solve(b) - x).norm(), 1e-8 * x.norm());
    EXPECT_LT((before.solve_transposed(b) - y).norm(), 1e-8 * y.norm());
    // However unlike the nodes' turns are, the transpose is that of the solution.
    NodeTurns unlike(nodes, none);
    for (std::size_t n = 0; n < nodes; n += 3) {
        unlike[n] = turned;
    }
    before.used_at(unlike);
    EXPECT_NEAR(b.dot(before.solve(x).col(0)), before.solve_transposed(b).dot(x.col(0)), 1e-9 * b.norm() * x.norm());
}

TEST(ImplicitGradients, OfAStiffBarInLongStepsAreThoseOfDifferences) {
    test::BarOptions o;
    o.young[0] = o.young[1] = 1e9;
    Schedule long_steps{{4, 4, 4}, {1.0 / 240, 1.0 / 240, 1.0 / 240}};
    long_steps.implicit = true;
    test::Bar bar = test::make_bar(o, long_steps);
    bar.fields.gravity = {3.0, 1.0, -9.81};
    F<double> direction;
    direction.mu.assign(bar.fields.mu.size(), 1e7);
    direction.gravity = {1, 2, 3};
    const auto t = bar.model->tangent(bar.fields, {direction}, long_steps);
    const double h = 1e-2;
    const auto p = bar.model->simulate(moved(bar.fields, direction, h), long_steps), q = bar.model->simulate(moved(bar.fields, direction, -h), long_steps);
    double wrong = 0, size = 0;
    for (std::size_t i = 0; i < p.displacement.size(); ++i) {
        const double difference = (p.displacement[i] - q.displacement[i]) / (2 * h);
        wrong += std::pow(difference - t[1].displacement[i], 2);
        size += difference * difference;
    }
    EXPECT_LT(std::sqrt(wrong / size), 1e-5);
}

TEST(ImplicitGradients, InFloatFollowThoseInDouble) {
    Settings settings;
    settings.active = test::only_active({});
    test::Bar b = test::make_bar({}, schedule, settings);
    const TotalLagrangian<float> narrow(b.model->geometry(), settings);
    F<float> f = test::fields_at_rest<float>({}, b.model->geometry(), schedule);
    b.fields.gravity = {0, 2, -9};
    f.gravity = {0, 2, -9};
    test::Random random(1);
    const std::vector<double> v0 = random.numbers(3 * b.model->node_count(), -0.5, 0.5);
    b.fields.velocity0 = v0;
    f.velocity0.assign(v0.begin(), v0.end());
    const Trajectory<double> x = b.model->simulate(b.fields, schedule);
    const Trajectory<float> y = narrow.simulate(f, schedule);
    for (std::size_t i = 0; i < x.velocity.size(); ++i) {
        EXPECT_NEAR(x.velocity[i], static_cast<double>(y.velocity[i]), 5e-5);
    }
    const std::vector<double> seed = random.numbers(x.displacement.size(), -1, 1);
    F<double> g = b.model->adjoint(b.fields, schedule, {seed, {}});
    F<float> h = narrow.adjoint(f, schedule, {std::vector<float>(seed.begin(), seed.end()), {}});
    for (std::size_t i = 0; i < F<double>::count; ++i) {
        double error = 0, size = 0;
        for (std::size_t n = 0; n < g.all()[i]->size(); ++n) {
            const double a = (*g.all()[i])[n], c = static_cast<double>((*h.all()[i])[n]);
            error += (a - c) * (a - c);
            size += a * a;
        }
        EXPECT_LE(std::sqrt(error), 3e-4 * std::sqrt(size)) << F<double>::names[i];
    }
}

TEST(ImplicitGradients, AreTheSameAtAnyMemoryBudget) {
    Settings settings;
    settings.active = test::only_active({});
    test::Bar roomy = test::make_bar({}, schedule, settings);
    test::stir(roomy, 31);
    settings.memory_budget = 1;
    const TotalLagrangian<double> tight(roomy.model->geometry(), settings);
    test::Random random(32);
    const std::size_t size = (schedule.steps.size() + 1) * 3 * roomy.model->node_count();
    const Trajectory<double> seed{random.numbers(size, -1e3, 1e3), random.numbers(size, -1, 1)};
    long again = 0;
    F<double> a = roomy.model->adjoint(roomy.fields, schedule, seed), b = tight.adjoint(roomy.fields, schedule, seed, {}, &again);
    EXPECT_GT(again, 0);
    for (std::size_t i = 0; i < F<double>::count; ++i) {
        double error = 0, whole = 0;
        for (std::size_t n = 0; n < a.all()[i]->size(); ++n) {
            error += std::pow((*a.all()[i])[n] - (*b.all()[i])[n], 2);
            whole += std::pow((*a.all()[i])[n], 2);
        }
        EXPECT_LE(std::sqrt(error), 1e-9 * std::sqrt(whole)) << F<double>::names[i];
    }
}

}  // namespace
}  // namespace mphygs
