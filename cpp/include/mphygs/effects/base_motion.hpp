// The whole frame accelerates: body force -m a sin(2 pi f t + phase). As a pulse of weight 1 it does so during
// the first half wave alone, 0 <= 2 pi f t + phase <= pi: it begins at t = -phase / (2 pi f) and lasts 1 / (2 f).
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct BaseMotion {
    static constexpr EffectInfo info{
        .name = "base_motion",
        .summary = "the frame accelerates: -m a sin(2 pi f t + phase)",
        .site = Site::body,
        .parameters = {{"a_x", "m/s^2", 0, -100, 100, 0.5, true},
                       {"a_y", "m/s^2", 0, -100, 100, 0.5, true},
                       {"a_z", "m/s^2", 0, -100, 100, 0.5, true},
                       {"f", "Hz", 2, 0, 1000, 1, true, Role::frequency},
                       {"phase", "rad", 0, -1e5, 1e5, 1, true, Role::phase},
                       {"pulse", "-", 0, 0, 1, 1, false, Role::switch_}},
    };
    static constexpr int uniform_count = 3;
    template <class S>
    static void uniforms(const S* p, typename ScalarOf<S>::type time, typename ScalarOf<S>::type, S* q) {
        using R = typename ScalarOf<S>::type;
        const S angle = p[3] * (R(6.283185307179586) * time) + p[4];
        const auto at = value_of(angle);
        const auto zero = decltype(at){}, half_turn = zero + R(3.141592653589793);
        const S plain = sine(angle), after = plain * (R(1) - p[5]);
        const S wave = select(at >= zero, select(at <= half_turn, plain, after), after);
        for (int i = 0; i < 3; ++i) {
            q[i] = -p[i] * wave;
        }
    }
    template <class S>
    static Vec3<S> acceleration(const BodyPoint<S>&, const S* q) {
        return {{q[0], q[1], q[2]}};
    }
};

}  // namespace mphygs
