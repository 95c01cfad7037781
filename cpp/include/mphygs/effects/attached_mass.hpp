// A point mass carried at a place on the object: inertia and weight.
//
// The mass joins the lumped mass of the nodes (or particle) around its place, so inertia, gravity
// and every body force follow without further code.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct AttachedMass {
    static constexpr EffectInfo info{
        .name = "attached_mass",
        .summary = "a point mass carried at a place on the object",
        .site = Site::mass,
        .loads_at_rest = true,
        .parameters = {{"m", "kg", 0, 0, 100, 0.01, true}},
    };
};

}  // namespace mphygs
