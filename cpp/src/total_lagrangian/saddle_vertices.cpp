#include "mphygs/total_lagrangian/saddle_vertices.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <map>
#include <numeric>

namespace mphygs {

namespace {

/// The number of the piece in which every node stands: nodes that share cells, one after the other.
std::vector<int> pieces(const Eigen::SparseMatrix<double>& matrix, int node_count) {
    std::vector<int> piece(static_cast<std::size_t>(node_count), -1);
    int count = 0;
    for (int seed = 0; seed < node_count; ++seed) {
        if (piece[static_cast<std::size_t>(seed)] >= 0) {
            continue;
        }
        std::vector<int> next{seed};
        piece[static_cast<std::size_t>(seed)] = count;
        while (!next.empty()) {
            const int n = next.back();
            next.pop_back();
            for (Eigen::SparseMatrix<double>::InnerIterator it(matrix, 3 * n); it && it.row() < 3 * node_count; ++it) {
                int& of = piece[static_cast<std::size_t>(it.row() / 3)];
                if (of < 0) {
                    of = count;
                    next.push_back(static_cast<int>(it.row() / 3));
                }
            }
        }
        ++count;
    }
    return piece;
}

/// The rows of one hold, or of one joint.
struct Ties {
    std::vector<int> rows, nodes;
};

std::map<std::int32_t, Ties> ties_of(const Geometry& g, const std::vector<std::int32_t>& node) {
    std::map<std::int32_t, Ties> ties;
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        Ties& own = ties[g.row_hold[r]];
        own.rows.push_back(static_cast<int>(r));
        own.nodes.insert(own.nodes.end(), node.begin() + g.row_begin[r], node.begin() + g.row_begin[r + 1]);
    }
    for (auto& [number, own] : ties) {
        std::sort(own.nodes.begin(), own.nodes.end());
        own.nodes.erase(std::unique(own.nodes.begin(), own.nodes.end()), own.nodes.end());
    }
    return ties;
}

/// How many joints lie between every piece and a hold; pieces that nothing holds are as far as what they hang on.
std::vector<int> joints_to_a_hold(const std::map<std::int32_t, Ties>& ties, const std::vector<int>& piece) {
    const int count = piece.empty() ? 0 : 1 + *std::max_element(piece.begin(), piece.end());
    std::vector<std::vector<int>> beside(static_cast<std::size_t>(count));
    std::vector<int> far(static_cast<std::size_t>(count), -1), level;
    const auto reach = [&](int p, int distance) {
        if (far[static_cast<std::size_t>(p)] < 0) {
            far[static_cast<std::size_t>(p)] = distance;
            level.push_back(p);
        }
    };
    for (const auto& [number, own] : ties) {
        for (const int n : own.nodes) {
            const int p = piece[static_cast<std::size_t>(n)];
            if (number >= 0) {
                reach(p, 0);
            } else {
                const int first = piece[static_cast<std::size_t>(own.nodes[0])];
                beside[static_cast<std::size_t>(p)].push_back(first);
                beside[static_cast<std::size_t>(first)].push_back(p);
            }
        }
    }
    for (int seed = 0; seed <= count; ++seed) {
        for (std::size_t k = 0; k < level.size(); ++k) {
            const int p = level[k];
            for (const int q : beside[static_cast<std::size_t>(p)]) {
                reach(q, far[static_cast<std::size_t>(p)] + 1);
            }
        }
        level.clear();
        if (seed < count) {
            reach(seed, 0);
        }
    }
    return far;
}

/// Whether the rows are independent of each other on these nodes alone.
bool independent(const Geometry& g, const std::vector<std::int32_t>& node, const std::vector<int>& rows, const std::vector<int>& nodes) {
    Eigen::MatrixXd weight = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(nodes.size()), static_cast<Eigen::Index>(rows.size()));
    for (std::size_t k = 0; k < rows.size(); ++k) {
        const std::size_t r = static_cast<std::size_t>(rows[k]);
        for (int w = g.row_begin[r]; w < g.row_begin[r + 1]; ++w) {
            const auto at = std::lower_bound(nodes.begin(), nodes.end(), node[static_cast<std::size_t>(w)]);
            if (at != nodes.end() && *at == node[static_cast<std::size_t>(w)]) {
                weight(at - nodes.begin(), static_cast<Eigen::Index>(k)) += g.row_weight[static_cast<std::size_t>(w)];
            }
        }
    }
    if (weight.rows() < weight.cols()) {
        return false;
    }
    Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(weight);
    qr.setThreshold(1e-3);  // what they leave of a front loses twice as many digits
    return qr.rank() == weight.cols();
}

}  // namespace

std::vector<std::vector<int>> saddle_vertices(const Geometry& g, const std::vector<std::int32_t>& node, std::size_t node_count,
                                              const Eigen::SparseMatrix<double>& matrix) {
    const int count = static_cast<int>(node_count);
    const std::vector<int> piece = pieces(matrix, count);
    const std::map<std::int32_t, Ties> ties = ties_of(g, node);
    const std::vector<int> far = joints_to_a_hold(ties, piece);
    // Nodes by the first node that they stand with: a node that two hold or tie joins them.
    std::vector<int> first(node_count);
    std::iota(first.begin(), first.end(), 0);
    const auto find = [&](int n) {
        while (first[static_cast<std::size_t>(n)] != n) {
            n = first[static_cast<std::size_t>(n)] = first[static_cast<std::size_t>(first[static_cast<std::size_t>(n)])];
        }
        return n;
    };
    std::vector<std::pair<int, const std::vector<int>*>> rows_at;
    for (const auto& [number, own] : ties) {
        std::vector<int> with = own.nodes;
        if (number < 0) {
            const auto further = [&](int a, int b) {
                const int p = piece[static_cast<std::size_t>(a)], q = piece[static_cast<std::size_t>(b)];
                return std::pair(far[static_cast<std::size_t>(p)], p) < std::pair(far[static_cast<std::size_t>(q)], q);
            };
            const int furthest = piece[static_cast<std::size_t>(*std::max_element(with.begin(), with.end(), further))];
            std::erase_if(with, [&](int n) { return piece[static_cast<std::size_t>(n)] != furthest; });
            if (!independent(g, node, own.rows, with)) {
                with = own.nodes;
            }
        }
        for (const int n : with) {
            const int a = find(with[0]), b = find(n);
            first[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
        }
        rows_at.emplace_back(with[0], &own.rows);
    }
    std::vector<std::vector<int>> vertices;
    std::vector<int> vertex_of(node_count, -1);
    for (int n = 0; n < count; ++n) {
        int& of = vertex_of[static_cast<std::size_t>(find(n))];
        if (of < 0) {
            of = static_cast<int>(vertices.size());
            vertices.emplace_back();
        }
        vertices[static_cast<std::size_t>(of)].insert(vertices[static_cast<std::size_t>(of)].end(), {3 * n, 3 * n + 1, 3 * n + 2});
    }
    for (const auto& [n, rows] : rows_at) {
        std::vector<int>& vertex = vertices[static_cast<std::size_t>(vertex_of[static_cast<std::size_t>(find(n))])];
        for (const int r : *rows) {
            for (int c = 0; c < 3; ++c) {
                vertex.push_back(3 * count + 3 * r + c);
            }
        }
    }
    return vertices;
}

}  // namespace mphygs
