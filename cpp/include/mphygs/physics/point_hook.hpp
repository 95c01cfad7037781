// Forces and stresses that the caller computes for all quadrature points at once, in every substep.
//
// A way in for effects that are not compiled: slower by a call a substep, the same in all other
// respects. Arrays hold lane after lane, the value and then one derivative for each direction;
// points stand in the caller's order.
#pragma once

#include <functional>
#include <vector>

namespace mphygs {

template <class T>
struct PointState {
    int lanes = 1;            // the value and the directions
    int first_direction = 0;  // number of lane 1 among all directions of the call
    double time = 0;          // [s]
    std::vector<T> position;     // (lanes, P, 3) [m]
    std::vector<T> velocity;     // (lanes, P, 3) [m/s]
    std::vector<T> deformation;  // (lanes, P, 9) from the stress-free state [-]
};

/// Empty arrays: none.
template <class T>
struct PointForces {
    std::vector<T> force;   // (lanes, P, 3) [N]
    std::vector<T> stress;  // (lanes, P, 9) first Piola-Kirchhoff [Pa]
};

template <class T>
struct PointHook {
    std::function<PointForces<T>(const PointState<T>&)> forward;
    /// Bars of the state (value lane only) for bars of what `forward` returns there. Bars of
    /// whatever else the forces depend on stay with the caller.
    std::function<PointState<T>(const PointState<T>&, const PointForces<T>& bar)> reverse;
};

}  // namespace mphygs
