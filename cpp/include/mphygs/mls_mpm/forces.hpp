// What a particle gives to the grid: momentum, forces, stress, holds; eight at a time.
#pragma once

#include "mphygs/mls_mpm/particle_point.hpp"
#include "mphygs/mls_mpm/tile.hpp"

namespace mphygs {

template <class T, int K>
class MlsForces {
  public:
    using S = PackScalar<T, K>;
    using U = PlainScalar<T, K>;
    using P = Pack<T>;

    MlsForces(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const StepTable& table) : model_(model), inputs_(inputs), table_(table) {
        uniforms_.resize(static_cast<std::size_t>(Registry::total_uniform_count));
        plain_uniforms_.resize(uniforms_.size());
        for (std::size_t i = 0; i < static_cast<std::size_t>(Registry::parameter_count); ++i) {
            parameters_.push_back(inputs.plain(&Fields<T>::effect, i));
        }
        for (std::size_t c = 0; c < 3; ++c) {
            const U g = inputs.plain(&Fields<T>::gravity, c);
            for (int l = 0; l <= K; ++l) {
                lane_of(gravity_[static_cast<int>(c)], l) = broadcast<T>(lane_of(g, l));
            }
        }
    }

    /// Moves to substep `n` of the run.
    void refresh(int n) {
        n_ = n;
        frame_ = static_cast<std::size_t>(table_.frame[static_cast<std::size_t>(n)]);
        time_ = static_cast<T>(table_.time[static_cast<std::size_t>(n)]);
        dt_ = static_cast<T>(table_.dt[static_cast<std::size_t>(n)]);
        all_uniforms(model_.slots_, parameters_.data(), time_, dt_, plain_uniforms_.data());
        for (std::size_t i = 0; i < uniforms_.size(); ++i) {
            for (int l = 0; l <= K; ++l) {
                lane_of(uniforms_[i], l) = broadcast<T>(lane_of(plain_uniforms_[i], l));
            }
        }
        holds_.clear();
        for (std::size_t h = 0; h < static_cast<std::size_t>(model_.geometry_.hold_count); ++h) {
            holds_.push_back(hold_motion(h));
        }
    }

    /// Neo-Hookean particles that only gravity acts on: the hot path has them to itself.
    bool plain() const {
        const ActiveSites& a = model_.sites_;
        return model_.settings_.law == linearised_law && !a.volume && !a.body && !a.surface && inputs_.primal->node_force.empty();
    }
    bool plain_tile(const MlsOrder<T>& order, std::size_t first) const {
        bool good = true;
        for (std::size_t b = first / lane_count; b < (first + tile_size) / lane_count; ++b) {
            good &= !(model_.sites_.point && order.placed[b]);
        }
        return good;
    }
    /// f(particle, hold, id) for the held particles of a tile.
    template <class F>
    void each_held_of_tile(const MlsOrder<T>& order, std::size_t first, F&& f) const {
        for (std::size_t b = first; b < first + tile_size; b += lane_count) {
            if (order.held[b / lane_count]) {
                each_held(order, b, [&](int lane, std::size_t hold, std::size_t id) { f(b + static_cast<std::size_t>(lane), hold, id); });
            }
        }
    }
    /// Of the run, the one that it stands at.
    int substep() const { return n_; }
    T gravity(int c) const { return lane_of(gravity_[c], 0)[0]; }

    /// Momentum q and affine part A = m C - dt V (4/h^2) tau of the eight particles from `first`.
    /// history: (lanes, numbers, size), moved on by one substep.
    void evaluate(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<S>& p, T* history, Vec3<S>& momentum,
                  Mat3<S>& affine) const {
        const S mass = fixed(order, fixed_mass, first);
        VolumePoint<S> point = volume_point(order, first, p);
        Vec3<S> force = known_force(order, first);
        if (model_.sites_.volume) {
            const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
            std::vector<S> before(count), after(count);
            load_history(order, first, history, before);
            evaluate_volume(model_.slots_, uniforms_.data(), point, before.data(), after.data());
            for (std::size_t i = 0; i < count; ++i) {
                for (int l = 0; l <= K; ++l) {
                    store<T>(history + (static_cast<std::size_t>(l) * count + i) * order.size + first, lane_of(after[i], l));
                }
            }
            if (model_.sites_.body_volume) {
                force = force + own_mass(order, first) * point.acceleration;
            }
        } else {
            point.stress = elastic_stress(point.law, point.deformation, point.mu, point.lambda);
        }
        Vec3<S> acceleration = gravity_;
        if (model_.sites_.body) {
            acceleration = acceleration + evaluate_body(model_.slots_, uniforms_.data(), body_point(p));
        }
        force = force + mass * acceleration;
        if (model_.sites_.surface && order.exposed[first / lane_count]) {
            force = force + evaluate_surface(model_.slots_, uniforms_.data(), surface_point(order, first, p));
        }
        if (model_.sites_.point && order.placed[first / lane_count]) {
            each_place(order, first, [&](int lane, std::size_t place) {
                const std::vector<U> q = place_parameters(place);
                const Vec3<U> f = evaluate_point(model_.slots_, q.data(), material_point(place, p, lane));
                for (int c = 0; c < 3; ++c) {
                    put<T, K>(force[c], lane, pick<T, K>(force[c], lane) + f[c]);
                }
            });
        }
        Vec3<S> velocity = p.v;
        if (order.held[first / lane_count]) {
            each_held(order, first, [&](int lane, std::size_t hold, std::size_t id) {
                for (int c = 0; c < 3; ++c) {
                    put<T, K>(velocity[c], lane, held_velocity(hold, id, c, pick<T, K>(p.u[c], lane)));
                }
            });
        }
        for (int c = 0; c < 3; ++c) {
            momentum[c] = mass * velocity[c] + dt_ * force[c];
        }
        affine = mass * p.c - (stress_scale() * fixed(order, fixed_volume, first)) * (point.stress * transpose(p.f));
    }

    S fixed(const MlsOrder<T>& order, Fixed number, std::size_t first) const {
        S s{};
        for (int l = 0; l <= K; ++l) {
            lane_of(s, l) = load<T>(&order.fixed[static_cast<std::size_t>(l) * fixed_numbers * order.size + slot_of(number, fixed_numbers, first)]);
        }
        return s;
    }
    S own_mass(const MlsOrder<T>& order, std::size_t first) const {
        S s{};
        for (int l = 0; l <= K; ++l) {
            lane_of(s, l) = load<T>(&order.own_mass[static_cast<std::size_t>(l) * order.size + first]);
        }
        return s;
    }
    T stress_scale() const { return dt_ * static_cast<T>(4.0 / (model_.geometry_.spacing * model_.geometry_.spacing)); }
    T dt() const { return dt_; }
    /// First of the twelve numbers of a hold's pose before substep `step`.
    std::size_t pose_index(std::size_t hold, int step) const {
        return (hold * static_cast<std::size_t>(table_.count() + 1) + static_cast<std::size_t>(step)) * 12;
    }

    /// f(lane, hold, particle) for the held ones of eight particles.
    template <class F>
    void each_held(const MlsOrder<T>& order, std::size_t first, F&& f) const {
        for (std::size_t q = 0; q < lane_count; ++q) {
            if (order.hold[first + q] >= 0) {
                f(static_cast<int>(q), static_cast<std::size_t>(order.hold[first + q]), static_cast<std::size_t>(order.id[first + q]));
            }
        }
    }
    T relaxation() const { return static_cast<T>(1.0 / model_.settings_.hold_relaxation) / dt_; }

    /// What the velocity of a hold's particles is made of at this substep: the rows of the motion
    /// until the next one, and of the displacement now.
    struct HoldMotion {
        U moved[3][4], displaced[3][4];
    };
    HoldMotion hold_motion(std::size_t hold) const {
        HoldMotion m;
        const std::size_t now = pose_index(hold, n_), next = pose_index(hold, n_ + 1);
        for (std::size_t c = 0; c < 3; ++c) {
            for (std::size_t k = 0; k < 4; ++k) {
                const std::size_t at = k < 3 ? 3 * c + k : 9 + c;
                m.displaced[c][k] = inputs_.plain(&Fields<T>::pose, now + at);
                m.moved[c][k] = (inputs_.plain(&Fields<T>::pose, next + at) - m.displaced[c][k]) / dt_;
            }
            m.displaced[c][c] = m.displaced[c][c] - T(1);
        }
        return m;
    }

    /// v = (u_n+1 - u_n)/dt + (u_n - u)/(kappa dt), u_n the particle's displacement under the hold's motion.
    U held_velocity(std::size_t hold, std::size_t id, int c, const U& u) const {
        const double* rest = &model_.geometry_.points[3 * id];
        const U* moved = holds_[hold].moved[c];
        const U* displaced = holds_[hold].displaced[c];
        U now = displaced[3] - u, velocity = moved[3];
        for (int k = 0; k < 3; ++k) {
            now += displaced[k] * static_cast<T>(rest[k]);
            velocity += moved[k] * static_cast<T>(rest[k]);
        }
        return velocity + now * relaxation();
    }

  private:
    template <class TT>
    friend class MlsForcesReverse;

    VolumePoint<S> volume_point(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<S>& p) const {
        VolumePoint<S> point;
        point.deformation = p.f;
        if (model_.sites_.rate) {
            point.rate = p.c * p.f;
        }
        point.mu = fixed(order, fixed_mu, first);
        point.lambda = fixed(order, fixed_lambda, first);
        point.law = model_.settings_.law;
        point.time = time_;
        point.dt = dt_;
        return point;
    }

    void load_history(const MlsOrder<T>& order, std::size_t first, const T* history, std::vector<S>& to) const {
        const std::size_t count = to.size();
        for (std::size_t i = 0; i < count; ++i) {
            for (int l = 0; l <= K; ++l) {
                lane_of(to[i], l) = load<T>(history + (static_cast<std::size_t>(l) * count + i) * order.size + first);
            }
        }
    }

    Vec3<S> absolute(const Vec3<S>& x) const {
        Vec3<S> r = x;
        for (int c = 0; c < 3; ++c) {
            lane_of(r[c], 0) += static_cast<T>(model_.anchor_[static_cast<std::size_t>(c)]);
        }
        return r;
    }
    BodyPoint<S> body_point(const ParticlePoint<S>& p) const { return {absolute(p.x), p.v, time_}; }
    SurfacePoint<S> surface_point(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<S>& p) const {
        return {absolute(p.x), p.v, S(load<T>(&order.area[first])), time_};
    }

    Vec3<S> known_force(const MlsOrder<T>& order, std::size_t first) const {
        Vec3<S> force;
        const std::size_t count = model_.particle_count();
        for (int l = 0; l <= K; ++l) {
            const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
            if (!fields || fields->node_force.empty()) {
                continue;
            }
            for (int q = 0; q < lane_count; ++q) {
                const std::size_t i = static_cast<std::size_t>(order.id[first + static_cast<std::size_t>(q)]);
                for (std::size_t c = 0; i < count && c < 3; ++c) {
                    lane_of(force[static_cast<int>(c)], l)[q] = fields->node_force[(frame_ * count + i) * 3 + c];
                }
            }
        }
        return force;
    }

    /// f(lane, place) for the places on eight particles.
    template <class F>
    void each_place(const MlsOrder<T>& order, std::size_t first, F&& f) const {
        for (std::size_t q = 0; q < lane_count; ++q) {
            const std::int32_t start = order.place_next[first + q];
            for (std::size_t place = static_cast<std::size_t>(start); start >= 0 && place < model_.place_particle_.size(); ++place) {
                if (model_.place_particle_[place] == order.id[first + q]) {
                    f(static_cast<int>(q), place);
                }
            }
        }
    }
    std::vector<U> place_parameters(std::size_t place) const {
        const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
        std::vector<U> q(count);
        for (std::size_t i = 0; i < count; ++i) {
            q[i] = inputs_.plain(&Fields<T>::place_effect, place * count + i);
        }
        return q;
    }
    /// The place moves with its particle: at rest it is where it was given.
    MaterialPoint<U> material_point(std::size_t place, const ParticlePoint<S>& p, int lane) const {
        MaterialPoint<U> m;
        const std::size_t id = static_cast<std::size_t>(model_.place_particle_[place]);
        for (std::size_t c = 0; c < 3; ++c) {
            const double rest = model_.geometry_.places[3 * place + c];
            const int k = static_cast<int>(c);
            m.rest[k] = constant<U>(static_cast<T>(rest));
            m.position[k] = pick<T, K>(p.x[k], lane) + static_cast<T>(rest - (model_.geometry_.points[3 * id + c] - model_.anchor_[c]));
            m.velocity[k] = pick<T, K>(p.v[k], lane);
        }
        m.time = time_;
        return m;
    }

    const MlsMpm<T>& model_;
    Inputs<T, K> inputs_;
    const StepTable& table_;
    std::vector<U> parameters_, plain_uniforms_;
    std::vector<S> uniforms_;
    Vec3<S> gravity_;
    std::vector<HoldMotion> holds_;
    int n_ = 0;
    std::size_t frame_ = 0;
    T time_ = 0, dt_ = 0;
};

}  // namespace mphygs
