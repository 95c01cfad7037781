#include "mphygs/total_lagrangian/midpoint_matrix.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "mphygs/numerics/polar.hpp"

namespace mphygs {

Mat3<double> nearest_turn(const Mat3<double>& sum) {
    constexpr double least = 0.01;  // of the determinant, over that of rotations of the same size that do not cancel
    double squares = 0;
    for (int i = 0; i < 3; ++i) {
        squares += sum[i][0] * sum[i][0] + sum[i][1] * sum[i][1] + sum[i][2] * sum[i][2];
    }
    return determinant(sum, cofactor(sum)) > least * std::pow(squares / 3.0, 1.5) ? polar_rotation(sum) : Mat3<double>::identity();
}

MidpointMatrix::MidpointMatrix(const Geometry& g, const std::vector<std::int32_t>& node, const std::vector<CellNodes>& cells, std::vector<double> mass,
                               const Eigen::SparseMatrix<double>& shared) {
    const std::size_t count = mass.size();
    mass_.resize(static_cast<Eigen::Index>(3 * count));
    for (Eigen::Index i = 0; i < mass_.size(); ++i) {
        mass_[i] = mass[static_cast<std::size_t>(i / 3)];
    }
    weight_ = 3.0 / mass_.sum() * mass_;
    std::vector<std::vector<int>> beside(count);
    for (const CellNodes& cell : cells) {
        for (const std::int32_t a : cell) {
            std::vector<int>& own = beside[static_cast<std::size_t>(a)];
            own.insert(own.end(), cell.begin(), cell.end());
        }
    }
    const int first_row = static_cast<int>(3 * count);
    std::vector<Eigen::Triplet<double>> entries, rows;
    for (std::size_t n = 0; n < count; ++n) {
        beside[n].push_back(static_cast<int>(n));
        std::sort(beside[n].begin(), beside[n].end());
        beside[n].erase(std::unique(beside[n].begin(), beside[n].end()), beside[n].end());
        for (const int m : beside[n]) {
            for (int i = 0; i < 9; ++i) {
                entries.emplace_back(3 * m + i % 3, 3 * static_cast<int>(n) + i / 3, 0.0);
            }
        }
    }
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (int w = g.row_begin[r]; w < g.row_begin[r + 1]; ++w) {
            for (int c = 0; c < 3; ++c) {
                const int row = 3 * static_cast<int>(r) + c, of = 3 * node[static_cast<std::size_t>(w)] + c;
                const double weight = g.row_weight[static_cast<std::size_t>(w)];
                rows.emplace_back(row, of, weight);
                entries.emplace_back(first_row + row, of, weight);
                entries.emplace_back(of, first_row + row, weight);
            }
        }
    }
    const int all = first_row + 3 * static_cast<int>(g.row_count());
    for (int i = first_row; i < all; ++i) {
        entries.emplace_back(i, i, 0.0);
    }
    row_begin_.assign(g.row_begin.begin(), g.row_begin.end());
    row_node_.assign(node.begin(), node.end());
    row_weight_.assign(g.row_weight.begin(), g.row_weight.end());
    rows_.resize(all - first_row, first_row);
    rows_.setFromTriplets(rows.begin(), rows.end());
    matrix_.resize(all, all);
    matrix_.setFromTriplets(entries.begin(), entries.end());
    for (Eigen::Index column = 0; column < nodes3(); ++column) {
        const int c = static_cast<int>(column % 3);
        matrix_.valuePtr()[entry(static_cast<int>(column / 3), column) + c] = mass_[column];
        for (Eigen::SparseMatrix<double>::InnerIterator it(shared, column / 3); it; ++it) {
            matrix_.valuePtr()[entry(static_cast<int>(it.row()), column) + c] -= it.value();
        }
    }
    still_.assign(matrix_.valuePtr(), matrix_.valuePtr() + matrix_.nonZeros());
    cells_ = cells;
    for (const CellNodes& cell : cells) {
        CellPlaces& places = places_.emplace_back();
        for (std::size_t i = 0; i < places.size(); ++i) {
            const Eigen::Index column = 3 * cell[i / 27];
            const std::int32_t row = cell[i % 27];
            places[i] = mass_[3 * row] > 0.0 ? static_cast<std::int32_t>(entry(row, column) - matrix_.outerIndexPtr()[column]) : -1;
        }
    }
    // Every node by itself, and the rows of every hold and joint.
    std::vector<std::vector<int>> vertices(count);
    std::vector<bool> last(count, false);
    for (std::size_t n = 0; n < count; ++n) {
        vertices[n] = {3 * static_cast<int>(n), 3 * static_cast<int>(n) + 1, 3 * static_cast<int>(n) + 2};
    }
    std::map<std::int32_t, std::vector<int>> ties;
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (int c = 0; c < 3; ++c) {
            ties[g.row_hold[r]].push_back(first_row + 3 * static_cast<int>(r) + c);
        }
    }
    for (auto& [number, own] : ties) {
        vertices.push_back(std::move(own));
        last.push_back(true);
    }
    solver_.analyse(matrix_, vertices, std::move(last));
}

void MidpointMatrix::clear() { std::copy(still_.begin(), still_.end(), matrix_.valuePtr()); }

Eigen::Index MidpointMatrix::entry(int row_node, Eigen::Index column) const {
    const auto* rows = matrix_.innerIndexPtr();
    const auto *first = rows + matrix_.outerIndexPtr()[column], *end = rows + matrix_.outerIndexPtr()[column + 1];
    return std::lower_bound(first, end, 3 * row_node) - rows;
}

template <class T>
void MidpointMatrix::add(std::size_t cell, const CellMatrix<T>& block) {
    const CellPlaces& places = places_[cell];
    for (std::size_t b = 0; b < 27; ++b) {
        for (int k = 0; k < 3; ++k) {
            double* column = matrix_.valuePtr() + matrix_.outerIndexPtr()[3 * cells_[cell][b] + k];
            const T* of = block.data() + 27 * 3 * (3 * b + static_cast<std::size_t>(k));
            for (std::size_t a = 0; a < 27; ++a) {
                const std::int32_t at = places[27 * b + a];
                for (std::size_t i = 0; i < 3 && at >= 0; ++i) {
                    column[static_cast<std::size_t>(at) + i] += static_cast<double>(of[27 * i + a]);
                }
            }
        }
    }
}

template void MidpointMatrix::add<float>(std::size_t, const CellMatrix<float>&);
template void MidpointMatrix::add<double>(std::size_t, const CellMatrix<double>&);

void MidpointMatrix::add(int node, const Eigen::Matrix3d& block) {
    for (int k = 0; k < 3; ++k) {
        const Eigen::Index at = entry(node, 3 * node + k);
        for (int i = 0; i < 3; ++i) {
            matrix_.valuePtr()[at + i] += block(i, k);
        }
    }
}

bool MidpointMatrix::factorise() {
    double largest = 0;
    for (Eigen::Index i = 0; i < nodes3(); ++i) {
        double& own = matrix_.coeffRef(i, i);
        own = mass_[i] > 0.0 ? own : 1.0;  // nodes without mass stay where they are
        largest = std::max(largest, own);
    }
    // Rows of two held faces that meet can depend on each other: a hold a billion times stiffer than the object shares
    // the force between them.
    for (Eigen::Index i = nodes3(); i < matrix_.rows(); ++i) {
        matrix_.coeffRef(i, i) = -1e-9 / largest;
    }
    return std::isfinite(largest) && solver_.factorise(matrix_);
}

void MidpointMatrix::made_at(NodeTurns turns) {
    made_ = std::move(turns);
    turns_.clear();
    row_turns_.clear();
}

void MidpointMatrix::used_at(const NodeTurns& turns) {
    turns_.resize(turns.size());
    for (std::size_t n = 0; n < turns.size(); ++n) {
        turns_[n] = turns[n] * transpose(made_[n]);
    }
    row_turns_.assign(static_cast<std::size_t>(rows_.rows() / 3), Mat3<double>{});
    for (std::size_t r = 0; r < row_turns_.size(); ++r) {
        for (int w = row_begin_[r]; w < row_begin_[r + 1]; ++w) {
            const std::size_t at = static_cast<std::size_t>(w);
            row_turns_[r] = row_turns_[r] + std::abs(row_weight_[at]) * turns_[static_cast<std::size_t>(row_node_[at])];
        }
        row_turns_[r] = nearest_turn(row_turns_[r]);
    }
}

Eigen::MatrixXd MidpointMatrix::turned(const NodeTurns& turns, const Eigen::MatrixXd& x, bool back) {
    Eigen::MatrixXd to = x;
    for (std::size_t n = 0; n < turns.size(); ++n) {
        const Eigen::Matrix3d own = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(&turns[n].e[0][0]);
        const Eigen::Index at = static_cast<Eigen::Index>(3 * n);
        for (Eigen::Index k = 0; k < x.cols(); ++k) {
            const Eigen::Vector3d of = x.block<3, 1>(at, k);
            to.block<3, 1>(at, k) = back ? Eigen::Vector3d(own.transpose() * of) : Eigen::Vector3d(own * of);
        }
    }
    return to;
}

Eigen::MatrixXd MidpointMatrix::solve(const Eigen::MatrixXd& b) const {
    Eigen::MatrixXd right(matrix_.rows(), b.cols());
    right.topRows(nodes3()) = mass_.asDiagonal() * turned(turns_, b, true);
    right.bottomRows(rows_.rows()) = turned(row_turns_, rows_ * b, true);
    return turned(turns_, solver_.solve_all(right).topRows(nodes3()), false);
}

Eigen::VectorXd MidpointMatrix::solve_transposed(const Eigen::VectorXd& b) const {
    Eigen::VectorXd right = Eigen::VectorXd::Zero(matrix_.rows());
    right.head(nodes3()) = turned(turns_, b, true);
    const Eigen::VectorXd x = solver_.solve_transposed(right);
    return turned(turns_, mass_.cwiseProduct(x.head(nodes3())), false) + rows_.transpose() * turned(row_turns_, x.tail(rows_.rows()), false);
}

}  // namespace mphygs
