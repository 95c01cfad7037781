// Which unknowns a direct solver eliminates together: those of a node, and the rows of a hold or joint with nodes that
// can carry them.
#pragma once

#include <Eigen/Sparse>
#include <vector>

#include "mphygs/model.hpp"

namespace mphygs {

/// Every unknown of a saddle matrix in one vertex, as `SparseFactors::analyse` takes them. The unknowns of node n are 3 n ... 3 n + 2,
/// those of row r follow all nodes'. node: of every weight of the rows.
///
/// A hold's rows stand with all nodes that they hold, a joint's rows with the nodes of that side which is further
/// from the holds, where these see all its patterns, else with those of both sides. Whatever is eliminated is then held by
/// what is left, or by rows that are eliminated with it: no front is singular, though a part by itself can float.
std::vector<std::vector<int>> saddle_vertices(const Geometry& geometry, const std::vector<std::int32_t>& node, std::size_t node_count,
                                              const Eigen::SparseMatrix<double>& matrix);

}  // namespace mphygs
