#include "mphygs/total_lagrangian/midpoint_matrix.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "mphygs/total_lagrangian/saddle_vertices.hpp"

namespace mphygs {

namespace {

// Two nodes with a common neighbour are less than this apart along every axis of their grid.
constexpr int apart = 5;

}  // namespace

MidpointMatrix::MidpointMatrix(const Geometry& g, const std::vector<std::int32_t>& node_index, const std::vector<std::int32_t>& node,
                               const std::vector<std::int32_t>& cells, std::vector<double> mass) {
    const std::size_t count = mass.size();
    mass_.resize(static_cast<Eigen::Index>(3 * count));
    for (Eigen::Index i = 0; i < mass_.size(); ++i) {
        mass_[i] = mass[static_cast<std::size_t>(i / 3)];
    }
    weight_ = 3.0 / mass_.sum() * mass_;
    std::map<std::array<int, 3>, std::vector<int>> colour;
    for (std::size_t n = 0; n < count; ++n) {
        const auto of = [](int i) { return ((i % apart) + apart) % apart; };
        colour[{of(g.standing(node_index[3 * n])), of(node_index[3 * n + 1]), of(node_index[3 * n + 2])}].push_back(static_cast<int>(n));
    }
    for (auto& [where, nodes] : colour) {
        nodes_of_.push_back(std::move(nodes));
    }
    std::vector<std::vector<int>> beside(count);
    for (std::size_t first = 0; first < cells.size(); first += 27) {
        for (std::size_t a = first; a < first + 27; ++a) {
            beside[static_cast<std::size_t>(cells[a])].insert(beside[static_cast<std::size_t>(cells[a])].end(), cells.begin() + static_cast<std::ptrdiff_t>(first),
                                                              cells.begin() + static_cast<std::ptrdiff_t>(first + 27));
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
    rows_.resize(all - first_row, first_row);
    rows_.setFromTriplets(rows.begin(), rows.end());
    matrix_.resize(all, all);
    matrix_.setFromTriplets(entries.begin(), entries.end());
    solver_.analyse(matrix_, saddle_vertices(g, node, count, matrix_));
}

void MidpointMatrix::put(std::size_t colour, int component, const std::vector<double>& sum) {
    for (const int n : nodes_of_[colour]) {
        for (Eigen::SparseMatrix<double>::InnerIterator it(matrix_, 3 * n + component); it; ++it) {
            if (it.row() < nodes3()) {
                it.valueRef() = sum[static_cast<std::size_t>(it.row())];
            }
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

Eigen::MatrixXd MidpointMatrix::solve(const Eigen::MatrixXd& b) const {
    Eigen::MatrixXd right(matrix_.rows(), b.cols());
    right.topRows(nodes3()) = mass_.asDiagonal() * b;
    right.bottomRows(rows_.rows()) = rows_ * b;
    return solver_.solve_all(right).topRows(nodes3());
}

Eigen::VectorXd MidpointMatrix::solve_transposed(const Eigen::VectorXd& b) const {
    Eigen::VectorXd right = Eigen::VectorXd::Zero(matrix_.rows());
    right.head(nodes3()) = b;
    const Eigen::VectorXd x = solver_.solve_transposed(right);
    return mass_.cwiseProduct(x.head(nodes3())) + rows_.transpose() * x.tail(rows_.rows());
}

}  // namespace mphygs
