// Set-up of curved grids: where their nodes stand, the weights and masses of points in their cells.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

namespace {

void require(bool condition, const char* message) {
    if (!condition) {
        throw std::invalid_argument(message);
    }
}

}  // namespace

template <class T>
void TotalLagrangian<T>::place_curved_nodes() {
    const Geometry& g = geometry_;
    require(g.curved_node.size() == g.curved_position.size(), "curved_node and curved_position must both be (K, 3)");
    std::vector<bool> standing_elsewhere(node_count(), false);
    for (std::size_t k = 0; k < g.curved_node.size() / 3; ++k) {
        const int i = g.curved_node[3 * k], grid = g.grid_of(i);
        require(grid >= 0, "a curved node is of no grid");
        curved_.resize(std::max(curved_.size(), static_cast<std::size_t>(grid) + 1), false);
        curved_[static_cast<std::size_t>(grid)] = true;
        if (const int n = find_node(i, g.curved_node[3 * k + 1], g.curved_node[3 * k + 2]); n >= 0) {
            std::copy_n(&g.curved_position[3 * k], 3, &node_positions_[3 * static_cast<std::size_t>(n)]);
            standing_elsewhere[static_cast<std::size_t>(n)] = true;
        }
    }
    spanned_.assign(curved_.size(), {true, true, true});
    std::vector<std::int32_t> first(3 * curved_.size(), -1);
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        const std::size_t grid = static_cast<std::size_t>(g.grid_of(g.cell[3 * b]));
        for (std::size_t c = 0; grid < curved_.size() && c < 3; ++c) {
            std::int32_t& one = first[3 * grid + c];
            one = one < 0 ? g.cell[3 * b + c] : one;
            spanned_[grid][c] = spanned_[grid][c] && one == g.cell[3 * b + c];
        }
    }
    for (std::size_t n = 0; n < node_count(); ++n) {
        require(!is_curved(node_index_[3 * n]) || standing_elsewhere[n], "a curved grid has a node without a place");
    }
}

template <class T>
bool TotalLagrangian<T>::is_curved(int i) const {
    const std::size_t grid = static_cast<std::size_t>(geometry_.grid_of(i));
    return grid < curved_.size() && curved_[grid];
}

template <class T>
CurvedCell TotalLagrangian<T>::curved_cell(const std::int32_t* cell) const {
    const std::array<std::int32_t, 9> rows = rows_of(cell);
    CurvedCell curved;
    for (int a = 0; a < 27; ++a) {
        const std::size_t n = static_cast<std::size_t>(rows[static_cast<std::size_t>(a / 3)] + a % 3);
        std::copy_n(&node_positions_[3 * n], 3, curved.node[a]);
    }
    return curved;
}

template <class T>
void TotalLagrangian<T>::in_cell(const double* point, const std::int32_t* cell, double (&s)[3]) const {
    if (is_curved(cell[0])) {
        curved_cell(cell).find(point, s);
        return;
    }
    const int standing[3] = {geometry_.standing(cell[0]), cell[1], cell[2]};
    const std::array<double, 3> origin = geometry_.origin_at(cell[0]), spacing = geometry_.spacing_at(cell[0]);
    for (std::size_t c = 0; c < 3; ++c) {
        s[c] = (point[c] - origin[c]) / spacing[c] - standing[c];
    }
}

template <class T>
void TotalLagrangian<T>::weights_at(const double (&s)[3], const std::int32_t* cell, double (&n)[27], double (&dn)[27][3]) const {
    if (is_curved(cell[0])) {
        const double unit[3] = {1.0, 1.0, 1.0};
        point_weights(s, unit, n, dn);
        curved_cell(cell).turn(s, dn);
    } else {
        point_weights(s, geometry_.spacing_at(cell[0]).data(), n, dn);
    }
}

template <class T>
void TotalLagrangian<T>::set_points(const double (&s)[8][3], const std::int32_t* cell, GradientTable<T>& gradient,
                                    ValueTable<T>& value) const {
    const std::array<double, 3> spacing = geometry_.spacing_at(cell[0]);
    for (int q = 0; q < 8; ++q) {
        if (is_curved(cell[0])) {
            double n[27], dn[27][3];
            weights_at(s[q], cell, n, dn);
            set_point(q, n, dn, gradient, value);
        } else {
            set_point(q, s[q], spacing.data(), gradient, value);
        }
    }
}

/// The nodes' values, as everywhere, but along axes that one cell spans: there these would be a mass far from the middle,
/// and the part would turn about itself much too slowly. Instead the three nodes, at -1, 0 and 1, are given the mass,
/// the mean and the variance that the points have along the axis,
///   m_1 = (var + mean^2 + mean) / 2,  m_0 = 1 - var - mean^2,  m_-1 = (var + mean^2 - mean) / 2,
/// so that a rigid turn has the momentum and the energy that it has. Where the points lie to one side so far that one of
/// these were negative, the variance is taken that makes it none.
template <class T>
void TotalLagrangian<T>::mass_shares(const double (&s)[8][3], const std::int32_t* cell, double (&share)[3][8][3]) const {
    const std::array<bool, 3>& spanned = spanned_[static_cast<std::size_t>(geometry_.grid_of(cell[0]))];
    for (int c = 0; c < 3; ++c) {
        double mean = 0, square = 0;
        for (int q = 0; q < 8; ++q) {
            mean += s[q][c] / 8.0;
            square += s[q][c] * s[q][c] / 8.0;
        }
        square = std::max(square, std::abs(mean) * 1.001);
        for (int q = 0; q < 8; ++q) {
            const SplineWeights<double> w = spline_weights(s[q][c]);
            const double whole[3] = {0.5 * (square - mean), 1.0 - square, 0.5 * (square + mean)};
            for (int k = 0; k < 3; ++k) {
                share[c][q][k] = spanned[static_cast<std::size_t>(c)] ? whole[k] : w.value[k];
            }
        }
    }
}

template <class T>
MassTable<T> TotalLagrangian<T>::mass_table(const double (&s)[8][3], const std::int32_t* cell, const ValueTable<T>& value) const {
    MassTable<T> mass;
    if (!is_curved(cell[0])) {
        std::copy_n(value.by_node, 27, mass.by_node);
        return mass;
    }
    double share[3][8][3];
    mass_shares(s, cell, share);
    for (int a = 0; a < 27; ++a) {
        for (int q = 0; q < 8; ++q) {
            mass.by_node[a][q] = static_cast<T>(share[0][q][a / 9] * share[1][q][(a / 3) % 3] * share[2][q][a % 3]);
        }
    }
    return mass;
}

/// Of a block as its cell's own coordinates see it, each in the length that it has in the middle of the points.
template <class T>
CellSprings<T> TotalLagrangian<T>::curved_springs(std::size_t block) const {
    const Geometry& g = geometry_;
    const std::int32_t* cell = &g.cell[3 * block];
    double s[8][3], middle[3] = {}, length[3];
    for (int q = 0; q < 8; ++q) {
        in_cell(&g.points[24 * block + 3 * static_cast<std::size_t>(q)], cell, s[q]);
        for (int c = 0; c < 3; ++c) {
            middle[c] += s[q][c] / 8.0;
        }
    }
    curved_cell(cell).lengths(middle, length);
    GradientTable<T> gradient{};
    ValueTable<T> value{};
    for (int q = 0; q < 8; ++q) {
        set_point(q, s[q], length, gradient, value);
    }
    return {value, gradient, length, g.sparse[block]};
}

#define MPHYGS_CURVED(T)                                                                                                     \
    template void TotalLagrangian<T>::place_curved_nodes();                                                                  \
    template bool TotalLagrangian<T>::is_curved(int) const;                                                                  \
    template void TotalLagrangian<T>::in_cell(const double*, const std::int32_t*, double (&)[3]) const;                      \
    template void TotalLagrangian<T>::weights_at(const double (&)[3], const std::int32_t*, double (&)[27], double (&)[27][3]) const; \
    template void TotalLagrangian<T>::set_points(const double (&)[8][3], const std::int32_t*, GradientTable<T>&, ValueTable<T>&) const; \
    template void TotalLagrangian<T>::mass_shares(const double (&)[8][3], const std::int32_t*, double (&)[3][8][3]) const;   \
    template MassTable<T> TotalLagrangian<T>::mass_table(const double (&)[8][3], const std::int32_t*, const ValueTable<T>&) const; \
    template CurvedCell TotalLagrangian<T>::curved_cell(const std::int32_t*) const;                                          \
    template CellSprings<T> TotalLagrangian<T>::curved_springs(std::size_t) const;

MPHYGS_CURVED(float)
MPHYGS_CURVED(double)
#undef MPHYGS_CURVED

}  // namespace mphygs
