#include "mphygs/numerics/elimination_order.hpp"

#include <Eigen/OrderingMethods>
#include <Eigen/Sparse>
#include <algorithm>

namespace mphygs {

namespace {

// An entry that is set, added to a parent's or changed by few pivots takes as long as so many operations in a product of
// large matrices; a front by itself as long as so many.
constexpr double moved = 8, begun = 4000;

/// Of a front that eliminates p unknowns and changes b: its LU, two triangular solves, one product, and what it moves.
double front_work(double p, double b) {
    return 2.0 / 3.0 * p * p * p + 2.0 * p * p * b + 2.0 * p * b * b + moved * (p + b) * (p + b) + begun;
}

std::vector<int> sorted_union(const std::vector<int>& a, const std::vector<int>& b) {
    std::vector<int> c;
    c.reserve(a.size() + b.size());
    std::set_union(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(c));
    return c;
}

/// Breadth first from a vertex: levels, one after the other. seen: the pass in which a vertex was reached last.
std::vector<std::vector<int>> levels_from(const VertexGraph& graph, int root, std::vector<int>& seen, int pass) {
    std::vector<std::vector<int>> levels{{root}};
    seen[static_cast<std::size_t>(root)] = pass;
    while (true) {
        std::vector<int> next;
        for (const int v : levels.back()) {
            for (const int w : graph.beside[static_cast<std::size_t>(v)]) {
                int& last = seen[static_cast<std::size_t>(w)];
                if (last != pass) {
                    last = pass;
                    next.push_back(w);
                }
            }
        }
        if (next.empty()) {
            return levels;
        }
        levels.push_back(std::move(next));
    }
}

/// The levels from an end of what is connected with a vertex.
std::vector<std::vector<int>> levels_from_an_end(const VertexGraph& graph, int vertex, std::vector<int>& seen, int& pass) {
    const auto degree = [&](int v) { return graph.beside[static_cast<std::size_t>(v)].size(); };
    std::vector<std::vector<int>> levels = levels_from(graph, vertex, seen, ++pass);
    while (true) {
        const std::vector<int>& far = levels.back();
        const int end = *std::min_element(far.begin(), far.end(), [&](int a, int b) { return degree(a) < degree(b); });
        std::vector<std::vector<int>> other = levels_from(graph, end, seen, ++pass);
        if (other.size() <= levels.size()) {
            return levels;
        }
        levels = std::move(other);
    }
}

bool comes_last(const VertexGraph& graph, int v) { return !graph.last.empty() && graph.last[static_cast<std::size_t>(v)]; }

/// Of unknowns by threes: a vertex that stands for many counts for as much. all: also of what comes last anyway.
std::vector<int> least_degree(const VertexGraph& graph, bool all) {
    std::vector<int> first, of;
    for (int v = 0; v < graph.count(); ++v) {
        first.push_back(static_cast<int>(of.size()));
        const int weight = all || !comes_last(graph, v) ? graph.weight[static_cast<std::size_t>(v)] : 0;
        of.insert(of.end(), static_cast<std::size_t>(weight + 2) / 3, v);
    }
    first.push_back(static_cast<int>(of.size()));
    std::vector<Eigen::Triplet<double>> entries;
    for (int c = 0; c < static_cast<int>(of.size()); ++c) {
        const int v = of[static_cast<std::size_t>(c)];
        std::vector<int> beside = graph.beside[static_cast<std::size_t>(v)];
        beside.push_back(v);
        for (const int w : beside) {
            for (int r = first[static_cast<std::size_t>(w)]; r < first[static_cast<std::size_t>(w) + 1]; ++r) {
                entries.emplace_back(r, c, 1.0);
            }
        }
    }
    const Eigen::Index size = static_cast<Eigen::Index>(of.size());
    Eigen::SparseMatrix<double> matrix(size, size);
    matrix.setFromTriplets(entries.begin(), entries.end());
    Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> found;
    Eigen::AMDOrdering<int>()(matrix, found);
    std::vector<int> order;
    std::vector<bool> taken(graph.weight.size(), false);
    for (Eigen::Index k = 0; k < size; ++k) {
        const int v = of[static_cast<std::size_t>(found.indices()[k])];
        if (!taken[static_cast<std::size_t>(v)]) {
            taken[static_cast<std::size_t>(v)] = true;
            order.push_back(v);
        }
    }
    return order;
}

/// Limbs from their tips: what branches is eliminated branch by branch. Of a level the heavy vertices first, or what they
/// tie would join them.
std::vector<int> far_ends_first(const VertexGraph& graph) {
    std::vector<int> order, seen(graph.weight.size(), 0);
    int pass = 0;
    for (int v = 0; v < graph.count(); ++v) {
        if (seen[static_cast<std::size_t>(v)] > 0) {
            continue;
        }
        for (std::vector<int>& level : levels_from_an_end(graph, v, seen, pass)) {
            std::stable_sort(level.begin(), level.end(), [&](int a, int b) {
                return graph.weight[static_cast<std::size_t>(a)] < graph.weight[static_cast<std::size_t>(b)];
            });
            order.insert(order.end(), level.begin(), level.end());
        }
    }
    std::reverse(order.begin(), order.end());
    return order;
}

/// An order of the vertices in which those that come last follow the last one that they are beside.
std::vector<int> postponed(const VertexGraph& graph, const std::vector<int>& order) {
    std::vector<int> wanted(graph.weight.size(), 0), to;
    for (int v = 0; v < graph.count(); ++v) {
        wanted[static_cast<std::size_t>(v)] = static_cast<int>(graph.beside[static_cast<std::size_t>(v)].size());
        if (comes_last(graph, v) && wanted[static_cast<std::size_t>(v)] == 0) {
            to.push_back(v);
        }
    }
    for (const int v : order) {
        if (comes_last(graph, v)) {
            continue;
        }
        to.push_back(v);
        for (const int w : graph.beside[static_cast<std::size_t>(v)]) {
            if (comes_last(graph, w) && --wanted[static_cast<std::size_t>(w)] == 0) {
                to.push_back(w);
            }
        }
    }
    return to;
}

}  // namespace

EliminationTree elimination_tree(const VertexGraph& graph, const std::vector<int>& order) {
    const std::size_t count = order.size();
    std::vector<int> place(count);
    for (std::size_t k = 0; k < count; ++k) {
        place[static_cast<std::size_t>(order[k])] = static_cast<int>(k);
    }
    // By place: a front of one vertex changes its later neighbours and what its children change beyond it.
    std::vector<std::vector<int>> changed(count), children(count);
    std::vector<int> roots;
    for (std::size_t k = 0; k < count; ++k) {
        std::vector<int> own;
        for (const int w : graph.beside[static_cast<std::size_t>(order[k])]) {
            const int at = place[static_cast<std::size_t>(w)];
            if (at > static_cast<int>(k)) {
                own.push_back(at);
            }
        }
        std::sort(own.begin(), own.end());
        for (const int child : children[k]) {
            const std::vector<int>& of = changed[static_cast<std::size_t>(child)];
            own = sorted_union(own, {of.begin() + 1, of.end()});  // its first is this vertex
        }
        if (own.empty()) {
            roots.push_back(static_cast<int>(k));
        } else {
            children[static_cast<std::size_t>(own[0])].push_back(static_cast<int>(k));
        }
        changed[k] = std::move(own);
    }
    // A child is eliminated together with its parent where one larger front costs less than two.
    struct Merged {
        std::vector<int> pivots, children;
        double p = 0, b = 0, work = 0;
    };
    std::vector<Merged> merged(count);
    const auto weight = [&](int at) { return static_cast<double>(graph.weight[static_cast<std::size_t>(order[static_cast<std::size_t>(at)])]); };
    for (std::size_t k = 0; k < count; ++k) {
        Merged& own = merged[k];
        own.p = weight(static_cast<int>(k));
        for (const int at : changed[k]) {
            own.b += weight(at);
        }
        own.work = front_work(own.p, own.b);
        for (const int child : children[k]) {
            Merged& other = merged[static_cast<std::size_t>(child)];
            const double both = front_work(own.p + other.p, own.b);
            if (both < own.work + other.work) {
                own.p += other.p;
                own.work = both;
                own.pivots.insert(own.pivots.end(), other.pivots.begin(), other.pivots.end());
                own.children.insert(own.children.end(), other.children.begin(), other.children.end());
                other = {};
            } else {
                own.children.push_back(child);
            }
        }
        own.pivots.push_back(static_cast<int>(k));
    }
    EliminationTree tree;
    const auto vertices = [&](const std::vector<int>& places) {
        std::vector<int> of;
        for (const int at : places) {
            of.push_back(order[static_cast<std::size_t>(at)]);
        }
        return of;
    };
    // Children before their parents, depth first: what a front waits for is done just before it.
    struct Visit {
        int at;
        bool entered;
    };
    std::vector<int> number(count, -1);
    std::vector<Visit> stack;
    for (auto root = roots.rbegin(); root != roots.rend(); ++root) {
        stack.push_back({*root, false});
    }
    while (!stack.empty()) {
        const Visit visit = stack.back();
        const Merged& own = merged[static_cast<std::size_t>(visit.at)];
        if (!visit.entered) {
            stack.back().entered = true;
            for (const int child : own.children) {
                stack.push_back({child, false});
            }
            continue;
        }
        stack.pop_back();
        number[static_cast<std::size_t>(visit.at)] = static_cast<int>(tree.fronts.size());
        for (const int child : own.children) {
            tree.fronts[static_cast<std::size_t>(number[static_cast<std::size_t>(child)])].parent = number[static_cast<std::size_t>(visit.at)];
        }
        tree.fronts.push_back({vertices(own.pivots), vertices(changed[static_cast<std::size_t>(visit.at)]), -1});
        tree.work += own.work;
    }
    return tree;
}

EliminationTree cheapest_elimination(const VertexGraph& graph) {
    EliminationTree best;
    const auto offer = [&](const std::vector<int>& order) {
        EliminationTree tree = elimination_tree(graph, postponed(graph, order));
        if (best.fronts.empty() || tree.work < best.work) {
            best = std::move(tree);
        }
    };
    offer(far_ends_first(graph));
    offer(least_degree(graph, true));
    if (!graph.last.empty()) {
        offer(least_degree(graph, false));
    }
    return best;
}

}  // namespace mphygs
