// What an effect says of itself: its site, its numbers, and what part each of them plays.
//
// General code, here and in Python, reads `info` and knows no effect by name. What depends on the values of its numbers
// an effect may say by
//
//   static double stiffness_factor(const double* q)         by how much it multiplies the stiffness that bounds the
//                                                           substep, where the rates at rest do not show it
//   static void worst_case(double* q)                       makes its numbers those with which all of it acts that
//                                                           can: the rates that bound the substep are taken there
//   static void complete(double* q, const ObjectScales&)    chooses the numbers that are left at their null
//   static void simplify(const double* q, const ObjectScales&, double* of_simpler)
//                                                           the numbers of the simpler effect in the limit in which
//                                                           it is that one; without it, those of the same name
#pragma once

namespace mphygs {

enum class Site : int { volume, body, surface, point, mass, hold };

/// The part that a number plays, and so how it is tried.
enum class Role : int {
    plain,      // not said: a strength where it is fitted, else a constant
    strength,   // how much of the effect there is: absent at its null, where the derivative tells of it
    level,      // a positive number with a scale of its own (a time, a stress), tried on a logarithmic grid
    direction,  // x, y or z, three in a row, of a vector of which only the direction counts
    axis,       // the same where the sign does not count either, of length 1
    flow,       // x, y or z of a velocity that another number, the strength, multiplies
    anchor,     // x, y or z of a point in space that a material point is tied to
    offset,     // of a plane direction . x = offset
    frequency,  // [Hz]
    phase,      // [rad] of that frequency
    switch_,    // 0 or 1, each a form of the effect
    constant,   // given by the user
};

inline constexpr int max_effect_parameters = 8;

struct ParameterInfo {
    const char* name;
    const char* unit;
    double null;
    double lower;
    double upper;
    double scale;  // a usual size: prior scale and size of trial steps
    bool fitted;   // false: a constant that the user gives
    Role role = Role::plain;
    double low = 0, high = 0;  // where it is tried (a level's grid, a flow's speed); 0, 0: about its scale

    constexpr Role part() const { return role != Role::plain ? role : fitted ? Role::strength : Role::constant; }
};

struct EffectInfo {
    const char* name;
    const char* summary;
    Site site;
    bool threshold = false;         // its derivative at the null is zero: only finite trials show it
    bool needs_rate = false;        // reads the rate of deformation
    int history_count = 0;          // numbers carried per point
    bool loads_at_rest = false;     // it loads the object at rest as well, where the rest shape is an equilibrium;
                                    // what acts in the volume does so without saying it
    bool corrects_gravity = false;  // its three numbers add to the gravity vector
    bool carries_gravity = false;   // its three numbers are the gravity that the rest shape carries: `prestress paper`
    const char* simpler = "";       // the effect that it is where its flow is nothing, or as its level goes to zero
    const char* not_with_mls = "";  // why the MLS-MPM transfer cannot have it; empty where it can
    ParameterInfo parameters[max_effect_parameters] = {};

    constexpr int parameter_count() const {
        int count = 0;
        while (count < max_effect_parameters && parameters[count].name != nullptr) {
            ++count;
        }
        return count;
    }
};

/// Of an object, what an effect may choose its own numbers by.
struct ObjectScales {
    double youngs_modulus;  // least [Pa]
    double spacing;         // least edge of a cell [m]
    double shear_modulus;   // geometric mean of the parts' [Pa]
};

template <class E>
double stiffness_factor([[maybe_unused]] const double* q) {
    if constexpr (requires { E::stiffness_factor(q); }) {
        return E::stiffness_factor(q);
    } else {
        return 1.0;
    }
}

template <class E>
void worst_case([[maybe_unused]] double* q) {
    if constexpr (requires { E::worst_case(q); }) {
        E::worst_case(q);
    }
}

/// False where it does not say.
template <class E>
bool simplify([[maybe_unused]] const double* q, [[maybe_unused]] const ObjectScales& of, [[maybe_unused]] double* of_simpler) {
    if constexpr (requires { E::simplify(q, of, of_simpler); }) {
        E::simplify(q, of, of_simpler);
        return true;
    } else {
        return false;
    }
}

template <class E>
void complete([[maybe_unused]] double* q, [[maybe_unused]] const ObjectScales& of) {
    if constexpr (requires { E::complete(q, of); }) {
        E::complete(q, of);
    }
}

}  // namespace mphygs
