// The paper's prestress: f_ext = m g + Q f_int0, f_int0 = -m g, Q the polar rotation of F.
//
// Only the second term stands here; m g is the model's gravity. The parameters are the gravity
// that the rest shape carries: zero is off.
// Source: M-PhyGs (Wada, Yamashita, Kawahara, Nishino), the section on forward dynamics.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Prestress {
    static constexpr EffectInfo info{
        .name = "prestress",
        .summary = "the paper's stored internal force, turning with the part",
        .site = Site::volume,
        .carries_gravity = true,
        .parameters = {{"g_x", "m/s^2", 0, -100, 100, 1, false},
                       {"g_y", "m/s^2", 0, -100, 100, 1, false},
                       {"g_z", "m/s^2", 0, -100, 100, 1, false}},
    };
    template <class S>
    static void body(VolumePoint<S>& p, const S* q) {
        const Mat3<S> rotation = polar_rotation(p.deformation);
        const Vec3<S> carried{{q[0], q[1], q[2]}};
        p.acceleration = p.acceleration - rotation * carried;
    }
};

}  // namespace mphygs
