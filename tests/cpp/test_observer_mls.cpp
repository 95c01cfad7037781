// Feedback from measured targets on the particles of MLS-MPM: closed form, derivatives three ways, paths, bits, errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "mls_mpm_case.hpp"

namespace mphygs {
namespace {

using test::MlsCase;
using test::mls_case;
using test::product;
using test::random_bar;
using test::random_direction;

constexpr std::size_t channels = 3;

/// How particles are pulled: each by a number, each by a matrix, or all of a few groups alike, by matrices.
enum class Kind { number, matrix, group };

template <class T>
struct Scene {
    MlsCase<T> body;
    Observer observer;
    ParticleTrajectory<T> run(const Fields<T>& fields) const {
        return body.model().simulate(fields, body.schedule, {}, &observer);
    }
};

template <class T>
Scene<T> scene(std::array<int, 3> shape, std::vector<int> steps, bool hold, Kind kind) {
    Scene<T> s{mls_case<T>(shape, std::move(steps), hold), {}};
    std::mt19937 random(5);
    std::uniform_real_distribution<double> unit(-1, 1);
    const int particles = static_cast<int>(s.body.geometry.particle_count()), frames = s.body.schedule.frame_count();
    Observer& o = s.observer;
    o.row_begin = {0};
    for (int i = 0; i < static_cast<int>(channels); ++i) {
        for (int k = 0; k < 4; ++k) {
            o.row_carrier.push_back((11 * i + 7 * k) % particles);
            o.row_weight.push_back(0.25 + 0.1 * unit(random));
        }
        o.row_begin.push_back(static_cast<std::int32_t>(o.row_carrier.size()));
    }
    const int rows = kind == Kind::group ? 5 : particles;
    for (int p = 0; kind == Kind::group && p < particles; ++p) {
        o.reach_row.push_back(p % 6 - 1);  // one in six is not pulled
    }
    o.reach_begin = {0};
    for (int n = 0; n < rows; ++n) {
        for (int i = n % 2; i < static_cast<int>(channels); ++i) {
            o.reach_channel.push_back(i);
            for (int k = 0; k < (kind == Kind::number ? 1 : 9); ++k) {
                o.reach_weight.push_back((k % 4 == 0 ? 0.3 : 0.0) + 0.2 * unit(random));
            }
        }
        o.reach_begin.push_back(static_cast<std::int32_t>(o.reach_channel.size()));
    }
    // Far harder than any memory of frames asks for, so that it shows in a few substeps.
    o.stiffness = 1e5;
    o.damping = 6e2;
    o.share.assign(static_cast<std::size_t>(frames) * channels, 1.0);
    o.share[channels - 1] = 0.0;
    for (std::size_t k = 0; k < 12 * channels * static_cast<std::size_t>(frames); ++k) {
        s.body.fields.target.push_back(static_cast<T>(2e-3 * unit(random)));
    }
    return s;
}

std::size_t number_of(const std::string& name) {
    return static_cast<std::size_t>(std::find(Fields<double>::names.begin(), Fields<double>::names.end(), name) - Fields<double>::names.begin());
}

/// A direction of one field alone.
Fields<double> along(const Fields<double>& fields, const std::string& name, unsigned seed = 12) {
    Fields<double> all = random_direction(fields, seed), one;
    *one.all()[number_of(name)] = *all.all()[number_of(name)];
    return one;
}

const char* const every_field[] = {"mu", "lambda", "stress_volume", "mass", "deformation0", "gravity", "displacement0", "velocity0", "target"};

class MlsPull : public testing::TestWithParam<Kind> {};
INSTANTIATE_TEST_SUITE_P(Observer, MlsPull, testing::Values(Kind::number, Kind::matrix, Kind::group));

/// On the hot path, held or not, and on the general one.
TEST_P(MlsPull, AdjointIsTheTransposeOfTheTangent) {
    for (const int path : {0, 1, 2}) {
        auto s = scene<double>({4, 5, 9}, {6, 7}, path > 0, GetParam());
        if (path < 2) {
            s.body.fields.node_force.clear();
        } else {
            s.body.settings.active[test::effect_index("viscosity")] = true;
        }
        const auto model = s.body.model();
        const auto& fields = s.body.fields;
        const auto bar = random_bar(s.run(fields), 3);
        Fields<double> gradient = model.adjoint(fields, s.body.schedule, bar, {}, nullptr, &s.observer);
        std::vector<Fields<double>> directions;
        for (const std::string name : every_field) {
            directions.push_back(along(fields, name));
        }
        const auto slopes = model.tangent(fields, directions, s.body.schedule, {}, &s.observer);
        for (std::size_t d = 0; d < directions.size(); ++d) {
            const std::string name = every_field[d];
            Fields<double>& one = directions[d];
            const std::size_t at = number_of(name);
            const double by_tangent = product(bar, slopes[d + 1]);
            double by_adjoint = 0, scale = 0;
            for (std::size_t i = 0; i < one.all()[at]->size(); ++i) {
                by_adjoint += (*gradient.all()[at])[i] * (*one.all()[at])[i];
                scale += std::abs((*gradient.all()[at])[i] * (*one.all()[at])[i]);
            }
            EXPECT_GT(std::abs(by_tangent), 0) << name;
            EXPECT_NEAR(by_tangent, by_adjoint, 1e-10 * scale) << name << " on path " << path;
        }
    }
}

TEST_P(MlsPull, TangentsFollowDifferencesAloneAndInManyLanes) {
    auto s = scene<double>({3, 4, 6}, {5, 4}, true, GetParam());
    s.body.settings.active[test::effect_index("viscosity")] = true;
    const auto model = s.body.model();
    const auto& fields = s.body.fields;
    const auto bar = random_bar(s.run(fields), 11);
    std::vector<Fields<double>> directions;
    for (const std::string name : every_field) {
        directions.push_back(along(fields, name));
    }
    const auto lanes = model.tangent(fields, directions, s.body.schedule, {}, &s.observer);
    for (std::size_t d = 0; d < directions.size(); ++d) {
        const auto at = [&](double step) {
            Fields<double> moved = fields, direction = directions[d];
            for (std::size_t i = 0; i < Fields<double>::count; ++i) {
                for (std::size_t k = 0; k < direction.all()[i]->size(); ++k) {
                    (*moved.all()[i])[k] += step * (*direction.all()[i])[k];
                }
            }
            return product(bar, s.run(moved));
        };
        const double step = 1e-4, differences = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step);
        const double alone = product(bar, model.tangent(fields, {directions[d]}, s.body.schedule, {}, &s.observer)[1]);
        EXPECT_NEAR(alone, differences, 2e-6 * std::abs(differences) + 1e-8) << every_field[d];
        EXPECT_NEAR(product(bar, lanes[d + 1]), alone, 1e-9 * std::abs(alone)) << every_field[d];
    }
}

/// An effect at its null goes the general way, a tangent node by node: all must agree with the hot path.
TEST_P(MlsPull, AllPathsAgree) {
    auto s = scene<double>({4, 5, 9}, {12, 8}, true, GetParam());
    s.body.fields.node_force.clear();
    const auto hot = s.run(s.body.fields);
    const auto tangent = s.body.model().tangent(s.body.fields, {Fields<double>{}}, s.body.schedule, {}, &s.observer)[0];
    Fields<double> plain = s.body.fields;
    plain.target.clear();
    const auto free = s.body.model().simulate(plain, s.body.schedule);
    s.body.settings.active[test::effect_index("gravity")] = true;
    s.body.fields.effect.assign(s.body.fields.effect.size(), 0.0);
    const auto general = s.run(s.body.fields);
    double change = 0;
    for (std::size_t i = 0; i < hot.position.size(); ++i) {
        EXPECT_NEAR(hot.position[i], general.position[i], 1e-14);
        EXPECT_NEAR(hot.position[i], tangent.position[i], 1e-14);
        EXPECT_NEAR(hot.velocity[i], general.velocity[i], 1e-11);
        change = std::max(change, std::abs(hot.position[i] - free.position[i]));
    }
    EXPECT_GT(change, 1e-5);
}

TEST(MlsObserver, FloatFollowsDouble) {
    const auto narrow = scene<float>({4, 5, 9}, {12, 8}, true, Kind::group);
    const auto wide = scene<double>({4, 5, 9}, {12, 8}, true, Kind::group);
    const auto x = narrow.run(narrow.body.fields);
    const auto y = wide.run(wide.body.fields);
    for (std::size_t i = 0; i < x.velocity.size(); ++i) {
        EXPECT_NEAR(static_cast<double>(x.velocity[i]), y.velocity[i], 1e-4);
    }
    const auto bar = random_bar(y, 2);
    const ParticleTrajectory<float> rounded{{bar.position.begin(), bar.position.end()}, {bar.velocity.begin(), bar.velocity.end()}, {}};
    const auto g = narrow.body.model().adjoint(narrow.body.fields, narrow.body.schedule, rounded, {}, nullptr, &narrow.observer).target;
    const auto h = wide.body.model().adjoint(wide.body.fields, wide.body.schedule, {bar.position, bar.velocity, {}}, {}, nullptr, &wide.observer).target;
    double error = 0, size = 0;
    for (std::size_t i = 0; i < h.size(); ++i) {
        error += std::pow(static_cast<double>(g[i]) - h[i], 2);
        size += h[i] * h[i];
    }
    EXPECT_GT(size, 0);
    EXPECT_LT(std::sqrt(error), 1e-3 * std::sqrt(size));
}

TEST(MlsObserver, ThreadsAndCheckpointsDoNotShowInTheBits) {
    auto s = scene<double>({8, 8, 24}, {6, 7}, true, Kind::matrix);
    const auto bar = random_bar(s.run(s.body.fields), 2);
    const auto outcome = [&](int threads, std::size_t budget) {
        s.body.settings.threads = threads;
        s.body.settings.memory_budget = budget;
        long recomputed = 0;
        Fields<double> gradient = s.body.model().adjoint(s.body.fields, s.body.schedule, bar, {}, &recomputed, &s.observer);
        EXPECT_EQ(recomputed > 0, budget == 1);
        const auto t = s.body.model().tangent(s.body.fields, {along(s.body.fields, "target")}, s.body.schedule, {}, &s.observer);
        std::vector<std::vector<double>> numbers{s.run(s.body.fields).position, t[1].position};
        for (const auto* field : gradient.all()) {
            numbers.push_back(*field);
        }
        return numbers;
    };
    const auto one = outcome(1, std::size_t(1) << 30);
    EXPECT_EQ(one, outcome(3, std::size_t(1) << 30));
    EXPECT_EQ(one, outcome(2, 1));
}

TEST(MlsObserver, WithoutSharesItIsAFreeRunToTheBit) {
    auto s = scene<float>({4, 5, 9}, {6, 7}, true, Kind::number);
    Fields<float> plain = s.body.fields;
    plain.target.clear();
    const auto free = s.body.model().simulate(plain, s.body.schedule);
    EXPECT_NE(free.position, s.run(s.body.fields).position);
    std::fill(s.observer.share.begin(), s.observer.share.end(), 0.0);
    EXPECT_EQ(free.position, s.run(s.body.fields).position);
    // What is asked for in the second interval shows in it alone.
    std::fill(s.observer.share.begin() + channels, s.observer.share.end(), 1.0);
    const auto later = s.run(s.body.fields);
    const std::size_t first = 2 * 3 * s.body.geometry.particle_count();
    const auto head = [&](const std::vector<float>& x) { return std::vector<float>(x.begin(), x.begin() + static_cast<std::ptrdiff_t>(first)); };
    EXPECT_EQ(head(free.velocity), head(later.velocity));
    EXPECT_NE(free.position, later.position);
}

/// A free body whose particles are all pulled towards a rigid shift y: e'' + 2 w e' + w^2 e = 0, e(0) = y, so
/// e = y (1 + w t) exp(-w t). The largest difference from it, as a share of y; substeps: `finer` times as many.
double off_the_closed_form(int finer) {
    const double w = 40.0, shift[3] = {2e-3, -1e-3, 5e-4};
    auto s = scene<double>({4, 4, 6}, {finer * 50, finer * 80, finer * 40}, false, Kind::group);
    auto& f = s.body.fields;
    s.body.schedule.dt = {2e-4 / finer, 1.5e-4 / finer, 2e-4 / finer};
    for (auto* field : {&f.deformation0, &f.displacement0, &f.velocity0, &f.node_force}) {
        field->clear();
    }
    f.gravity.assign(3, 0.0);
    Observer& o = s.observer;
    o.row_begin = {0, 3};
    o.row_carrier = {1, 20, 70};
    o.row_weight = {0.5, 0.25, 0.25};
    o.reach_row.assign(s.body.geometry.particle_count(), 0);
    o.reach_begin = {0, 1};
    o.reach_channel = {0};
    o.reach_weight = {1.0};
    o.stiffness = w * w;
    o.damping = 2 * w;
    o.share.assign(3, 1.0);
    f.target.assign(36, 0.0);
    for (std::size_t k = 0; k < 9; ++k) {
        f.target[12 * (k / 3) + k % 3] = shift[k % 3];
    }
    const auto t = s.run(f);
    const std::size_t size = 3 * s.body.geometry.particle_count();
    double time = 0, worst = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        time += s.body.schedule.steps[k] * s.body.schedule.dt[k];
        const double left = (1 + w * time) * std::exp(-w * time);
        for (std::size_t i = 0; i < size; ++i) {
            const double u = t.position[(k + 1) * size + i] - s.body.geometry.points[i];
            worst = std::max(worst, std::abs((shift[i % 3] - u) / shift[i % 3] - left));
        }
    }
    return worst;
}

TEST(MlsObserver, AFreeBodyFollowsItsTargetAsACriticallyDampedOscillator) {
    const double coarse = off_the_closed_form(1), fine = off_the_closed_form(4);
    EXPECT_LT(coarse, 5e-3);
    // Of first order in the substep, and of nothing else.
    EXPECT_NEAR(coarse / fine, 4.0, 0.2);
}

/// A constant pull on all particles changes the momentum by what it asks for, held or padded ones left out.
TEST(MlsObserver, WhatIsAskedForIsGiven) {
    auto s = scene<double>({4, 5, 6}, {1, 1}, false, Kind::group);
    s.body.fields.node_force.clear();
    s.observer.damping = 0;
    Fields<double> plain = s.body.fields;
    plain.target.clear();
    const auto pulled = s.run(s.body.fields), free = s.body.model().simulate(plain, s.body.schedule);
    // After one substep: m dt G share k (y_0 - H u_0), y_0 the constant of the polynomials.
    const auto& o = s.observer;
    const auto& f = s.body.fields;
    double wanted[3] = {}, got[3] = {}, asked[channels][3];
    for (std::size_t i = 0; i < channels; ++i) {
        for (std::size_t c = 0; c < 3; ++c) {
            double e = f.target[12 * i + c];
            for (auto r = static_cast<std::size_t>(o.row_begin[i]); r < static_cast<std::size_t>(o.row_begin[i + 1]); ++r) {
                e -= o.row_weight[r] * f.displacement0[3 * static_cast<std::size_t>(o.row_carrier[r]) + c];
            }
            asked[i][c] = o.share[i] * o.stiffness * e;
        }
    }
    const std::size_t count = s.body.geometry.particle_count();
    for (std::size_t p = 0; p < count; ++p) {
        for (std::size_t c = 0; c < 3; ++c) {
            got[c] += f.mass[p] * (pulled.velocity[3 * (count + p) + c] - free.velocity[3 * (count + p) + c]);
        }
        const std::int32_t row = o.reach_row[p];
        for (std::int32_t r = row < 0 ? 0 : o.reach_begin[static_cast<std::size_t>(row)];
             row >= 0 && r < o.reach_begin[static_cast<std::size_t>(row) + 1]; ++r) {
            const auto at = static_cast<std::size_t>(r);
            for (std::size_t k = 0; k < 9; ++k) {
                wanted[k / 3] += f.mass[p] * s.body.schedule.dt[0] * o.reach_weight[9 * at + k] * asked[static_cast<std::size_t>(o.reach_channel[at])][k % 3];
            }
        }
    }
    for (std::size_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(got[c], wanted[c], 1e-11 * std::abs(wanted[c]));
    }
}

TEST(MlsObserver, RefusesWhatDoesNotFit) {
    const auto s = scene<double>({3, 3, 4}, {2}, false, Kind::group);
    const auto refused = [&](const std::string& expected, auto change) {
        auto broken = s;
        change(broken);
        const auto named = [&](auto run) {
            try {
                run();
                ADD_FAILURE() << "not refused: " << expected;
            } catch (const std::invalid_argument& error) {
                EXPECT_NE(std::string(error.what()).find(expected), std::string::npos) << error.what();
            }
        };
        const auto model = s.body.model();
        const auto& f = broken.body.fields;
        named([&] { model.simulate(f, s.body.schedule, {}, &broken.observer); });
        named([&] { model.tangent(f, {Fields<double>{}}, s.body.schedule, {}, &broken.observer); });
        named([&] { model.adjoint(f, s.body.schedule, {}, {}, nullptr, &broken.observer); });
    };
    refused("target must be", [](auto& b) { b.body.fields.target.pop_back(); });
    refused("reach_row must be", [](auto& b) { b.observer.reach_row.pop_back(); });
    refused("reach_row names a row out of range", [](auto& b) { b.observer.reach_row[0] = 5; });
    refused("reach_row names a row out of range", [](auto& b) { b.observer.reach_row[0] = -2; });
    refused("row names a number out of range", [](auto& b) { b.observer.row_carrier[0] = 36; });
    EXPECT_THROW(s.body.model().simulate(s.body.fields, s.body.schedule), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
