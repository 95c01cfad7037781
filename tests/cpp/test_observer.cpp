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

/// Channels that read a few nodes each, and pull all of them; size: numbers to each pull, 1 or 9.
Observer observer_of(const TotalLagrangian<double>& model, std::size_t frames, std::size_t size, unsigned seed = 5) {
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
            for (std::size_t k = 0; k < size; ++k) {
                o.reach_weight.push_back(random.between(k % 4 == 0 ? 0.1 : -0.2, k % 4 == 0 ? 0.5 : 0.2));
            }
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

Scene scene(Settings settings = {}, std::size_t size = 1) {
    settings.active = test::only_active({effect_number("viscosity"), effect_number("mass_damping")});
    Scene s{test::make_bar({}, schedule, settings), {}};
    test::stir(s.bar, 21);
    s.observer = observer_of(*s.bar.model, schedule.steps.size(), size);
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

std::size_t number_of(const std::string& name) {
    return static_cast<std::size_t>(std::find(F::names.begin(), F::names.end(), name) - F::names.begin());
}

double distance(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    }
    return std::sqrt(sum);
}

double norm(const std::vector<double>& a) { return distance(a, std::vector<double>(a.size(), 0.0)); }

/// Pulls by numbers and by matrices.
class Pulls : public testing::TestWithParam<std::size_t> {};
INSTANTIATE_TEST_SUITE_P(Observer, Pulls, testing::Values(std::size_t{1}, std::size_t{9}));

TEST_P(Pulls, TangentsFollowDifferencesAloneAndInManyLanes) {
    const Scene s = scene({}, GetParam());
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

TEST(Observer, TangentsOfEachFieldFollowDifferences) {
    const Scene s = scene();
    const char* names[] = {"mu", "mass", "gravity", "displacement0", "target"};
    std::vector<F> directions;
    F all = direction_of(s.bar.fields, 6);
    for (const char* name : names) {
        F one;
        *one.all()[number_of(name)] = *all.all()[number_of(name)];
        directions.push_back(one);
    }
    const auto lanes = s.bar.model->tangent(s.bar.fields, directions, schedule, {}, nullptr, {}, &s.observer);
    ASSERT_EQ(lanes.size(), 1 + directions.size());
    const double h = 1e-2;
    for (std::size_t d = 0; d < directions.size(); ++d) {
        const auto run = [&](double by) {
            return s.bar.model->simulate(moved(s.bar.fields, directions[d], by), schedule, {}, nullptr, &s.observer);
        };
        const auto ahead = run(h), behind = run(-h);
        const auto one = s.bar.model->tangent(s.bar.fields, {directions[d]}, schedule, {}, nullptr, {}, &s.observer)[1];
        const auto follows = [&](const std::vector<double>& a, const std::vector<double>& b, const std::vector<double>& alone,
                                 const std::vector<double>& lane) {
            std::vector<double> slope(a.size());
            for (std::size_t i = 0; i < slope.size(); ++i) {
                slope[i] = (a[i] - b[i]) / (2 * h);
            }
            EXPECT_GT(norm(alone), 1e-9) << names[d];
            EXPECT_LT(distance(alone, slope), 1e-6 * norm(slope)) << names[d];
            EXPECT_LT(distance(lane, slope), 1e-6 * norm(slope)) << names[d];
            EXPECT_LT(distance(lane, alone), 1e-10 * norm(alone)) << names[d];
        };
        follows(ahead.displacement, behind.displacement, one.displacement, lanes[1 + d].displacement);
        follows(ahead.velocity, behind.velocity, one.velocity, lanes[1 + d].velocity);
    }
}

TEST_P(Pulls, AdjointIsTheTransposeOfTheTangent) {
    Settings settings;
    settings.memory_budget = 1;  // checkpoints, and everything computed again
    const Scene s = scene(settings, GetParam());
    test::Random random(4);
    const std::size_t size = (schedule.steps.size() + 1) * 3 * s.bar.model->node_count();
    const Trajectory<double> bar{random.numbers(size, -1, 1), random.numbers(size, -1e-3, 1e-3)};
    long recomputed = 0;
    F gradient = s.bar.model->adjoint(s.bar.fields, schedule, bar, {}, &recomputed, nullptr, &s.observer);
    EXPECT_GT(recomputed, 0);
    F roomy = scene({}, GetParam()).bar.model->adjoint(s.bar.fields, schedule, bar, {}, nullptr, nullptr, &s.observer);
    for (std::size_t i = 0; i < static_cast<std::size_t>(F::count); ++i) {
        EXPECT_EQ(*gradient.all()[i], *roomy.all()[i]) << F::names[i];
    }
    F direction = direction_of(s.bar.fields, 8);
    for (const char* name : {"mu", "mass", "gravity", "displacement0", "velocity0", "node_force", "pose", "target", "effect"}) {
        F one;
        const std::size_t at = number_of(name);
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

TEST(Observer, FromAGapOnItIsAFreeRunToTheBit) {
    Scene s = scene();
    std::fill(s.observer.share.begin() + channels, s.observer.share.end(), 0.0);  // pulled in the first interval alone
    const auto pulled = s.bar.model->simulate(s.bar.fields, schedule, {}, nullptr, &s.observer);
    const std::size_t size = 3 * s.bar.model->node_count();
    const auto first = static_cast<std::size_t>(schedule.steps[0]);
    const auto tail = [](const std::vector<double>& a, std::size_t from) {
        return std::vector<double>(a.begin() + static_cast<std::ptrdiff_t>(from), a.end());
    };
    const auto begin = static_cast<std::ptrdiff_t>(size);
    F rest = s.bar.fields;
    rest.displacement0.assign(pulled.displacement.begin() + begin, pulled.displacement.begin() + 2 * begin);
    rest.velocity0.assign(pulled.velocity.begin() + begin, pulled.velocity.begin() + 2 * begin);
    rest.node_force = tail(rest.node_force, size);
    ASSERT_EQ(s.bar.model->geometry().hold_count, 1);
    rest.pose = tail(rest.pose, 12 * first);
    rest.target.clear();
    const Schedule later{{schedule.steps[1], schedule.steps[2]}, {schedule.dt[1], schedule.dt[2]},
                         schedule.start + schedule.steps[0] * schedule.dt[0]};
    const auto free = s.bar.model->simulate(rest, later);
    EXPECT_EQ(tail(pulled.displacement, size), free.displacement);
    EXPECT_EQ(tail(pulled.velocity, size), free.velocity);
    // What pulled before has moved it: another run from the start is elsewhere.
    F plain = s.bar.fields;
    plain.target.clear();
    EXPECT_GT(distance(pulled.displacement, s.bar.model->simulate(plain, schedule).displacement), 1e-9);
}

TEST_P(Pulls, DerivativesDoNotDependOnTheThreadsToTheBit) {
    const Scene s = scene({}, GetParam());
    const F direction = direction_of(s.bar.fields, 12);
    test::Random random(13);
    const std::size_t size = (schedule.steps.size() + 1) * 3 * s.bar.model->node_count();
    const Trajectory<double> bar{random.numbers(size, -1, 1), random.numbers(size, -1e-3, 1e-3)};
    const auto outcome = [&](int threads) {
        s.bar.model->set_threads(threads);
        auto out = s.bar.model->tangent(s.bar.fields, {direction, direction}, schedule, {}, nullptr, {}, &s.observer);
        out.push_back(s.bar.model->tangent(s.bar.fields, {direction}, schedule, {}, nullptr, {}, &s.observer)[1]);
        F gradient = s.bar.model->adjoint(s.bar.fields, schedule, bar, {}, nullptr, nullptr, &s.observer);
        EXPECT_GT(norm(gradient.target), 0);
        std::vector<std::vector<double>> numbers;
        for (const auto& t : out) {
            numbers.insert(numbers.end(), {t.displacement, t.velocity});
        }
        for (const auto* field : gradient.all()) {
            numbers.push_back(*field);
        }
        return numbers;
    };
    EXPECT_EQ(outcome(1), outcome(2));
}

/// A free body whose nodes are all pulled towards a rigid shift y: e'' + 2 w e' + w^2 e = 0, e(0) = y, so
/// e = y (1 + w t) exp(-w t). The largest difference from it, as a share of y; substeps: `finer` times as many.
double off_the_closed_form(int finer) {
    const double w = 40.0, shift[3] = {2e-3, -1e-3, 5e-4};
    const std::vector<int> steps{finer * 50, finer * 80, finer * 40, finer * 50};
    const std::vector<double> dt{2e-4 / finer, 1.5e-4 / finer, 2e-4 / finer, 1e-4 / finer};
    const Schedule slow{steps, dt, 0};
    const std::size_t frames = steps.size();
    test::BarOptions options;
    options.held = false;
    const TotalLagrangian<double> model(test::bar_geometry(options), {});
    F fields = test::fields_at_rest<double>(options, model.geometry(), slow);
    const int nodes = static_cast<int>(model.node_count());
    const std::vector<double> mass = model.node_mass(fields);
    Observer o;
    o.row_begin = {0};
    for (const double weight : {0.5, 0.25, 0.25}) {  // one channel: the mean of three nodes that have mass
        int node = static_cast<int>(o.row_carrier.size()) * nodes / 3;
        while (mass[static_cast<std::size_t>(node)] == 0) {
            ++node;
        }
        o.row_carrier.push_back(node);
        o.row_weight.push_back(weight);
    }
    o.row_begin.push_back(static_cast<std::int32_t>(o.row_carrier.size()));
    for (int n = 0; n <= nodes; ++n) {
        o.reach_begin.push_back(n);
    }
    o.reach_channel.assign(static_cast<std::size_t>(nodes), 0);
    o.reach_weight.assign(static_cast<std::size_t>(nodes), 1.0);
    o.stiffness = w * w;
    o.damping = 2 * w;
    o.share.assign(frames, 1.0);
    fields.target.assign(frames * 12, 0.0);
    for (std::size_t f = 0; f < frames; ++f) {
        std::copy(shift, shift + 3, fields.target.begin() + static_cast<std::ptrdiff_t>(12 * f));
    }
    const auto t = model.simulate(fields, slow, {}, nullptr, &o);
    double time = 0, worst = 0;
    for (std::size_t f = 0; f < frames; ++f) {
        time += steps[f] * dt[f];
        const double left = (1 + w * time) * std::exp(-w * time);
        for (std::size_t n = 0; n < static_cast<std::size_t>(nodes); ++n) {
            for (std::size_t c = 0; mass[n] > 0 && c < 3; ++c) {
                const double u = t.displacement[((f + 1) * static_cast<std::size_t>(nodes) + n) * 3 + c];
                worst = std::max(worst, std::abs((shift[c] - u) / shift[c] - left));
            }
        }
    }
    return worst;
}

TEST(Observer, AFreeBodyFollowsItsTargetAsACriticallyDampedOscillator) {
    const double coarse = off_the_closed_form(1), fine = off_the_closed_form(4);
    EXPECT_LT(coarse, 5e-3);
    // Of first order in the substep, and of nothing else.
    EXPECT_NEAR(coarse / fine, 4.0, 0.2);
}

TEST(Observer, AMatrixThatIsANumberPullsLikeIt) {
    Scene s = scene();
    const auto by_numbers = s.bar.model->simulate(s.bar.fields, schedule, {}, nullptr, &s.observer);
    std::vector<double> matrices;
    for (const double g : s.observer.reach_weight) {
        matrices.insert(matrices.end(), {g, 0, 0, 0, g, 0, 0, 0, g});
    }
    s.observer.reach_weight = matrices;
    const auto by_matrices = s.bar.model->simulate(s.bar.fields, schedule, {}, nullptr, &s.observer);
    EXPECT_LT(distance(by_numbers.displacement, by_matrices.displacement), 1e-12 * norm(by_numbers.displacement));
    // And one that turns pulls to another side.
    Scene turned = scene({}, 9);
    for (std::size_t k = 0; k < turned.observer.reach_weight.size(); ++k) {
        turned.observer.reach_weight[k] = k % 9 == 1 ? 1.0 : 0.0;  // x of the carrier by y of the channel
    }
    F& fields = turned.bar.fields;
    for (std::size_t k = 0; k < fields.target.size(); ++k) {
        fields.target[k] = k % 12 == 1 ? 1e-2 : 0.0;
    }
    F plain = fields;
    plain.target.clear();
    const auto moved = turned.bar.model->simulate(fields, schedule, {}, nullptr, &turned.observer);
    const auto free = turned.bar.model->simulate(plain, schedule);
    double mean[3] = {};
    for (std::size_t k = 0; k < free.displacement.size(); ++k) {
        mean[k % 3] += moved.displacement[k] - free.displacement[k];
    }
    EXPECT_GT(mean[0], 10 * std::abs(mean[1]));
    EXPECT_GT(mean[0], 10 * std::abs(mean[2]));
}

/// A target that moves at a constant rate is followed without a lag: the rate counts in what pulls.
TEST(Observer, AMovingTargetIsFollowedWithoutALag) {
    const double rate = 0.05;
    const Schedule slow{{50, 80}, {2e-4, 1.5e-4}, 0};
    test::BarOptions options;
    options.held = false;
    const TotalLagrangian<double> model(test::bar_geometry(options), {});
    F fields = test::fields_at_rest<double>(options, model.geometry(), slow);
    const std::size_t nodes = model.node_count();
    const std::vector<double> mass = model.node_mass(fields);
    const auto seen = static_cast<std::size_t>(std::max_element(mass.begin(), mass.end()) - mass.begin());
    Observer o;
    o.row_begin = {0, 1};
    o.row_carrier = {static_cast<std::int32_t>(seen)};
    o.row_weight = {1.0};
    for (std::size_t n = 0; n <= nodes; ++n) {
        o.reach_begin.push_back(static_cast<std::int32_t>(n));
    }
    o.reach_channel.assign(nodes, 0);
    o.reach_weight.assign(nodes, 1.0);
    o.stiffness = 1600;
    o.damping = 80;
    o.share = {1.0, 1.0};
    fields.target.assign(24, 0.0);
    fields.velocity0.assign(3 * nodes, 0.0);
    for (std::size_t n = 0; n < nodes; ++n) {
        fields.velocity0[3 * n + 1] = rate;
    }
    double time = 0;
    for (std::size_t f = 0; f < 2; ++f) {  // y = rate t, in powers of the share of each interval
        const double span = slow.steps[f] * slow.dt[f];
        fields.target[12 * f + 1] = rate * time;
        fields.target[12 * f + 4] = rate * span;
        time += span;
    }
    const auto t = model.simulate(fields, slow, {}, nullptr, &o);
    EXPECT_NEAR(t.displacement[(2 * nodes + seen) * 3 + 1], rate * time, 1e-9 * rate * time);
    EXPECT_NEAR(t.velocity[(2 * nodes + seen) * 3 + 1], rate, 1e-9 * rate);
}

TEST(Observer, RefusesWhatDoesNotFit) {
    const Scene s = scene();
    const auto refused = [&](const std::string& expected, auto change) {
        Scene broken = s;
        change(broken);
        const F& f = broken.bar.fields;
        const auto& model = *s.bar.model;
        const auto named = [&](auto run) {
            try {
                run();
                ADD_FAILURE() << "not refused: " << expected;
            } catch (const std::invalid_argument& error) {
                EXPECT_NE(std::string(error.what()).find(expected), std::string::npos) << error.what();
                EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
            }
        };
        named([&] { model.simulate(f, schedule, {}, nullptr, &broken.observer); });
        named([&] { model.tangent(f, {F{}, F{}}, schedule, {}, nullptr, {}, &broken.observer); });
        named([&] { model.adjoint(f, schedule, {}, {}, nullptr, nullptr, &broken.observer); });
    };
    refused("share must be", [](Scene& b) { b.observer.share.pop_back(); });
    refused("share must be", [](Scene& b) { b.observer.share.clear(); });
    refused("target must be", [](Scene& b) { b.bar.fields.target.pop_back(); });
    refused("target must be", [](Scene& b) { b.bar.fields.target.clear(); });
    refused("row_begin must be", [](Scene& b) { b.observer.row_begin[0] = 1; });
    refused("row_begin must not fall", [](Scene& b) { b.observer.row_begin[1] = 100; });
    refused("row_begin must end", [](Scene& b) { b.observer.row_begin.back() += 1; });
    refused("row_begin must end", [](Scene& b) { b.observer.row_carrier.pop_back(); });
    refused("row_begin must end", [](Scene& b) { b.observer.row_weight.pop_back(); });
    refused("row names a number out of range", [](Scene& b) { b.observer.row_carrier[0] = -1; });
    refused("row names a number out of range",
            [&](Scene& b) { b.observer.row_carrier[0] = static_cast<std::int32_t>(s.bar.model->node_count()); });
    refused("reach_begin must be", [](Scene& b) { b.observer.reach_begin.pop_back(); });
    refused("reach_begin must be", [](Scene& b) { b.observer.reach_begin[0] = 1; });
    refused("reach_begin must not fall", [](Scene& b) { b.observer.reach_begin[1] = 1 << 20; });
    refused("reach_begin must end", [](Scene& b) { b.observer.reach_channel.pop_back(); });
    refused("reach_begin must end", [](Scene& b) { b.observer.reach_weight.pop_back(); });
    refused("reach names a number out of range", [](Scene& b) { b.observer.reach_channel[0] = -1; });
    refused("reach names a number out of range", [](Scene& b) { b.observer.reach_channel[0] = static_cast<int>(channels); });
    refused("stiffness and damping", [](Scene& b) { b.observer.stiffness = -1; });
    refused("stiffness and damping", [](Scene& b) { b.observer.damping = -1; });
    refused("stiffness and damping", [](Scene& b) { b.observer.damping = std::nan(""); });
    EXPECT_THROW(s.bar.model->simulate(s.bar.fields, schedule), std::invalid_argument);
    // A direction's target has the size of the fields'.
    F odd;
    odd.target.assign(s.bar.fields.target.size() - 1, 0.0);
    EXPECT_THROW(s.bar.model->tangent(s.bar.fields, {odd}, schedule, {}, nullptr, {}, &s.observer), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
