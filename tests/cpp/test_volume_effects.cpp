// Effects of the volume on their own terms: what each adds, and how they add to one another.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "mphygs/physics/registry.hpp"
#include "random_numbers.hpp"

namespace mphygs {
namespace {

using M = Mat3<double>;
constexpr double mu = 4e3, lambda = 9e3, dt = 1e-3;

/// One material point with some effects switched on, driven by a list of deformations.
struct Point {
    Slots slots;
    std::vector<double> parameters, uniforms, history;
    Law law = Law::neo_hookean;
    double time = 0;
    VolumePoint<double> point;

    explicit Point(const std::vector<std::string>& effects) {
        std::vector<bool> active;
        for (const EffectInfo* info : Registry::infos) {
            bool on = false;
            for (const std::string& name : effects) {
                on |= name == info->name;
            }
            active.push_back(on);
            for (int k = 0; k < info->parameter_count(); ++k) {
                parameters.push_back(info->parameters[k].null);
            }
        }
        slots = make_slots(active);
        uniforms.resize(static_cast<std::size_t>(Registry::total_uniform_count));
        history.assign(static_cast<std::size_t>(active_sites(slots).history), 0.0);
    }
    double& parameter(const std::string& effect, const std::string& name) {
        std::size_t k = 0;
        for (const EffectInfo* info : Registry::infos) {
            for (int i = 0; i < info->parameter_count(); ++i, ++k) {
                if (effect == info->name && name == info->parameters[i].name) {
                    return parameters[k];
                }
            }
        }
        throw std::invalid_argument(effect + "." + name);
    }
    /// Stress at this deformation; the history moves on.
    M stress(const M& deformation, const M& rate = {}) {
        all_uniforms(slots, parameters.data(), time, dt, uniforms.data());
        point = {};
        point.deformation = deformation;
        point.rate = rate;
        point.mu = mu;
        point.lambda = lambda;
        point.law = law;
        point.time = time;
        point.dt = dt;
        std::vector<double> next(history);
        evaluate_volume(slots, uniforms.data(), point, history.data(), next.data());
        history = next;
        time += dt;
        return point.stress;
    }
};

void expect_near(const M& a, const M& b, double tolerance) {
    for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(a[i / 3][i % 3], b[i / 3][i % 3], tolerance) << i;
    }
}

/// dW/dF by central differences of an energy of the elastic part F exp(-rate t).
template <class Energy>
M slope_of(const M& f, double q, Energy&& energy) {
    M p;
    for (int i = 0; i < 9; ++i) {
        M plus = f, minus = f;
        plus[i / 3][i % 3] += 1e-6;
        minus[i / 3][i % 3] -= 1e-6;
        p[i / 3][i % 3] = (energy(M(q * plus)) - energy(M(q * minus))) / 2e-6;
    }
    return p;
}

TEST(VolumeEffects, StressOfAStoredEnergyIsItsDerivativeUnderGrowthToo) {
    test::Random random(1);
    const M f = random.deformation(0.2);
    const double a[3] = {0.36, 0.48, 0.8};
    const double fibre = 3e4, second = 2e4, growth = 0.3, time = 0.7;
    const auto elastic = [](const M& e) { return elastic_energy(Law::neo_hookean, e, mu, lambda); };
    const auto along = [&](const M& e) {
        const Vec3<double> ea = e * Vec3<double>{{a[0], a[1], a[2]}};
        return 0.5 * fibre * (dot(ea, ea) - 1) * (dot(ea, ea) - 1);
    };
    const auto stiffer = [&](const M& e) {
        const double j = determinant(e, cofactor(e));
        const double i1 = std::pow(j, -2.0 / 3.0) * inner(e, e) - 3;
        return second * i1 * i1;
    };
    for (const bool grown : {false, true}) {
        const double q = grown ? std::exp(-growth * time) : 1.0;
        const auto with = [&](const std::string& name) {
            std::vector<std::string> effects{name};
            if (grown) {
                effects.push_back("eigenstrain");
            }
            Point p(effects);
            p.time = time;
            p.parameter("eigenstrain", "rate") = growth;
            p.parameter("fibre", "k_f") = fibre;
            p.parameter("fibre", "a_x") = a[0];
            p.parameter("fibre", "a_y") = a[1];
            p.parameter("fibre", "a_z") = a[2];
            p.parameter("stiffening", "c_2") = second;
            return p.stress(f);
        };
        const M base = slope_of(f, q, elastic);
        expect_near(with("stiffening"), base + slope_of(f, q, stiffer), 1e-3);
        expect_near(with("fibre"), base + slope_of(f, q, along), 1e-3);
    }
}

TEST(VolumeEffects, ViscosityResistsStretchingAndNotRotation) {
    Point p({"viscosity"});
    p.parameter("viscosity", "eta") = 50;
    M spin;
    spin[0][1] = -2;
    spin[1][0] = 2;
    const M r = test::rotation_about(0, 0, 1, 0.4);
    expect_near(p.stress(r, M(spin * r)), M{}, 1e-9);
    M shear;
    shear[0][1] = 3;  // Cauchy stress 2 eta D, D_xy = 3/2
    const M stress = p.stress(M::identity(), shear);
    EXPECT_NEAR(stress[0][1], 150, 1e-9);
    EXPECT_NEAR(stress[1][0], 150, 1e-9);
    const M swelling = p.stress(M::identity(), M(2.0 * M::identity()));
    expect_near(swelling, M{}, 1e-9);  // deviatoric only
}

TEST(VolumeEffects, RelaxationDecaysToTheElasticStress) {
    Point p({"relaxation"});
    const double ratio = 0.5, tau = 0.02;
    p.parameter("relaxation", "ratio") = ratio;
    p.parameter("relaxation", "tau") = tau;
    p.stress(M::identity());
    test::Random random(2);
    const M f = random.deformation(0.05);
    const M elastic = elastic_stress(Law::neo_hookean, f, mu, lambda);
    const M first = p.stress(f);
    expect_near(first, (1 + ratio * std::exp(-dt / (2 * tau))) * elastic, 1e-9);  // a step loads the branch
    for (int n = 1; n < 30; ++n) {
        p.stress(f);
    }
    expect_near(p.stress(f), (1 + ratio * std::exp(-(30 + 0.5) * dt / tau)) * elastic, 1e-9);
    for (int n = 0; n < 1000; ++n) {
        p.stress(f);
    }
    expect_near(p.stress(f), elastic, 1e-9);
}

TEST(VolumeEffects, ASlowRelaxationOfAGrownPointIsTheSameShareOfItsStress) {
    // With tau beyond reach the branch is a second spring of `ratio` times the first, grown or not.
    Point p({"relaxation", "eigenstrain"}), alone({"eigenstrain"});
    p.parameter("relaxation", "ratio") = 0.5;
    p.parameter("relaxation", "tau") = 1e12;
    const double growth = 0.3;
    p.parameter("eigenstrain", "rate") = alone.parameter("eigenstrain", "rate") = growth;
    p.time = alone.time = 1.0;
    p.stress(M(std::exp(growth) * M::identity()));  // free of stress: the branch starts relaxed
    alone.time = p.time;
    test::Random random(3);
    const M f = random.deformation(0.2);
    expect_near(p.stress(f), 1.5 * alone.stress(f), 1e-8);
}

TEST(VolumeEffects, PlasticityKeepsTheYieldStressAndLeavesASet) {
    for (const Law law : {Law::neo_hookean, Law::fixed_corotated}) {
        Point p({"plasticity"});
        p.law = law;
        const double yield = 100;
        p.parameter("plasticity", "yield_stress") = yield;
        M f = M::identity();
        double j = 1;
        M kirchhoff;
        for (int n = 0; n < 400; ++n) {
            f[0][1] += 2.5e-4;  // simple shear, to 0.1: the yield strain is 0.014
            kirchhoff = p.stress(f) * transpose(f);
            j = determinant(p.point.factor, cofactor(p.point.factor));
        }
        const double mean = trace(kirchhoff) / 3;
        for (int i = 0; i < 3; ++i) {
            kirchhoff[i][i] -= mean;
        }
        EXPECT_NEAR(std::sqrt(1.5 * inner(kirchhoff, kirchhoff)), yield, 0.02 * yield);  // von Mises
        EXPECT_NEAR(j, 1.0, 1e-4);  // the plastic flow keeps the volume
        f[0][1] = 0.1 - 0.005;
        const M unloading = p.stress(f) * transpose(f);
        EXPECT_NEAR(kirchhoff[0][1] - unloading[0][1], mu * 0.005, 0.1 * mu * 0.005);  // elastic again
        EXPECT_GT(p.stress(M::identity())[1][0] * -1, 0.5 * yield / std::sqrt(3.0));   // back at the start: set
    }
}

TEST(VolumeEffects, EigenstrainIsFreeOfStressAtItsOwnSize) {
    Point p({"eigenstrain"});
    p.parameter("eigenstrain", "rate") = 0.2;
    p.time = 0.5;
    expect_near(p.stress(M(std::exp(0.1) * M::identity())), M{}, 1e-9);
    EXPECT_LT(p.stress(M::identity())[0][0], -100.0);  // held back: pressure
}

TEST(VolumeEffects, PaperPrestressCancelsGravityAtRestAndTurnsWithThePart) {
    Point p({"prestress"});
    p.parameter("prestress", "g_z") = -9.81;
    p.stress(M::identity());
    EXPECT_NEAR(p.point.acceleration[2], 9.81, 1e-12);
    const M r = test::rotation_about(1, 0, 0, 0.5 * 3.14159265358979);
    p.stress(r);
    EXPECT_NEAR(p.point.acceleration[1], -9.81, 1e-9);
    EXPECT_NEAR(p.point.acceleration[2], 0.0, 1e-9);
}

}  // namespace
}  // namespace mphygs
