// The hold gives way elastically: its displacement is compliance times the force it carries.
//
// No local function: the integrator solves for the reaction with the compliance in the same
// implicit step as the hold itself, so that zero is the rigid hold and is differentiable.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct HoldCompliance {
    static constexpr EffectInfo info{"hold_compliance", "the hold gives way elastically", Site::hold, false, false, 0, 1,
                                     {{"compliance", "m/N", 0, 0, 10, 1e-3, true}}};
};

}  // namespace mphygs
