// What the particles of the total-Lagrangian transfer give to the nodes: the law and the effects of the volume and of
// the surface, with their derivatives, chunk by chunk.
#pragma once

#include <algorithm>

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

/// T: float or double; K: number of directions (0: values only). Holds the nodes' state and what of the inputs the
/// points need, packed in the order in which a substep reads it.
template <class T, int K>
class TotalLagrangianForces {
  public:
    using Model = TotalLagrangian<T>;
    using S = PackScalar<T, K>;
    using U = PlainScalar<T, K>;
    static constexpr int lanes = K + 1;

    TotalLagrangianForces(const Model& model, const Inputs<T, K>& inputs)
        : model_(model), inputs_(inputs), stride_(model.stride_), size_(3 * model.stride_) {
        const Geometry& g = model.geometry_;
        const std::size_t blocks = g.block_count();
        u_.assign(lanes * size_, T{});
        v_.assign(lanes * size_, T{});
        for (std::size_t n = 0; n < model.node_count(); ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                for (int l = 0; l < lanes; ++l) {
                    u_[at(l, c, n)] = lane_of(inputs.plain(&Fields<T>::displacement0, 3 * n + c), l);
                    v_[at(l, c, n)] = lane_of(inputs.plain(&Fields<T>::velocity0, 3 * n + c), l);
                }
            }
        }
        for (int k = 0; k < K; ++k) {
            used_ = inputs.direction[k] ? k + 2 : used_;
        }
        // Packed per block, in the sorted order, so that a substep reads straight through.
        prestressed_ = !inputs.primal->deformation0.empty();
        mu_.resize(blocks);
        lambda_.resize(blocks);
        volume_.resize(blocks);
        mass_points_.resize(model.sites_.body_volume ? blocks : 0);
        f0_.resize(prestressed_ ? blocks : 0);
        history_.assign(blocks * static_cast<std::size_t>(model.sites_.history), S{});
        for (std::size_t b = 0; b < blocks; ++b) {
            const std::size_t from = 8 * static_cast<std::size_t>(model.order_[b]);
            mu_[b] = inputs.pack(&Fields<T>::mu, from);
            lambda_[b] = inputs.pack(&Fields<T>::lambda, from);
            volume_[b] = inputs.pack(&Fields<T>::stress_volume, from);
            if (model.sites_.body_volume) {
                mass_points_[b] = inputs.pack(&Fields<T>::mass, from);
            }
            if (prestressed_) {
                for (int i = 0; i < 9; ++i) {
                    f0_[b][i / 3][i % 3] = inputs.pack(&Fields<T>::deformation0, 9 * from + 8 * static_cast<std::size_t>(i));
                }
            }
        }
        spring_stiffness_.assign(model.springs_.size(), U{});
        for (std::size_t b = 0; b < blocks; ++b) {
            if (model.spring_[b] < 0) {
                continue;
            }
            U& sum = spring_stiffness_[static_cast<std::size_t>(model.spring_[b])];
            for (std::size_t q = 8 * static_cast<std::size_t>(model.order_[b]), end = q + 8; q < end; ++q) {
                sum = sum + inputs.plain(&Fields<T>::mu, q) * inputs.plain(&Fields<T>::stress_volume, q);
            }
            sum = model.springs_[static_cast<std::size_t>(model.spring_[b])].stiffness * sum;
        }
        surface_area_.resize(model.surface_rows_.size());
        for (std::size_t b = 0; b < surface_area_.size(); ++b) {
            for (int q = 0; q < 8; ++q) {
                surface_area_[b][q] =
                    static_cast<T>(g.surface_area[8 * static_cast<std::size_t>(model.surface_order_[b]) + static_cast<std::size_t>(q)]);
            }
        }
        for (const auto& c : model.chunks_) {
            chunk_force_.emplace_back(static_cast<std::size_t>(lanes) * 3 * static_cast<std::size_t>(c.node_end - c.node_begin), T{});
        }
        uniforms_.resize(static_cast<std::size_t>(Registry::total_uniform_count));
        plain_uniforms_.resize(uniforms_.size());
        parameters_.resize(static_cast<std::size_t>(Registry::parameter_count));
        for (std::size_t i = 0; i < parameters_.size(); ++i) {
            parameters_[i] = inputs.plain(&Fields<T>::effect, i);
        }
    }

    std::size_t at(int lane, std::size_t component, std::size_t node) const {
        return static_cast<std::size_t>(lane) * size_ + component * stride_ + node;
    }

  protected:
    template <class TT>
    friend class TotalLagrangianForcesReverse;
    template <class TT>
    friend class TotalLagrangianReverse;
    template <class TT, int L>
    friend class TotalLagrangianDirections;
    template <class TT, int L>
    friend class CellAssembly;

    /// What effects compute once a substep.
    void refresh_uniforms(double time, double dt) {
        all_uniforms(model_.slots_, parameters_.data(), static_cast<T>(time), static_cast<T>(dt), plain_uniforms_.data());
        for (std::size_t i = 0; i < uniforms_.size(); ++i) {
            for (int l = 0; l < lanes; ++l) {
                lane_of(uniforms_[i], l) = broadcast<T>(lane_of(plain_uniforms_[i], l));
            }
        }
        value_uniforms_.resize(uniforms_.size());
        for (std::size_t i = 0; i < uniforms_.size(); ++i) {
            value_uniforms_[i] = lane_of(uniforms_[i], 0);
        }
    }

    /// The forces of a chunk's points on its nodes, kept beside those of the others.
    void chunk_forces(std::size_t index, double time, double dt) {
        const auto& chunk = model_.chunks_[index];
        std::vector<T>& out = chunk_force_[index];
        const std::size_t span = static_cast<std::size_t>(chunk.node_end - chunk.node_begin);
        std::fill(out.begin(), out.end(), T{});
        for (std::size_t b = chunk.block_begin; b < chunk.block_end; ++b) {
            block_forces(b, time, dt, out.data() - chunk.node_begin, span);
            if (model_.spring_[b] >= 0) {
                spring_forces(b, out.data() - chunk.node_begin, span);
            }
        }
        if (model_.sites_.surface) {
            for (std::size_t b = chunk.surface_begin; b < chunk.surface_end; ++b) {
                surface_forces(b, time, out.data() - chunk.node_begin, span);
            }
        }
    }

    /// What the springs of a sparsely filled cell pull with (see `CellSprings`).
    void spring_forces(std::size_t b, T* out, std::size_t span) const {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t index = static_cast<std::size_t>(model_.spring_[b]);
        const CellSprings<T>& springs = model_.springs_[index];
        const U& stiffness = spring_stiffness_[index];
        for (std::size_t c = 0; c < 3; ++c) {
            const auto value = springs.along(u_.data() + at(0, c, 0), rows);
            for (int l = 0; l < used_; ++l) {
                auto pull = l == 0 ? value : springs.along(u_.data() + at(l, c, 0), rows);
                for (std::size_t k = 0; k < pull.size(); ++k) {
                    pull[k] *= -lane_of(stiffness, 0);
                    if (l > 0) {
                        pull[k] -= lane_of(stiffness, l) * value[k];
                    }
                }
                springs.add(pull, rows, out + (3 * static_cast<std::size_t>(l) + c) * span);
            }
        }
    }

    void block_forces(std::size_t b, double time, double dt, T* out, std::size_t span) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const GradientTable<T>& table = model_.gradients_[static_cast<std::size_t>(model_.table_[b])];
        if (!model_.sites_.volume && model_.settings_.law == linearised_law) {
            elastic_forces(b, out, span, rows, table);
            return;
        }
        VolumePoint<S> p;
        load_point(b, p, time, dt);
        Mat3<S> stress;
        if (!model_.sites_.volume) {
            stress = elastic_stress(p.law, p.deformation, p.mu, p.lambda);
        } else {
            const std::size_t count = static_cast<std::size_t>(model_.sites_.history);
            thread_local std::vector<S> before, after;
            before.assign(history_.begin() + static_cast<std::ptrdiff_t>(b * count),
                          history_.begin() + static_cast<std::ptrdiff_t>((b + 1) * count));
            after.resize(count);
            evaluate_volume(model_.slots_, uniforms_.data(), p, before.data(), after.data());
            std::copy(after.begin(), after.end(), history_.begin() + static_cast<std::ptrdiff_t>(b * count));
            stress = p.stress;
            if (model_.sites_.body_volume) {
                const Vec3<S> force = mass_points_[b] * p.acceleration;
                for (int l = 0; l < used_; ++l) {
                    Vec3<Pack<T>> part;
                    for (int c = 0; c < 3; ++c) {
                        part[c] = lane_of(force[c], l);
                    }
                    scatter_value<T>(part, out + static_cast<std::size_t>(l) * 3 * span, span, rows,
                                     model_.values_[static_cast<std::size_t>(model_.table_[b])]);
                }
            }
        }
        if (prestressed_) {
            stress = stress * transpose(f0_[b]);
        }
        stress = (-volume_[b]) * stress;
        for (int l = 0; l < used_; ++l) {
            scatter_gradient<T>(get_lane<Pack<T>>(stress, l), out + static_cast<std::size_t>(l) * 3 * span, span, rows, table);
        }
    }

    /// The law alone, one direction after the other: nothing but registers between gather and scatter.
    void elastic_forces(std::size_t b, T* out, std::size_t span, const Rows& rows, const GradientTable<T>& table) const {
        using P = Pack<T>;
        const Mat3<P> gradient = gather_gradient<T>(u_.data(), stride_, rows, table);
        Mat3<P> f0, f0t, f;
        if (prestressed_) {
            f0 = get_lane<P>(f0_[b], 0);
            f0t = transpose(f0);
            f = f0 + gradient * f0;
        } else {
            f = Mat3<P>::identity() + gradient;
        }
        const P volume = -lane_of(volume_[b], 0);
        const LinearisedLaw::Linearised<P> law(f, lane_of(mu_[b], 0), lane_of(lambda_[b], 0));
        Mat3<P> stress = law.stress();  // without the volume: the directions need it
        const Mat3<P> pulled = prestressed_ ? stress * f0t : stress;
        scatter_gradient<T>(volume * pulled, out, span, rows, table);
        for (int l = 1; l < used_; ++l) {
            Mat3<P> df = gather_gradient<T>(u_.data() + at(l, 0, 0), stride_, rows, table);
            Mat3<P> df0;
            if (prestressed_) {
                df0 = get_lane<P>(f0_[b], l);
                df = df * f0 + df0 + gradient * df0;
            }
            Mat3<P> change = law.change(df, lane_of(mu_[b], l), lane_of(lambda_[b], l));
            if (prestressed_) {
                change = change * f0t + stress * transpose(df0);
            }
            scatter_gradient<T>(volume * change + (-lane_of(volume_[b], l)) * pulled, out + static_cast<std::size_t>(l) * 3 * span,
                                span, rows, table);
        }
    }

    void load_point(std::size_t b, VolumePoint<S>& p, double time, double dt) const {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const GradientTable<T>& table = model_.gradients_[static_cast<std::size_t>(model_.table_[b])];
        Mat3<S> gradient;
        for (int l = 0; l < used_; ++l) {
            set_lane(gradient, l, gather_gradient<T>(u_.data() + at(l, 0, 0), stride_, rows, table));
        }
        p.deformation = prestressed_ ? f0_[b] + gradient * f0_[b] : Mat3<S>::identity() + gradient;
        if (model_.sites_.rate) {
            for (int l = 0; l < used_; ++l) {
                set_lane(gradient, l, gather_gradient<T>(v_.data() + at(l, 0, 0), stride_, rows, table));
            }
            p.rate = prestressed_ ? gradient * f0_[b] : gradient;
        }
        p.mu = mu_[b];
        p.lambda = lambda_[b];
        p.law = model_.settings_.law;
        p.time = static_cast<T>(time);
        p.dt = static_cast<T>(dt);
    }

    SurfacePoint<S> surface_point(std::size_t b, double time) const;

    /// Where the eight surface points of a block are.
    Vec3<Pack<T>> surface_position(std::size_t b, const Vec3<Pack<T>>& displacement) const;

    void surface_forces(std::size_t b, double time, T* out, std::size_t span) const;

    const Model& model_;
    Inputs<T, K> inputs_;
    std::size_t stride_, size_;
    bool prestressed_ = false;
    int used_ = 1;           // lanes: the value and the directions that are given
    std::vector<T> u_, v_;   // lane, component, node
    std::vector<S> mu_, lambda_, volume_, mass_points_, history_;
    std::vector<Mat3<S>> f0_;
    std::vector<U> spring_stiffness_;  // [N/m]
    std::vector<Pack<T>> surface_area_;
    std::vector<std::vector<T>> chunk_force_;
    std::vector<S> uniforms_;
    std::vector<Pack<T>> value_uniforms_;    // the same without directions
    std::vector<U> plain_uniforms_, parameters_;
};

}  // namespace mphygs
