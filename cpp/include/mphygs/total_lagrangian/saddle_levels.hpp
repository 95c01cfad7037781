// In which order a direct solver takes the unknowns of nodes and of the rows that hold or tie them.
#pragma once

#include <map>
#include <vector>

#include "mphygs/model.hpp"

namespace mphygs {

/// What `BlockTridiagonal::analyse` begins with, and what it keeps together.
struct SaddleLevels {
    std::vector<int> start;
    std::vector<std::vector<int>> together;

    /// The unknowns of node n are 3 n ... 3 n + 2, those of row r follow all nodes'. node: of every weight of the rows.
    /// The hold's rows and the nodes that they hold come first, a joint's rows and nodes together: their
    /// block needs the pivoting.
    SaddleLevels(const Geometry& g, const std::vector<std::int32_t>& node, std::size_t node_count) {
        const int first_row = static_cast<int>(3 * node_count);
        std::vector<bool> tied(3 * node_count, false);
        std::map<std::int32_t, std::vector<int>> joints;
        for (std::size_t r = 0; r < g.row_count(); ++r) {
            const bool joint = g.row_hold[r] < 0;
            std::vector<int>& rows = joint ? joints[g.row_hold[r]] : start;
            for (int c = 0; c < 3; ++c) {
                rows.push_back(first_row + 3 * static_cast<int>(r) + c);
            }
            for (int w = g.row_begin[r]; w < g.row_begin[r + 1]; ++w) {
                for (int c = 0; c < 3; ++c) {
                    const int unknown = 3 * node[static_cast<std::size_t>(w)] + c;
                    if (joint) {
                        rows.push_back(unknown);
                    } else {
                        tied[static_cast<std::size_t>(unknown)] = true;
                    }
                }
            }
        }
        for (auto& [joint, unknowns] : joints) {
            together.push_back(std::move(unknowns));
        }
        for (int i = 0; i < first_row; ++i) {
            if (tied[static_cast<std::size_t>(i)]) {
                start.push_back(i);
            }
        }
    }
};

}  // namespace mphygs
