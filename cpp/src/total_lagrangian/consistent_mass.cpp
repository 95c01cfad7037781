// The mass that nodes of thin parts share: set-up, and the matrix of given masses.
#include "mphygs/total_lagrangian/consistent_mass.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

/// After all tables and places are known.
template <class T>
void TotalLagrangian<T>::share_mass() {
    const Geometry& g = geometry_;
    for (std::size_t b = 0; b < rows_.size(); ++b) {
        const std::size_t block = static_cast<std::size_t>(order_[b]);
        const std::int32_t* cell = &g.cell[3 * block];
        if (!is_curved(cell[0])) {
            continue;
        }
        const std::array<bool, 3>& spanned = spanned_[static_cast<std::size_t>(g.grid_of(cell[0]))];
        double s[8][3], share[3][8][3];
        for (int q = 0; q < 8; ++q) {
            in_cell(&g.points[24 * block + 3 * static_cast<std::size_t>(q)], cell, s[q]);
        }
        mass_shares(s, cell, share);
        SharedPoints<T> points{8 * block, 8, 0, T(0.25), {}};
        std::array<std::size_t, 3> along{};
        for (std::size_t c = 0; c < 3; ++c) {
            if (!spanned[c]) {
                along[static_cast<std::size_t>(points.axes++)] = c;
            }
        }
        for (std::size_t a = 0; a < 27; ++a) {
            const std::size_t at[3] = {a / 9, (a / 3) % 3, a % 3};
            double across = 1.0;
            int line = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                if (spanned[c]) {
                    across *= share[c][0][at[c]];
                    line = 3 * line + static_cast<int>(at[c]);
                }
            }
            points.node[a] = rows_[b][a / 3] + static_cast<int>(a % 3);
            points.line[a] = static_cast<std::int8_t>(line);
            points.across[a] = static_cast<T>(across);
            for (std::size_t q = 0; q < 8; ++q) {
                for (std::size_t k = 0; k < static_cast<std::size_t>(points.axes); ++k) {
                    double weight = 1.0;
                    for (std::size_t i = 0; i < static_cast<std::size_t>(points.axes); ++i) {
                        const std::size_t c = along[i];
                        const SplineWeights<double> w = spline_weights(s[q][c]);
                        weight *= i == k ? w.slope[at[c]] : w.value[at[c]];
                    }
                    points.weight[q][k][a] = static_cast<T>(weight);
                }
            }
        }
        shared_points_.push_back(points);
    }
    leave_mass();
    for (std::size_t p = 0; p < places_.size(); ++p) {
        if (is_curved(g.place_cell[3 * p])) {
            SharedPoints<T> place{p, 1, 1, T(-1), places_[p].node};
            place.across.fill(T(1));
            place.own = place.weight[0][0] = places_[p].value;
            shared_places_.push_back(place);
        }
    }
}

/// Each node's mass is divided among its cells in proportion to what they take of it by itself. Where no cell takes more than a
/// share of what it is given, whatever way its nodes move, all together take no more than this share.
template <class T>
void TotalLagrangian<T>::leave_mass() {
    constexpr double most = 0.9;
    const Geometry& g = geometry_;
    std::vector<double> mass(node_count()), taken(node_count());
    std::vector<Eigen::Matrix<double, 27, 27>> matrices;
    for (std::size_t b = 0, at = 0; b < rows_.size(); ++b) {
        const std::size_t block = static_cast<std::size_t>(order_[b]);
        if (!is_curved(g.cell[3 * block])) {
            continue;
        }
        const SharedPoints<T>& points = shared_points_[at++];
        std::array<T, 8> volume;
        for (std::size_t q = 0; q < 8; ++q) {
            volume[q] = g.volume.empty() ? T(1) : static_cast<T>(g.volume[8 * block + q]);
        }
        Eigen::Matrix<double, 27, 27>& matrix = matrices.emplace_back(Eigen::Matrix<double, 27, 27>::Zero());
        points.each(volume.data(), [&](int i, int j, T d) { matrix(i, j) = static_cast<double>(d); });
        for (std::size_t a = 0; a < 27; ++a) {
            const std::size_t n = static_cast<std::size_t>(points.node[a]);
            taken[n] += matrix(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(a));
            for (std::size_t q = 0; q < 8; ++q) {
                mass[n] += static_cast<double>(volume[q] * masses_[static_cast<std::size_t>(table_[b])].by_node[a][static_cast<int>(q)]);
            }
        }
    }
    for (std::size_t k = 0; k < shared_points_.size(); ++k) {
        SharedPoints<T>& points = shared_points_[k];
        Eigen::Matrix<double, 27, 27>& matrix = matrices[k];
        Eigen::Array<double, 27, 1> scale;
        for (Eigen::Index a = 0; a < 27; ++a) {
            const std::size_t n = static_cast<std::size_t>(points.node[static_cast<std::size_t>(a)]);
            const double given = taken[n] > 0.0 ? mass[n] * matrix(a, a) / taken[n] : 0.0;
            scale[a] = given > 0.0 ? 1.0 / std::sqrt(given) : 0.0;
        }
        matrix = scale.matrix().asDiagonal() * matrix * scale.matrix().asDiagonal();
        const double largest = Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 27, 27>>(matrix, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
        if (largest > most) {
            points.scale *= static_cast<T>(most / largest);
        }
    }
}

template <class T>
SharedMass<T> TotalLagrangian<T>::shared_mass(const Fields<T>& fields) const {
    const Eigen::Index count = static_cast<Eigen::Index>(node_count());
    SharedMass<T> matrix(count, count);
    std::vector<Eigen::Triplet<T>> entries;
    const auto add = [&](const std::vector<SharedPoints<T>>& all, const std::vector<T>& mass) {
        for (const SharedPoints<T>& points : all) {
            if (!mass.empty()) {
                points.each(&mass[points.first], [&](int a, int b, T d) {
                    entries.emplace_back(points.node[static_cast<std::size_t>(a)], points.node[static_cast<std::size_t>(b)], d);
                });
            }
        }
    };
    add(shared_points_, fields.mass);
    if (sites_.mass) {
        add(shared_places_, fields.place_mass);
    }
    matrix.setFromTriplets(entries.begin(), entries.end());
    return matrix;
}

template void TotalLagrangian<float>::leave_mass();
template void TotalLagrangian<double>::leave_mass();
template void TotalLagrangian<float>::share_mass();
template void TotalLagrangian<double>::share_mass();
template SharedMass<float> TotalLagrangian<float>::shared_mass(const Fields<float>&) const;
template SharedMass<double> TotalLagrangian<double>::shared_mass(const Fields<double>&) const;

}  // namespace mphygs
