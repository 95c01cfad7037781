// The whole frame accelerates: body force -m a sin(2 pi f t + phase).
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct BaseMotion {
    static constexpr EffectInfo info{"base_motion", "the frame accelerates: -m a sin(2 pi f t + phase)", Site::body, false,
                                     false, 0, 5,
                                     {{"a_x", "m/s^2", 0, -100, 100, 0.5, true},
                                      {"a_y", "m/s^2", 0, -100, 100, 0.5, true},
                                      {"a_z", "m/s^2", 0, -100, 100, 0.5, true},
                                      {"f", "Hz", 2, 0, 1000, 1, true},
                                      {"phase", "rad", 0, -10, 10, 1, true}}};
    static constexpr int uniform_count = 3;
    template <class S>
    static void uniforms(const S* p, typename ScalarOf<S>::type time, typename ScalarOf<S>::type, S* q) {
        using R = typename ScalarOf<S>::type;
        const S wave = sine(p[3] * (R(6.283185307179586) * time) + p[4]);
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
