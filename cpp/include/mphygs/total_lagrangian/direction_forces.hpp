// Forces of a run's directions, block by block: the law, the effects of the volume and of the surface, springs.
#pragma once

#include "mphygs/total_lagrangian/direction_surface.hpp"

namespace mphygs {

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::chunk_forces(std::size_t index, double time, double dt) {
    const auto& chunk = model_.chunks_[index];
    const std::size_t begin = static_cast<std::size_t>(chunk.node_begin), span = static_cast<std::size_t>(chunk.node_end) - begin;
    std::fill(chunk_force_[index].begin(), chunk_force_[index].end(), W{});
    std::fill(chunk_added_[index].begin(), chunk_added_[index].end(), T{});
    W* out = chunk_force_[index].data() - 3 * begin;
    T* added = chunk_added_[index].data() - begin;
    for (std::size_t b = chunk.block_begin; b < chunk.block_end; ++b) {
        block_forces(b, time, dt, OfNodes{*this, b, out, 3 * span});
        if (volume_added_) {
            added_volume(b, time, dt, added, span);
        }
        if (model_.spring_[b] >= 0) {
            spring_forces(b, out, 3 * span);
        }
    }
    for (std::size_t b = chunk.surface_begin; surface_ && b < chunk.surface_end; ++b) {
        surface_forces(b, time, out, span, added);
    }
}

/// Forces of a block's volume by how its nodes move; ends: where motions come from and forces go.
template <class T, int L>
template <class Ends>
inline void TotalLagrangianDirections<T, L>::block_forces(std::size_t b, double time, double dt, const Ends& ends) {
    if (linearised() && !model_.sites_.volume) {
        linearised_forces<false>(b, time, dt, ends);
    } else if (linearised()) {
        linearised_forces<true>(b, time, dt, ends);
    } else {
        volume_forces(b, time, dt, ends);
    }
}

/// The nodes' motion in all directions, and the forces on them.
template <class T, int L>
struct TotalLagrangianDirections<T, L>::OfNodes {
    const TotalLagrangianDirections& run;
    std::size_t block;
    W* out;
    std::size_t span;

    const Rows& rows() const { return *reinterpret_cast<const Rows*>(run.model_.rows_[block].data()); }
    std::size_t table() const { return static_cast<std::size_t>(run.model_.table_[block]); }
    void motion(std::size_t s, Points& to) const { gather_directions<W, T>(&run.u_[s * run.slab_], rows(), run.model_.gradients_[table()], to); }
    void rates(std::size_t s, Points& to) const { gather_directions<W, T>(&run.v_[s * run.slab_], rows(), run.model_.gradients_[table()], to); }
    void stress(std::size_t s, const Points& from) const { scatter_directions<W, T>(from, out + s * span, rows(), run.model_.gradients_[table()]); }
    void body(std::size_t s, const Vec3<W> (&from)[lane_count]) const {
        scatter_direction_values<W, T>(from, out + s * span, rows(), run.model_.values_[table()]);
    }
};

/// The neo-Hookean law, and effects of the volume that say how they change.
template <class T, int L>
template <bool Effects, class Ends>
inline void TotalLagrangianDirections<T, L>::linearised_forces(std::size_t b, double time, double dt, const Ends& ends) {
    using P = Pack<T>;
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
    const GradientTable<T>& table = model_.gradients_[static_cast<std::size_t>(model_.table_[b])];
    const bool prestressed = value_.prestressed_, rate = Effects && model_.sites_.rate;
    const std::size_t count = static_cast<std::size_t>(model_.sites_.history), blocks = model_.rows_.size();
    const Mat3<P> moved = Mat3<P>::identity() + gather_gradient<T>(value_.u_.data(), stride_, rows, table);
    const Mat3<P> f0 = prestressed ? value_.f0_[b] : Mat3<P>::identity();
    const LinearisedLaw::Linearised<P> law(prestressed ? moved * f0 : moved, value_.mu_[b], value_.lambda_[b]);
    Mat3<P> stress = law.stress(), speed;
    thread_local LinearisedEffects<P> added;
    thread_local VolumePoint<P> now;  // large: cleared once, written over
    VolumeChange<W> d;
    if constexpr (Effects) {
        if (rate) {
            speed = gather_gradient<T>(value_.v_.data(), stride_, rows, table);
            now.rate = prestressed ? speed * f0 : speed;
        }
        now.deformation = law.f;
        now.stress = stress;
        now.time = static_cast<T>(time);
        now.dt = static_cast<T>(dt);
        added.set(model_.slots_, value_.plain_uniforms_.data(), now, count ? &value_.history_[b * count] : nullptr);
        stress = added.stress;
    }
    const Mat3<P> pulled = prestressed ? stress * transpose(f0) : stress;
    alignas(64) Points points;
    [[maybe_unused]] alignas(64) Points rates;
    for (std::size_t s = 0; s < slabs_; ++s) {
        ends.motion(s, points);
        if (rate) {
            ends.rates(s, rates);
        }
        const std::size_t first = 8 * (s * blocks + b);
        for (int q = 0; q < lane_count; ++q) {
            const std::size_t p = first + static_cast<std::size_t>(q);
            LinearisedLaw::Linearised<T> here;
            here.f = in_lane(law.f, q);
            here.c = in_lane(law.c, q);
            here.mu = law.mu[q];
            here.lambda = law.lambda[q];
            here.inverse_j = law.inverse_j[q];
            here.log_j = law.log_j[q];
            here.scale = law.scale[q];
            const Mat3<T> start = in_lane(f0, q);
            Mat3<W> df = at_point(points, q);
            if (prestressed) {
                df = product(df, start);
                if (!f0_.empty()) {
                    df = df + product(in_lane(moved, q), f0_[p]);
                }
            }
            Mat3<W> change = here.change(df, of(mu_, p), of(lambda_, p));
            if constexpr (Effects) {
                if (rate) {
                    d.rate = at_point(rates, q);
                    if (prestressed) {
                        d.rate = product(d.rate, start);
                        if (!f0_.empty()) {
                            d.rate = d.rate + product(in_lane(speed, q), f0_[p]);
                        }
                    }
                }
                d.deformation = df;
                d.law = d.stress = change;
                W* history = count ? &history_[p * count] : nullptr;
                added.change(model_.slots_, q, d, &uniforms_[s * static_cast<std::size_t>(Registry::total_uniform_count)], history, history);
                change = d.stress;
            }
            if (prestressed) {
                change = product(change, transpose(start));
                if (!f0_.empty()) {
                    change = change + product(in_lane(stress, q), transpose(f0_[p]));
                }
            }
            const T size = -value_.volume_[b][q];
            for (int i = 0; i < 9; ++i) {
                W& x = change.e[i / 3][i % 3];
                x = size * x;
                if (!volume_.empty()) {
                    x -= pulled.e[i / 3][i % 3][q] * volume_[p];
                }
            }
            put(points, q, change);
        }
        ends.stress(s, points);
    }
}

/// Any law and any effects of the volume: by dual numbers, point after point.
template <class T, int L>
template <class Ends>
inline void TotalLagrangianDirections<T, L>::volume_forces(std::size_t b, double time, double dt, const Ends& ends) {
    using P = Pack<T>;
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
    const GradientTable<T>& table = model_.gradients_[static_cast<std::size_t>(model_.table_[b])];
    const bool prestressed = value_.prestressed_, rate = model_.sites_.rate;
    const std::size_t count = static_cast<std::size_t>(model_.sites_.history), blocks = model_.rows_.size();
    const Mat3<P> moved = Mat3<P>::identity() + gather_gradient<T>(value_.u_.data(), stride_, rows, table);
    const Mat3<P> speed = rate ? gather_gradient<T>(value_.v_.data(), stride_, rows, table) : Mat3<P>{};
    const Mat3<P> f0 = prestressed ? value_.f0_[b] : Mat3<P>::identity();
    const Mat3<P> deformation = prestressed ? moved * f0 : moved, flow = prestressed ? speed * f0 : speed;
    alignas(64) Points points, rates;
    Vec3<W> body[lane_count];
    thread_local std::vector<D> before, after;
    thread_local VolumePoint<D> p;  // large: cleared once, written over
    before.resize(count);
    after.resize(count);
    const auto joined = [](const Mat3<P>& value, const Mat3<W>& slope, int q) {
        Mat3<D> r;
        for (int i = 0; i < 9; ++i) {
            r.e[i / 3][i % 3] = dual(value.e[i / 3][i % 3][q], slope.e[i / 3][i % 3]);
        }
        return r;
    };
    for (std::size_t s = 0; s < slabs_; ++s) {
        ends.motion(s, points);
        if (rate) {
            ends.rates(s, rates);
        }
        const D* uniforms = &uniforms_[s * static_cast<std::size_t>(Registry::total_uniform_count)];
        for (int q = 0; q < lane_count; ++q) {
            const std::size_t at = 8 * (s * blocks + b) + static_cast<std::size_t>(q);
            const Mat3<T> start = in_lane(f0, q);
            Mat3<W> df = at_point(points, q), dr = rate ? at_point(rates, q) : Mat3<W>{};
            if (prestressed) {
                df = product(df, start);
                dr = rate ? product(dr, start) : dr;
                if (!f0_.empty()) {
                    df = df + product(in_lane(moved, q), f0_[at]);
                    dr = rate ? dr + product(in_lane(speed, q), f0_[at]) : dr;
                }
            }
            p.acceleration = {};
            p.deformation = joined(deformation, df, q);
            if (rate) {
                p.rate = joined(flow, dr, q);
            }
            p.mu = dual(value_.mu_[b][q], of(mu_, at));
            p.lambda = dual(value_.lambda_[b][q], of(lambda_, at));
            p.law = model_.settings_.law;
            p.time = static_cast<T>(time);
            p.dt = static_cast<T>(dt);
            for (std::size_t i = 0; i < count; ++i) {
                before[i] = dual(value_.history_[b * count + i][q], history_[at * count + i]);
            }
            if (model_.sites_.volume) {
                evaluate_volume(model_.slots_, uniforms, p, before.data(), after.data());
                for (std::size_t i = 0; i < count; ++i) {
                    history_[at * count + i] = after[i].d[0];
                }
            } else {
                p.stress = elastic_stress(p.law, p.deformation, p.mu, p.lambda);
            }
            if (model_.sites_.body_volume) {
                const D mass = dual(value_.mass_points_[b][q], of(mass_points_, at));
                for (int c = 0; c < 3; ++c) {
                    body[q][c] = (mass * p.acceleration[c]).d[0];
                }
            }
            Mat3<D> stress = p.stress;
            if (prestressed) {
                stress = stress * transpose(joined(f0, f0_.empty() ? Mat3<W>{} : f0_[at], q));
            }
            stress = dual(-value_.volume_[b][q], -of(volume_, at)) * stress;
            for (int i = 0; i < 9; ++i) {
                points[i / 3][i % 3 * lane_count + q] = stress.e[i / 3][i % 3].d[0];
            }
        }
        ends.stress(s, points);
        if (model_.sites_.body_volume) {
            ends.body(s, body);
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::spring_forces(std::size_t b, W* out, std::size_t span) const {
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
    const std::size_t index = static_cast<std::size_t>(model_.spring_[b]);
    const CellSprings<T>& springs = model_.springs_[index];
    constexpr std::size_t shapes = CellSprings<T>::shapes;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto value = springs.along(value_.u_.data() + c * stride_, rows);
        for (std::size_t s = 0; s < slabs_; ++s) {
            const W* u = &u_[s * slab_ + c];
            const W stiffer = of(spring_stiffness_, s * model_.springs_.size() + index);
            W pull[shapes] = {};
            for (std::size_t a = 0; a < 27; ++a) {
                const W x = u[3 * node_of<T>(rows, static_cast<int>(a))];
                for (std::size_t k = 0; k < shapes; ++k) {
                    pull[k] += springs.shape[k][a / 3 * 4 + a % 3] * x;
                }
            }
            for (std::size_t k = 0; k < shapes; ++k) {
                pull[k] = -value_.spring_stiffness_[index] * pull[k] - value[k] * stiffer;
            }
            for (std::size_t a = 0; a < 27; ++a) {
                W& to = out[s * span + c + 3 * static_cast<std::size_t>(node_of<T>(rows, static_cast<int>(a)))];
                for (std::size_t k = 0; k < shapes; ++k) {
                    to += springs.shape[k][a / 3 * 4 + a % 3] * pull[k];
                }
            }
        }
    }
}

}  // namespace mphygs
