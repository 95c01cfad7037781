// Every elastic law: stress is the derivative of the energy, rotations store nothing, dual numbers.
#include <gtest/gtest.h>

#include <cmath>

#include "mphygs/material.hpp"
#include "random_numbers.hpp"

namespace mphygs {
namespace {

using M = Mat3<double>;

struct Material : testing::TestWithParam<int> {
    static Law GetParam() { return static_cast<Law>(testing::TestWithParam<int>::GetParam()); }
};
INSTANTIATE_TEST_SUITE_P(Laws, Material, testing::Range(0, AllLaws::count));

constexpr double mu = 4e3, lambda = 9e3;

TEST_P(Material, StressIsTheDerivativeOfTheEnergy) {
    test::Random random(1);
    for (int n = 0; n < 10; ++n) {
        const M f = random.deformation(0.3);
        const M p = elastic_stress(GetParam(), f, mu, lambda);
        double size = 0;
        for (int i = 0; i < 9; ++i) {
            M plus = f, minus = f;
            const double h = 1e-6;
            plus[i / 3][i % 3] += h;
            minus[i / 3][i % 3] -= h;
            const double slope = (elastic_energy(GetParam(), plus, mu, lambda) - elastic_energy(GetParam(), minus, mu, lambda)) / (2 * h);
            EXPECT_NEAR(p[i / 3][i % 3], slope, 1e-4);
            size += std::abs(slope);
        }
        EXPECT_GT(size, 100.0);
    }
}

TEST_P(Material, RotationTurnsTheStressAndKeepsTheEnergy) {
    test::Random random(2);
    const M f = random.deformation(0.3);
    const M r = test::rotation_about(1, 2, -1, 2.0);
    EXPECT_NEAR(elastic_energy(GetParam(), M(r * f), mu, lambda), elastic_energy(GetParam(), f, mu, lambda), 1e-9);
    EXPECT_NEAR(elastic_energy(GetParam(), M(f * r), mu, lambda), elastic_energy(GetParam(), f, mu, lambda), 1e-9);  // isotropic
    const M turned = elastic_stress(GetParam(), M(r * f), mu, lambda), expected = r * elastic_stress(GetParam(), f, mu, lambda);
    for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(turned[i / 3][i % 3], expected[i / 3][i % 3], 1e-8);
    }
}

TEST_P(Material, ARigidRotationStoresNothing) {
    const M r = test::rotation_about(1, -1, 0.5, 1.2);
    EXPECT_NEAR(elastic_energy(GetParam(), r, mu, lambda), 0.0, 1e-10);
    const M p = elastic_stress(GetParam(), r, mu, lambda);
    for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(p[i / 3][i % 3], 0.0, 1e-9);
    }
}

TEST_P(Material, SmallStrainsGiveHookesLaw) {
    test::Random random(3);
    const double size = 1e-6;
    M strain;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j <= i; ++j) {
            strain[i][j] = strain[j][i] = size * random.between(-1, 1);
        }
    }
    const M p = elastic_stress(GetParam(), M(M::identity() + strain), mu, lambda);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            const double hooke = 2 * mu * strain[i][j] + (i == j ? lambda * trace(strain) : 0.0);
            EXPECT_NEAR(p[i][j], hooke, 1e-4 * mu * size);
        }
    }
}

TEST_P(Material, TangentAgreesWithCentralDifferences) {
    test::Random random(4);
    using D = Dual<double, 1>;
    const M f = random.deformation(0.3), direction = random.deformation(1.0);
    const double dmu = 1.5e3, dlambda = -2e3, h = 1e-6;
    Mat3<D> dual;
    for (int i = 0; i < 9; ++i) {
        dual[i / 3][i % 3] = D(f[i / 3][i % 3]);
        dual[i / 3][i % 3].d[0] = direction[i / 3][i % 3];
    }
    D m(mu), l(lambda);
    m.d[0] = dmu;
    l.d[0] = dlambda;
    const Mat3<D> p = elastic_stress(GetParam(), dual, m, l);
    const D energy = elastic_energy(GetParam(), dual, m, l);
    const auto at = [&](double s) { return elastic_stress(GetParam(), M(f + s * direction), mu + s * dmu, lambda + s * dlambda); };
    const auto energy_at = [&](double s) { return elastic_energy(GetParam(), M(f + s * direction), mu + s * dmu, lambda + s * dlambda); };
    for (int i = 0; i < 9; ++i) {
        EXPECT_NEAR(p[i / 3][i % 3].d[0], (at(h)[i / 3][i % 3] - at(-h)[i / 3][i % 3]) / (2 * h), 1e-3);
    }
    EXPECT_NEAR(energy.d[0], (energy_at(h) - energy_at(-h)) / (2 * h), 1e-4);
}

}  // namespace
}  // namespace mphygs
