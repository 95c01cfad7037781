// A small held, jittered block of two parts in motion: what the MLS-MPM tests run.
#pragma once

#include <cmath>
#include <random>

#include "effect_values.hpp"
#include "mphygs/mls_mpm/model.hpp"
#include "mphygs/physics/registry.hpp"

namespace mphygs::test {

template <class T>
struct MlsCase {
    MlsGeometry geometry;
    MlsSettings settings;
    Fields<T> fields;
    Schedule schedule;
    MlsMpm<T> model() const { return {geometry, settings}; }
};

inline std::size_t effect_index(const std::string& name) {
    for (std::size_t i = 0; i < Registry::count; ++i) {
        if (name == Registry::infos[i]->name) {
            return i;
        }
    }
    throw std::invalid_argument(name);
}

/// First parameter of an effect in Fields::effect.
inline std::size_t parameter_of(std::size_t effect) {
    std::size_t at = 0;
    for (std::size_t i = 0; i < effect; ++i) {
        at += static_cast<std::size_t>(Registry::infos[i]->parameter_count());
    }
    return at;
}

/// shape: particles along each axis, two per 1 cm cell. hold: the lowest layer is held by a hold
/// that turns and moves.
template <class T>
MlsCase<T> mls_case(std::array<int, 3> shape, std::vector<int> steps, bool hold) {
    MlsCase<T> c;
    std::mt19937 random(7);
    std::uniform_real_distribution<double> unit(-1, 1);
    MlsGeometry& g = c.geometry;
    g.spacing = 0.01;
    g.origin = {0.003, -0.001, 0.002};
    g.part_count = 2;
    g.hold_count = hold ? 1 : 0;
    for (int i = 0; i < shape[0]; ++i) {
        for (int j = 0; j < shape[1]; ++j) {
            for (int k = 0; k < shape[2]; ++k) {
                for (const int n : {i, j, k}) {
                    g.points.push_back(0.005 * (n + 0.3 * unit(random)));
                }
                g.part.push_back(2 * k > shape[2]);
                g.hold.push_back(hold && k == 0 ? 0 : -1);
                g.surface_area.push_back(i == 0 || j == 0 ? 2.5e-5 : 0.0);
            }
        }
    }
    const std::size_t n = g.particle_count();
    g.places = {g.points[3 * (n - 1)] + 0.001, g.points[3 * n - 2], g.points[3 * n - 1], 0.004, 0.001, 0.006};
    g.place_particle = {-1, 2};
    c.settings.active.assign(Registry::count, false);
    c.settings.sort_interval = 3;
    c.settings.hold_relaxation = 4;
    c.settings.hold_weight = 7;

    Fields<T>& f = c.fields;
    const auto number = [&](double x) { return static_cast<T>(x); };
    for (std::size_t i = 0; i < n; ++i) {
        f.mu.push_back(number(g.part[i] ? 4e3 : 2e4));
        f.lambda.push_back(number(g.part[i] ? 6e3 : 3e4));
        f.stress_volume.push_back(number(1.25e-7 * (1 + 0.1 * unit(random))));
        f.mass.push_back(number(1.25e-4 * (1 + 0.1 * unit(random))));
        for (int k = 0; k < 9; ++k) {
            f.deformation0.push_back(number((k % 4 == 0) + 0.05 * unit(random)));
        }
        for (int k = 0; k < 3; ++k) {
            f.displacement0.push_back(number(5e-4 * unit(random)));
            f.velocity0.push_back(number(0.5 * unit(random) + (k == 0 ? 0.3 : 0)));
        }
    }
    f.gravity = {number(0.5), number(-0.3), number(-9.81)};
    for (const EffectInfo* e : Registry::infos) {
        for (int k = 0; k < e->parameter_count(); ++k) {
            f.effect.push_back(number(trial_value(*e, k)));
        }
    }
    std::size_t point_parameters = 0;
    for (const EffectInfo* e : Registry::infos) {
        if (e->site == Site::point) {
            for (int p = 0; p < 2; ++p) {
                for (int k = 0; k < e->parameter_count(); ++k) {
                    f.place_effect.push_back(number(k == 0 ? 5.0 : 0.01 * k));
                }
            }
            point_parameters += static_cast<std::size_t>(e->parameter_count());
        }
    }
    EXPECT_EQ(f.place_effect.size(), 2 * point_parameters);
    f.place_mass = {number(2e-4), number(1e-4)};
    c.schedule.steps = steps;
    c.schedule.dt.assign(steps.size(), 2e-4);
    c.schedule.start = 0.01;
    for (std::size_t i = 0; i < 3 * n * steps.size(); ++i) {
        f.node_force.push_back(number(1e-4 * unit(random)));
    }
    for (int s = 0; hold && s <= c.schedule.total_steps(); ++s) {
        const double angle = 1e-3 * s;
        for (const double x : {std::cos(angle), -std::sin(angle), 0.0, std::sin(angle), std::cos(angle), 0.0, 0.0, 0.0, 1.0,
                               1e-5 * s, 0.0, 2e-5 * s}) {
            f.pose.push_back(number(x));
        }
    }
    return c;
}

/// Random numbers of the shapes of `like`, scaled by the size of each field.
template <class T>
Fields<T> random_direction(const Fields<T>& like, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> unit(-1, 1);
    Fields<T> d = like;
    for (std::vector<T>* v : d.all()) {
        for (T& x : *v) {
            x = static_cast<T>(unit(random)) * (x == T{} ? T(1e-3) : std::abs(x));
        }
    }
    return d;
}

template <class T>
ParticleTrajectory<T> random_bar(const ParticleTrajectory<T>& like, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> unit(-1, 1);
    ParticleTrajectory<T> bar = like;
    for (std::vector<T>* v : {&bar.position, &bar.velocity, &bar.deformation}) {
        for (T& x : *v) {
            x = static_cast<T>(unit(random));
        }
    }
    return bar;
}

template <class T>
double product(const ParticleTrajectory<T>& a, const ParticleTrajectory<T>& b) {
    double sum = 0;
    const auto add = [&](const std::vector<T>& x, const std::vector<T>& y) {
        for (std::size_t i = 0; i < x.size(); ++i) {
            sum += static_cast<double>(x[i]) * static_cast<double>(y[i]);
        }
    };
    add(a.position, b.position);
    add(a.velocity, b.velocity);
    add(a.deformation, b.deformation);
    return sum;
}

}  // namespace mphygs::test
