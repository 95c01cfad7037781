// Feedback from measured targets: closed form, derivatives three ways, gaps, threads, errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using F = Fields<double>;
constexpr std::size_t channels = 3;
const Schedule schedule{{3, 4, 2}, {1e-4, 8e-5, 1.2e-4}, 0.01};

/// Channels that read a few nodes each, and pull all of them.
Observer observer_of(const TotalLagrangian<double>& model, std::size_t frames, unsigned seed = 5) {
    test::Random random(seed);
    Observer o;
    const int nodes = static_cast<int>(model.node_count());
    o.row_begin = {0};
    for (std::size_t i = 0; i < channels; ++i) {
        for (int k = 0; k < 4; ++k) {
            o.row_carrier.push_back((static_cast<int>(i) * 11 + 5 * k) % nodes);
            o.row_weight.push_back(random.between(0.1, 0.4));
        }
        o.row_begin.push_back(static_cast<std::int32_t>(o.row_carrier.size()));
    }
    o.reach_begin = {0};
    for (int n = 0; n < nodes; ++n) {
        for (int i = n % 2; i < static_cast<int>(channels); ++i) {
            o.reach_channel.push_back(i);
            o.reach_weight.push_back(random.between(0.1, 0.5));
        }
        o.reach_begin.push_back(static_cast<std::int32_t>(o.reach_channel.size()));
    }
    // Far harder than any memory of frames asks for, so that it shows in a few substeps.
    o.stiffness = 4e6;
    o.damping = 3e3;
    o.share.assign(frames * channels, 1.0);
    o.share[channels + 1] = 0.0;
    return o;
}

int effect_number(const std::string& name) {
    for (int i = 0; i < Registry::count; ++i) {
        if (name == Registry::infos[i]->name) {
            return i;
        }
    }
    throw std::out_of_range(name);
}

struct Scene {
    test::Bar bar;
    Observer observer;
};

Scene scene(Settings settings = {}) {
    settings.active = test::only_active({effect_number("viscosity"), effect_number("mass_damping")});
    Scene s{test::make_bar({}, schedule, settings), {}};
    test::stir(s.bar, 21);
    s.observer = observer_of(*s.bar.model, schedule.steps.size());
    test::Random random(9);
    s.bar.fields.target = random.numbers(12 * schedule.steps.size() * channels, -2e-3, 2e-3);
    return s;
}

/// A direction in which every field but the holds' poses changes in proportion to its size.
F direction_of(const F& fields, unsigned seed) {
    test::Random random(seed);
    F from = fields, d;
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        double largest = 0;
        for (const double x : *from.all()[i]) {
            largest = std::max(largest, std::abs(x));
        }
        *d.all()[i] = random.numbers(from.all()[i]->size(), -0.01 * largest, 0.01 * largest);
    }
    return d;
}

F moved(const F& fields, const F& direction, double by) {
    F out = fields, d = direction;
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        for (std::size_t k = 0; k < d.all()[i]->size(); ++k) {
            (*out.all()[i])[k] += by * (*d.all()[i])[k];
        }
    }
    return out;
}

double distance(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    }
    return std::sqrt(sum);
}

double norm(const std::vector<double>& a) { return distance(a, std::vector<double>(a.size(), 0.0)); }

TEST(Observer, TangentsFollowDifferencesAloneAndInManyLanes) {
    const Scene s = scene();
    F all = direction_of(s.bar.fields, 3);
    all.effect.clear();  // numbers of all sizes, yields of a million pascals among them
    F aimed;
    aimed.target = all.target;
    const auto run = [&](const F& d, double by) {
        return s.bar.model->simulate(moved(s.bar.fields, d, by), schedule, {}, nullptr, &s.observer);
    };
    const double h = 1e-3;
    const auto many = s.bar.model->tangent(s.bar.fields, {aimed, all, aimed}, schedule, {}, nullptr, {}, &s.observer);
    for (const F& d : {all, aimed}) {
        const auto one = s.bar.model->tangent(s.bar.fields, {d}, schedule, {}, nullptr, {}, &s.observer)[1];
        const auto ahead = run(d, h), behind = run(d, -h);
        std::vector<double> slope(one.displacement.size());
        for (std::size_t i = 0; i < slope.size(); ++i) {
            slope[i] = (ahead.displacement[i] - behind.displacement[i]) / (2 * h);
        }
        EXPECT_GT(norm(one.displacement), 1e-8);
        EXPECT_LT(distance(one.displacement, slope), 1e-5 * norm(slope));
        const auto& lane = many[&d == &aimed || d.mu.empty() ? 1 : 2];
        EXPECT_LT(distance(one.displacement, lane.displacement), 1e-10 * norm(one.displacement));
        EXPECT_LT(distance(one.velocity, lane.velocity), 1e-10 * norm(one.velocity));
    }
}

TEST(Observer, AdjointIsTheTransposeOfTheTangent) {
    Settings settings;
    settings.memory_budget = 1;  // checkpoints, and everything computed again
    const Scene s = scene(settings);
    test::Random random(4);
    const std::size_t size = (schedule.steps.size() + 1) * 3 * s.bar.model->node_count();
    const Trajectory<double> bar{random.numbers(size, -1, 1), random.numbers(size, -1e-3, 1e-3)};
    F gradient = s.bar.model->adjoint(s.bar.fields, schedule, bar, {}, nullptr, nullptr, &s.observer);
    F direction = direction_of(s.bar.fields, 8);
    for (const char* name : {"mu", "mass", "gravity", "displacement0", "velocity0", "node_force", "pose", "target", "effect"}) {
        F one;
        const auto at = static_cast<std::size_t>(std::find(F::names.begin(), F::names.end(), std::string(name)) - F::names.begin());
        *one.all()[at] = *direction.all()[at];
        const auto t = s.bar.model->tangent(s.bar.fields, {one}, schedule, {}, nullptr, {}, &s.observer)[1];
        double by_tangent = 0, by_adjoint = 0, scale = 0;
        for (std::size_t i = 0; i < size; ++i) {
            by_tangent += bar.displacement[i] * t.displacement[i] + bar.velocity[i] * t.velocity[i];
        }
        for (std::size_t i = 0; i < one.all()[at]->size(); ++i) {
            by_adjoint += (*gradient.all()[at])[i] * (*one.all()[at])[i];
            scale += std::abs((*gradient.all()[at])[i] * (*one.all()[at])[i]);
        }
        EXPECT_GT(std::abs(by_tangent), 0) << name;
        EXPECT_NEAR(by_tangent, by_adjoint, 1e-9 * scale) << name;
    }
}

TEST(Observer, WithoutSharesItIsAFreeRunToTheBitWhateverTheThreads) {
    Scene s = scene();
    F plain = s.bar.fields;
    plain.target.clear();
    const auto free = s.bar.model->simulate(plain, schedule);
    std::fill(s.observer.share.begin(), s.observer.share.end(), 0.0);
    const auto same = s.bar.model->simulate(s.bar.fields, schedule, {}, nullptr, &s.observer);
    EXPECT_EQ(free.displacement, same.displacement);
    const Scene pulled = scene();
    const auto one = pulled.bar.model->simulate(pulled.bar.fields, schedule, {}, nullptr, &pulled.observer);
    EXPECT_GT(distance(one.displacement, free.displacement), 1e-9);
    pulled.bar.model->set_threads(2);
    EXPECT_EQ(one.displacement, pulled.bar.model->simulate(pulled.bar.fields, schedule, {}, nullptr, &pulled.observer).displacement);
}

/// A free body whose nodes are all pulled towards a rigid shift y: e'' + 2 w e' + w^2 e = 0, e(0) = y.
TEST(Observer, AFreeBodyFollowsItsTargetAsACriticallyDampedOscillator) {
    const double w = 40.0, shift = 2e-3;
    const Schedule slow{std::vector<int>(6, 50), std::vector<double>(6, 2e-4), 0};
    test::BarOptions options;
    test::Bar bar = test::make_bar(options, slow);
    Geometry g = bar.model->geometry();
    for (auto* rows : {&g.row_begin, &g.row_node, &g.row_hold}) {
        rows->clear();
    }
    g.row_begin = {0};
    g.row_weight.clear();
    g.row_target.clear();
    g.hold_count = 0;
    const TotalLagrangian<double> model(g, {});
    F fields = test::fields_at_rest<double>(options, g, slow);
    Observer o;
    const int nodes = static_cast<int>(model.node_count());
    const std::vector<double> mass = model.node_mass(fields);
    const int seen = static_cast<int>(std::max_element(mass.begin(), mass.end()) - mass.begin());
    o.row_begin = {0, 1};
    o.row_carrier = {seen};
    o.row_weight = {1.0};
    for (int n = 0; n <= nodes; ++n) {
        o.reach_begin.push_back(n);
    }
    o.reach_channel.assign(static_cast<std::size_t>(nodes), 0);
    o.reach_weight.assign(static_cast<std::size_t>(nodes), 1.0);
    o.stiffness = w * w;
    o.damping = 2 * w;
    o.share.assign(6, 1.0);
    fields.target.assign(6 * 12, 0.0);
    for (std::size_t f = 0; f < 6; ++f) {
        fields.target[12 * f] = shift;
    }
    const auto t = model.simulate(fields, slow, {}, nullptr, &o);
    for (std::size_t f = 1; f <= 6; ++f) {
        const double time = 0.01 * static_cast<double>(f);
        const double left = shift * (1 + w * time) * std::exp(-w * time);
        const double u = t.displacement[(f * static_cast<std::size_t>(nodes) + static_cast<std::size_t>(seen)) * 3];
        EXPECT_NEAR(shift - u, left, 0.02 * shift) << f;
    }
}

TEST(Observer, RefusesWhatDoesNotFit) {
    const Scene s = scene();
    const auto refused = [&](auto change) {
        Scene broken = s;
        change(broken);
        EXPECT_THROW(s.bar.model->simulate(broken.bar.fields, schedule, {}, nullptr, &broken.observer), std::invalid_argument);
    };
    refused([](Scene& b) { b.observer.share.pop_back(); });
    refused([](Scene& b) { b.bar.fields.target.pop_back(); });
    refused([](Scene& b) { b.observer.row_carrier[0] = -1; });
    refused([](Scene& b) { b.observer.row_carrier[0] = 1 << 20; });
    refused([](Scene& b) { b.observer.reach_begin.pop_back(); });
    refused([](Scene& b) { b.observer.reach_channel[0] = static_cast<int>(channels); });
    refused([](Scene& b) { b.observer.row_begin[1] = 100; });
    refused([](Scene& b) { b.observer.stiffness = -1; });
    EXPECT_THROW(s.bar.model->simulate(s.bar.fields, schedule), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
