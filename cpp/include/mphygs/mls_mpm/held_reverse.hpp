// What held particles give and take, backwards: the reactions of the holds.
#pragma once

#include "mphygs/mls_mpm/step_reverse.hpp"

namespace mphygs {

template <class T>
inline typename MlsStepReverse<T>::HeldBars MlsStepReverse<T>::held_bars(const MlsOrder<T>& order, std::size_t first, int substep, double sign, const Vec3<P>& u, const Vec3<P>& momentum,
                                                                         std::vector<double>& pose, std::size_t stride, std::size_t at) const {
    HeldBars bars;
    const std::size_t s = static_cast<std::size_t>(substep), own = static_cast<std::size_t>(model_.geometry_.hold_count) * wrench_size;
    const double quarter = 0.25 * model_.geometry_.spacing * model_.geometry_.spacing;
    run_.forces_.each_held(order, first, [&](int q, std::size_t hold, std::size_t id) {
        double wrench[wrench_size] = {}, arm[3], arm_bar[3];
        for (std::size_t side = 0; side < 2; ++side) {
            const double share = sign * schedule_.reaction_weight[2 * s + side] / table_.dt[s];
            for (std::size_t i = 0; i < wrench_size; ++i) {
                wrench[i] += share * bar_.reaction[(static_cast<std::size_t>(table_.frame[s]) + side) * own + hold * wrench_size + i];
            }
        }
        for (std::size_t c = 0; c < 3; ++c) {
            arm[c] = model_.geometry_.points[3 * id + c] + static_cast<double>(u[static_cast<int>(c)][q]) - run_.centre(0, hold, substep, c);
        }
        const double* torque = wrench + 3;
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
            const int i = static_cast<int>(c), j = static_cast<int>(a), k = static_cast<int>(b);
            bars.momentum[i][q] = static_cast<T>(wrench[c] + torque[a] * arm[b] - torque[b] * arm[a]);
            arm_bar[c] = static_cast<double>(momentum[j][q]) * torque[b] - static_cast<double>(momentum[k][q]) * torque[a];
            bars.arm[i][q] = static_cast<T>(arm_bar[c]);
            bars.affine.e[k][j][q] += static_cast<T>(quarter * torque[c]);
            bars.affine.e[j][k][q] -= static_cast<T>(quarter * torque[c]);
        }
        for (std::size_t c = 0; c < 3; ++c) {
            double* to = &pose[stride * hold + at];
            to[9 + c] -= arm_bar[c];
            for (std::size_t j = 0; j < 3; ++j) {
                to[3 * c + j] -= arm_bar[c] * model_.geometry_.hold_centre[3 * hold + j];
            }
        }
    });
    return bars;
}

template <class T>
inline Vec3<Pack<T>> MlsStepReverse<T>::reverse_taken(std::size_t c, int n, const MlsOrder<T>& order, std::size_t p, T h, const ParticlePoint<P>& point,
                                                      ParticlePoint<P>& bar) {
    const P mass = run_.forces_.fixed(order, fixed_mass, p);
    const Vec3<P> before = point.u - broadcast<T>(h) * point.v;
    const HeldBars held = held_bars(order, p, n, -1.0, before, mass * point.v, taken_pose_[c], 12, 0);
    bar.v = bar.v + mass * held.momentum;
    bar.c = bar.c + mass * held.affine;
    T* mass_bar = particles_.at(fixed_mass, p);
    store<T>(mass_bar, load<T>(mass_bar) + dot(held.momentum, point.v) + inner(held.affine, point.c));
    return held.arm;
}

}  // namespace mphygs
