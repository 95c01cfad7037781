#include "mphygs/total_lagrangian/midpoint_cost.hpp"

#include <array>
#include <map>

#include "mphygs/total_lagrangian/midpoint_matrix.hpp"

namespace mphygs {

template <class T>
MidpointCost midpoint_cost(const TotalLagrangian<T>& model) {
    const Geometry& g = model.geometry();
    std::vector<double> points;  // one of every block: its cell's nodes are wanted
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        points.insert(points.end(), &g.points[24 * b], &g.points[24 * b] + 3);
    }
    const std::vector<std::int32_t> cells = model.weights(points, g.cell).node;
    std::map<std::array<std::int32_t, 3>, std::int32_t> number;
    const std::vector<std::int32_t>& index = model.node_index();
    for (std::size_t n = 0; n < model.node_count(); ++n) {
        number[{index[3 * n], index[3 * n + 1], index[3 * n + 2]}] = static_cast<std::int32_t>(n);
    }
    std::vector<std::int32_t> node;
    for (std::size_t w = 0; w < g.row_weight.size(); ++w) {
        node.push_back(number.at({g.row_node[3 * w], g.row_node[3 * w + 1], g.row_node[3 * w + 2]}));
    }
    const MidpointMatrix matrix(g, index, node, cells, std::vector<double>(model.node_count(), 1.0));
    return {3.0 * static_cast<double>(matrix.colours()), matrix.work(), matrix.entries()};
}

template MidpointCost midpoint_cost<float>(const TotalLagrangian<float>&);
template MidpointCost midpoint_cost<double>(const TotalLagrangian<double>&);

}  // namespace mphygs
