// What an implicit step's matrix costs, which depends on how the body is built and not on what it is made of.
#pragma once

#include "mphygs/total_lagrangian/midpoint_matrix.hpp"
#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

/// In operations as they pass in products of large matrices.
struct MidpointCost {
    double iteration;  // forces, and a solution by the factors
    double renewal;    // a new matrix and its factors
};

/// blocks: of eight points.
MidpointCost midpoint_cost(std::size_t blocks, const MidpointMatrix& matrix);

template <class T>
MidpointCost midpoint_cost(const TotalLagrangian<T>& model);

}  // namespace mphygs
