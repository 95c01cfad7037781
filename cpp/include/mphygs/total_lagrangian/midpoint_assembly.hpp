// The matrix of an implicit step, A = M - c (df/dv + c df/du) with c the rule's span, cell by cell.
//
// What a point's stress makes of nine unit gradients of its motion, c of a displacement and 1 of a velocity, is found by the
// run of directions; how the 27 nodes of the cell enter these gradients and are pushed by the stress is a product of their
// weights with it. So are the cell's surface points, by the three unit motions of each, and places; accelerations of the body
// are of a node by its own motion.
#pragma once

#include "mphygs/total_lagrangian/direction_forces.hpp"
#include "mphygs/total_lagrangian/direction_inputs.hpp"
#include "mphygs/total_lagrangian/holds.hpp"
#include "mphygs/total_lagrangian/midpoint_state.hpp"

namespace mphygs {

template <class T>
inline CellNodes nodes_of_rows(const std::array<std::int32_t, 9>& rows) {
    CellNodes nodes;
    for (int a = 0; a < 27; ++a) {
        nodes[static_cast<std::size_t>(a)] = node_of<T>(*reinterpret_cast<const Rows*>(rows.data()), a);
    }
    return nodes;
}

/// L: lanes of the directions that unit motions are.
template <class T, int L>
class CellAssembly : public MidpointAssembly<T> {
  public:
    CellAssembly(const TotalLagrangian<T>& model, const Fields<T>& fields, const Schedule& schedule, Team& team)
        : model_(model), team_(team), run_(model, fields, std::vector<const Fields<T>*>(gradients, &none_), {}, nullptr, nullptr, 0, schedule, team) {
        const auto part = [&](const std::vector<std::array<std::int32_t, 9>>& rows, bool surface) {
            for (std::size_t b = 0; b < rows.size(); ++b) {
                if (b == 0 || rows[b] != rows[b - 1]) {
                    cells_.push_back({b, b, surface});
                }
                ++cells_.back().end;
            }
        };
        part(model.rows_, false);
        acting_ = cells_.size();
        part(model.surface_rows_, true);
        acting_ = model.sites_.surface ? cells_.size() : acting_;
    }

    void assemble(const std::vector<T>& displacement, const std::vector<T>& velocity, const std::vector<Pack<T>>& history, double time, double dt,
                  double span, MidpointMatrix& to) override {
        run_.value_.u_ = displacement;
        run_.value_.v_ = velocity;
        run_.value_.history_.assign(run_.value_.history_.size(), P{});
        std::copy(history.begin(), history.end(), run_.value_.history_.begin());
        run_.refresh(time, dt);
        std::fill(run_.history_.begin(), run_.history_.end(), W{});
        to.clear();
        constexpr std::size_t abreast = 16;
        std::vector<CellMatrix<T>> blocks(std::min(abreast, acting_));
        for (std::size_t first = 0; first < acting_; first += abreast) {
            const std::size_t count = std::min(abreast, acting_ - first);
            team_.each(static_cast<int>(count), [&](int k) {
                const Cell& cell = cells_[first + static_cast<std::size_t>(k)];
                CellMatrix<T>& block = blocks[static_cast<std::size_t>(k)];
                block.setZero();
                for (std::size_t b = cell.begin; b < cell.end; ++b) {
                    if (cell.surface) {
                        add_surface(b, time, static_cast<T>(span), block);
                    } else {
                        add_volume(b, time, dt, static_cast<T>(span), block);
                    }
                }
            });
            for (std::size_t k = 0; k < count; ++k) {
                to.add(first + k, blocks[k]);
            }
        }
        if (model_.sites_.point) {
            for (std::size_t p = 0; p < model_.places_.size(); ++p) {
                add_place(p, time, static_cast<T>(span), to);
            }
        }
        if (model_.sites_.body) {
            for (std::size_t n = 0; n < model_.node_count(); ++n) {
                add_body(n, time, span, to);
            }
        }
    }

  private:
    using Run = TotalLagrangianDirections<T, L>;
    using W = typename Run::W;
    using D = typename Run::D;
    using Points = typename Run::Points;
    using P = Pack<T>;
    static constexpr std::size_t gradients = 9, width = Run::width, slabs = (gradients + width - 1) / width;

    /// Blocks of points that stand on the same nodes.
    struct Cell {
        std::size_t begin, end;
        bool surface;
    };
    /// Lane l of slab s is unit number s L + l: of a gradient 3 k + l that of component k along axis l.
    static W unit(std::size_t s, std::size_t number, T size) {
        T of[width] = {};
        if (number / width == s) {
            of[number % width] = size;
        }
        return read<W>(of);
    }
    struct OfGradients {
        T span;
        Points* stresses;
        Vec3<W> (*bodies)[lane_count];

        static void units(std::size_t s, T size, Points& to) {
            for (std::size_t i = 0; i < gradients; ++i) {
                std::fill_n(&to[i / 3][i % 3 * lane_count], lane_count, unit(s, i, size));
            }
        }
        void motion(std::size_t s, Points& to) const { units(s, span, to); }
        void rates(std::size_t s, Points& to) const { units(s, T(1), to); }
        void stress(std::size_t s, const Points& from) const { std::memcpy(stresses[s], from, sizeof from); }
        void body(std::size_t s, const Vec3<W> (&from)[lane_count]) const { std::copy_n(from, lane_count, bodies[s]); }
    };

    /// Adds what so many numbers of every point push the nodes with, `pushed` their weights, by how these move.
    template <int Numbers, class Made>
    static void add_product(const P (&pushed)[27][Numbers], const Made& made, CellMatrix<T>& to) {
        Eigen::Matrix<T, 27, Numbers * lane_count> weights;
        Eigen::Matrix<T, Numbers * lane_count, 243> by_motion;
        for (int a = 0; a < 27; ++a) {
            for (int j = 0; j < Numbers; ++j) {
                for (int q = 0; q < lane_count; ++q) {
                    weights(a, j * lane_count + q) = pushed[a][j][q];
                }
            }
        }
        for (int column = 0; column < 243; ++column) {
            for (int j = 0; j < Numbers; ++j) {
                const P x = made(column / 9, column / 3 % 3, column % 3, j);
                std::memcpy(&by_motion(j * lane_count, column), &x, sizeof x);
            }
        }
        to.noalias() += weights * by_motion;
    }

    void add_volume(std::size_t b, double time, double dt, T span, CellMatrix<T>& to) {
        alignas(64) Points stresses[slabs];
        Vec3<W> bodies[slabs][lane_count];
        run_.block_forces(b, time, dt, OfGradients{span, stresses, bodies});
        const std::size_t number = static_cast<std::size_t>(model_.table_[b]);
        const auto& table = model_.gradients_[number].by_node;
        P change[3][3][gradients];
        for (std::size_t g = 0; g < gradients; ++g) {
            for (std::size_t i = 0; i < 9; ++i) {
                for (std::size_t q = 0; q < static_cast<std::size_t>(lane_count); ++q) {
                    change[i / 3][i % 3][g][q] = -span * stresses[g / width][i / 3][i % 3 * lane_count + q][g % width];
                }
            }
        }
        add_product<3>(table, [&](int n, int k, int i, int j) {
            const P* by = &change[i][j][3 * k];
            return by[0] * table[n][0] + by[1] * table[n][1] + by[2] * table[n][2];
        }, to);
        if (model_.sites_.body_volume) {
            P value[27][1];
            for (int a = 0; a < 27; ++a) {
                value[a][0] = model_.values_[number].by_node[a];
            }
            P force[3][gradients];
            for (std::size_t g = 0; g < gradients; ++g) {
                for (int i = 0; i < 3; ++i) {
                    for (std::size_t q = 0; q < static_cast<std::size_t>(lane_count); ++q) {
                        force[i][g][q] = -span * bodies[g / width][q][i][g % width];
                    }
                }
            }
            add_product<1>(value, [&](int n, int k, int i, int) {
                const P* by = &force[i][3 * k];
                return by[0] * table[n][0] + by[1] * table[n][1] + by[2] * table[n][2];
            }, to);
        }
        if (model_.spring_[b] >= 0) {
            const std::size_t spring = static_cast<std::size_t>(model_.spring_[b]);
            const auto& shape = model_.springs_[spring].shape;
            const T stiffness = span * span * run_.value_.spring_stiffness_[spring];
            for (int n = 0; n < 27; ++n) {
                for (int a = 0; a < 27; ++a) {
                    T sum{};
                    for (const auto& w : shape) {
                        sum += w[a / 3 * 4 + a % 3] * w[n / 3 * 4 + n % 3];
                    }
                    for (int i = 0; i < 3; ++i) {
                        to(a, 3 * (3 * n + i) + i) += stiffness * sum;
                    }
                }
            }
        }
    }

    void add_surface(std::size_t b, double time, T span, CellMatrix<T>& to) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
        const ValueTable<T>& table = model_.surface_values_[b];
        const Vec3<P> x = run_.value_.surface_position(b, gather_value<T>(run_.value_.u_.data(), run_.stride_, rows, table));
        if (model_.sites_.out_of_reach && surface_out_of_reach(model_.slots_, run_.value_.value_uniforms_.data(), x)) {
            return;
        }
        const Vec3<P> v = gather_value<T>(run_.value_.v_.data(), run_.stride_, rows, table);
        P change[3][3], value[27][1];
        for (std::size_t q = 0; q < static_cast<std::size_t>(lane_count); ++q) {
            of_motion(span, [&](std::size_t s, const Vec3<W>& moved, const Vec3<W>& speed) {
                SurfacePoint<D> p;
                for (int c = 0; c < 3; ++c) {
                    p.position[c] = Run::dual(x[c][q], moved[c]);
                    p.velocity[c] = Run::dual(v[c][q], speed[c]);
                }
                p.area = Run::dual(run_.value_.surface_area_[b][q], W{});
                p.time = static_cast<T>(time);
                return evaluate_surface(model_.slots_, uniforms(s), p);
            }, [&](int i, int k, T slope) { change[i][k][q] = -span * slope; });
        }
        for (int a = 0; a < 27; ++a) {
            value[a][0] = table.by_node[a];
        }
        add_product<1>(value, [&](int n, int k, int i, int) { return change[i][k] * value[n][0]; }, to);
    }

    void add_place(std::size_t number, double time, T span, MidpointMatrix& to) {
        const auto& place = model_.places_[number];
        const MaterialPoint<T> now = run_.value_.material_point(number, time);
        const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
        std::vector<D> q(count);
        for (std::size_t i = 0; i < count; ++i) {
            q[i] = Run::dual(run_.value_.inputs_.plain(&Fields<T>::place_effect, number * count + i), W{});
        }
        CellMatrix<T> block;
        of_motion(span, [&](std::size_t, const Vec3<W>& moved, const Vec3<W>& speed) {
            MaterialPoint<D> m;
            m.time = now.time;
            for (int c = 0; c < 3; ++c) {
                m.rest[c] = Run::dual(now.rest[c], W{});
                m.position[c] = Run::dual(now.position[c], moved[c]);
                m.velocity[c] = Run::dual(now.velocity[c], speed[c]);
            }
            return evaluate_point(model_.slots_, q.data(), m);
        }, [&](int i, int k, T slope) {
            for (int n = 0; n < 27; ++n) {
                for (int a = 0; a < 27; ++a) {
                    block(a, 3 * (3 * n + k) + i) = -span * slope * place.value[static_cast<std::size_t>(a)] * place.value[static_cast<std::size_t>(n)];
                }
            }
        });
        to.add(cells_.size() + number, block);
    }

    void add_body(std::size_t n, double time, double span, MidpointMatrix& to) {
        Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
        const double mass = run_.value_.inverse_mass_[n] == T{} ? 0.0 : static_cast<double>(run_.value_.mass_[n]);
        of_motion(static_cast<T>(span), [&](std::size_t s, const Vec3<W>& moved, const Vec3<W>& speed) {
            BodyPoint<D> p;
            p.time = static_cast<T>(time);
            for (int c = 0; c < 3; ++c) {
                const std::size_t i = run_.value_.at(0, static_cast<std::size_t>(c), n);
                p.position[c] = Run::dual(static_cast<T>(model_.node_positions_[3 * n + static_cast<std::size_t>(c)]) + run_.value_.u_[i], moved[c]);
                p.velocity[c] = Run::dual(run_.value_.v_[i], speed[c]);
            }
            return evaluate_body(model_.slots_, uniforms(s), p);
        }, [&](int i, int k, T slope) { block(i, k) = -span * mass * static_cast<double>(slope); });
        to.add(static_cast<int>(n), block);
    }

    const D* uniforms(std::size_t s) const { return &run_.uniforms_[s * static_cast<std::size_t>(Registry::total_uniform_count)]; }

    /// put(i, k, slope) of what `force` says of a point's component i as it moves along k, span of a place and 1 of a speed.
    template <class Force, class Put>
    static void of_motion(T span, const Force& force, const Put& put) {
        for (std::size_t s = 0; s * width < 3; ++s) {
            Vec3<W> moved, speed;
            for (std::size_t k = 0; k < 3; ++k) {
                moved[static_cast<int>(k)] = unit(s, k, span);
                speed[static_cast<int>(k)] = unit(s, k, T(1));
            }
            const auto f = force(s, moved, speed);
            for (std::size_t k = s * width; k < std::min<std::size_t>(3, (s + 1) * width); ++k) {
                for (int i = 0; i < 3; ++i) {
                    put(i, static_cast<int>(k), f[i].d[0][k % width]);
                }
            }
        }
    }

    const TotalLagrangian<T>& model_;
    Team& team_;
    Fields<T> none_;
    Run run_;
    std::vector<Cell> cells_;  // places follow them, as in the model's coupled nodes
    std::size_t acting_;       // how many of them forces act in
};

}  // namespace mphygs
