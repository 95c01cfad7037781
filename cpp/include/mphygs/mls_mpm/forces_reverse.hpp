// Adjoint of MlsForces: from the bars of momentum, mass and affine part to those of the particles
// and of everything that the forces are made of.
#pragma once

#include "mphygs/mls_mpm/forces.hpp"

namespace mphygs {

/// Sums of one chunk that all its particles share, for one substep.
struct MlsChunkSums {
    std::vector<double> uniform;  // of all effects
    std::vector<double> pose;     // (holds, 2, 12): at the start and the end of the substep
    double gravity[3] = {0, 0, 0};
};

/// Bars of the fixed numbers of the particles, in the order of the particles.
template <class T>
struct MlsParticleBars {
    std::vector<T> fixed;     // (groups, Fixed, 16)
    std::vector<T> own_mass;  // (size,)
    explicit MlsParticleBars(std::size_t n) : fixed(fixed_numbers * n), own_mass(n) {}
    T* at(Fixed number, std::size_t p) { return &fixed[slot_of(number, fixed_numbers, p)]; }
};

/// Bars of a substep's results for eight particles.
template <class T>
struct GivenBars {
    Vec3<Pack<T>> momentum;
    Pack<T> mass;
    Mat3<Pack<T>> affine;
};

template <class T>
class MlsForcesReverse {
  public:
    using P = Pack<T>;
    using V = Var<P>;
    using Forces = MlsForces<T, 0>;

    MlsForcesReverse(const Forces& forces, const Fields<T>& fields)
        : forces_(forces), node_force_bar(fields.node_force.size(), T{}), place_effect_bar(fields.place_effect.size(), 0.0) {}

    /// `bar` gains the bars of the point; history_bar turns from after the substep to before it.
    void reverse(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<P>& point, const T* history,
                 const GivenBars<T>& given, T* history_bar, ParticlePoint<P>& bar, MlsParticleBars<T>& particles,
                 MlsChunkSums& sums) {
        const MlsMpm<T>& model = forces_.model_;
        const P mass = forces_.fixed(order, fixed_mass, first);
        const Vec3<P> force_bar = broadcast<T>(forces_.dt_) * given.momentum;
        P mass_bar = given.mass + inner(given.affine, point.c);
        bar.c = bar.c + mass * given.affine;

        Vec3<P> velocity = point.v;
        Vec3<P> velocity_bar = mass * given.momentum;
        if (order.held[first / lane_count]) {
            forces_.each_held(order, first, [&](int lane, std::size_t hold, std::size_t id) {
                for (int c = 0; c < 3; ++c) {
                    velocity[c][lane] = forces_.held_velocity(hold, id, c, point.u[c][lane]);
                    reverse_held(hold, id, c, velocity_bar[c][lane], sums);
                    bar.x[c][lane] -= forces_.relaxation() * velocity_bar[c][lane];
                    velocity_bar[c][lane] = 0;
                }
            });
        }
        mass_bar += dot(given.momentum, velocity);
        bar.v = bar.v + velocity_bar;

        known_force(order, first, force_bar);
        Vec3<P> acceleration = forces_.gravity_;
        if (model.sites_.body) {
            acceleration = acceleration + reverse_body(point, mass * force_bar, bar, sums);
        }
        mass_bar += dot(force_bar, acceleration);
        for (int c = 0; c < 3; ++c) {
            sums.gravity[c] += static_cast<double>(sum_lanes<T>(mass * force_bar[c]));
        }
        if (model.sites_.surface && order.exposed[first / lane_count]) {
            reverse_surface(order, first, point, force_bar, bar, sums);
        }
        if (model.sites_.point && order.placed[first / lane_count]) {
            forces_.each_place(order, first, [&](int lane, std::size_t place) { reverse_place(place, lane, point, force_bar, bar); });
        }
        add(particles.at(fixed_mass, first), mass_bar);
        reverse_volume(order, first, point, history, given, force_bar, history_bar, bar, particles, sums);
    }

    /// From the bar of a held velocity to those of the poses.
    void reverse_held(std::size_t hold, std::size_t id, int c, T bar, MlsChunkSums& sums) const {
        const double* rest = &forces_.model_.geometry_.points[3 * id];
        const double next = static_cast<double>(bar) / static_cast<double>(forces_.dt_);
        const double now = static_cast<double>(bar) * static_cast<double>(forces_.relaxation()) - next;
        double* pose = &sums.pose[hold * 24];
        pose[9 + c] += now;
        pose[21 + c] += next;
        for (int k = 0; k < 3; ++k) {
            pose[3 * c + k] += now * rest[k];
            pose[12 + 3 * c + k] += next * rest[k];
        }
    }

    /// Chain of the once-per-substep functions, parameters -> uniforms.
    void reverse_uniforms(const std::vector<double>& uniform_bar, std::vector<double>& parameter_bar) const {
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            using D = Dual<double, max_effect_parameters>;
            if constexpr (uniform_count<E>() > 0 && E::info.site != Site::point) {
                const EffectSlot& s = forces_.model_.slots_[static_cast<std::size_t>(i)];
                if (!s.active) {
                    return;
                }
                D parameters[max_effect_parameters], q[uniform_count<E>()];
                for (int k = 0; k < E::info.parameter_count(); ++k) {
                    parameters[k] = D(static_cast<double>(forces_.parameters_[static_cast<std::size_t>(s.parameter + k)]));
                    parameters[k].d[k] = 1;
                }
                effect_uniforms<E>(parameters, static_cast<double>(forces_.time_), static_cast<double>(forces_.dt_), q);
                for (int j = 0; j < uniform_count<E>(); ++j) {
                    for (int k = 0; k < E::info.parameter_count(); ++k) {
                        parameter_bar[static_cast<std::size_t>(s.parameter + k)] +=
                            uniform_bar[static_cast<std::size_t>(s.uniform + j)] * q[j].d[k];
                    }
                }
            }
        });
    }

  private:
    const Forces& forces_;

  public:
    std::vector<T> node_force_bar;
    std::vector<double> place_effect_bar;

  private:
    static Tape<P>& tape() { return Tape<P>::current(); }
    static void add(T* to, P x) { store<T>(to, load<T>(to) + x); }
    static Vec3<V> input(const Vec3<P>& x) { return {{V::input(x[0]), V::input(x[1]), V::input(x[2])}}; }
    static Mat3<V> input(const Mat3<P>& x) {
        Mat3<V> r;
        for (int i = 0; i < 9; ++i) {
            r[i / 3][i % 3] = V::input(x[i / 3][i % 3]);
        }
        return r;
    }
    static void seed(const V& x, P bar) {
        if (x.i >= 0) {
            tape().adjoint(x.i) += bar;
        }
    }
    static Vec3<P> adjoint(const Vec3<V>& x) { return {{tape().adjoint(x[0].i), tape().adjoint(x[1].i), tape().adjoint(x[2].i)}}; }
    static Mat3<P> adjoint(const Mat3<V>& x) {
        Mat3<P> r;
        for (int i = 0; i < 9; ++i) {
            r[i / 3][i % 3] = tape().adjoint(x[i / 3][i % 3].i);
        }
        return r;
    }
    /// Uniforms as inputs of the tape; those of effects that are not active stay constants.
    std::vector<V> tape_uniforms(Site site) const {
        std::vector<V> u(forces_.uniforms_.begin(), forces_.uniforms_.end());
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            const EffectSlot& s = forces_.model_.slots_[static_cast<std::size_t>(i)];
            for (int k = 0; s.active && E::info.site == site && k < uniform_count<E>(); ++k) {
                V& x = u[static_cast<std::size_t>(s.uniform + k)];
                x = V::input(x.v);
            }
        });
        return u;
    }
    static void add_uniforms(const std::vector<V>& uniforms, MlsChunkSums& sums) {
        for (std::size_t i = 0; i < uniforms.size(); ++i) {
            if (uniforms[i].i >= 0) {
                sums.uniform[i] += static_cast<double>(sum_lanes<T>(tape().adjoint(uniforms[i].i)));
            }
        }
    }

    void known_force(const MlsOrder<T>& order, std::size_t first, const Vec3<P>& force_bar) {
        const std::size_t count = forces_.model_.particle_count();
        for (int q = 0; !node_force_bar.empty() && q < lane_count; ++q) {
            const std::size_t i = static_cast<std::size_t>(order.id[first + static_cast<std::size_t>(q)]);
            for (std::size_t c = 0; i < count && c < 3; ++c) {
                node_force_bar[(forces_.frame_ * count + i) * 3 + c] += force_bar[static_cast<int>(c)][q];
            }
        }
    }

    Vec3<P> reverse_body(const ParticlePoint<P>& point, const Vec3<P>& seeds, ParticlePoint<P>& bar, MlsChunkSums& sums) const {
        tape().reset();
        const BodyPoint<P> value = forces_.body_point(point);
        const BodyPoint<V> p{input(value.position), input(value.velocity), value.time};
        const std::vector<V> uniforms = tape_uniforms(Site::body);
        const Vec3<V> a = evaluate_body(forces_.model_.slots_, uniforms.data(), p);
        tape().prepare();
        Vec3<P> result;
        for (int c = 0; c < 3; ++c) {
            seed(a[c], seeds[c]);
            result[c] = a[c].v;
        }
        tape().sweep();
        bar.x = bar.x + adjoint(p.position);
        bar.v = bar.v + adjoint(p.velocity);
        add_uniforms(uniforms, sums);
        return result;
    }

    void reverse_surface(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<P>& point, const Vec3<P>& seeds,
                         ParticlePoint<P>& bar, MlsChunkSums& sums) const {
        tape().reset();
        const SurfacePoint<P> value = forces_.surface_point(order, first, point);
        const SurfacePoint<V> p{input(value.position), input(value.velocity), V(value.area), value.time};
        const std::vector<V> uniforms = tape_uniforms(Site::surface);
        const Vec3<V> f = evaluate_surface(forces_.model_.slots_, uniforms.data(), p);
        tape().prepare();
        for (int c = 0; c < 3; ++c) {
            seed(f[c], seeds[c]);
        }
        tape().sweep();
        bar.x = bar.x + adjoint(p.position);
        bar.v = bar.v + adjoint(p.velocity);
        add_uniforms(uniforms, sums);
    }

    void reverse_place(std::size_t place, int lane, const ParticlePoint<P>& point, const Vec3<P>& seeds, ParticlePoint<P>& bar) {
        tape().reset();
        const MaterialPoint<T> value = forces_.material_point(place, point, lane);
        MaterialPoint<V> m;
        for (int c = 0; c < 3; ++c) {
            m.rest[c] = V(broadcast<T>(value.rest[c]));
            m.position[c] = V::input(broadcast<T>(value.position[c]));
            m.velocity[c] = V::input(broadcast<T>(value.velocity[c]));
        }
        m.time = value.time;
        std::vector<V> q;
        for (const T x : forces_.place_parameters(place)) {
            q.push_back(V::input(broadcast<T>(x)));
        }
        const Vec3<V> f = evaluate_point(forces_.model_.slots_, q.data(), m);
        tape().prepare();
        for (int c = 0; c < 3; ++c) {
            seed(f[c], broadcast<T>(seeds[c][lane]));
        }
        tape().sweep();
        for (int c = 0; c < 3; ++c) {
            bar.x[c][lane] += tape().adjoint(m.position[c].i)[0];
            bar.v[c][lane] += tape().adjoint(m.velocity[c].i)[0];
        }
        for (std::size_t i = 0; i < q.size(); ++i) {
            place_effect_bar[place * q.size() + i] += static_cast<double>(tape().adjoint(q[i].i)[0]);
        }
    }

    /// A = m C - k V P F^T, k = 4 dt/h^2; and the acceleration of volume effects.
    void reverse_volume(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<P>& point, const T* history,
                        const GivenBars<T>& given, const Vec3<P>& force_bar, T* history_bar, ParticlePoint<P>& bar,
                        MlsParticleBars<T>& particles, MlsChunkSums& sums) const;
};

}  // namespace mphygs
