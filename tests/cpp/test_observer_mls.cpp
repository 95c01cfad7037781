// Feedback from measured targets in MLS-MPM: closed form, derivatives three ways, gaps, threads, momentum, errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mls_mpm_case.hpp"
#include "random_numbers.hpp"

namespace mphygs {
namespace {

using F = Fields<double>;
using test::MlsCase;
constexpr std::size_t channels = 3;

/// Channels that read a few particles each, held ones and shared ones among them, and pull most.
Observer observer_of(std::size_t particles, std::size_t intervals) {
    test::Random random(5);
    Observer o;
    o.row_begin = {0};
    for (std::size_t i = 0; i < channels; ++i) {
        for (std::size_t k = 0; k < 6; ++k) {
            o.row_carrier.push_back(static_cast<std::int32_t>((7 * i + 11 * k) % particles));
            o.row_weight.push_back(random.between(0.1, 0.4));
        }
        o.row_begin.push_back(static_cast<std::int32_t>(o.row_carrier.size()));
    }
    o.reach_begin = {0};
    for (std::size_t p = 0; p < particles; ++p) {
        for (std::size_t i = p % 4; i < channels; ++i) {  // none of every fourth
            o.reach_channel.push_back(static_cast<std::int32_t>(i));
            o.reach_weight.push_back(random.between(0.1, 0.5));
        }
        o.reach_begin.push_back(static_cast<std::int32_t>(o.reach_channel.size()));
    }
    // Far harder than any memory of frames asks for, so that it shows in a few substeps.
    o.stiffness = 4e5;
    o.damping = 1e3;
    o.share.assign(intervals * channels, 1.0);
    o.share[1] = 0.0;
    o.share[channels] = 0.6;
    return o;
}

template <class T>
struct Scene {
    MlsCase<T> c;
    Observer observer;
};

/// Several intervals of different substeps; plain: nothing but gravity acts, and tiles take the hot path.
template <class T = double>
Scene<T> scene(bool plain, bool hold = true, std::array<int, 3> shape = {4, 5, 9}) {
    Scene<T> s{test::mls_case<T>(shape, {3, 5, 4}, hold), {}};
    s.c.schedule.dt = {2e-4, 1.5e-4, 2.5e-4};
    if (plain) {
        s.c.fields.node_force.clear();
    } else {
        s.c.settings.active[test::effect_index("viscosity")] = true;
        s.c.settings.active[test::effect_index("air_drag")] = true;
    }
    s.observer = observer_of(s.c.geometry.particle_count(), 3);
    test::Random random(9);
    for (const double x : random.numbers(3 * channels * 12, -2e-3, 2e-3)) {
        s.c.fields.target.push_back(static_cast<T>(x));
    }
    return s;
}

F only(F d, std::size_t field) {
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        if (i != field) {
            d.all()[i]->clear();
        }
    }
    return d;
}

F moved(F fields, F direction, double by) {
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        for (std::size_t k = 0; k < direction.all()[i]->size(); ++k) {
            (*fields.all()[i])[k] += by * (*direction.all()[i])[k];
        }
    }
    return fields;
}

/// The adjoint against the tangent, field by field.
void compare_derivatives(const Scene<double>& s) {
    const MlsMpm<double> model = s.c.model();
    const auto bar = test::random_bar(model.simulate(s.c.fields, s.c.schedule, {}, &s.observer), 3);
    F gradient = model.adjoint(s.c.fields, s.c.schedule, bar, {}, nullptr, &s.observer);
    const F direction = test::random_direction(s.c.fields, 5);
    std::vector<F> directions;
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        directions.push_back(only(direction, i));
    }
    const auto tangents = model.tangent(s.c.fields, directions, s.c.schedule, {}, &s.observer);
    const auto free = model.tangent(moved(s.c.fields, {}, 0), {directions[0]}, s.c.schedule, {}, &s.observer);
    EXPECT_NEAR(test::product(bar, free[1]), test::product(bar, tangents[1]), 1e-10 * std::abs(test::product(bar, free[1])));  // K = 1 and 4
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        const std::string name = F::names[i];
        const std::vector<double>&g = *gradient.all()[i], &d = *directions[i].all()[i];
        ASSERT_TRUE(g.empty() || g.size() == d.size()) << name;
        double by_adjoint = 0, size = 0;
        for (std::size_t k = 0; k < g.size(); ++k) {
            by_adjoint += g[k] * d[k];
            size += std::abs(g[k] * d[k]);
        }
        const double by_tangent = test::product(bar, tangents[i + 1]);
        EXPECT_NEAR(by_adjoint, by_tangent, 1e-10 * (size + 1e-6)) << name;
        if (name != "effect" && name != "place_effect" && name != "place_mass" && !d.empty()) {
            EXPECT_GT(std::abs(by_tangent), 1e-9) << name;
        }
    }
}

TEST(MlsObserver, AdjointIsTheTransposeOfTheTangent) {
    for (const bool plain : {true, false}) {
        compare_derivatives(scene(plain));
        compare_derivatives(scene(plain, false));
    }
    auto checkpointed = scene(true);
    checkpointed.c.settings.memory_budget = 1;
    compare_derivatives(checkpointed);
    auto several_chunks = scene(true, true, {8, 9, 32});
    ASSERT_GT(several_chunks.c.geometry.particle_count(), 2048u);
    compare_derivatives(several_chunks);
    auto from_rest = scene(true);
    from_rest.c.fields.velocity0.clear();
    compare_derivatives(from_rest);
}

TEST(MlsObserver, TangentFollowsCentralDifferences) {
    for (const bool plain : {true, false}) {
        const auto s = scene(plain);
        const MlsMpm<double> model = s.c.model();
        const auto run = [&](const F& d, double by) { return model.simulate(moved(s.c.fields, d, by), s.c.schedule, {}, &s.observer); };
        const F all = test::random_direction(s.c.fields, 12);
        for (const std::string name : {"mu", "mass", "gravity", "velocity0", "displacement0", "target"}) {
            const auto i = static_cast<std::size_t>(std::find(F::names.begin(), F::names.end(), name) - F::names.begin());
            const F d = only(all, i);
            const auto tangent = model.tangent(s.c.fields, {d}, s.c.schedule, {}, &s.observer)[1];
            const double h = name == "target" ? 1.0 : 1e-4;
            const auto ahead = run(d, h), behind = run(d, -h);
            double error = 0, size = 0;
            for (std::size_t k = 0; k < tangent.velocity.size(); ++k) {
                const double slope = (ahead.velocity[k] - behind.velocity[k]) / (2 * h);
                error += std::pow(slope - tangent.velocity[k], 2);
                size += std::pow(tangent.velocity[k], 2);
            }
            EXPECT_GT(size, 1e-12) << name;
            EXPECT_LT(std::sqrt(error / size), name == "target" ? 1e-3 : 1e-5) << name;
        }
    }
}

/// A free body whose particles are all pulled towards a rigid shift y: e'' + 2 w e' + w^2 e = 0, e(0) = y. The target
/// moves on in the second half, and the body with it.
template <class T>
void follows(double tolerance) {
    const double w = 40.0, shift = 2e-3, speed = 0.1;
    auto c = test::mls_case<T>({4, 5, 9}, std::vector<int>(12, 50), false);
    F like;
    c.fields.node_force.clear();
    c.fields.displacement0.clear();
    c.fields.velocity0.clear();
    c.fields.deformation0.clear();
    std::fill(c.fields.gravity.begin(), c.fields.gravity.end(), T{});
    Observer o;
    const std::size_t count = c.geometry.particle_count();
    o.row_begin = {0, 2};
    o.row_carrier = {17, static_cast<std::int32_t>(count) - 9};
    o.row_weight = {0.25, 0.75};
    for (std::size_t p = 0; p <= count; ++p) {
        o.reach_begin.push_back(static_cast<std::int32_t>(p));
    }
    o.reach_channel.assign(count, 0);
    o.reach_weight.assign(count, 1.0);
    o.stiffness = w * w;
    o.damping = 2 * w;
    o.share.assign(12, 1.0);
    c.fields.target.assign(12 * 12, T{});
    for (std::size_t f = 0; f < 12; ++f) {
        c.fields.target[12 * f] = static_cast<T>(shift + (f < 6 ? 0.0 : speed * 0.01 * static_cast<double>(f - 6)));
        c.fields.target[12 * f + 3] = static_cast<T>(f < 6 ? 0.0 : speed * 0.01);
    }
    const auto t = c.model().simulate(c.fields, c.schedule, {}, &o);
    double e = shift, rate = 0;  // of the error, at the beginning of a half
    for (std::size_t f = 1; f <= 12; ++f) {
        const double time = 0.01 * static_cast<double>(f <= 6 ? f : f - 6);
        if (f == 7) {
            const double T6 = 0.06;
            const double left = shift * (1 + w * T6) * std::exp(-w * T6), slope = -shift * w * w * T6 * std::exp(-w * T6);
            e = left, rate = slope + speed;
        }
        const double left = (e + (rate + w * e) * time) * std::exp(-w * time);
        const double aimed = shift + (f <= 6 ? 0.0 : speed * time);
        for (const std::size_t p : {std::size_t(3), count - 1}) {
            const double u = static_cast<double>(t.position[(f * count + p) * 3]) - c.geometry.points[3 * p];
            EXPECT_NEAR(aimed - u, left, tolerance * shift) << f;
        }
    }
}
TEST(MlsObserver, AFreeBodyFollowsItsTargetAsACriticallyDampedOscillator) {
    follows<double>(0.02);
    follows<float>(0.02);
}

/// Before it is shared with the grid: the momentum of one substep is what the particles are given.
TEST(MlsObserver, GivesTheMomentumThatItAsksFor) {
    auto s = scene(true, false);
    s.c.schedule = {{1, 1}, {2e-4, 2e-4}, 0.0};
    s.observer = observer_of(s.c.geometry.particle_count(), 2);
    s.c.fields.target.resize(2 * channels * 12);
    F plain = s.c.fields;
    plain.target.clear();
    const MlsMpm<double> model = s.c.model();
    const auto pulled = model.simulate(s.c.fields, s.c.schedule, {}, &s.observer), free = model.simulate(plain, s.c.schedule);
    const std::size_t count = s.c.geometry.particle_count();
    const Observer& o = s.observer;
    for (std::size_t c = 0; c < 3; ++c) {
        double gained = 0, wanted = 0, size = 0;
        for (std::size_t p = 0; p < count; ++p) {
            gained += s.c.fields.mass[p] * (pulled.velocity[(count + p) * 3 + c] - free.velocity[(count + p) * 3 + c]);
            for (auto r = static_cast<std::size_t>(o.reach_begin[p]); r < static_cast<std::size_t>(o.reach_begin[p + 1]); ++r) {
                const auto i = static_cast<std::size_t>(o.reach_channel[r]);
                double place = s.c.fields.target[12 * i + c], rate = s.c.fields.target[12 * i + 3 + c] / 2e-4;
                for (auto k = static_cast<std::size_t>(o.row_begin[i]); k < static_cast<std::size_t>(o.row_begin[i + 1]); ++k) {
                    const auto q = 3 * static_cast<std::size_t>(o.row_carrier[k]) + c;
                    place -= o.row_weight[k] * s.c.fields.displacement0[q];
                    rate -= o.row_weight[k] * s.c.fields.velocity0[q];
                }
                const double a = o.share[i] * (o.stiffness * place + o.damping * rate);
                wanted += 2e-4 * s.c.fields.mass[p] * o.reach_weight[r] * a;
                size += std::abs(2e-4 * s.c.fields.mass[p] * o.reach_weight[r] * a);
            }
        }
        EXPECT_NEAR(gained, wanted, 1e-10 * size) << c;
        EXPECT_GT(std::abs(wanted), 1e-3 * size) << c;
    }
}

TEST(MlsObserver, WithoutSharesItIsAFreeRunAndThreadsDoNotMatter) {
    for (const bool plain : {true, false}) {
        auto s = scene(plain, true, {8, 9, 32});
        MlsMpm<double> model = s.c.model();
        F unaimed = s.c.fields;
        unaimed.target.clear();
        const auto free = model.simulate(unaimed, s.c.schedule);
        const auto pulled = model.simulate(s.c.fields, s.c.schedule, {}, &s.observer);
        EXPECT_NE(free.position, pulled.position);
        const auto bar = test::random_bar(pulled, 3);
        const F gradient = model.adjoint(s.c.fields, s.c.schedule, bar, {}, nullptr, &s.observer);
        const F direction = test::random_direction(s.c.fields, 5);
        const auto tangent = model.tangent(s.c.fields, {direction}, s.c.schedule, {}, &s.observer)[1];
        model.set_threads(2);
        EXPECT_EQ(pulled.position, model.simulate(s.c.fields, s.c.schedule, {}, &s.observer).position);
        EXPECT_EQ(tangent.velocity, model.tangent(s.c.fields, {direction}, s.c.schedule, {}, &s.observer)[1].velocity);
        F again = model.adjoint(s.c.fields, s.c.schedule, bar, {}, nullptr, &s.observer), first = gradient;
        for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
            EXPECT_EQ(*first.all()[i], *again.all()[i]) << F::names[i];
        }
        std::fill(s.observer.share.begin(), s.observer.share.end(), 0.0);
        EXPECT_EQ(free.position, model.simulate(s.c.fields, s.c.schedule, {}, &s.observer).position);
    }
}

TEST(MlsObserver, AGapPullsNothingAndHasNoGradient) {
    auto s = scene(true);
    const MlsMpm<double> model = s.c.model();
    const auto before = model.simulate(s.c.fields, s.c.schedule, {}, &s.observer);
    F gradient = model.adjoint(s.c.fields, s.c.schedule, test::random_bar(before, 3), {}, nullptr, &s.observer);
    for (std::size_t k = 0; k < 12; ++k) {  // channel 1 in interval 0
        EXPECT_EQ(gradient.target[12 + k], 0.0);
        EXPECT_TRUE(k >= 3 || gradient.target[k] != 0.0);
        s.c.fields.target[12 + k] += 1.0;
    }
    EXPECT_EQ(before.position, model.simulate(s.c.fields, s.c.schedule, {}, &s.observer).position);
}

TEST(MlsObserver, FloatsFollowDoubles) {
    const auto d = scene<double>(true);
    const auto f = scene<float>(true);
    const auto exact = d.c.model().simulate(d.c.fields, d.c.schedule, {}, &d.observer);
    const auto found = f.c.model().simulate(f.c.fields, f.c.schedule, {}, &f.observer);
    for (std::size_t i = 0; i < exact.velocity.size(); ++i) {
        EXPECT_NEAR(exact.velocity[i], static_cast<double>(found.velocity[i]), 1e-4);
    }
}

TEST(MlsObserver, RefusesWhatDoesNotFit) {
    const auto s = scene(true);
    const MlsMpm<double> model = s.c.model();
    const auto refused = [&](const std::string& message, auto change) {
        auto broken = s;
        change(broken);
        try {
            model.simulate(broken.c.fields, broken.c.schedule, {}, &broken.observer);
            ADD_FAILURE() << message;
        } catch (const std::invalid_argument& e) {
            EXPECT_NE(std::string(e.what()).find(message), std::string::npos) << e.what();
        }
    };
    refused("share must be", [](auto& b) { b.observer.share.pop_back(); });
    refused("target must be", [](auto& b) { b.c.fields.target.clear(); });
    refused("row names a number out of range", [](auto& b) { b.observer.row_carrier[0] = 1 << 20; });
    refused("reach_begin must be", [](auto& b) { b.observer.reach_begin.pop_back(); });
    EXPECT_THROW(model.simulate(s.c.fields, s.c.schedule), std::invalid_argument);
    EXPECT_THROW(model.adjoint(s.c.fields, s.c.schedule, {}), std::invalid_argument);
    EXPECT_GT(model.largest_rates(s.c.fields)[0], 0.0);  // asked with a target, which plays no part
}

}  // namespace
}  // namespace mphygs
