// What kinds of substep there are, as numbers that the code for all of them reads.
//
// An implicit one solves v = v* + span a(u* + span v, v), with the holds C (u* + reach v) = hold at its end:
//   midpoint  u* = u_n, v* = v_n, span = length / 2, reach = length;  u_n+1 = u_n + length v, v_n+1 = 2 v - v_n;
//   BDF2      u* = last u_n - before u_n-1, v* likewise, span = reach;  u_n+1 = u* + span v, v_n+1 = v.
// The midpoint rule alone conserves energy to high order, and reflects what is too fast for it at every step. A sheet's
// or a rod's thickness is that, and large turns pump it. In pairs, a midpoint substep and one of BDF2 over both, the rule is
// L-stable: what is too fast dies at once. The first takes 2 - sqrt 2 of a pair: then both have the same span, and the same
// factors serve both. It is of order two, and what it takes from a motion of angular frequency w, as a share of critical
// damping, is 0.0037 (2 w dt)^3, dt half a pair.
// Sources: Bathe and Baig, "On a composite implicit time integration procedure for nonlinear dynamics", 2005; Bank et al.,
// "Transient simulation of silicon devices and circuits", 1985.
#pragma once

#include <numbers>

#include "mphygs/model.hpp"

namespace mphygs {

/// Times are in dt: a substep, or half a pair, which its two substeps share unevenly.
struct SubstepRule {
    bool second = false;    // of a pair: BDF2
    double length = 1.0;
    double span = 1.0;
    double at = 0.0;        // when forces act, from where the substep began if all were alike
    double within = 0.0;    // how much of the substep is over then
    double elapsed = 1.0;   // since forces were last asked for
    double reach = 1.0;
    double impulses = 1.0;  // a substep's impulse of the holds over that which their rows are solved for
    double last = 1.0, before = 0.0;

    static SubstepRule of(const Schedule& schedule, int n) {
        constexpr double root = std::numbers::sqrt2, span = 2.0 - root;
        if (!schedule.implicit) {
            return {};
        }
        if (!schedule.paired) {
            return {.span = 0.5, .at = 0.5, .within = 0.5, .impulses = 2.0};
        }
        if (n % 2 == 0) {
            return {.length = 2.0 * span, .span = span, .at = span, .within = 0.5, .elapsed = span, .reach = 2.0 * span, .impulses = 1.0 / span};
        }
        return {.second = true, .length = 2.0 - 2.0 * span, .span = span, .at = 1.0, .within = 1.0, .elapsed = root, .reach = span,
                .impulses = 1.0 / span, .last = (root + 1.0) / 2.0, .before = (root - 1.0) / 2.0};
    }
    /// How much a hold gives way for the impulse that its rows are solved for, in reaches.
    double give() const { return reach / span; }
};

}  // namespace mphygs
