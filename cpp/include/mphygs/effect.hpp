// Physical effects: what an effect is, and the sites at which it may act.
//
// An effect is a struct in effects/<name>.hpp. It has `info` (name, parameters, units, null, bounds)
// and writes ONE of the functions below as a template over the scalar type; tangents come from
// running it on Dual numbers, adjoints from running it on Var numbers. The build collects all
// files of the folder into effect_list.hpp: adding a file adds the effect everywhere.
//
//   volume   static void strain(VolumePoint<S>&, const S* q)    changes the elastic deformation
//            static void stress(VolumePoint<S>&, const S* q)    adds first Piola-Kirchhoff stress
//            static void body(VolumePoint<S>&, const S* q)      adds acceleration of the particle
//            and, where dual numbers are too slow a way to the derivatives of `stress`,
//            struct Linearised<P>                               what it adds, and how that changes (see `VolumeChange`)
//   body     static Vec3<S> acceleration(const BodyPoint<S>&, const S* q)        [m/s^2]
//   surface  static Vec3<S> force(const SurfacePoint<S>&, const S* q)            [N]
//            and, where it acts on little of the surface, so that the rest is passed over,
//            static bool out_of_reach(const Vec3<P>& position, const P* q)   it is zero at all eight points
//            and, where it does not look at the position,
//            static constexpr bool reads_position = false                    for the sake of speed alone
//   point    static Vec3<S> force(const MaterialPoint<S>&, const S* q)           [N]
//   mass     no function: adds a mass at a material point (parameter 0) [kg]
//   hold     no function: acts on the holds, inside the integrator
//
// q are the effect's parameters, or, where it declares `uniform_count`, what
//            static void uniforms(const S* parameters, R time, R dt, S* q)
// makes of them once per substep (exponentials, harmonics).
//
// All of `info`, and what else an effect may say of itself, is in descriptor.hpp.
#pragma once

#include <concepts>
#include <cstddef>

#include "mphygs/material.hpp"
#include "mphygs/physics/descriptor.hpp"

namespace mphygs {

/// A quadrature point or particle, eight at a time.
template <class S>
struct VolumePoint {
    using R = typename ScalarOf<S>::type;
    Mat3<S> deformation;  // F [-], from the stress-free state
    Mat3<S> rate;         // dF/dt [1/s], where an active effect needs it
    Mat3<S> elastic;      // the part of F that stores energy
    Mat3<S> factor;       // elastic = deformation * factor
    bool strained = false;
    S mu, lambda;         // [Pa]
    Law law = usual_law;
    Mat3<S> stress;       // first Piola-Kirchhoff stress [Pa]
    Vec3<S> acceleration;  // further body force per mass [m/s^2]
    const S* history = nullptr;  // of this effect, before the substep
    S* history_next = nullptr;   // and after it
    R time = 0, dt = 0;          // [s]
};

/// A grid node (total Lagrangian) or particle (MLS-MPM), eight at a time.
template <class S>
struct BodyPoint {
    using R = typename ScalarOf<S>::type;
    Vec3<S> position;  // [m]
    Vec3<S> velocity;  // [m/s]
    R time = 0;        // [s]
};

/// A sample of the exposed surface, eight at a time.
template <class S>
struct SurfacePoint {
    using R = typename ScalarOf<S>::type;
    Vec3<S> position;  // [m]
    Vec3<S> velocity;  // [m/s]
    S area;            // at rest [m^2]
    R time = 0;        // [s]
};

/// A place on the object that an effect is tied to.
template <class S>
struct MaterialPoint {
    using R = typename ScalarOf<S>::type;
    Vec3<S> rest;      // [m]
    Vec3<S> position;  // [m]
    Vec3<S> velocity;  // [m/s]
    R time = 0;        // [s]
};

template <class E>
constexpr int uniform_count() {
    if constexpr (requires { E::uniform_count; }) {
        return E::uniform_count;
    } else {
        return E::info.parameter_count();
    }
}

template <class E, class S>
inline void effect_uniforms(const S* parameters, typename ScalarOf<S>::type time, typename ScalarOf<S>::type dt, S* q) {
    if constexpr (requires { E::uniform_count; }) {
        E::uniforms(parameters, time, dt, q);
    } else {
        for (int i = 0; i < E::info.parameter_count(); ++i) {
            q[i] = parameters[i];
        }
    }
}

template <class E, class S>
concept HasStrain = requires(VolumePoint<S>& p, const S* q) { E::strain(p, q); };
template <class E, class S>
concept HasStress = requires(VolumePoint<S>& p, const S* q) { E::stress(p, q); };
template <class E, class S>
concept HasBody = requires(VolumePoint<S>& p, const S* q) { E::body(p, q); };

template <class E, class P>
concept HasReach = requires(const Vec3<P>& x, const P* q) { E::out_of_reach(x, q); };

template <class E>
constexpr bool reads_position() {
    if constexpr (requires { E::reads_position; }) {
        return E::reads_position;
    } else {
        return true;
    }
}

/// Directions at a quadrature point, in the lanes of W; history is that of one effect, before and after the substep.
///
/// An effect's Linearised<P> is made of eight points at once,
///     Linearised(const VolumePoint<P>& p, const R* q, const P* history)   p.stress the law's alone, R the plain number,
/// holds `stress`, what the effect adds at these, and tells of point number i
///     template <class W> void change(int i, VolumeChange<W>& d, const Dual<W, 1>* q) const   adds to d.stress
/// which reads a number of d.history before it writes that of d.history_next: they may be the same.
template <class W>
struct VolumeChange {
    Mat3<W> deformation, rate;  // of F [-] and of dF/dt [1/s]
    Mat3<W> law;                // of the law's stress alone [Pa]
    Mat3<W> stress;             // of the whole one, so far [Pa]
    const W* history = nullptr;
    W* history_next = nullptr;
};

template <class E, class P>
concept HasLinearised = requires { typename E::template Linearised<P>; };

/// Where the effects of a list find their numbers in the flat arrays.
struct EffectSlot {
    int parameter = 0;
    int uniform = 0;
    int history = -1;  // -1 while the effect is not active
    bool active = false;
};

template <class... E>
struct Effects {
    static constexpr int count = sizeof...(E);
    static constexpr const EffectInfo* infos[sizeof...(E)] = {&E::info...};
    static constexpr int parameter_count = (0 + ... + E::info.parameter_count());
    static constexpr int total_uniform_count = (0 + ... + uniform_count<E>());

    /// Calls f(effect type tag, index) for every effect.
    template <class F>
    static void each(F&& f) {
        int index = 0;
        (f(std::type_identity<E>{}, index++), ...);
    }
};

}  // namespace mphygs
