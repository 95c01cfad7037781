#include "mphygs/numerics/sparse_factors.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>

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

/// A front's part of the factors.
template <class Numbers>
struct SparseFactors::Parts {
    using Matrix = Eigen::Map<std::conditional_t<std::is_const_v<Numbers>, const Eigen::MatrixXd, Eigen::MatrixXd>>;
    Parts(const Front& front, Numbers& factors)
        : p(front.pivots), b(static_cast<Eigen::Index>(front.boundary.size())), columns(factors.data() + front.factors, p + b, p),
          upper(columns.data() + columns.size(), b, p) {}

    const Eigen::Index p, b;
    Matrix columns, upper;
    auto diagonal() const { return columns.topRows(p); }
    auto lower() const { return columns.bottomRows(b); }
};

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
    const auto append = [](std::vector<Run>& runs, std::size_t begin, int from, int to, bool apart) {
        if (runs.size() == begin || apart || from != runs.back().from + runs.back().length || to != runs.back().to + runs.back().length) {
            runs.push_back({from, to, 0});
        }
        ++runs.back().length;
    };
    size_ = widest_ = 0;
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        Front& front = fronts_[f];
        stand(front);
        const int p = front.pivots, b = static_cast<int>(front.boundary.size());
        front.factors = size_;
        size_ += static_cast<std::size_t>(p * (p + 2 * b));
        widest_ = std::max(widest_, static_cast<std::size_t>(p * b));
        front.first_entry = static_cast<int>(entry_.size());
        for (const auto& [value, at] : entries[f]) {
            const int r = row[static_cast<std::size_t>(at.first)], c = row[static_cast<std::size_t>(at.second)];
            append(entry_, static_cast<std::size_t>(front.first_entry), value, c < p ? r + (p + b) * c : (p + b) * p + r + p * (c - p), r == 0 && c == p);
        }
        front.entries = static_cast<int>(entry_.size()) - front.first_entry;
        for (const int child : front.children) {
            Front& of = fronts_[static_cast<std::size_t>(child)];
            for (std::size_t k = 0; k < of.boundary.size(); ++k) {
                const int to = row[static_cast<std::size_t>(of.boundary[k])];
                append(of.in_parent, 0, static_cast<int>(k), to, to == p);
            }
        }
    }
    exchanged_.assign(n, 0);
    // Two stacks: a front takes what its children left from the one, and leaves its own on the other.
    std::vector<std::size_t> depth(fronts_.size(), 0);
    for (std::size_t f = fronts_.size(); f-- > 0;) {
        depth[f] = fronts_[f].parent < 0 ? 0 : depth[static_cast<std::size_t>(fronts_[f].parent)] + 1;
    }
    std::array<std::size_t, 2> used{}, most{};
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        for (const int child : fronts_[f].children) {
            const std::size_t b = fronts_[static_cast<std::size_t>(child)].boundary.size();
            used[(depth[f] + 1) % 2] -= b * b;
        }
        std::size_t& own = used[depth[f] % 2];
        fronts_[f].left = own;
        own += fronts_[f].boundary.size() * fronts_[f].boundary.size();
        most[depth[f] % 2] = std::max(most[depth[f] % 2], own);
    }
    for (std::size_t f = 0; f < fronts_.size(); ++f) {
        fronts_[f].left += depth[f] % 2 * most[0];
    }
    left_ = most[0] + most[1];
}

bool SparseFactors::factorise(const Eigen::SparseMatrix<double>& matrix) {
    factors_.resize(static_cast<Eigen::Index>(size_));
    room_.resize(static_cast<Eigen::Index>(left_ + widest_));
    for (const Front& front : fronts_) {
        Parts parts(front, factors_);
        const Eigen::Index p = parts.p, b = parts.b;
        Eigen::Map<Eigen::MatrixXd> left(room_.data() + front.left, b, b), upper(room_.data() + left_, p, b);
        parts.columns.setZero();
        left.setZero();
        upper.setZero();
        for (int k = front.first_entry; k < front.first_entry + front.entries; ++k) {
            const Run& run = entry_[static_cast<std::size_t>(k)];
            const Eigen::Index beyond = run.to - parts.columns.size();
            double* to = beyond < 0 ? parts.columns.data() + run.to : upper.data() + beyond;
            for (int i = 0; i < run.length; ++i) {
                to[i] = matrix.valuePtr()[run.from + i];
            }
        }
        for (const int child : front.children) {
            const Front& of = fronts_[static_cast<std::size_t>(child)];
            const double* from = room_.data() + of.left;
            for (const Run& columns : of.in_parent) {
                for (Eigen::Index c = columns.to; c < columns.to + columns.length; ++c, from += of.boundary.size()) {
                    double* pivots = c < p ? parts.columns.data() + (p + b) * c : upper.data() + p * (c - p);
                    double* others = c < p ? pivots + p : left.data() + b * (c - p);
                    for (const Run& rows : of.in_parent) {
                        double* to = rows.to < p ? pivots + rows.to : others + (rows.to - p);
                        for (int r = 0; r < rows.length; ++r) {
                            to[r] += from[rows.from + r];
                        }
                    }
                }
            }
        }
        Eigen::Ref<Eigen::MatrixXd> diagonal = parts.columns.topRows(p);
        const Eigen::PartialPivLU<Eigen::Ref<Eigen::MatrixXd>> lu(diagonal);
        const double smallest = diagonal.diagonal().cwiseAbs().minCoeff();
        if (!(smallest > 0.0) || !std::isfinite(smallest)) {
            return false;
        }
        Eigen::Map<Eigen::VectorXi> taken(exchanged_.data() + front.first, p);
        taken = Eigen::PermutationMatrix<Eigen::Dynamic>(lu.permutationP().inverse()).indices();
        if (b > 0) {
            for (Eigen::Index k = 0; k < p; ++k) {
                parts.upper.col(k) = upper.row(taken[k]).transpose();
            }
            diagonal.transpose().triangularView<Eigen::UnitUpper>().solveInPlace<Eigen::OnTheRight>(parts.upper);
            auto lower = parts.columns.bottomRows(b);
            diagonal.triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(lower);
            left.noalias() -= lower * parts.upper.transpose();
        }
    }
    return true;
}

template <class Right>
Right SparseFactors::solved(const Right& right) const {
    Right x = right(order_, Eigen::all);
    for (const Front& front : fronts_) {
        const Parts parts(front, factors_);
        auto own = x.middleRows(front.first, front.pivots);
        own = Right(own(exchanged(front), Eigen::all));
        parts.diagonal().template triangularView<Eigen::UnitLower>().solveInPlace(own);
        if (parts.b > 0) {
            const Right change = parts.lower() * own;
            x(front.boundary, Eigen::all) -= change;
        }
    }
    for (auto front = fronts_.rbegin(); front != fronts_.rend(); ++front) {
        const Parts parts(*front, factors_);
        auto own = x.middleRows(front->first, front->pivots);
        if (parts.b > 0) {
            own.noalias() -= parts.upper.transpose() * Right(x(front->boundary, Eigen::all));
        }
        parts.diagonal().template triangularView<Eigen::Upper>().solveInPlace(own);
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
        const Parts parts(front, factors_);
        auto own = x.segment(front.first, front.pivots);
        parts.diagonal().transpose().triangularView<Eigen::Lower>().solveInPlace(own);
        if (parts.b > 0) {
            const Eigen::VectorXd change = parts.upper * own;
            x(front.boundary) -= change;
        }
    }
    for (auto front = fronts_.rbegin(); front != fronts_.rend(); ++front) {
        const Parts parts(*front, factors_);
        auto own = x.segment(front->first, front->pivots);
        if (parts.b > 0) {
            own.noalias() -= parts.lower().transpose() * Eigen::VectorXd(x(front->boundary));
        }
        parts.diagonal().transpose().triangularView<Eigen::UnitUpper>().solveInPlace(own);
        own(exchanged(*front)) = Eigen::VectorXd(own);
    }
    Eigen::VectorXd result(right.size());
    result(order_) = x;
    return result;
}

double SparseFactors::entries() const { return static_cast<double>(size_); }

}  // namespace mphygs
