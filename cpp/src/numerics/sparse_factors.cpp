#include "mphygs/numerics/sparse_factors.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "mphygs/numerics/elimination_order.hpp"

namespace mphygs {

namespace {

VertexGraph graph_of(const Eigen::SparseMatrix<double>& matrix, const std::vector<std::vector<int>>& vertices, const std::vector<int>& vertex_of) {
    VertexGraph graph;
    for (std::size_t v = 0; v < vertices.size(); ++v) {
        std::vector<int> beside;
        for (const int column : vertices[v]) {
            for (Eigen::SparseMatrix<double>::InnerIterator it(matrix, column); it; ++it) {
                beside.push_back(vertex_of[static_cast<std::size_t>(it.row())]);
            }
        }
        std::sort(beside.begin(), beside.end());
        beside.erase(std::unique(beside.begin(), beside.end()), beside.end());
        std::erase(beside, static_cast<int>(v));
        graph.beside.push_back(std::move(beside));
        graph.weight.push_back(static_cast<int>(vertices[v].size()));
    }
    return graph;
}

}  // namespace

void SparseFactors::analyse(const Eigen::SparseMatrix<double>& matrix, const std::vector<std::vector<int>>& vertices, std::vector<bool> last) {
    const std::size_t n = static_cast<std::size_t>(matrix.rows());
    std::vector<int> vertex_of(n, -1);
    for (std::size_t v = 0; v < vertices.size(); ++v) {
        for (const int i : vertices[v]) {
            vertex_of[static_cast<std::size_t>(i)] = static_cast<int>(v);
        }
    }
    VertexGraph graph = graph_of(matrix, vertices, vertex_of);
    graph.last = std::move(last);
    const EliminationTree tree = cheapest_elimination(graph);
    work_ = tree.work;
    fronts_.assign(tree.fronts.size(), {});
    order_.clear();
    std::vector<int> place(n), front_of(n);
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        fronts_[f].first = static_cast<int>(order_.size());
        for (const int v : tree.fronts[f].pivots) {
            for (const int i : vertices[static_cast<std::size_t>(v)]) {
                place[static_cast<std::size_t>(i)] = static_cast<int>(order_.size());
                front_of[static_cast<std::size_t>(i)] = static_cast<int>(f);
                order_.push_back(i);
            }
        }
        fronts_[f].pivots = static_cast<int>(order_.size()) - fronts_[f].first;
    }
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        Front& front = fronts_[f];
        for (const int v : tree.fronts[f].boundary) {
            for (const int i : vertices[static_cast<std::size_t>(v)]) {
                front.boundary.push_back(place[static_cast<std::size_t>(i)]);
            }
        }
        std::sort(front.boundary.begin(), front.boundary.end());
        front.parent = tree.fronts[f].parent;
        if (front.parent >= 0) {
            fronts_[static_cast<std::size_t>(front.parent)].children.push_back(static_cast<int>(f));
        }
    }
    std::vector<int> row(n, -1);  // of every unknown in the front at hand
    const auto stand = [&](const Front& front) {
        for (int k = 0; k < front.pivots; ++k) {
            row[static_cast<std::size_t>(front.first + k)] = k;
        }
        for (std::size_t k = 0; k < front.boundary.size(); ++k) {
            row[static_cast<std::size_t>(front.boundary[k])] = front.pivots + static_cast<int>(k);
        }
    };
    std::vector<std::vector<std::pair<int, std::pair<int, int>>>> entries(fronts_.size());  // value, and its row and column by place
    for (int column = 0; column < matrix.cols(); ++column) {
        const int c = place[static_cast<std::size_t>(column)];
        for (int k = matrix.outerIndexPtr()[column]; k < matrix.outerIndexPtr()[column + 1]; ++k) {
            const std::size_t i = static_cast<std::size_t>(matrix.innerIndexPtr()[k]);
            const int r = place[i];
            entries[static_cast<std::size_t>(r < c ? front_of[i] : front_of[static_cast<std::size_t>(column)])].push_back({k, {r, c}});
        }
    }
    entry_.clear();
    entry_place_.clear();
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        Front& front = fronts_[f];
        stand(front);
        const int size = front.pivots + static_cast<int>(front.boundary.size());
        front.first_entry = static_cast<int>(entry_.size());
        front.entries = static_cast<int>(entries[f].size());
        for (const auto& [value, at] : entries[f]) {
            entry_.push_back(value);
            entry_place_.push_back(row[static_cast<std::size_t>(at.first)] + size * row[static_cast<std::size_t>(at.second)]);
        }
        for (const int child : front.children) {
            Front& of = fronts_[static_cast<std::size_t>(child)];
            for (const int unknown : of.boundary) {
                of.in_parent.push_back(row[static_cast<std::size_t>(unknown)]);
            }
        }
    }
}

bool SparseFactors::factorise(const Eigen::SparseMatrix<double>& matrix) {
    std::vector<Eigen::MatrixXd> left(fronts_.size());  // what a front leaves of its boundary, until its parent takes it
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        Front& front = fronts_[f];
        const Eigen::Index p = front.pivots, b = static_cast<Eigen::Index>(front.boundary.size());
        Eigen::MatrixXd whole = Eigen::MatrixXd::Zero(p + b, p + b);
        for (int k = front.first_entry; k < front.first_entry + front.entries; ++k) {
            whole.data()[entry_place_[static_cast<std::size_t>(k)]] += matrix.valuePtr()[entry_[static_cast<std::size_t>(k)]];
        }
        for (const int child : front.children) {
            Eigen::MatrixXd& of = left[static_cast<std::size_t>(child)];
            const std::vector<int>& to = fronts_[static_cast<std::size_t>(child)].in_parent;
            for (std::size_t c = 0; c < to.size(); ++c) {
                double* column = whole.data() + to[c] * (p + b);
                const double* from = of.data() + static_cast<std::size_t>(of.rows()) * c;
                for (std::size_t r = 0; r < to.size(); ++r) {
                    column[to[r]] += from[r];
                }
            }
            of.resize(0, 0);
        }
        front.diagonal.compute(whole.topLeftCorner(p, p));
        const auto& lu = front.diagonal.matrixLU();
        const double smallest = lu.diagonal().cwiseAbs().minCoeff();
        if (!(smallest > 0.0) || !std::isfinite(smallest)) {
            return false;
        }
        if (b > 0) {
            front.upper.noalias() = front.diagonal.permutationP() * whole.topRightCorner(p, b);
            lu.triangularView<Eigen::UnitLower>().solveInPlace(front.upper);
            front.lower = whole.bottomLeftCorner(b, p);
            lu.triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(front.lower);
            left[f] = whole.bottomRightCorner(b, b);
            left[f].noalias() -= front.lower * front.upper;
        }
    }
    return true;
}

template <class Right>
Right SparseFactors::solved(const Right& right) const {
    Right x = right(order_, Eigen::all);
    for (const Front& front : fronts_) {
        auto own = x.middleRows(front.first, front.pivots);
        own = (front.diagonal.permutationP() * own).eval();
        front.diagonal.matrixLU().template triangularView<Eigen::UnitLower>().solveInPlace(own);
        if (!front.boundary.empty()) {
            const Right change = front.lower * own;
            x(front.boundary, Eigen::all) -= change;
        }
    }
    for (auto front = fronts_.rbegin(); front != fronts_.rend(); ++front) {
        auto own = x.middleRows(front->first, front->pivots);
        if (!front->boundary.empty()) {
            own.noalias() -= front->upper * Right(x(front->boundary, Eigen::all));
        }
        front->diagonal.matrixLU().template triangularView<Eigen::Upper>().solveInPlace(own);
    }
    Right result(right.rows(), right.cols());
    result(order_, Eigen::all) = x;
    return result;
}

Eigen::VectorXd SparseFactors::solve(const Eigen::VectorXd& right) const { return solved(right); }

Eigen::MatrixXd SparseFactors::solve_all(const Eigen::MatrixXd& right) const {
    return right.cols() == 1 ? Eigen::MatrixXd(solve(right.col(0))) : solved(right);
}

Eigen::VectorXd SparseFactors::solve_transposed(const Eigen::VectorXd& right) const {
    Eigen::VectorXd x = right(order_);
    for (const Front& front : fronts_) {
        auto own = x.segment(front.first, front.pivots);
        front.diagonal.matrixLU().triangularView<Eigen::Upper>().transpose().solveInPlace(own);
        if (!front.boundary.empty()) {
            const Eigen::VectorXd change = front.upper.transpose() * own;
            x(front.boundary) -= change;
        }
    }
    for (auto front = fronts_.rbegin(); front != fronts_.rend(); ++front) {
        auto own = x.segment(front->first, front->pivots);
        if (!front->boundary.empty()) {
            own.noalias() -= front->lower.transpose() * Eigen::VectorXd(x(front->boundary));
        }
        front->diagonal.matrixLU().triangularView<Eigen::UnitLower>().transpose().solveInPlace(own);
        own = (front->diagonal.permutationP().transpose() * own).eval();
    }
    Eigen::VectorXd result(right.size());
    result(order_) = x;
    return result;
}

double SparseFactors::entries() const {
    double sum = 0;
    for (const Front& front : fronts_) {
        const double p = front.pivots, b = static_cast<double>(front.boundary.size());
        sum += p * (p + 2 * b);
    }
    return sum;
}

}  // namespace mphygs
