// One effect as a function of a flat list of numbers, the same at every site and over any scalar.
//
// Inputs are the effect's parameters, then the point's state; outputs are all that the effect may
// change. The effect runs through the registry, as the integrator runs it.
#pragma once

#include <vector>

#include "effect_values.hpp"
#include "mphygs/physics/registry.hpp"
#include "random_numbers.hpp"

namespace mphygs::test {

template <class E>
constexpr bool has_function() {
    return E::info.site != Site::mass && E::info.site != Site::hold;
}

template <class E>
int index_in_registry() {
    int index = -1;
    Registry::each([&](auto tag, int i) {
        if (std::is_same_v<typename decltype(tag)::type, E>) {
            index = i;
        }
    });
    return index;
}

template <class E>
Slots only(bool active) {
    std::vector<bool> flags(static_cast<std::size_t>(Registry::count), false);
    flags[static_cast<std::size_t>(index_in_registry<E>())] = active;
    return make_slots(flags);
}

inline constexpr double test_time = 0.37, test_dt = 1e-3;

/// Effect E (or, not active, its absence) at one point.
template <class E, class S>
std::vector<S> evaluate(const std::vector<S>& inputs, Law law, bool active = true) {
    const Slots slots = only<E>(active);
    const EffectSlot slot = slots[static_cast<std::size_t>(index_in_registry<E>())];
    std::vector<S> parameters(static_cast<std::size_t>(Registry::parameter_count));
    std::vector<S> uniforms(static_cast<std::size_t>(Registry::total_uniform_count));
    for (int k = 0; k < E::info.parameter_count(); ++k) {
        parameters[static_cast<std::size_t>(slot.parameter + k)] = inputs[static_cast<std::size_t>(k)];
    }
    all_uniforms(slots, parameters.data(), test_time, test_dt, uniforms.data());
    const S* next = inputs.data() + E::info.parameter_count();
    const auto matrix = [&next] {
        Mat3<S> m;
        for (int i = 0; i < 9; ++i) {
            m[i / 3][i % 3] = *next++;
        }
        return m;
    };
    const auto vector = [&next] {
        Vec3<S> v;
        for (int i = 0; i < 3; ++i) {
            v[i] = *next++;
        }
        return v;
    };
    std::vector<S> outputs;
    const auto put = [&outputs](const Vec3<S>& v) { outputs.insert(outputs.end(), v.e, v.e + 3); };
    if constexpr (E::info.site == Site::volume) {
        VolumePoint<S> p;
        p.deformation = matrix();
        p.rate = matrix();
        p.mu = *next++;
        p.lambda = *next++;
        p.law = law;
        p.time = test_time;
        p.dt = test_dt;
        std::vector<S> history(next, next + E::info.history_count), history_next(history);
        evaluate_volume(slots, uniforms.data(), p, history.data(), history_next.data());
        for (int i = 0; i < 3; ++i) {
            outputs.insert(outputs.end(), p.stress[i], p.stress[i] + 3);
        }
        put(p.acceleration);
        outputs.insert(outputs.end(), history_next.begin(), history_next.end());
    } else if constexpr (E::info.site == Site::body) {
        BodyPoint<S> p;
        p.position = vector();
        p.velocity = vector();
        p.time = test_time;
        put(evaluate_body(slots, uniforms.data(), p));
    } else if constexpr (E::info.site == Site::surface) {
        SurfacePoint<S> p;
        p.position = vector();
        p.velocity = vector();
        p.area = *next++;
        p.time = test_time;
        put(evaluate_surface(slots, uniforms.data(), p));
    } else if constexpr (E::info.site == Site::point) {
        MaterialPoint<S> p;
        p.rest = vector();
        p.position = vector();
        p.velocity = vector();
        p.time = test_time;
        std::vector<S> all(static_cast<std::size_t>(active_sites(slots).point_parameters));
        int offset = 0;
        Registry::each([&](auto tag, int) {
            using Other = typename decltype(tag)::type;
            if constexpr (Other::info.site == Site::point) {
                for (int k = 0; std::is_same_v<Other, E> && k < E::info.parameter_count(); ++k) {
                    all[static_cast<std::size_t>(offset + k)] = inputs[static_cast<std::size_t>(k)];
                }
                offset += Other::info.parameter_count();
            }
        });
        put(evaluate_point(slots, all.data(), p));
    }
    return outputs;
}

/// Eight states of usual size at which the effect acts, and the size of a usual change of each number.
struct EffectInputs {
    std::vector<Pack<double>> value;
    std::vector<double> size;
    void add(Pack<double> x, double usual_size) {
        value.push_back(x);
        size.push_back(usual_size);
    }
};

/// The parameters alone: at their null, or at a trial value.
template <class E>
EffectInputs effect_parameters(bool null) {
    EffectInputs inputs;
    for (int k = 0; k < E::info.parameter_count(); ++k) {
        const double value = null ? E::info.parameters[k].null : trial_value(E::info, k);
        inputs.add(broadcast<double>(value), E::info.parameters[k].scale);
    }
    return inputs;
}

/// Parameters and state. The history is the one that an earlier state leaves behind.
template <class E>
EffectInputs effect_inputs(Random& random, Law law, bool null) {
    EffectInputs inputs = effect_parameters<E>(null);
    const auto vector = [&](double size) {
        for (int i = 0; i < 3; ++i) {
            inputs.add(random.pack(-size, size), size);
        }
    };
    if constexpr (E::info.site == Site::volume) {
        const auto state = [&] {
            for (int i = 0; i < 9; ++i) {
                inputs.add(random.pack(-0.15, 0.15) + (i % 4 == 0 ? 1.0 : 0.0), 0.1);
            }
            for (int i = 0; i < 9; ++i) {
                inputs.add(random.pack(-3, 3), 1.0);
            }
            inputs.add(random.pack(0.5e5, 1.5e5), 1e4);
            inputs.add(random.pack(1e5, 2e5), 1e4);
        };
        state();
        for (int i = 0; i < E::info.history_count; ++i) {
            inputs.add(Pack<double>{}, 1.0);
        }
        const std::vector<Pack<double>> before = evaluate<E>(inputs.value, law);
        inputs = effect_parameters<E>(null);
        state();
        for (std::size_t i = before.size() - static_cast<std::size_t>(E::info.history_count); i < before.size(); ++i) {
            double size = 0;
            for (int q = 0; q < lane_count; ++q) {
                size = std::max(size, std::abs(before[i][q]));
            }
            inputs.add(before[i], size > 0 ? 0.1 * size : 1.0);
        }
    } else {
        if constexpr (E::info.site == Site::point) {
            vector(0.1);
        }
        vector(0.1);
        vector(1.0);
        if constexpr (E::info.site == Site::surface) {
            inputs.add(random.pack(1e-5, 1e-4), 1e-5);
        }
    }
    return inputs;
}

}  // namespace mphygs::test
