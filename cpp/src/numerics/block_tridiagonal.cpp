#include "mphygs/numerics/block_tridiagonal.hpp"

#include <cmath>

namespace mphygs {

namespace {

/// A^T x = b from P A = L U: U^T y = b, L^T z = y, x = P^T z.
Eigen::VectorXd transposed_solve(const Eigen::PartialPivLU<Eigen::MatrixXd>& lu, const Eigen::VectorXd& b) {
    const Eigen::VectorXd y = lu.matrixLU().triangularView<Eigen::Upper>().transpose().solve(b);
    const Eigen::VectorXd z = lu.matrixLU().triangularView<Eigen::UnitLower>().transpose().solve(y);
    return lu.permutationP().transpose() * z;
}

}  // namespace

void BlockTridiagonal::analyse(const Eigen::SparseMatrix<double>& matrix, const std::vector<int>& start,
                               const std::vector<std::vector<int>>& together) {
    const int n = static_cast<int>(matrix.rows());
    levels_.clear();
    level_of_.assign(static_cast<std::size_t>(n), -1);
    place_of_.assign(static_cast<std::size_t>(n), 0);
    std::vector<std::vector<std::size_t>> groups_of(static_cast<std::size_t>(n));
    for (std::size_t g = 0; g < together.size(); ++g) {
        for (const int i : together[g]) {
            groups_of[static_cast<std::size_t>(i)].push_back(g);
        }
    }
    std::vector<bool> entered(together.size(), false);
    std::vector<int> level = start;
    int next_seed = 0;
    while (true) {
        if (level.empty()) {
            while (next_seed < n && level_of_[static_cast<std::size_t>(next_seed)] >= 0) {
                ++next_seed;
            }
            if (next_seed == n) {
                break;
            }
            level = {next_seed};
        }
        const int number = static_cast<int>(levels_.size());
        for (std::size_t k = 0; k < level.size(); ++k) {
            level_of_[static_cast<std::size_t>(level[k])] = number;
            place_of_[static_cast<std::size_t>(level[k])] = static_cast<int>(k);
        }
        std::vector<int> next;
        for (const int column : level) {
            for (Eigen::SparseMatrix<double>::InnerIterator it(matrix, column); it; ++it) {
                int& l = level_of_[static_cast<std::size_t>(it.row())];
                if (l < 0) {
                    l = number + 1;
                    next.push_back(static_cast<int>(it.row()));
                }
            }
        }
        // Only of those found here: what joins them by one group does not call in its other groups.
        const std::size_t found = next.size();
        for (std::size_t k = 0; k < found; ++k) {
            for (const std::size_t g : groups_of[static_cast<std::size_t>(next[k])]) {
                if (entered[g]) {
                    continue;
                }
                entered[g] = true;
                for (const int i : together[g]) {
                    int& l = level_of_[static_cast<std::size_t>(i)];
                    if (l < 0) {
                        l = number + 1;
                        next.push_back(i);
                    }
                }
            }
        }
        levels_.push_back(std::move(level));
        level = std::move(next);
    }
}

bool BlockTridiagonal::factorise(const Eigen::SparseMatrix<double>& matrix) {
    const std::size_t count = levels_.size();
    std::vector<Eigen::MatrixXd> d(count);
    lower_.assign(count, {});
    upper_.assign(count, {});
    const auto size = [&](std::size_t l) { return static_cast<Eigen::Index>(levels_[l].size()); };
    for (std::size_t l = 0; l < count; ++l) {
        d[l].setZero(size(l), size(l));
        if (l > 0) {
            lower_[l].setZero(size(l), size(l - 1));
            upper_[l - 1].setZero(size(l - 1), size(l));
        }
    }
    for (int column = 0; column < matrix.cols(); ++column) {
        const std::size_t lc = static_cast<std::size_t>(level_of_[static_cast<std::size_t>(column)]);
        const int c = place_of_[static_cast<std::size_t>(column)];
        for (Eigen::SparseMatrix<double>::InnerIterator it(matrix, column); it; ++it) {
            const std::size_t lr = static_cast<std::size_t>(level_of_[static_cast<std::size_t>(it.row())]);
            const int r = place_of_[static_cast<std::size_t>(it.row())];
            if (lr == lc) {
                d[lc](r, c) = it.value();
            } else if (lr == lc + 1) {
                lower_[lr](r, c) = it.value();
            } else {
                upper_[lr](r, c) = it.value();
            }
        }
    }
    diagonal_.clear();
    diagonal_.reserve(count);
    for (std::size_t l = 0; l < count; ++l) {
        if (l > 0) {
            d[l].noalias() -= lower_[l] * diagonal_[l - 1].solve(upper_[l - 1]);
        }
        diagonal_.emplace_back(d[l]);
        const double smallest = diagonal_.back().matrixLU().diagonal().cwiseAbs().minCoeff();
        if (!(smallest > 0.0) || !std::isfinite(smallest)) {
            return false;
        }
    }
    return true;
}

Eigen::VectorXd BlockTridiagonal::solve(const Eigen::VectorXd& right) const {
    const std::size_t count = levels_.size();
    std::vector<Eigen::VectorXd> x(count);
    for (std::size_t l = 0; l < count; ++l) {
        x[l] = right(levels_[l]);
        if (l > 0) {
            x[l].noalias() -= lower_[l] * x[l - 1];
        }
        x[l] = diagonal_[l].solve(x[l]).eval();
    }
    for (std::size_t l = count - 1; l-- > 0;) {
        x[l] -= diagonal_[l].solve((upper_[l] * x[l + 1]).eval());
    }
    Eigen::VectorXd result(right.size());
    for (std::size_t l = 0; l < count; ++l) {
        result(levels_[l]) = x[l];
    }
    return result;
}

Eigen::MatrixXd BlockTridiagonal::solve_all(const Eigen::MatrixXd& right) const {
    const std::size_t count = levels_.size();
    std::vector<Eigen::MatrixXd> x(count);
    for (std::size_t l = 0; l < count; ++l) {
        x[l] = right(levels_[l], Eigen::all);
        if (l > 0) {
            x[l].noalias() -= lower_[l] * x[l - 1];
        }
        x[l] = diagonal_[l].solve(x[l]).eval();
    }
    for (std::size_t l = count - 1; l-- > 0;) {
        x[l] -= diagonal_[l].solve((upper_[l] * x[l + 1]).eval());
    }
    Eigen::MatrixXd result(right.rows(), right.cols());
    for (std::size_t l = 0; l < count; ++l) {
        result(levels_[l], Eigen::all) = x[l];
    }
    return result;
}

Eigen::VectorXd BlockTridiagonal::solve_transposed(const Eigen::VectorXd& right) const {
    const std::size_t count = levels_.size();
    std::vector<Eigen::VectorXd> x(count);
    for (std::size_t l = 0; l < count; ++l) {
        x[l] = right(levels_[l]);
        if (l > 0) {
            x[l].noalias() -= upper_[l - 1].transpose() * x[l - 1];
        }
        x[l] = transposed_solve(diagonal_[l], x[l]);
    }
    for (std::size_t l = count - 1; l-- > 0;) {
        x[l] -= transposed_solve(diagonal_[l], lower_[l + 1].transpose() * x[l + 1]);
    }
    Eigen::VectorXd result(right.size());
    for (std::size_t l = 0; l < count; ++l) {
        result(levels_[l]) = x[l];
    }
    return result;
}

}  // namespace mphygs
