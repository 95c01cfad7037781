// What kinds of substep there are, as numbers that the code for all of them reads.
//
// An implicit one solves v = v* + span a(u* + span v, v), with the holds C (u* + reach v) = hold at its end:
//   midpoint  u* = u_n, v* = v_n, span = dt / 2, reach = dt;  u_n+1 = u_n + dt v, v_n+1 = 2 v - v_n;
//   BDF2      u* = (4 u_n - u_n-1) / 3, v* likewise, span = reach = 2/3 dt;  u_n+1 = u* + span v, v_n+1 = v.
// The midpoint rule alone conserves energy to high order, and reflects what is too fast for it at every step. A sheet's
// or a rod's thickness is that, and large turns pump it. In pairs, a midpoint substep and one of BDF2 over both, the rule is
// L-stable: what is too fast dies at once. It is of order two, and what it takes from a motion of angular frequency w,
// as a share of critical damping, is 0.0035 (2 w dt)^3.
// Source: Bathe and Baig, "On a composite implicit time integration procedure for nonlinear dynamics", 2005.
#pragma once

#include "mphygs/model.hpp"

namespace mphygs {

struct SubstepRule {
    bool second = false;   // of a pair: BDF2
    double span = 1.0;     // of the substep, as reach
    double at = 0.0;       // where in the substep forces act
    double reach = 1.0;
    double impulses = 1.0;  // a substep's impulse of the holds over that which their rows are solved for

    static SubstepRule of(const Schedule& schedule, int n) {
        if (!schedule.implicit) {
            return {};
        }
        if (schedule.paired && n % 2 == 1) {
            return {true, 2.0 / 3.0, 1.0, 2.0 / 3.0, 1.5};
        }
        return {false, 0.5, 0.5, 1.0, 2.0};
    }
    /// How much a hold gives way for the impulse that its rows are solved for, in reaches.
    double give() const { return reach / span; }
};

}  // namespace mphygs
