// The grids that chunks scatter to, and their sum.
//
// Every chunk owns the planes that its particles may touch. The grids are all zero between
// passes: the sum clears what it reads, so a pass costs no separate clearing and the box may
// change from one pass to the next.
#pragma once

#include <algorithm>
#include <limits>

#include "mphygs/mls_mpm/lanes.hpp"
#include "mphygs/numerics/team.hpp"

namespace mphygs {

template <class T>
class MlsGrids {
  public:
    MlsGrids(int chunks, int lanes) : lanes_(static_cast<std::size_t>(lanes)), chunks_(static_cast<std::size_t>(chunks)) {}

    /// Room for the particles of `ranges` (per chunk) and one cell of motion.
    void prepare(const Box& box, const std::vector<CellRange>& ranges) {
        for (std::size_t c = 0; c < chunks_.size(); ++c) {
            Slab& slab = chunks_[c];
            slab.low = ranges[c].low[0] - 2;
            slab.planes = ranges[c].high[0] - ranges[c].low[0] + 5;
            slab.offset = static_cast<std::ptrdiff_t>(4 * box.plane()) * (slab.low - box.low[0]);
            slab.stride = 4 * (box.plane() * static_cast<std::size_t>(slab.planes) + 1);  // a row is four nodes wide
            if (slab.values.size() < lanes_ * slab.stride) {
                slab.values.resize(lanes_ * slab.stride, T{});
            }
        }
    }

    /// Chunk c's grid, to be indexed as the whole box; lanes are `lane_stride` apart.
    T* private_grid(std::size_t c) { return chunks_[c].values.data() - chunks_[c].offset; }
    std::size_t lane_stride(std::size_t c) const { return chunks_[c].stride; }

    /// Sums the chunks' grids in their order and divides momentum by mass; the result is zero where
    /// no particle reaches. ranges: where the particles were when they scattered.
    void reduce(const Box& box, const std::vector<CellRange>& ranges, Team& team, Buffer<T>& grid) {
        grid.resize(lanes_ * 4 * box.nodes() + 4);
        clear(box, ranges, team, grid.data());
        sum(box, ranges, team, [&](std::size_t first, std::size_t count, const auto& add) {
            for (std::size_t l = 0; l < lanes_; ++l) {
                add(l, &grid[4 * (l * box.nodes() + first)]);
            }
            std::size_t i = first;
            for (; lanes_ == 1 && i + 4 <= first + count; i += 4) {
                normalise_four(&grid[4 * i]);
            }
            for (; i < first + count; ++i) {
                normalise(grid.data() + 4 * i, 4 * box.nodes());
            }
        });
    }

    /// Zeros on the planes that are read: a row of three nodes reads a fourth.
    void clear(const Box& box, const std::vector<CellRange>& ranges, Team& team, T* grid) const {
        CellRange all;
        for (const CellRange& r : ranges) {
            all.cover(r);
        }
        const int first = all.low[0] - 1 - box.low[0], planes = all.high[0] - all.low[0] + 3;
        team.each(planes, [&](int plane) {
            const std::size_t at = static_cast<std::size_t>(first + plane) * box.plane();
            for (std::size_t l = 0; l < lanes_; ++l) {
                // The first node of the plane behind is the fourth of this plane's last row.
                std::fill_n(grid + 4 * (l * box.nodes() + at), 4 * box.plane() + (plane + 1 == planes ? 4 : 0), T{});
            }
        });
    }

    /// Calls f(first node, nodes, add) for every row of nodes that the particles reach; add(l, to)
    /// adds lane l of that row.
    template <class F>
    void sum(const Box& box, const std::vector<CellRange>& ranges, Team& team, F&& f) {
        CellRange all;
        for (const CellRange& r : ranges) {
            all.cover(r);
        }
        const std::size_t count = static_cast<std::size_t>(all.high[2] - all.low[2] + 3);
        team.each(all.high[0] - all.low[0] + 3, [&](int plane) {
            const int i = all.low[0] - 1 + plane;
            for (int j = all.low[1] - 1; j <= all.high[1] + 1; ++j) {
                const std::size_t first = (static_cast<std::size_t>(i - box.low[0]) * static_cast<std::size_t>(box.count[1]) +
                                           static_cast<std::size_t>(j - box.low[1])) *
                                              static_cast<std::size_t>(box.count[2]) +
                                          static_cast<std::size_t>(all.low[2] - 1 - box.low[2]);
                f(first, count, [&](std::size_t l, T* to) {
                    for (std::size_t c = 0; c < chunks_.size(); ++c) {
                        if (i >= ranges[c].low[0] - 1 && i <= ranges[c].high[0] + 1) {
                            T* from = private_grid(c) + l * chunks_[c].stride + 4 * first;
                            for (std::size_t k = 0; k < 4 * count; ++k) {
                                to[k] += from[k];
                                from[k] = T{};
                            }
                        }
                    }
                });
            }
        });
    }

    static constexpr T least_mass = std::numeric_limits<T>::min() * T(1e8);
    /// 1/m, or 0 on nodes with so little mass that it cannot be divided by.
    static T inverse_mass(T m) { return m > least_mass ? T(1) / m : T(0); }

  private:
    struct Slab {
        std::vector<T> values;
        int low = 0, planes = 0;
        std::ptrdiff_t offset = 0;
        std::size_t stride = 0;
    };

    void normalise(T* node, std::size_t lane_stride) const {
        const T inverse = inverse_mass(node[3]);
        for (int c = 0; c < 3; ++c) {
            node[c] *= inverse;
            for (std::size_t l = 1; l < lanes_; ++l) {
                T& d = node[l * lane_stride + static_cast<std::size_t>(c)];
                d = (d - node[c] * node[l * lane_stride + 3]) * inverse;
            }
        }
    }

    static void normalise_four(T* nodes) {
        const Row<T> value = read<Row<T>>(nodes);
        const Row<T> mass = fourth(value);
        const Row<T> inverse = choose(mass > least_mass, T(1) / mass, Row<T>{});
        write(nodes, keep_fourth(value * inverse, value));
    }

    std::size_t lanes_;
    std::vector<Slab> chunks_;
};

}  // namespace mphygs
