// Directions of the total-Lagrangian forces two at a time: the points of the second in the upper eight lanes.
#pragma once

#include "mphygs/transfers/total_lagrangian_forces.hpp"

namespace mphygs {

template <class T, int K>
inline int TotalLagrangianForces<T, K>::elastic_pairs(std::size_t b, float* out, std::size_t span, const Rows& rows,
                                                      const GradientTable<float>& table,
                                                      const NeoHookean::Linearised<Pack<float>>& point,
                                                      const Mat3<Pack<float>>& gradient, const Mat3<Pack<float>>& stress,
                                                      const Mat3<Pack<float>>& pulled) const {
    using W = PackPair;
    const auto twice = [](const Mat3<Pack<float>>& m) {
        Mat3<W> r;
        for (int i = 0; i < 9; ++i) {
            r.e[i / 3][i % 3] = join(m.e[i / 3][i % 3], m.e[i / 3][i % 3]);
        }
        return r;
    };
    const auto lanes_of = [](const S& x, int l) { return pair_lanes(x, l); };
    NeoHookean::Linearised<W> law;
    law.f = twice(point.f);
    law.c = twice(point.c);
    law.mu = join(point.mu, point.mu);
    law.lambda = join(point.lambda, point.lambda);
    law.inverse_j = join(point.inverse_j, point.inverse_j);
    law.log_j = join(point.log_j, point.log_j);
    law.scale = join(point.scale, point.scale);
    const Mat3<W> both_pulled = twice(pulled);
    Mat3<W> f0, f0t, g, s;
    if (prestressed_) {
        f0 = twice(get_lane<Pack<float>>(f0_[b], 0));
        f0t = transpose(f0);
        g = twice(gradient);
        s = twice(stress);
    }
    const W volume = join(-volume_[b].v, -volume_[b].v);
    int l = 1;
    for (; l + 1 < used_; l += 2) {
        Mat3<W> df = gather_gradient_pair(u_.data() + at(l, 0, 0), size_, stride_, rows, table);
        Mat3<W> df0;
        if (prestressed_) {
            for (int i = 0; i < 9; ++i) {
                df0.e[i / 3][i % 3] = lanes_of(f0_[b].e[i / 3][i % 3], l);
            }
            df = df * f0 + df0 + g * df0;
        }
        Mat3<W> change = law.change(df, lanes_of(mu_[b], l), lanes_of(lambda_[b], l));
        if (prestressed_) {
            change = change * f0t + s * transpose(df0);
        }
        const W dvolume = -lanes_of(volume_[b], l);
        float* to = out + static_cast<std::size_t>(l) * 3 * span;
        scatter_gradient_pair(volume * change + dvolume * both_pulled, to, to + 3 * span, span, rows, table);
    }
    return l;
}

template <class T, int K>
inline void TotalLagrangianForces<T, K>::volume_pairs(std::size_t b, double time, double dt, float* out, std::size_t span,
                                                      const Rows& rows, const GradientTable<float>& table) {
    using D = PairScalar;
    static_assert(K % 2 == 0);
    const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
    thread_local std::vector<D> before, after;
    before.resize(count);
    after.resize(count);
    const Mat3<Pack<float>> strain = gather_gradient<float>(u_.data(), stride_, rows, table);
    Mat3<Pack<float>> speed;
    if (model_.sites_.rate) {
        speed = gather_gradient<float>(v_.data(), stride_, rows, table);
    }
    const auto gathered = [&](const Mat3<Pack<float>>& value, const std::vector<float>& field, int l) {
        const Mat3<PackPair> change = gather_gradient_pair(field.data() + at(l, 0, 0), size_, stride_, rows, table);
        Mat3<D> r;
        for (int i = 0; i < 9; ++i) {
            r.e[i / 3][i % 3] = D(join(value.e[i / 3][i % 3], value.e[i / 3][i % 3]));
            r.e[i / 3][i % 3].d[0] = change.e[i / 3][i % 3];
        }
        return r;
    };
    thread_local VolumePoint<D> p;  // large: cleared once, written over
    for (int l = 1; l < used_; l += 2) {
        p.acceleration = {};
        Mat3<D> f0;
        p.deformation = gathered(strain, u_, l);
        if (prestressed_) {
            f0 = pair_of(f0_[b], l);
            p.deformation = f0 + p.deformation * f0;
        } else {
            p.deformation = Mat3<D>::identity() + p.deformation;
        }
        if (model_.sites_.rate) {
            p.rate = gathered(speed, v_, l);
            if (prestressed_) {
                p.rate = p.rate * f0;
            }
        }
        p.mu = pair_of(mu_[b], l);
        p.lambda = pair_of(lambda_[b], l);
        p.law = model_.settings_.law;
        p.time = static_cast<float>(time);
        p.dt = static_cast<float>(dt);
        if (model_.sites_.volume) {
            S* history = history_.data() + b * count;
            for (std::size_t i = 0; i < count; ++i) {
                before[i] = pair_of(history[i], l);
            }
            const D* uniforms = pair_uniforms_.data() + static_cast<std::size_t>(l / 2) * uniforms_.size();
            evaluate_volume(model_.slots_, uniforms, p, before.data(), after.data());
            if (l + 2 < used_) {
                // The other pairs still need the value before.
                for (std::size_t i = 0; i < count; ++i) {
                    history[i].d[l - 1] = lower(after[i].d[0]);
                    history[i].d[l] = upper(after[i].d[0]);
                }
            } else {
                for (std::size_t i = 0; i < count; ++i) {
                    put_pair(history[i], l, after[i]);
                }
            }
            if (model_.sites_.body_volume) {
                const Vec3<D> force = pair_of(mass_points_[b], l) * p.acceleration;
                const ValueTable<float>& values = model_.values_[static_cast<std::size_t>(model_.table_[b])];
                for (int k = l == 1 ? 0 : l; k < std::min(l + 2, used_); ++k) {
                    scatter_value<float>(pair_part(force, l, k), out + static_cast<std::size_t>(k) * 3 * span, span, rows, values);
                }
            }
        } else {
            p.stress = elastic_stress(p.law, p.deformation, p.mu, p.lambda);
        }
        Mat3<D> stress = prestressed_ ? p.stress * transpose(f0) : p.stress;
        stress = (-pair_of(volume_[b], l)) * stress;
        Mat3<Pack<float>> value, change;
        Mat3<PackPair> changes;
        for (int i = 0; i < 9; ++i) {
            const D& x = stress.e[i / 3][i % 3];
            value.e[i / 3][i % 3] = lower(x.v);
            change.e[i / 3][i % 3] = lower(x.d[0]);
            changes.e[i / 3][i % 3] = x.d[0];
        }
        if (l == 1) {
            scatter_gradient<float>(value, out, span, rows, table);
        }
        float* to = out + static_cast<std::size_t>(l) * 3 * span;
        if (l + 1 < used_) {
            scatter_gradient_pair(changes, to, to + 3 * span, span, rows, table);
        } else {
            scatter_gradient<float>(change, to, span, rows, table);
        }
    }
}

template <class T, int K>
inline void TotalLagrangianForces<T, K>::surface_pairs(std::size_t b, double time, float* out, std::size_t span,
                                                       const Rows& rows, const ValueTable<float>& table) const {
    using D = PairScalar;
    const Vec3<Pack<float>> x = surface_position(b, gather_value<float>(u_.data(), stride_, rows, table));
    const Vec3<Pack<float>> v = gather_value<float>(v_.data(), stride_, rows, table);
    for (int l = 1; l < used_; l += 2) {
        SurfacePoint<D> p;
        const Vec3<PackPair> dx = gather_value_pair(u_.data() + at(l, 0, 0), size_, stride_, rows, table);
        const Vec3<PackPair> dv = gather_value_pair(v_.data() + at(l, 0, 0), size_, stride_, rows, table);
        for (int c = 0; c < 3; ++c) {
            p.position[c].v = join(x[c], x[c]);
            p.position[c].d[0] = dx[c];
            p.velocity[c].v = join(v[c], v[c]);
            p.velocity[c].d[0] = dv[c];
        }
        p.area = D(join(surface_area_[b], surface_area_[b]));
        p.time = static_cast<float>(time);
        const Vec3<D> force =
            evaluate_surface(model_.slots_, pair_uniforms_.data() + static_cast<std::size_t>(l / 2) * uniforms_.size(), p);
        for (int k = l == 1 ? 0 : l; k < std::min(l + 2, used_); ++k) {
            scatter_value<float>(pair_part(force, l, k), out + static_cast<std::size_t>(k) * 3 * span, span, rows, table);
        }
    }
}

template <class T, int K>
inline Vec3<Pack<float>> TotalLagrangianForces<T, K>::pair_part(const Vec3<PairScalar>& a, int l, int k) {
    Vec3<Pack<float>> r;
    for (int c = 0; c < 3; ++c) {
        r[c] = k == 0 ? lower(a[c].v) : k == l ? lower(a[c].d[0]) : upper(a[c].d[0]);
    }
    return r;
}

}  // namespace mphygs
