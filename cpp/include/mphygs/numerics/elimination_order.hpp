// In which order a direct solver eliminates the vertices of a graph, and what it then costs.
#pragma once

#include <vector>

namespace mphygs {

/// An undirected graph whose vertices stand for so many unknowns.
struct VertexGraph {
    std::vector<std::vector<int>> beside;  // of every vertex, sorted, without itself
    std::vector<int> weight;               // unknowns
    std::vector<bool> last = {};           // eliminated after all that they are beside, none of which is another of them; empty: none

    int count() const { return static_cast<int>(weight.size()); }
};

/// Where the factors of a matrix are not zero: fronts, each a dense matrix of the unknowns that are eliminated in it and of
/// those that they leave changed, children before their parents.
struct EliminationTree {
    struct Front {
        std::vector<int> pivots, boundary;  // vertices; the boundary in the order of elimination
        int parent = -1;                    // front, -1: none
    };
    std::vector<Front> fronts;
    double work = 0;  // of a factorisation [floating-point operations], what is moved counted too
};

/// The tree of an order of elimination.
EliminationTree elimination_tree(const VertexGraph& graph, const std::vector<int>& order);

/// The cheapest tree of three orders: from the far ends of a level structure to its root (George, 1971), which is that of
/// slender bodies and of bodies with limbs, and the least degree first (Amestoy, Davis and Duff, 1996), with what comes last
/// and without it.
EliminationTree cheapest_elimination(const VertexGraph& graph);

}  // namespace mphygs
