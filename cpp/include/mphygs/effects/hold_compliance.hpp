// The hold gives way elastically: its displacement is compliance times the force it carries.
//
// No local function: the integrator solves for the reaction with the compliance in the same
// implicit step as the hold itself, so that zero is the rigid hold and is differentiable.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct HoldCompliance {
    static constexpr EffectInfo info{
        .name = "hold_compliance",
        .summary = "the hold gives way elastically",
        .site = Site::hold,
        .not_with_mls = "it imposes the hold's velocity and knows no reaction",
        .parameters = {{"compliance", "m/N", 0, 0, 10, 1e-3, true, Role::strength, 1e-5, 1e-1}},
    };
};

}  // namespace mphygs
