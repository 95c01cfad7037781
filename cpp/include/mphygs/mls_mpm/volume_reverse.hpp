// The stress of eight particles backwards, and what else effects of the volume do.
#pragma once

#include "mphygs/mls_mpm/forces_reverse.hpp"

namespace mphygs {

template <class T>
inline void MlsForcesReverse<T>::reverse_volume(const MlsOrder<T>& order, std::size_t first, const ParticlePoint<P>& point, const T* history,
                                                const GivenBars<T>& given, const Vec3<P>& force_bar, T* history_bar, ParticlePoint<P>& bar,
                                                MlsParticleBars<T>& particles, MlsChunkSums& sums) const {
    const MlsMpm<T>& model = forces_.model_;
    const VolumePoint<P> value = forces_.volume_point(order, first, point);
    const P volume = forces_.fixed(order, fixed_volume, first);
    const T k = forces_.stress_scale();
    const Mat3<P> tau_bar = (-k * volume) * given.affine;
    const Mat3<P> stress_bar = tau_bar * point.f;
    Mat3<P> stress, deformation_bar;
    P mu_bar{}, lambda_bar{};
    if (!model.sites_.volume) {
        // The Hessian of an energy is symmetric: its adjoint is its tangent.
        using D = Dual<P, 3>;
        Mat3<D> f;
        for (int i = 0; i < 9; ++i) {
            f[i / 3][i % 3] = D(point.f[i / 3][i % 3]);
            f[i / 3][i % 3].d[0] = stress_bar[i / 3][i % 3];
        }
        D mu(value.mu), lambda(value.lambda);
        mu.d[1] = broadcast<T>(1);
        lambda.d[2] = broadcast<T>(1);
        const Mat3<D> p = elastic_stress(value.law, f, mu, lambda);
        for (int i = 0; i < 9; ++i) {
            const D& x = p[i / 3][i % 3];
            stress[i / 3][i % 3] = x.v;
            deformation_bar[i / 3][i % 3] = x.d[0];
            mu_bar += stress_bar[i / 3][i % 3] * x.d[1];
            lambda_bar += stress_bar[i / 3][i % 3] * x.d[2];
        }
    } else {
        tape().reset();
        VolumePoint<V> p;
        p.deformation = input(value.deformation);
        p.rate = input(value.rate);
        p.mu = V::input(value.mu);
        p.lambda = V::input(value.lambda);
        p.law = value.law;
        p.time = value.time;
        p.dt = value.dt;
        const std::vector<V> uniforms = tape_uniforms(Site::volume);
        const std::size_t count = static_cast<std::size_t>(model.sites_.history);
        std::vector<V> before(count), after(count);
        for (std::size_t i = 0; i < count; ++i) {
            before[i] = V::input(load<T>(history + i * order.size + first));
        }
        evaluate_volume(model.slots_, uniforms.data(), p, before.data(), after.data());
        tape().prepare();
        for (int i = 0; i < 9; ++i) {
            stress[i / 3][i % 3] = p.stress[i / 3][i % 3].v;
            seed(p.stress[i / 3][i % 3], stress_bar[i / 3][i % 3]);
        }
        for (std::size_t i = 0; i < count; ++i) {
            seed(after[i], load<T>(history_bar + i * order.size + first));
        }
        if (model.sites_.body_volume) {
            const P own = forces_.own_mass(order, first);
            P own_bar{};
            for (int c = 0; c < 3; ++c) {
                seed(p.acceleration[c], own * force_bar[c]);
                own_bar += force_bar[c] * p.acceleration[c].v;
            }
            add(&particles.own_mass[first], own_bar);
        }
        tape().sweep();
        deformation_bar = adjoint(p.deformation);
        if (model.sites_.rate) {  // dF/dt = C F
            const Mat3<P> rate_bar = adjoint(p.rate);
            deformation_bar = deformation_bar + transpose(point.c) * rate_bar;
            bar.c = bar.c + rate_bar * transpose(point.f);
        }
        mu_bar = tape().adjoint(p.mu.i);
        lambda_bar = tape().adjoint(p.lambda.i);
        for (std::size_t i = 0; i < count; ++i) {
            store<T>(history_bar + i * order.size + first, tape().adjoint(before[i].i));
        }
        add_uniforms(uniforms, sums);
    }
    bar.f = bar.f + deformation_bar + transpose(tau_bar) * stress;
    add(particles.at(fixed_mu, first), mu_bar);
    add(particles.at(fixed_lambda, first), lambda_bar);
    add(particles.at(fixed_volume, first), -k * inner(given.affine, stress * transpose(point.f)));
}

}  // namespace mphygs
