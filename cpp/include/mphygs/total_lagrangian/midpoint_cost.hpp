// What an implicit step's matrix costs, which depends on how the body is built and not on what it is made of.
#pragma once

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

struct MidpointCost {
    double columns;  // derivatives of all forces that tell the matrix
    double factors;  // operations of a factorisation
    double entries;  // numbers in the factors, all of which a solution reads
};

template <class T>
MidpointCost midpoint_cost(const TotalLagrangian<T>& model);

}  // namespace mphygs
