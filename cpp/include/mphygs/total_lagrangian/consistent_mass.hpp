// What nodes of a thin part share of their points' mass.
//
// Lumped, a point's mass stands at its nodes, M_L = sum_q m_q diag(N_a). Their weights have the variance h^2 / 4 wherever the
// point is: as it turns it has a moment of inertia of m h^2 / 4 that is the grid's alone, and bending is slow by (k h)^2 / 8,
// k its wave number and h a cell. Taken from the nodes again,
//   M = M_L - D,  D = sum_q m_q (h^2 / 4) sum_c (dN_a/dx_c) (dN_b/dx_c),
// over the axes c along the part, what stays is right to the order of h^2, as that of the consistent mass sum_q m_q N_a N_b is;
// but what alternates from node to node, which points that are drawn in hardly see, keeps all of its mass. Across a part the
// nodes keep the moments that `mass_table` gives them. Cells that are hardly filled, at one end, could share more than their nodes
// have: there D is as much smaller as leaves every motion of the nodes a tenth of its lumped mass. A mass at a place may be larger
// than a cell's: there it is the
// consistent one, D = m (diag(N_a) - N_a N_b), which leaves no mass negative.
//
// An implicit step is M_L (v - v_0) = span f + D (v - v_0): its nodes push each other by D (v - v_0) / span, and all that has
// to do with holds, joints and observers stays as it is with a lumped mass. D takes nothing from a uniform acceleration, so
// that weights are the same. Solids stay lumped: they take explicit steps too.
#pragma once

#include <Eigen/Sparse>
#include <array>
#include <cstdint>

#include "mphygs/total_lagrangian/midpoint_matrix.hpp"

namespace mphygs {

/// D, by nodes (N, N) [kg]: alike for all three components.
template <class T>
using SharedMass = Eigen::SparseMatrix<T, Eigen::RowMajor>;

/// D of the points of a block, or of a place, per mass: on each line of nodes `across` (diag(own) + scale sum_c w_c w_c^T).
template <class T>
struct SharedPoints {
    std::size_t first;                       // of the fields' points, or the place's number
    int count, axes;                         // of points: 8, or 1 of a place
    T scale;
    CellNodes node;
    std::array<std::int8_t, 27> line{};      // of each node: those on the same line, or plane, along the part share
    std::array<T, 27> across{}, own{};       // what its line carries of a point's mass; see above
    std::array<std::array<std::array<T, 27>, 3>, 8> weight{};  // point, axis

    /// put(a, b, d): sum_q mass_q D_q by the 27 nodes.
    template <class Put>
    void each(const T* mass, const Put& put) const {
        for (std::size_t a = 0; a < 27; ++a) {
            for (std::size_t b = 0; b < 27; ++b) {
                if (line[a] == line[b] && across[a] != T{}) {
                    T sum{};
                    for (std::size_t q = 0; q < static_cast<std::size_t>(count); ++q) {
                        T of = a == b ? own[a] : T{};
                        for (std::size_t c = 0; c < static_cast<std::size_t>(axes); ++c) {
                            of += scale * (weight[q][c][a] * weight[q][c][b]);  // alike for (a, b) and (b, a)
                        }
                        sum += mass[q] * of;
                    }
                    put(static_cast<int>(a), static_cast<int>(b), across[a] * sum);
                }
            }
        }
    }

    /// x . D_q y of two numbers for each node.
    double product(std::size_t q, const std::array<T, 27>& x, const std::array<T, 27>& y) const {
        double sum = 0;
        for (std::size_t c = 0; c < static_cast<std::size_t>(axes); ++c) {
            double of_x[27] = {}, of_y[27] = {};
            for (std::size_t a = 0; a < 27; ++a) {
                const double w = static_cast<double>(weight[q][c][a]);
                of_x[line[a]] += static_cast<double>(across[a]) * w * static_cast<double>(x[a]);
                of_y[line[a]] += w * static_cast<double>(y[a]);
            }
            for (std::size_t l = 0; l < 27; ++l) {
                sum += static_cast<double>(scale) * of_x[l] * of_y[l];
            }
        }
        for (std::size_t a = 0; a < 27; ++a) {
            sum += static_cast<double>(across[a] * own[a]) * static_cast<double>(x[a]) * static_cast<double>(y[a]);
        }
        return sum;
    }
};

/// add(n, c, sum) of component c of D x for each node n, from x as get(n, c), in numbers that T multiplies.
template <class Number, class T, class Get, class Add>
inline void push_each_other(const SharedMass<T>& shared, const Get& get, const Add& add) {
    for (Eigen::Index n = 0; n < shared.outerSize(); ++n) {
        Number sum[3] = {};
        for (typename SharedMass<T>::InnerIterator it(shared, n); it; ++it) {
            for (std::size_t c = 0; c < 3; ++c) {
                sum[c] += it.value() * get(static_cast<std::size_t>(it.col()), c);
            }
        }
        for (std::size_t c = 0; c < 3; ++c) {
            add(static_cast<std::size_t>(n), c, sum[c]);
        }
    }
}

}  // namespace mphygs
