// What the forces of a run's directions do to their velocities, with the observer and what acts on whole bodies.
#pragma once

#include "mphygs/total_lagrangian/directions.hpp"

namespace mphygs {

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::ask(int n, int frame, double dt) {
    const Observer& o = *observer_;
    const std::size_t count = o.channel_count(), from = static_cast<std::size_t>(frame) * count;
    if (frame != aimed_) {
        aimed_ = frame;
        aims_.clear();
        for (std::size_t s = 0; s < slabs_ && any(&Fields<T>::target); ++s) {
            for (std::size_t i = 0; i < 12 * count; ++i) {
                aims_.push_back(lanes(&Fields<T>::target, s, 12 * from + i));
            }
        }
    }
    const ObserverRows<T>& rows = *value_.observer_;
    const auto factors = rows.factors(value_.target_basis(n, frame, dt));
    const std::vector<std::size_t>& read = rows.read_carriers();
    blend_.resize(3 * read.size());
    asked_.resize(slabs_ * 3 * count);
    for (std::size_t s = 0; s < slabs_; ++s) {
        // Rows are linear: one pass over them does for place and rate.
        for (std::size_t k = 0; k < read.size(); ++k) {
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t i = s * slab_ + 3 * read[k] + c;
                blend_[3 * k + c] = rows.stiffness() * u_[i] + rows.damping() * v_[i];
            }
        }
        for (std::size_t i = 0; i < count; ++i) {
            const T share = static_cast<T>(o.share[from + i]);
            W asked[3] = {};
            rows.each_row(i, [&](std::size_t at, T weight) {
                for (std::size_t c = 0; c < 3; ++c) {
                    asked[c] -= weight * blend_[3 * at + c];
                }
            });
            for (std::size_t c = 0; c < 3; ++c) {
                for (std::size_t k = 0; !aims_.empty() && k < 4; ++k) {
                    asked[c] += factors[k] * aims_[((s * count + i) * 4 + k) * 3 + c];
                }
                asked_[(s * count + i) * 3 + c] = share * asked[c];
            }
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::spread_pulls(double dt) {
    constexpr std::size_t quad = ObserverRows<T>::quad;
    const std::size_t count = observer_->channel_count();
    columns_.resize(directions_.size() * quad * count);
    pulled_.resize(directions_.size() * slab_);
    std::vector<const T*> asked;
    std::vector<T*> pulled;
    for (std::size_t k = 0; k < directions_.size(); ++k) {
        T* column = &columns_[k * quad * count];
        const W* from = &asked_[k / width * 3 * count];
        for (std::size_t i = 0; i < 3 * count; ++i) {
            column[i / 3 * quad + i % 3] = from[i][k % width];
        }
        asked.push_back(column);
        pulled.push_back(&pulled_[k * slab_]);
    }
    value_.spread_pulls(dt, asked, pulled);
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::add_pulls() {
    for (std::size_t k = 0; k < directions_.size(); ++k) {
        T* to = reinterpret_cast<T*>(&v_[k / width * slab_]) + k % width;
        for (std::size_t c = 0; c < 3; ++c) {
            const T* from = &pulled_[k * slab_ + c * stride_];
            for (std::size_t n = 0; n < model_.node_count(); ++n) {
                to[(3 * n + c) * width] += from[n];
            }
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::known_forces(int frame) {
    if (frame != frame_) {
        frame_ = frame;
        known_.clear();
        const std::size_t size = 3 * model_.node_count();
        for (std::size_t s = 0; s < slabs_ && any(&Fields<T>::node_force); ++s) {
            for (std::size_t i = 0; i < size; ++i) {
                known_.push_back(lanes(&Fields<T>::node_force, s, static_cast<std::size_t>(frame) * size + i));
            }
        }
    }
    const std::size_t size = known_.size() / std::max<std::size_t>(slabs_, 1);
    for (std::size_t s = 0; s < slabs_; ++s) {
        for (std::size_t i = 0; i < size; ++i) {
            f_[s * slab_ + i] += known_[s * size + i];
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::accelerate(double time, double dt) {
    const T h = static_cast<T>(dt);
    const std::size_t uniforms = static_cast<std::size_t>(Registry::total_uniform_count);
    for (std::size_t s = 0; s < slabs_; ++s) {
        for (std::size_t n = 0; n < model_.node_count(); ++n) {
            const T inverse = value_.inverse_mass_[n];
            W* v = &v_[s * slab_ + 3 * n];
            if (inverse == T{}) {
                v[0] = v[1] = v[2] = W{};  // nodes without mass stay where they are
                continue;
            }
            const W* f = &f_[s * slab_ + 3 * n];
            Vec3<D> effects;
            if (model_.sites_.body) {
                BodyPoint<D> p;
                p.time = static_cast<T>(time);
                for (std::size_t c = 0; c < 3; ++c) {
                    const std::size_t i = value_.at(0, c, n);
                    p.position[static_cast<int>(c)] = dual(static_cast<T>(model_.node_positions_[3 * n + c]) + value_.u_[i], u_[s * slab_ + 3 * n + c]);
                    p.velocity[static_cast<int>(c)] = dual(value_.v_[i], v[c]);
                }
                effects = evaluate_body(model_.slots_, &uniforms_[s * uniforms], p);
            }
            for (int c = 0; c < 3; ++c) {
                W total = gravity_[3 * s + static_cast<std::size_t>(c)] + f[c] * inverse;
                if (model_.sites_.body) {
                    total += effects[c].d[0];
                }
                v[c] += h * total;
            }
        }
    }
    for (const Direction& a : added_) {
        if (a.forces.own().body) {
            add_acceleration(a, time, h);
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::add_acceleration(const Direction& a, double time, T h) {
    T* to = reinterpret_cast<T*>(&v_[a.number / width * slab_]) + a.number % width;
    for (std::size_t n = 0; n < stride_; n += lane_count) {
        const BodyPoint<Pack<T>> now = value_.body_point(n, time);
        BodyPoint<typename AddedForces<T>::P> p;
        for (int c = 0; c < 3; ++c) {
            p.position[c].v = now.position[c];
            p.velocity[c].v = now.velocity[c];
        }
        p.time = now.time;
        const Vec3<Pack<T>> slope = a.forces.acceleration(p);
        for (std::size_t q = 0; q < static_cast<std::size_t>(lane_count); ++q) {
            for (std::size_t c = 0; c < 3 && value_.inverse_mass_[n + q] != T{}; ++c) {
                to[(3 * (n + q) + c) * width] += h * slope[static_cast<int>(c)][q];
            }
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::lighten(double dt) {
    const T h = static_cast<T>(dt);
    for (std::size_t s = 0; s < slabs_ && !inverse_mass_.empty(); ++s) {
        for (std::size_t n = 0; n < model_.node_count(); ++n) {
            const W slope = inverse_mass_[s * stride_ + n];
            for (std::size_t c = 0; c < 3; ++c) {
                v_[s * slab_ + 3 * n + c] += (h * value_.f_[value_.at(0, c, n)]) * slope;
            }
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::reduce_forces() {
    std::fill(f_.begin(), f_.end(), W{});
    for (std::size_t c = 0; c < model_.chunks_.size(); ++c) {
        const auto& chunk = model_.chunks_[c];
        const std::size_t begin = static_cast<std::size_t>(chunk.node_begin);
        const std::size_t span = static_cast<std::size_t>(chunk.node_end) - begin, used = std::min(span, stride_ - begin);
        for (std::size_t s = 0; s < slabs_; ++s) {
            const W* from = &chunk_force_[c][s * 3 * span];
            W* to = &f_[s * slab_ + 3 * begin];
            for (std::size_t i = 0; i < 3 * used; ++i) {
                to[i] += from[i];
            }
        }
        for (std::size_t a = 0; a < added_.size(); ++a) {
            const std::size_t k = added_[a].number;
            T* to = reinterpret_cast<T*>(&f_[k / width * slab_ + 3 * begin]) + k % width;
            for (std::size_t i = 0; i < 3; ++i) {
                const T* from = &chunk_added_[c][(3 * a + i) * span];
                for (std::size_t n = 0; n < used; ++n) {
                    to[(3 * n + i) * width] += from[n];
                }
            }
        }
    }
}

template <class T, int L>
inline auto TotalLagrangianDirections<T, L>::compliance(std::size_t slab, std::size_t lane) const -> T {
    T sum{};
    Registry::each([&](auto tag, int i) {
        using E = typename decltype(tag)::type;
        if constexpr (E::info.site == Site::hold) {
            const EffectSlot& at = model_.slots_[static_cast<std::size_t>(i)];
            if (at.active) {
                sum += parameters_[slab * value_.parameters_.size() + static_cast<std::size_t>(at.parameter)].d[0][lane];
            }
        }
    });
    return sum;
}

}  // namespace mphygs
