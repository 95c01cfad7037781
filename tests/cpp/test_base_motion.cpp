// A frame that accelerates: the harmonic, and the pulse that is its first half wave.
#include <gtest/gtest.h>

#include <cmath>

#include "mphygs/effects/base_motion.hpp"
#include "mphygs/numerics/dual.hpp"

namespace mphygs {
namespace {

constexpr double pi = 3.141592653589793;

/// Parameters of a wave along y: 3 m/s^2 at 2.5 Hz.
struct Wave {
    double phase, pulse;
    double at(double time) const {
        const double p[6] = {0, 3, 0, 2.5, phase, pulse};
        double q[3];
        BaseMotion::uniforms(p, time, 1e-3, q);
        EXPECT_EQ(q[0], 0.0);
        EXPECT_EQ(q[2], 0.0);
        return q[1];
    }
};

TEST(BaseMotion, HarmonicIsMinusAmplitudeTimesSine) {
    const Wave wave{0.4, 0};
    for (const double time : {0.0, 0.07, 0.31, 1.9}) {
        EXPECT_NEAR(wave.at(time), -3 * std::sin(2 * pi * 2.5 * time + 0.4), 1e-13);
    }
}

TEST(BaseMotion, PulseIsTheFirstHalfWaveAlone) {
    const double begin = 0.3, width = 0.2;
    const Wave pulse{-2 * pi * 2.5 * begin, 1}, harmonic{pulse.phase, 0};
    EXPECT_EQ(pulse.at(0), 0.0);
    EXPECT_EQ(pulse.at(begin - 1e-6), 0.0);
    EXPECT_EQ(pulse.at(begin + width + 1e-6), 0.0);
    EXPECT_NEAR(pulse.at(begin + 0.5 * width), -3.0, 1e-12);
    EXPECT_EQ(pulse.at(begin + 0.3 * width), harmonic.at(begin + 0.3 * width));
    EXPECT_NE(harmonic.at(begin + 1.3 * width), 0.0);
    // What it gives the object: the integral of a sine's half wave, 2 / pi of its height times its width.
    double speed = 0;
    const double dt = 1e-4;
    for (int k = 0; k < 10000; ++k) {
        speed += dt * pulse.at((k + 0.5) * dt);
    }
    EXPECT_NEAR(speed, -3 * 2 / pi * width, 1e-6);
}

TEST(BaseMotion, PulseHasDerivativesByHeightFrequencyAndPhaseWhileItActs) {
    using D = Dual<double, 6>;
    D p[6] = {D(0.5), D(3.0), D(-1.0), D(2.5), D(-4.0), D(1.0)};
    for (int k = 0; k < 6; ++k) {
        p[k].d[k] = 1;
    }
    const auto at = [&](double time) {
        D q[3];
        BaseMotion::uniforms(p, time, 1e-3, q);
        return q[1];
    };
    const double time = 0.3, angle = 2 * pi * 2.5 * time - 4.0;  // 0.71 rad: within
    const D inside = at(time), outside = at(0.6);
    EXPECT_NEAR(inside.d[1], -std::sin(angle), 1e-13);
    EXPECT_NEAR(inside.d[3], -3 * std::cos(angle) * 2 * pi * time, 1e-12);
    EXPECT_NEAR(inside.d[4], -3 * std::cos(angle), 1e-12);
    EXPECT_EQ(inside.d[5], 0.0);
    for (const int k : {0, 1, 2, 3, 4}) {
        EXPECT_EQ(outside.d[k], 0.0) << "parameter " << k;
    }
    EXPECT_NEAR(outside.d[5], 3 * std::sin(2 * pi * 2.5 * 0.6 - 4.0), 1e-12) << "the weight of the pulse";
}

}  // namespace
}  // namespace mphygs
