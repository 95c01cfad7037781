// Springs on the shapes of a sparsely filled cell that its eight points cannot see.
//
// The slopes at eight points are 24 numbers, the nodes of a cell 27: beside the constant two shapes have no slope there, or
// up to seven where the points stand in a box along the axes (with Q zero at both coordinates: Q(x) Q(y) and the like).
// In a cell that is full the neighbours see them. Where material fills little of it nobody does: they have mass and no
// stiffness, swing slowly, and where one of them is as slow as a mode of the object it takes a part of its motion. The
// springs' energy, for each component of the displacement, is
//   E = s/2 sum_k (w_k . u)^2,  s = (filled / h)^2 sum_q mu_q V_q,
// where w_1 to w_7 are the shapes of least slope, less what a polynomial of degree 2 has of them, weighed and normed by
// n_a = mean_q N_a(X_q) as the nodes' masses are: neither a rigid motion nor a strain that is uniform or linear over the
// cell costs any, and no shape swings faster than filled c_s / h, far below what the stable substep is chosen for. `filled`
// is the share of the cell with material: a thin sheet's bending, which goes with its square, stays softer than the rest.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "mphygs/total_lagrangian/spline_tables.hpp"

namespace mphygs {

inline constexpr int cell_shapes = 7;

/// w_1 to w_7. share: n_a; slopes: of N_a at the eight points along the three axes, in spacings.
void flat_shapes(const double (&share)[27], const double (&slopes)[24][27], double (&shape)[cell_shapes][27]);

template <class T>
struct CellSprings {
    static constexpr int shapes = cell_shapes;

    CellSprings() = default;

    /// value, gradient: N_a and dN_a/dX at the cell's eight points; spacing: of the grid [m]; filled: share of the cell.
    CellSprings(const ValueTable<T>& value, const GradientTable<T>& gradient, const double spacing[3], double filled) {
        const double h = std::min({spacing[0], spacing[1], spacing[2]});
        stiffness = static_cast<T>(filled * filled / (h * h));
        double share[27], slopes[24][27];
        for (int a = 0; a < 27; ++a) {
            share[a] = static_cast<double>(sum_lanes<T>(value.by_node[a])) / lane_count;
            for (int i = 0; i < 24; ++i) {
                slopes[i][a] = static_cast<double>(gradient.by_node[a][i % 3][i / 3]) * spacing[i % 3];
            }
        }
        double found[shapes][27];
        flat_shapes(share, slopes, found);
        for (int a = 0; a < 27; ++a) {
            for (int k = 0; k < shapes; ++k) {
                shape[k][a / 3 * 4 + a % 3] = static_cast<T>(found[k][a]);
            }
        }
    }

    /// w_k . u of one component of a field; `field` may be read one number beyond the last node.
    std::array<T, shapes> along(const T* field, const Rows& rows) const {
        FourNodes<T> sum[shapes] = {};
        for (int r = 0; r < row_count_27; ++r) {
            const FourNodes<T> x = read<FourNodes<T>>(field + rows[r]);
            for (int k = 0; k < shapes; ++k) {
                sum[k] += read<FourNodes<T>>(shape[k] + 4 * r) * x;
            }
        }
        std::array<T, shapes> total;
        for (std::size_t k = 0; k < shapes; ++k) {
            total[k] = (sum[k][0] + sum[k][1]) + sum[k][2];
        }
        return total;
    }

    /// Adds sum_k factor_k w_k to one component of a field.
    void add(const std::array<T, shapes>& factor, const Rows& rows, T* field) const {
        for (int r = 0; r < row_count_27; ++r) {
            FourNodes<T> pull{};
            for (std::size_t k = 0; k < shapes; ++k) {
                pull += factor[k] * read<FourNodes<T>>(shape[k] + 4 * r);
            }
            add_row<T>(field + rows[r], pull);
        }
    }

    T stiffness = 0;                                   // s over the sum of mu V [1/m^2]
    alignas(64) T shape[shapes][node_lanes] = {};  // w_k, rows of three and a lane of zero
};

}  // namespace mphygs
