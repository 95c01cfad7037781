// What holds exert in MLS-MPM: the balance of momentum, the tangent against differences, the adjoint against the tangent.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "mls_mpm_case.hpp"

namespace mphygs {
namespace {

constexpr std::array<int, 3> shape{4, 3, 6};

test::MlsCase<double> asking_case(bool effects) {
    test::MlsCase<double> c = test::mls_case<double>(shape, {3, 4}, true);
    c.geometry.hold_centre = {0.004, 0.003, -0.002};
    for (std::size_t i = 0; effects && i < c.settings.active.size(); ++i) {
        c.settings.active[i] = Registry::infos[i]->site != Site::hold;
    }
    std::mt19937 random(3);
    std::uniform_real_distribution<double> unit(0.05, 0.3);
    for (int i = 0; i < 2 * c.schedule.total_steps(); ++i) {
        c.schedule.reaction_weight.push_back(unit(random));
    }
    return c;
}

double dot(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

std::vector<Fields<double>> directions(const Fields<double>& like, bool effects) {
    std::vector<Fields<double>> all;
    Fields<double> everything = test::random_direction(like, 5);
    if (!effects) {
        everything.effect.clear();
        everything.place_effect.clear();
        everything.place_mass.clear();
    }
    all.push_back(everything);
    Fields<double> mass, pose;
    mass.mass = everything.mass;
    pose.pose = everything.pose;
    for (double& x : pose.pose) {
        x *= 1e-3;
    }
    all.push_back(mass);
    all.push_back(pose);
    return all;
}

class MlsReaction : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Effects, MlsReaction, testing::Bool());

TEST_P(MlsReaction, AdjointIsTheTransposeOfTheTangent) {
    const auto c = asking_case(GetParam());
    const auto model = c.model();
    const auto all = directions(c.fields, GetParam());
    const auto t = model.tangent(c.fields, all, c.schedule);
    ASSERT_EQ(t[0].reaction.size(), 18u);
    std::mt19937 random(4);
    std::uniform_real_distribution<double> unit(-1, 1);
    ParticleTrajectory<double> seed;
    for (std::size_t i = 0; i < t[0].reaction.size(); ++i) {
        seed.reaction.push_back(unit(random));
    }
    Fields<double> gradient = model.adjoint(c.fields, c.schedule, seed);
    for (std::size_t i = 0; i < all.size(); ++i) {
        Fields<double> direction = all[i];
        double by_adjoint = 0;
        for (std::size_t k = 0; k < Fields<double>::count; ++k) {
            by_adjoint += dot(*gradient.all()[k], *direction.all()[k]);
        }
        const double by_tangent = dot(seed.reaction, t[i + 1].reaction);
        EXPECT_NE(by_tangent, 0.0);
        EXPECT_NEAR(by_adjoint, by_tangent, 1e-9 * std::abs(by_tangent)) << i;
    }
}

TEST_P(MlsReaction, TangentAgreesWithCentralDifferences) {
    const auto c = asking_case(GetParam());
    const auto model = c.model();
    const auto all = directions(c.fields, GetParam());
    const auto t = model.tangent(c.fields, all, c.schedule);
    for (std::size_t i = 0; i < all.size(); ++i) {
        double best = std::numeric_limits<double>::infinity();
        for (const double h : {1e-5, 1e-6, 1e-7}) {
            const auto at = [&](double step) {
                Fields<double> moved = c.fields, d = all[i];
                for (std::size_t k = 0; k < Fields<double>::count; ++k) {
                    for (std::size_t n = 0; n < d.all()[k]->size(); ++n) {
                        (*moved.all()[k])[n] += step * (*d.all()[k])[n];
                    }
                }
                return model.simulate(moved, c.schedule).reaction;
            };
            const std::vector<double> ahead = at(h), behind = at(-h);
            double error = 0, size = 0;
            for (std::size_t n = 0; n < ahead.size(); ++n) {
                const double difference = (ahead[n] - behind[n]) / (2 * h);
                error += (t[i + 1].reaction[n] - difference) * (t[i + 1].reaction[n] - difference);
                size += difference * difference;
            }
            best = std::min(best, std::sqrt(error / size));
        }
        EXPECT_LT(best, 1e-5) << i;
    }
}

TEST(MlsReactions, AreWhatTheFreeParticlesLoseOfTheirMomentum) {
    auto c = asking_case(false);
    c.fields.node_force.clear();
    c.schedule.reaction_weight = {0, 1.0 / 3, 0, 1.0 / 3, 0, 1.0 / 3, 0, 0.25, 0, 0.25, 0, 0.25, 0, 0.25};  // means of intervals
    const auto found = c.model().simulate(c.fields, c.schedule);
    const std::size_t count = c.geometry.particle_count();
    for (std::size_t f = 0; f < 2; ++f) {
        for (std::size_t a = 0; a < 3; ++a) {
            double change = 0, mass = 0;
            for (std::size_t p = 0; p < count; ++p) {
                if (c.geometry.hold[p] < 0) {
                    change += c.fields.mass[p] * (found.velocity[((f + 1) * count + p) * 3 + a] - found.velocity[(f * count + p) * 3 + a]);
                    mass += c.fields.mass[p];
                }
            }
            const double force = change / (c.schedule.steps[f] * c.schedule.dt[f]) - mass * c.fields.gravity[a];
            EXPECT_NEAR(found.reaction[6 * (f + 1) + a], force, 1e-7 * std::abs(force)) << f << a;
        }
    }
}

TEST(MlsReactions, LeaveTheMotionAsItIs) {
    auto c = asking_case(false);
    const auto with = c.model().simulate(c.fields, c.schedule);
    c.schedule.reaction_weight.clear();
    const auto without = c.model().simulate(c.fields, c.schedule);
    EXPECT_TRUE(without.reaction.empty());
    for (std::size_t i = 0; i < with.position.size(); ++i) {
        EXPECT_NEAR(with.position[i], without.position[i], 1e-13);
    }
}

}  // namespace
}  // namespace mphygs
