// Laws and effects at eight points at once, of the numbers that both transfers and their derivatives use: compiled once,
// in src/physics/evaluation.cpp. Together they are the largest part of the core.
#pragma once

#include "mphygs/physics/registry.hpp"

namespace mphygs {

template <class T>
using PackDual = Dual<Pack<T>, 1>;

#define MPHYGS_EVALUATION(keyword, S)                                                                          \
    keyword template Mat3<S> elastic_stress(Law, const Mat3<S>&, const S&, const S&);                          \
    keyword template void evaluate_volume(const Slots&, const S*, VolumePoint<S>&, const S*, S*);              \
    keyword template Vec3<S> evaluate_body(const Slots&, const S*, const BodyPoint<S>&);                       \
    keyword template Vec3<S> evaluate_surface(const Slots&, const S*, const SurfacePoint<S>&);
#define MPHYGS_EVALUATIONS(keyword, T)        \
    MPHYGS_EVALUATION(keyword, Pack<T>)       \
    MPHYGS_EVALUATION(keyword, PackDual<T>)   \
    MPHYGS_EVALUATION(keyword, Var<Pack<T>>)

MPHYGS_EVALUATIONS(extern, float)
MPHYGS_EVALUATIONS(extern, double)

}  // namespace mphygs
