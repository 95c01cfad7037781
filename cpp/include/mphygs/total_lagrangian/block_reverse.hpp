// Backwards through the forces of blocks of points, of springs, of the surface and at places.
#pragma once

#include "mphygs/total_lagrangian/forces_reverse.hpp"

namespace mphygs {

template <class T>
inline void TotalLagrangianForcesReverse<T>::reverse_places(double time) {
    Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
    const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
    for (std::size_t p = 0; p < model_.places_.size(); ++p) {
        const auto& place = model_.places_[p];
        tape.reset();
        const MaterialPoint<T> value = run_.material_point(p, time);
        MaterialPoint<V> m;
        for (int c = 0; c < 3; ++c) {
            m.rest[c] = V(broadcast<T>(value.rest[c]));
            m.position[c] = V::input(broadcast<T>(value.position[c]));
            m.velocity[c] = V::input(broadcast<T>(value.velocity[c]));
        }
        m.time = value.time;
        std::vector<V> q;
        for (const T x : run_.place_parameters(p)) {
            q.push_back(V::input(broadcast<T>(x)));
        }
        const Vec3<V> force = evaluate_point(model_.slots_, q.data(), m);
        tape.prepare();
        for (int c = 0; c < 3; ++c) {
            T bar{};
            for (std::size_t a = 0; a < 27; ++a) {
                bar += place.value[a] * fbar_[run_.at(0, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]))];
            }
            seed(force[c], broadcast<T>(bar));
        }
        tape.sweep();
        const Vec3<Pack<T>> xbar = adjoint(m.position), vbar = adjoint(m.velocity);
        for (int c = 0; c < 3; ++c) {
            for (std::size_t a = 0; a < 27; ++a) {
                const std::size_t i = run_.at(0, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]));
                ubar_[i] += place.value[a] * xbar[c][0];
                vbar_[i] += place.value[a] * vbar[c][0];
            }
        }
        for (std::size_t i = 0; i < count; ++i) {
            place_effect_bar_[p * count + i] += static_cast<double>(tape.adjoint(q[i].i)[0]);
        }
    }
}

template <class T>
inline void TotalLagrangianForcesReverse<T>::reverse_block(std::size_t b, double time, double dt, T* ubar, T* vbar, std::size_t span, std::vector<double>& uniform_bar) {
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
    const std::size_t table_index = static_cast<std::size_t>(model_.table_[b]);
    const GradientTable<T>& table = model_.gradients_[table_index];
    const Pack<T> volume = run_.volume_[b];
    // f_a = - V P_u dN_a: the bar of P_u is -V G, the bar of V is -G : P_u.
    const Mat3<Pack<T>> g = gather_gradient<T>(fbar_.data(), run_.stride_, rows, table);
    VolumePoint<Pack<T>> value;
    run_.load_point(b, value, time, dt);
    const Mat3<Pack<T>> pulled = run_.prestressed_ ? g * run_.f0_[b] : g;
    const Mat3<Pack<T>> stress_bar = (-volume) * pulled;
    Mat3<Pack<T>> stress, deformation_bar, rate_bar;
    Pack<T> mu_bar, lambda_bar;
    if (!model_.sites_.volume) {
        // The Hessian of an energy is symmetric: its adjoint is its tangent.
        using D = Dual<Pack<T>, 3>;
        Mat3<D> f;
        for (int i = 0; i < 9; ++i) {
            f[i / 3][i % 3] = D(value.deformation[i / 3][i % 3]);
            f[i / 3][i % 3].d[0] = stress_bar[i / 3][i % 3];
        }
        D mu(value.mu), lambda(value.lambda);
        mu.d[1] = broadcast<T>(1);
        lambda.d[2] = broadcast<T>(1);
        const Mat3<D> p = elastic_stress(value.law, f, mu, lambda);
        mu_bar = lambda_bar = Pack<T>{};
        for (int i = 0; i < 9; ++i) {
            const D& x = p[i / 3][i % 3];
            stress[i / 3][i % 3] = x.v;
            deformation_bar[i / 3][i % 3] = x.d[0];
            mu_bar += stress_bar[i / 3][i % 3] * x.d[1];
            lambda_bar += stress_bar[i / 3][i % 3] * x.d[2];
        }
    } else {
        Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
        tape.reset();
        VolumePoint<V> p;
        p.deformation = input(value.deformation);
        p.rate = input(value.rate);
        p.mu = V::input(value.mu);
        p.lambda = V::input(value.lambda);
        p.law = value.law;
        p.time = value.time;
        p.dt = value.dt;
        const std::vector<V> uniforms = tape_uniforms(Site::volume);
        const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
        std::vector<V> before(count), after(count);
        for (std::size_t i = 0; i < count; ++i) {
            before[i] = V::input(run_.history_[b * count + i]);
        }
        evaluate_volume(model_.slots_, uniforms.data(), p, before.data(), after.data());
        tape.prepare();
        for (int i = 0; i < 9; ++i) {
            stress[i / 3][i % 3] = p.stress[i / 3][i % 3].v;
            seed(p.stress[i / 3][i % 3], stress_bar[i / 3][i % 3]);
        }
        for (std::size_t i = 0; i < count; ++i) {
            seed(after[i], history_bar_[b * count + i]);
        }
        if (model_.sites_.body_volume) {
            const Vec3<Pack<T>> force_bar = gather_value<T>(fbar_.data(), run_.stride_, rows, model_.values_[table_index]);
            Pack<T> mass_bar{};
            for (int c = 0; c < 3; ++c) {
                seed(p.acceleration[c], run_.mass_points_[b] * force_bar[c]);
                mass_bar += force_bar[c] * p.acceleration[c].v;
            }
            accumulate(&mass_bar_[8 * static_cast<std::size_t>(model_.order_[b])], mass_bar);
        }
        tape.sweep();
        deformation_bar = adjoint(p.deformation);
        rate_bar = adjoint(p.rate);
        mu_bar = tape.adjoint(p.mu.i);
        lambda_bar = tape.adjoint(p.lambda.i);
        for (std::size_t i = 0; i < count; ++i) {
            history_bar_[b * count + i] = tape.adjoint(before[i].i);
        }
        add_uniform_bar(uniforms, uniform_bar);
    }
    const std::size_t to = 8 * static_cast<std::size_t>(model_.order_[b]);
    accumulate(&mu_bar_[to], mu_bar);
    accumulate(&lambda_bar_[to], lambda_bar);
    accumulate(&volume_bar_[to], -inner(pulled, stress));
    Mat3<Pack<T>> gradient_bar = deformation_bar;
    if (run_.prestressed_) {
        // F = F_u F0, dF/dt = G_v F0, P_u = P F0^T
        const Mat3<Pack<T>>& f0 = run_.f0_[b];
        gradient_bar = deformation_bar * transpose(f0);
        Mat3<Pack<T>> f0_bar = transpose(value.deformation * inverse(f0)) * deformation_bar +
                               (-volume) * (transpose(g) * stress);
        if (model_.sites_.rate) {
            f0_bar = f0_bar + transpose(value.rate * inverse(f0)) * rate_bar;
        }
        add_deformation0_bar(to, f0_bar);
    }
    scatter_gradient<T>(gradient_bar, ubar, span, rows, table);
    if (model_.sites_.rate) {
        const Mat3<Pack<T>> velocity_bar = run_.prestressed_ ? rate_bar * transpose(run_.f0_[b]) : rate_bar;
        scatter_gradient<T>(velocity_bar, vbar, span, rows, table);
    }
}

template <class T>
inline void TotalLagrangianForcesReverse<T>::reverse_springs(std::size_t b, T* ubar, std::size_t span) {
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
    const std::size_t index_here = static_cast<std::size_t>(model_.spring_[b]);
    const CellSprings<T>& springs = model_.springs_[index_here];
    const T stiffness = run_.spring_stiffness_[index_here];
    double stiffness_bar = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto value = springs.along(run_.u_.data() + run_.at(0, c, 0), rows);
        auto pull = springs.along(fbar_.data() + run_.at(0, c, 0), rows);
        for (std::size_t k = 0; k < pull.size(); ++k) {
            stiffness_bar -= static_cast<double>(pull[k] * value[k]);
            pull[k] *= -stiffness;
        }
        springs.add(pull, rows, ubar + c * span);
    }
    const std::size_t to = 8 * static_cast<std::size_t>(model_.order_[b]);
    const Pack<T> bar = broadcast<T>(static_cast<T>(stiffness_bar) * springs.stiffness);
    accumulate(&mu_bar_[to], bar * run_.volume_[b]);
    accumulate(&volume_bar_[to], bar * run_.mu_[b]);
}

template <class T>
inline void TotalLagrangianForcesReverse<T>::reverse_surface(std::size_t b, double time, T* ubar, T* vbar, std::size_t span, std::vector<double>& uniform_bar) {
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
    const ValueTable<T>& table = model_.surface_values_[b];
    Tape<Pack<T>>& tape = Tape<Pack<T>>::current();
    tape.reset();
    const SurfacePoint<Pack<T>> value = run_.surface_point(b, time);
    SurfacePoint<V> p;
    p.position = input(value.position);
    p.velocity = input(value.velocity);
    p.area = V(value.area);
    p.time = value.time;
    const std::vector<V> uniforms = tape_uniforms(Site::surface);
    const Vec3<V> force = evaluate_surface(model_.slots_, uniforms.data(), p);
    tape.prepare();
    const Vec3<Pack<T>> force_bar = gather_value<T>(fbar_.data(), run_.stride_, rows, table);
    for (int c = 0; c < 3; ++c) {
        seed(force[c], force_bar[c]);
    }
    tape.sweep();
    scatter_value<T>(adjoint(p.position), ubar, span, rows, table);
    scatter_value<T>(adjoint(p.velocity), vbar, span, rows, table);
    add_uniform_bar(uniforms, uniform_bar);
}

}  // namespace mphygs
