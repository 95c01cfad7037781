// The map of one cell of a curved grid.
#include <Eigen/Dense>
#include <cmath>
#include <stdexcept>

#include "mphygs/total_lagrangian/curved_grid.hpp"
#include "mphygs/total_lagrangian/spline_tables.hpp"

namespace mphygs {

namespace {

void map_at(const CurvedCell& cell, const double s[3], Eigen::Vector3d& place, Eigen::Matrix3d& jacobian) {
    const double unit[3] = {1.0, 1.0, 1.0};
    double value[27], gradient[27][3];
    point_weights(s, unit, value, gradient);
    place.setZero();
    jacobian.setZero();
    for (int a = 0; a < 27; ++a) {
        const Eigen::Map<const Eigen::Vector3d> node(cell.node[a]);
        place += value[a] * node;
        jacobian += node * Eigen::RowVector3d(gradient[a][0], gradient[a][1], gradient[a][2]);
    }
}

}  // namespace

void CurvedCell::at(const double s[3], double (&place)[3], double (&jacobian)[3][3]) const {
    Eigen::Vector3d x;
    Eigen::Matrix3d j;
    map_at(*this, s, x, j);
    Eigen::Map<Eigen::Vector3d>{place} = x;
    Eigen::Map<Eigen::Matrix3d>{jacobian[0]} = j;
}

void CurvedCell::find(const double place[3], double (&s)[3]) const {
    constexpr int most = 50;
    constexpr double tight = 1e-8, furthest = 4.0;  // of a step: the next is as small again
    s[0] = s[1] = s[2] = 0.0;
    Eigen::Vector3d found, step;
    Eigen::Matrix3d jacobian;
    const Eigen::Vector3d wanted(place[0], place[1], place[2]);
    for (int i = 0; i < most; ++i) {
        map_at(*this, s, found, jacobian);
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

void CurvedCell::lengths(const double s[3], double (&length)[3]) const {
    Eigen::Vector3d place;
    Eigen::Matrix3d jacobian;
    map_at(*this, s, place, jacobian);
    for (int c = 0; c < 3; ++c) {
        length[c] = jacobian.col(c).norm();
    }
}

void CurvedCell::turn(const double s[3], double (&gradient)[27][3]) const {
    Eigen::Vector3d place;
    Eigen::Matrix3d jacobian;
    map_at(*this, s, place, jacobian);
    const Eigen::Matrix3d back = jacobian.inverse().transpose();
    for (auto& row : gradient) {
        const Eigen::Vector3d turned = back * Eigen::Vector3d(row[0], row[1], row[2]);
        for (int c = 0; c < 3; ++c) {
            row[c] = turned[c];
        }
    }
}

}  // namespace mphygs
