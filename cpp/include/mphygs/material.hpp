// Elastic laws: first Piola-Kirchhoff stress from the deformation gradient, one law a file.
#pragma once

#include "mphygs/materials/fixed_corotated.hpp"
#include "mphygs/materials/neo_hookean.hpp"

namespace mphygs {

enum class Law : int { neo_hookean = 0, fixed_corotated = 1 };

/// First Piola-Kirchhoff stress P = dW/dF [Pa].
/// deformation: F [-]; mu, lambda: Lame's parameters [Pa].
template <class S>
inline Mat3<S> elastic_stress(Law law, const Mat3<S>& deformation, const S& mu, const S& lambda) {
    if (law == Law::fixed_corotated) {
        return FixedCorotated::stress(deformation, mu, lambda);
    }
    return NeoHookean::stress(deformation, mu, lambda);
}

/// Energy density W [J/m^3].
template <class S>
inline S elastic_energy(Law law, const Mat3<S>& deformation, const S& mu, const S& lambda) {
    if (law == Law::fixed_corotated) {
        return FixedCorotated::energy(deformation, mu, lambda);
    }
    return NeoHookean::energy(deformation, mu, lambda);
}

}  // namespace mphygs
