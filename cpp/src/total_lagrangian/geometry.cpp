// Set-up of the total-Lagrangian transfer: nodes, tables, chunks, weights.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <numeric>
#include <set>
#include <string>
#include <utility>

#include "mphygs/numerics/parallel.hpp"
#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

namespace {

// Blocks that have to share a table for it to be in the cache when the next of them reads it.
constexpr int common_table = 4;

/// Blocks from cell to cell, and in how many chunks they are worked on. Within a chunk no block follows one that is
/// shifted against it by a node or two along z: its rows would be read, to be added to, before the four numbers that were
/// just written there across their ends have left the processor's store buffer.
std::vector<std::int32_t> sorted_by_cell(const std::vector<std::int32_t>& cell, int chunks) {
    std::vector<std::int32_t> order(cell.size() / 3);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
        const std::int32_t* x = &cell[3 * static_cast<std::size_t>(a)];
        const std::int32_t* y = &cell[3 * static_cast<std::size_t>(b)];
        return std::lexicographical_compare(x, x + 3, y, y + 3);
    });
    for (int c = 0; c < chunks; ++c) {
        const auto at = [&](int chunk) { return order.begin() + static_cast<std::ptrdiff_t>(part_begin(order.size(), chunks, chunk)); };
        std::stable_sort(at(c), at(c + 1), [&](std::int32_t a, std::int32_t b) {
            const std::int32_t x = cell[3 * static_cast<std::size_t>(a) + 2], y = cell[3 * static_cast<std::size_t>(b) + 2];
            return std::pair(x & 3, x) < std::pair(y & 3, y);
        });
    }
    return order;
}

void require(bool condition, const std::string& message) {
    if (!condition) {
        throw std::invalid_argument(message);
    }
}

}  // namespace

template <class T>
int TotalLagrangian<T>::find_node(int i, int j, int k) const {
    const int a = i - grid_low_[0], b = j - grid_low_[1], c = k - grid_low_[2];
    if (a < 0 || b < 0 || c < 0 || a >= grid_shape_[0] || b >= grid_shape_[1] || c >= grid_shape_[2]) {
        return -1;
    }
    return node_of_grid_[static_cast<std::size_t>((a * grid_shape_[1] + b) * grid_shape_[2] + c)];
}

template <class T>
std::array<std::int32_t, 9> TotalLagrangian<T>::rows_of(const std::int32_t* cell) const {
    std::array<std::int32_t, 9> rows{};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            const int n = find_node(cell[0] + i - 1, cell[1] + j - 1, cell[2] - 1);
            require(n >= 0 && find_node(cell[0] + i - 1, cell[1] + j - 1, cell[2] + 1) == n + 2,
                    "a surface point or place lies in a cell without material");
            rows[static_cast<std::size_t>(i * 3 + j)] = n;
        }
    }
    return rows;
}

template <class T>
TotalLagrangian<T>::TotalLagrangian(Geometry geometry, Settings settings)
    : geometry_(std::move(geometry)), settings_(std::move(settings)) {
    const Geometry& g = geometry_;
    const std::size_t blocks = g.block_count();
    require(g.grid_origin.size() == g.grid_spacing.size() && (g.grid_origin.empty() || g.grid_width > 0),
            "origin and spacing must be of one grid, or of each of those that grid_width tells apart");
    require(blocks > 0, "the object has no material: no block of points was given");
    require(g.cell.size() == 3 * blocks && g.points.size() == 24 * blocks, "cell, part and points disagree in size");
    slots_ = make_slots(settings_.active);
    sites_ = active_sites(slots_);

    // Nodes: the 27 of every block's cell, numbered with z fastest.
    std::array<int, 3> low{g.cell[0], g.cell[1], g.cell[2]}, high = low;
    for (std::size_t b = 0; b < blocks; ++b) {
        for (std::size_t c = 0; c < 3; ++c) {
            low[c] = std::min(low[c], g.cell[3 * b + c]);
            high[c] = std::max(high[c], g.cell[3 * b + c]);
        }
    }
    for (std::size_t c = 0; c < 3; ++c) {
        grid_low_[c] = low[c] - 1;
        grid_shape_[c] = high[c] - low[c] + 3;
    }
    node_of_grid_.assign(static_cast<std::size_t>(grid_shape_[0]) * static_cast<std::size_t>(grid_shape_[1]) *
                             static_cast<std::size_t>(grid_shape_[2]),
                         -1);
    for (std::size_t b = 0; b < blocks; ++b) {
        for (int a = 0; a < 27; ++a) {
            const int i = g.cell[3 * b] - low[0] + a / 9;
            const int j = g.cell[3 * b + 1] - low[1] + (a / 3) % 3;
            const int k = g.cell[3 * b + 2] - low[2] + a % 3;
            node_of_grid_[static_cast<std::size_t>((i * grid_shape_[1] + j) * grid_shape_[2] + k)] = 0;
        }
    }
    std::int32_t next = 0;
    for (int i = 0; i < grid_shape_[0]; ++i) {
        for (int j = 0; j < grid_shape_[1]; ++j) {
            for (int k = 0; k < grid_shape_[2]; ++k) {
                std::int32_t& n = node_of_grid_[static_cast<std::size_t>((i * grid_shape_[1] + j) * grid_shape_[2] + k)];
                if (n < 0) {
                    continue;
                }
                n = next++;
                const int index[3] = {i + grid_low_[0], j + grid_low_[1], k + grid_low_[2]};
                const int standing[3] = {g.standing(index[0]), index[1], index[2]};
                const std::array<double, 3> origin = g.origin_at(index[0]), spacing = g.spacing_at(index[0]);
                for (std::size_t c = 0; c < 3; ++c) {
                    node_index_.push_back(index[c]);
                    node_positions_.push_back(origin[c] + standing[c] * spacing[c]);
                }
            }
        }
    }
    place_curved_nodes();
    // Room for the over-read of the last row and for whole packs.
    stride_ = (node_count() + 4 + lane_count - 1) / lane_count * lane_count;

    // Tables, shared between blocks with the same points (all uncut cells).
    std::map<std::vector<std::int64_t>, std::int32_t> known;
    const auto table_key = [&](const double* points, const std::int32_t* cell, double (&s)[8][3]) {
        std::vector<std::int64_t> key;
        for (int q = 0; q < 8; ++q) {
            in_cell(points + 3 * q, cell, s[q]);
            for (const double x : s[q]) {
                key.push_back(std::llround(x * 1e12));
            }
        }
        if (is_curved(cell[0])) {
            const CurvedCell curved = curved_cell(cell);
            for (int i = 0; i < 81; ++i) {
                key.push_back(std::llround((curved.node[i / 3][i % 3] - curved.node[13][i % 3]) * 1e15));
            }
            return key;
        }
        for (const double h : g.spacing_at(cell[0])) {
            key.push_back(std::llround(h * 1e15));
        }
        return key;
    };
    const int parts = static_cast<int>(std::clamp<std::size_t>(blocks / 32, 1, 16));
    order_ = sorted_by_cell(g.cell, parts);
    for (const std::int32_t b : order_) {
        const std::size_t block = static_cast<std::size_t>(b);
        rows_.push_back(rows_of(&g.cell[3 * block]));
        double s[8][3];
        auto [entry, fresh] = known.try_emplace(table_key(&g.points[24 * block], &g.cell[3 * block], s),
                                                static_cast<std::int32_t>(gradients_.size()));
        table_.push_back(entry->second);
        if (!fresh) {
            continue;
        }
        GradientTable<T> gradient{};
        ValueTable<T> value{};
        set_points(s, &g.cell[3 * block], gradient, value);
        gradients_.push_back(gradient);
        values_.push_back(value);
        masses_.push_back(mass_table(s, &g.cell[3 * block], value));
    }
    require(g.volume.empty() || g.volume.size() == 8 * blocks, "volume must have eight entries for every block, or none");
    require(g.sparse.empty() || g.sparse.size() == blocks, "sparse must have one entry for every block, or none");
    for (std::size_t b = 0; b < blocks; ++b) {
        const bool sparse = !g.sparse.empty() && g.sparse[static_cast<std::size_t>(order_[b])] > 0;
        spring_.push_back(sparse ? static_cast<std::int32_t>(springs_.size()) : -1);
        if (sparse) {
            const std::size_t table = static_cast<std::size_t>(table_[b]);
            const std::size_t block = static_cast<std::size_t>(order_[b]);
            if (is_curved(g.cell[3 * block])) {
                springs_.push_back(curved_springs(block));
            } else {
                springs_.emplace_back(values_[table], gradients_[table], g.spacing_at(g.cell[3 * block]).data(), g.sparse[block]);
            }
        }
    }
    std::vector<int> users(gradients_.size(), 0);
    std::vector<bool> of_curved(gradients_.size(), false);
    for (std::size_t b = 0; b < blocks; ++b) {
        const std::size_t t = static_cast<std::size_t>(table_[b]);
        ++users[t];
        of_curved[t] = is_curved(g.cell[3 * static_cast<std::size_t>(order_[b])]);
    }
    for (std::size_t t = 0; t < users.size(); ++t) {
        // What is curved has no factors.
        gradients_[t].common = users[t] >= common_table || of_curved[t];
    }

    require(g.surface_points.size() == 24 * g.surface_count() && g.surface_area.size() == 8 * g.surface_count(),
            "surface_cell, surface_points and surface_area disagree in size");
    surface_order_ = sorted_by_cell(g.surface_cell, parts);
    for (const std::int32_t b : surface_order_) {
        const std::size_t block = static_cast<std::size_t>(b);
        surface_rows_.push_back(rows_of(&g.surface_cell[3 * block]));
        double s[8][3];
        table_key(&g.surface_points[24 * block], &g.surface_cell[3 * block], s);
        ValueTable<T> value{};
        GradientTable<T> unused;
        set_points(s, &g.surface_cell[3 * block], unused, value);
        surface_values_.push_back(value);
    }

    const PointWeights place_weights = weights(g.places, g.place_cell);
    for (std::size_t p = 0; p < g.place_count(); ++p) {
        PlaceRows rows;
        for (std::size_t a = 0; a < 27; ++a) {
            rows.node[a] = place_weights.node[27 * p + a];
            rows.value[a] = static_cast<T>(place_weights.value[27 * p + a]);
        }
        places_.push_back(rows);
    }

    // Fixed chunks of blocks, each with the range of nodes that it touches.
    for (int c = 0; c < parts; ++c) {
        Chunk chunk{part_begin(blocks, parts, c), part_begin(blocks, parts, c + 1),
                    part_begin(surface_rows_.size(), parts, c), part_begin(surface_rows_.size(), parts, c + 1),
                    static_cast<int>(stride_), 0};
        const auto cover = [&](const std::array<std::int32_t, 9>& rows) {
            chunk.node_begin = std::min(chunk.node_begin, *std::min_element(rows.begin(), rows.end()));
            chunk.node_end = std::max(chunk.node_end, *std::max_element(rows.begin(), rows.end()) + 4);
        };
        for (std::size_t b = chunk.block_begin; b < chunk.block_end; ++b) {
            cover(rows_[b]);
        }
        for (std::size_t b = chunk.surface_begin; b < chunk.surface_end; ++b) {
            cover(surface_rows_[b]);
        }
        chunks_.push_back(chunk);
    }

    // Constraint rows: from grid indices to node numbers.
    for (const std::int32_t hold : g.row_hold) {
        require(hold < g.hold_count,
                "hold " + std::to_string(hold) + " does not exist: hold_count is " + std::to_string(g.hold_count));
    }
    require(g.row_begin.size() == g.row_count() + 1 || g.row_count() == 0, "row_begin must have one entry more than there are rows");
    for (std::size_t w = 0; w < g.row_weight.size(); ++w) {
        const int n = find_node(g.row_node[3 * w], g.row_node[3 * w + 1], g.row_node[3 * w + 2]);
        require(n >= 0, "a hold or tie is attached to a node without material");
        constraint_node_.push_back(n);
    }
    share_mass();
    geometry_.actuation.settle(node_count(), g.hold_count);
}

template <class T>
double TotalLagrangian<T>::extent() const {
    double squares = 0.0;
    for (std::size_t c = 0; c < 3; ++c) {
        double low = node_positions_[c], high = low;
        for (std::size_t n = 1; n < node_count(); ++n) {
            low = std::min(low, node_positions_[3 * n + c]);
            high = std::max(high, node_positions_[3 * n + c]);
        }
        squares += (high - low) * (high - low);
    }
    return std::sqrt(squares);
}

template <class T>
PointWeights TotalLagrangian<T>::weights(const std::vector<double>& points, const std::vector<std::int32_t>& cell) const {
    require(points.size() == cell.size(), "points and cell must both be (M, 3)");
    PointWeights w;
    for (std::size_t p = 0; p < points.size() / 3; ++p) {
        const std::array<std::int32_t, 9> rows = rows_of(&cell[3 * p]);
        double s[3], n[27], dn[27][3];
        in_cell(&points[3 * p], &cell[3 * p], s);
        weights_at(s, &cell[3 * p], n, dn);
        for (int a = 0; a < 27; ++a) {
            w.node.push_back(rows[static_cast<std::size_t>(a / 3)] + a % 3);
            w.value.push_back(n[a]);
            w.gradient.insert(w.gradient.end(), dn[a], dn[a] + 3);
        }
    }
    return w;
}

template class TotalLagrangian<float>;
template class TotalLagrangian<double>;

}  // namespace mphygs
