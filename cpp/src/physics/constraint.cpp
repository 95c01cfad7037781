#include "mphygs/physics/constraint.hpp"

#include <Eigen/Dense>
#include <numeric>

namespace mphygs {

Constraint::Constraint(const Geometry& g, const std::vector<std::int32_t>& node, const std::vector<double>& inverse_mass)
    : rows_(g.row_count()),
      holds_(static_cast<std::size_t>(g.hold_count)),
      nodes_(node),
      hold_(g.row_hold) {
    if (rows_ == 0) {
        return;
    }
    by_row_.begin.assign(g.row_begin.begin(), g.row_begin.end());
    by_row_.weight = g.row_weight;
    std::sort(nodes_.begin(), nodes_.end());
    nodes_.erase(std::unique(nodes_.begin(), nodes_.end()), nodes_.end());
    for (const std::int32_t n : node) {
        by_row_.column.push_back(static_cast<std::size_t>(std::lower_bound(nodes_.begin(), nodes_.end(), n) - nodes_.begin()));
    }
    by_node_.begin.assign(nodes_.size() + 1, 0);
    for (const std::size_t place : by_row_.column) {
        ++by_node_.begin[place + 1];
    }
    std::partial_sum(by_node_.begin.begin(), by_node_.begin.end(), by_node_.begin.begin());
    by_node_.column.resize(node.size());
    by_node_.weight.resize(node.size());
    std::vector<std::size_t> next = by_node_.begin;
    for (std::size_t r = 0; r < rows_; ++r) {
        for (std::size_t w = by_row_.begin[r]; w < by_row_.begin[r + 1]; ++w) {
            const std::size_t to = next[by_row_.column[w]]++;
            by_node_.column[to] = r;
            by_node_.weight[to] = by_row_.weight[w];
        }
    }
    const Eigen::Index n = static_cast<Eigen::Index>(rows_);
    Eigen::MatrixXd c = Eigen::MatrixXd::Zero(n, static_cast<Eigen::Index>(inverse_mass.size()));
    for (std::size_t r = 0; r < rows_; ++r) {
        for (std::size_t w = by_row_.begin[r]; w < by_row_.begin[r + 1]; ++w) {
            c(static_cast<Eigen::Index>(r), node[w]) += by_row_.weight[w];
        }
    }
    const Eigen::Map<const Eigen::VectorXd> m(inverse_mass.data(), static_cast<Eigen::Index>(inverse_mass.size()));
    const Eigen::MatrixXd a = c * m.asDiagonal() * c.transpose();
    // Rows of two faces that meet can depend on each other: a pseudo-inverse keeps them consistent.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(a);
    const double cut = 1e-10 * eigen.eigenvalues().maxCoeff();
    const Eigen::VectorXd inverse_values =
        eigen.eigenvalues().unaryExpr([cut](double x) { return x > cut ? 1.0 / x : 0.0; });
    const Eigen::MatrixXd inverse = eigen.eigenvectors() * inverse_values.asDiagonal() * eigen.eigenvectors().transpose();
    inverse_.assign(inverse.data(), inverse.data() + inverse.size());
    inverse_ones_.assign(holds_ * rows_, 0.0);
    hold_gram_.assign(holds_ * holds_, 0.0);
    for (std::size_t r = 0; r < rows_; ++r) {
        for (std::size_t s = 0; s < rows_; ++s) {
            if (hold_[s] >= 0) {
                inverse_ones_[static_cast<std::size_t>(hold_[s]) * rows_ + r] += inverse_[r * rows_ + s];
            }
        }
    }
    for (std::size_t h = 0; h < holds_; ++h) {
        sum_per_hold(&inverse_ones_[h * rows_], &hold_gram_[h * holds_]);
    }
}

void Constraint::sum_per_hold(const double* x, double* result) const {
    for (std::size_t h = 0; h < holds_; ++h) {
        result[h] = 0;
    }
    for (std::size_t r = 0; r < rows_; ++r) {
        if (hold_[r] >= 0) {
            result[hold_[r]] += x[r];
        }
    }
}

void Constraint::give_way(double softness, int columns, double* lambda) const {
    // Woodbury: (A + s U U^T)^-1 b = A^-1 b - A^-1 U (1/s + U^T A^-1 U)^-1 U^T A^-1 b.
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    const Eigen::Index h = static_cast<Eigen::Index>(holds_), n = static_cast<Eigen::Index>(rows_);
    Eigen::MatrixXd core = Eigen::Map<const Eigen::MatrixXd>(hold_gram_.data(), h, h);
    core.diagonal().array() += 1.0 / softness;
    Eigen::Map<Rows> x(lambda, n, columns);
    Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(h, columns);
    for (std::size_t r = 0; r < rows_; ++r) {
        if (hold_[r] >= 0) {
            sums.row(hold_[r]) += x.row(static_cast<Eigen::Index>(r));
        }
    }
    x -= Eigen::Map<const Eigen::MatrixXd>(inverse_ones_.data(), n, h) * core.ldlt().solve(sums);
}

}  // namespace mphygs
