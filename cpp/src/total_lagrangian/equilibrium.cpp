#include "mphygs/total_lagrangian/equilibrium.hpp"

#include <algorithm>
#include <cmath>

#include "mphygs/total_lagrangian/equilibrium_assembly.hpp"
#include "mphygs/total_lagrangian/saddle_vertices.hpp"

namespace mphygs {

namespace {

using P = Pack<double>;

/// Projector (27, 27) from the node values of a cell to what is left of them beside polynomials of degree 2 or less,
/// the shapes that eight points always see.
Eigen::Matrix<double, 27, 27> beside_polynomials() {
    Eigen::Matrix<double, 27, 10> shapes;
    for (int a = 0; a < 27; ++a) {
        const double x = a / 9 - 1, y = (a / 3) % 3 - 1, z = a % 3 - 1;
        shapes.row(a) << 1, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x;
    }
    const Eigen::Matrix<double, 27, 10> q = shapes.householderQr().householderQ() * Eigen::Matrix<double, 27, 10>::Identity();
    return Eigen::Matrix<double, 27, 27>::Identity() - q * q.transpose();
}

}  // namespace

Equilibrium::Equilibrium(std::shared_ptr<const TotalLagrangian<double>> model) : model_(std::move(model)) {
    const Geometry& g = model_->geometry();
    if (std::none_of(g.row_hold.begin(), g.row_hold.end(), [](std::int32_t hold) { return hold >= 0; })) {
        throw std::invalid_argument("a shape in equilibrium must be held somewhere: this object has no hold");
    }
    const Assembly a{*model_};
    const int n = static_cast<int>(3 * (model_->node_count() + g.row_count()));
    const int first_row = static_cast<int>(3 * model_->node_count());
    std::vector<Eigen::Triplet<double>> entries;
    for (std::size_t b = 0; b < a.blocks(); ++b) {
        for (int c = 0; c < 81; ++c) {
            for (int r = 0; r < 81; ++r) {
                entries.emplace_back(3 * node_of<double>(a.rows(b), r / 3) + r % 3, 3 * node_of<double>(a.rows(b), c / 3) + c % 3, 0.0);
            }
        }
    }
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (int w = g.row_begin[r]; w < g.row_begin[r + 1]; ++w) {
            for (int c = 0; c < 3; ++c) {
                const int row = first_row + 3 * static_cast<int>(r) + c;
                const int node = 3 * a.constraint_node()[static_cast<std::size_t>(w)] + c;
                entries.emplace_back(row, node, g.row_weight[static_cast<std::size_t>(w)]);
                entries.emplace_back(node, row, g.row_weight[static_cast<std::size_t>(w)]);
            }
        }
    }
    for (int i = first_row; i < n; ++i) {
        entries.emplace_back(i, i, 0.0);
    }
    matrix_.resize(n, n);
    matrix_.setFromTriplets(entries.begin(), entries.end());
    position_.reserve(a.blocks() * 81 * 81);
    for (std::size_t b = 0; b < a.blocks(); ++b) {
        for (int c = 0; c < 81; ++c) {
            const int column = 3 * node_of<double>(a.rows(b), c / 3) + c % 3;
            const int* begin = matrix_.innerIndexPtr() + matrix_.outerIndexPtr()[column];
            const int* end = matrix_.innerIndexPtr() + matrix_.outerIndexPtr()[column + 1];
            for (int r = 0; r < 81; ++r) {
                const int row = 3 * node_of<double>(a.rows(b), r / 3) + r % 3;
                position_.push_back(static_cast<std::int32_t>(std::lower_bound(begin, end, row) - matrix_.innerIndexPtr()));
            }
        }
    }
    unknown_ = Eigen::VectorXd::Zero(n);
    solver_.analyse(matrix_, saddle_vertices(g, a.constraint_node(), model_->node_count(), matrix_));
}

void Equilibrium::assemble(const std::vector<double>& w, bool matrix, Eigen::VectorXd& residual) {
    const Assembly a{*model_};
    const Geometry& g = model_->geometry();
    using D = Dual<P, 9>;
    const auto value = [&](std::size_t i) { return Dual<double, 9>(fields_.effect[i]); };
    const std::vector<D> uniforms = uniforms_at_rest<D>(a.slots(), value);
    const std::vector<P> plain = uniforms_at_rest<P>(a.slots(), [&](std::size_t i) { return fields_.effect[i]; });
    residual.setZero(unknown_.size());
    const Eigen::Matrix<double, 27, 27> stiff = unseen_ * g.spacing[0] * beside_polynomials();
    if (matrix) {
        // The constraint's entries stay; only the blocks' are summed again.
        for (const std::int32_t k : position_) {
            matrix_.valuePtr()[k] = 0.0;
        }
    }
    for (std::size_t b = 0; b < a.blocks(); ++b) {
        const std::size_t from = 8 * a.caller(b);
        const P volume = load<double>(&volume_[from]);
        const P mu = load<double>(&fields_.mu[from]), lambda = load<double>(&fields_.lambda[from]);
        const Mat3<P> gradient = a.gradient(b, w);
        const GradientTable<double>& table = a.table(b);
        Mat3<P> sigma;
        if (!matrix) {
            sigma = cauchy_stress<P>(*model_, a.slots(), plain, a.history(), gradient, mu, lambda);
        } else {
            Mat3<D> seeded;
            for (int i = 0; i < 9; ++i) {
                seeded[i / 3][i % 3] = D(gradient[i / 3][i % 3]);
                seeded[i / 3][i % 3].d[i] = broadcast<double>(1);
            }
            const Mat3<D> s = cauchy_stress<D>(*model_, a.slots(), uniforms, a.history(), seeded, D(mu), D(lambda));
            for (int i = 0; i < 9; ++i) {
                sigma[i / 3][i % 3] = s[i / 3][i % 3].v;
            }
            const std::int32_t* to = &position_[b * 81 * 81];
            for (int na = 0; na < 27; ++na) {
                P t[3][3][3];  // i, k, l: sum_j V D_ijkl dN_a/dx_j
                for (int i = 0; i < 3; ++i) {
                    for (int k = 0; k < 3; ++k) {
                        for (int l = 0; l < 3; ++l) {
                            P sum{};
                            for (int j = 0; j < 3; ++j) {
                                sum += s[i][j].d[3 * k + l] * table.by_node[na][j];
                            }
                            t[i][k][l] = volume * sum;
                        }
                    }
                }
                for (int nb = 0; nb < 27; ++nb) {
                    for (int k = 0; k < 3; ++k) {
                        for (int i = 0; i < 3; ++i) {
                            P sum{};
                            for (int l = 0; l < 3; ++l) {
                                sum += t[i][k][l] * table.by_node[nb][l];
                            }
                            matrix_.valuePtr()[to[(3 * nb + k) * 81 + 3 * na + i]] += sum_lanes<double>(sum);
                        }
                    }
                }
            }
        }
        for (int na = 0; na < 27; ++na) {
            const int n = 3 * node_of<double>(a.rows(b), na);
            for (int i = 0; i < 3; ++i) {
                P sum{};
                for (int j = 0; j < 3; ++j) {
                    sum += sigma[i][j] * table.by_node[na][j];
                }
                residual[n + i] += sum_lanes<double>(volume * sum);
            }
        }
        // Of the same sign as the map's stiffness, and the same whatever the parameters are: see below.
        for (int na = 0; na < 27; ++na) {
            const int n = 3 * node_of<double>(a.rows(b), na);
            for (int nb = 0; nb < 27; ++nb) {
                const int m = 3 * node_of<double>(a.rows(b), nb);
                for (int i = 0; i < 3; ++i) {
                    residual[n + i] -= stiff(na, nb) * w[static_cast<std::size_t>(m + i)];
                    if (matrix) {
                        matrix_.valuePtr()[position_[b * 81 * 81 + static_cast<std::size_t>((3 * nb + i) * 81 + 3 * na + i)]] -= stiff(na, nb);
                    }
                }
            }
        }
    }
    if (matrix) {
        // Rows of two held faces that meet can depend on each other: a hold a billion times stiffer
        // than the object shares the force between them. The residual below keeps the hold exact.
        const double largest = matrix_.diagonal().head(static_cast<Eigen::Index>(3 * model_->node_count())).cwiseAbs().maxCoeff();
        const double give = 1e-9 / largest;
        // Nodes that touch next to no material would move by any distance: springs keep them, as of a
        // material of 1e-6 Pa, the same whatever the parameters are, so that no derivative sees them.
        // The map leads back from the load: all stiffness is negative here, and so must theirs be, or a
        // node as soft as its spring has none.
        node_spring_ = 1e-6 * g.spacing[0];
        for (Eigen::Index i = 0; i < static_cast<Eigen::Index>(3 * model_->node_count()); ++i) {
            matrix_.coeffRef(i, i) -= node_spring_;
        }
        for (Eigen::Index i = static_cast<Eigen::Index>(3 * model_->node_count()); i < matrix_.rows(); ++i) {
            matrix_.coeffRef(i, i) = give;
        }
    }
    const Eigen::Index first_row = static_cast<Eigen::Index>(3 * model_->node_count());
    for (Eigen::Index i = 0; i < first_row; ++i) {
        residual[i] -= node_spring_ * w[static_cast<std::size_t>(i)] + load_[static_cast<std::size_t>(i)];
    }
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (int k = g.row_begin[r]; k < g.row_begin[r + 1]; ++k) {
            for (int c = 0; c < 3; ++c) {
                const Eigen::Index row = first_row + 3 * static_cast<Eigen::Index>(r) + c;
                const Eigen::Index node = 3 * a.constraint_node()[static_cast<std::size_t>(k)] + c;
                residual[node] += g.row_weight[static_cast<std::size_t>(k)] * unknown_[row];
                residual[row] += g.row_weight[static_cast<std::size_t>(k)] * w[static_cast<std::size_t>(node)];
            }
        }
    }
}

void Equilibrium::fill(Solution& s) const {
    const Assembly a{*model_};
    s.map = w_;
    s.springs = unseen_;
    s.deformation0.resize(72 * a.blocks());
    s.volume_ratio.resize(8 * a.blocks());
    for (std::size_t b = 0; b < a.blocks(); ++b) {
        const Mat3<P> h = Mat3<P>::identity() + a.gradient(b, w_);
        const Mat3<P> f = inverse(h);
        for (std::size_t i = 0; i < 9; ++i) {
            store<double>(&s.deformation0[72 * a.caller(b) + 8 * i], f[static_cast<int>(i / 3)][i % 3]);
        }
        store<double>(&s.volume_ratio[8 * a.caller(b)], determinant(h, cofactor(h)));
    }
}

void Equilibrium::factorise() {
    if (!solver_.factorise(matrix_)) {
        throw SimulationError("equilibrium: the stiffness matrix is singular; is a part of the object not connected to the hold?");
    }
}

void Equilibrium::factorise_here() {
    if (!factors_are_here_) {
        Eigen::VectorXd residual;
        assemble(w_, true, residual);
        factorise();
        factors_are_here_ = true;
    }
}

}  // namespace mphygs
