#include "mphygs/total_lagrangian/midpoint_cost.hpp"

namespace mphygs {

namespace {

// Of a block, in double precision: its forces are gathered and scattered in 4 x 27 x 9 x 8 multiplications and additions,
// few of them in products of large matrices, beside the law's; its part of the matrix is a product of 27 x 24 and 24 x 243,
// and has to be entered.
constexpr double forces = 2e4, assembly = 1.5 * 2.0 * 27 * 24 * 243;
// What it takes to read a number of the factors, 8 bytes.
constexpr double read_number = 8.0;

}  // namespace

MidpointCost midpoint_cost(std::size_t blocks, const MidpointMatrix& matrix) {
    const double b = static_cast<double>(blocks);
    return {forces * b + read_number * matrix.entries(), assembly * b + matrix.work()};
}

template <class T>
MidpointCost midpoint_cost(const TotalLagrangian<T>& model) {
    const Eigen::Index count = static_cast<Eigen::Index>(model.node_count());
    const MidpointMatrix matrix(model.geometry(), model.constraint_node(), model.coupled_nodes(), std::vector<double>(model.node_count(), 1.0),
                                Eigen::SparseMatrix<double>(count, count));
    return midpoint_cost(model.geometry().block_count(), matrix);
}

template MidpointCost midpoint_cost<float>(const TotalLagrangian<float>&);
template MidpointCost midpoint_cost<double>(const TotalLagrangian<double>&);

}  // namespace mphygs
