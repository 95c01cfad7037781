// Grids whose nodes stand elsewhere than on a lattice: thin parts have one curved cell through their thickness.
//
// A point's place is the spline of its cell's nodes, X(s) = sum_a N_a(s) P_a, s in spacings from the cell's node. The same
// splines carry the motion, so that a rigid one is carried exactly whatever the nodes' places are, and
//   dN_a/dX = J^-T dN_a/ds,  J = sum_a P_a (dN_a/ds)^T.
// Isoparametric: Hughes, Cottrell, Bazilevs, "Isogeometric analysis", 2005.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <stdexcept>

#include "mphygs/total_lagrangian/spline_tables.hpp"

namespace mphygs {

/// One cell's map from s to space.
struct CurvedCell {
    Eigen::Matrix<double, 3, 27> node;  // P_a [m]

    /// X and J at s.
    void at(const double s[3], Eigen::Vector3d& place, Eigen::Matrix3d& jacobian) const {
        const double unit[3] = {1.0, 1.0, 1.0};
        double value[27], gradient[27][3];
        point_weights(s, unit, value, gradient);
        place.setZero();
        jacobian.setZero();
        for (int a = 0; a < 27; ++a) {
            place += value[a] * node.col(a);
            jacobian += node.col(a) * Eigen::RowVector3d(gradient[a][0], gradient[a][1], gradient[a][2]);
        }
    }

    /// Where in the cell, or beyond it by its own polynomial, a place is. Newton's method, from the middle.
    /// Throws std::invalid_argument where it does not arrive, or the map turns inside out on the way.
    void find(const double place[3], double (&s)[3]) const {
        constexpr int most = 50;
        constexpr double tight = 1e-8, furthest = 4.0;  // of a step: the next is as small again
        s[0] = s[1] = s[2] = 0.0;
        Eigen::Vector3d found, step;
        Eigen::Matrix3d jacobian;
        const Eigen::Vector3d wanted(place[0], place[1], place[2]);
        for (int i = 0; i < most; ++i) {
            at(s, found, jacobian);
            step = jacobian.partialPivLu().solve(wanted - found);
            const double size = step.cwiseAbs().maxCoeff();
            if (!(jacobian.determinant() > 0.0) || !std::isfinite(size)) {
                break;
            }
            const double share = size > 0.5 ? 0.5 / size : 1.0;
            for (int c = 0; c < 3; ++c) {
                s[c] += share * step[c];
            }
            if (size < tight) {
                return;
            }
            if (std::abs(s[0]) > furthest || std::abs(s[1]) > furthest || std::abs(s[2]) > furthest) {
                break;
            }
        }
        throw std::invalid_argument("a point lies too far from the curved cell that is to carry it");
    }

    /// Lengths of the cell's three edges through s [m].
    void lengths(const double s[3], double (&length)[3]) const {
        Eigen::Vector3d place;
        Eigen::Matrix3d jacobian;
        at(s, place, jacobian);
        for (int c = 0; c < 3; ++c) {
            length[c] = jacobian.col(c).norm();
        }
    }

    /// Turns derivatives by s into such by X.
    void turn(const double s[3], double (&gradient)[27][3]) const {
        Eigen::Vector3d place;
        Eigen::Matrix3d jacobian;
        at(s, place, jacobian);
        const Eigen::Matrix3d back = jacobian.inverse().transpose();
        for (auto& row : gradient) {
            const Eigen::Vector3d turned = back * Eigen::Vector3d(row[0], row[1], row[2]);
            for (int c = 0; c < 3; ++c) {
                row[c] = turned[c];
            }
        }
    }
};

}  // namespace mphygs
