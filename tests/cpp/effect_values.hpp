// Values at which an effect acts: what the tests of every registered effect use.
#pragma once

#include <algorithm>

#include "mphygs/effect.hpp"

namespace mphygs::test {

/// A value of parameter k away from the null, of usual size and within the bounds. A threshold
/// effect is absent for a whole range around its null, so its parameters take their usual size. A phase is
/// more than a turn, where the weight of a pulse counts, and that weight is small: the wave is left to see.
inline double trial_value(const EffectInfo& effect, int k) {
    const ParameterInfo& p = effect.parameters[k];
    if (p.role == Role::phase || p.role == Role::switch_) {
        return p.role == Role::phase ? 6.283185307179586 + 0.7 * p.scale : 0.1;
    }
    const double value = effect.threshold ? p.scale : p.null + 0.7 * p.scale;
    return std::clamp(value, p.lower, p.upper);
}

}  // namespace mphygs::test
