// Curved grids: places are found, rigid motions cost nothing, uniform strains are seen as they are.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {
namespace {

constexpr int cells[3] = {4, 3, 1};
constexpr double thickness = 3e-4;

Eigen::Vector3d bent(double i, double j, double k) {
    const double angle = 0.15 * i, radius = 0.03 - thickness * (k - 1.0);
    return {radius * std::sin(angle), 0.004 * j, 0.03 - radius * std::cos(angle)};
}

/// A sheet bent over a cylinder, one cell through its thickness, two blocks of points in turn.
Geometry sheet() {
    Geometry g;
    g.spacing = {1.0, 1.0, 1.0};
    Eigen::Vector3d unused;
    for (int i = 0; i < cells[0] + 2; ++i) {
        for (int j = 0; j < cells[1] + 2; ++j) {
            for (int k = 0; k < cells[2] + 2; ++k) {
                const Eigen::Vector3d x = bent(i, j, k);
                g.curved_node.insert(g.curved_node.end(), {i, j, k});
                g.curved_position.insert(g.curved_position.end(), x.data(), x.data() + 3);
            }
        }
    }
    const double gauss = 0.5 / std::sqrt(3.0);
    for (int i = 1; i <= cells[0]; ++i) {
        for (int j = 1; j <= cells[1]; ++j) {
            CurvedCell cell;
            for (int a = 0; a < 27; ++a) {
                Eigen::Map<Eigen::Vector3d>{cell.node[a]} = bent(i + a / 9 - 1, j + (a / 3) % 3 - 1, a % 3);
            }
            g.cell.insert(g.cell.end(), {i, j, 1});
            g.part.push_back(0);
            for (int q = 0; q < 8; ++q) {
                const double s[3] = {q & 4 ? gauss : -gauss, q & 2 ? gauss : -gauss, q & 1 ? gauss : -gauss};
                double x[3], jacobian[3][3];
                cell.at(s, x, jacobian);
                g.points.insert(g.points.end(), x, x + 3);
            }
        }
    }
    return g;
}

Fields<double> material(const TotalLagrangian<double>& model) {
    const std::size_t points = 8 * model.geometry().block_count();
    Fields<double> f;
    f.mu.assign(points, 2e6);
    f.lambda.assign(points, 3e6);
    f.stress_volume.assign(points, 0.0045 * 0.004 * thickness / 8);
    f.mass.assign(points, 1000 * f.stress_volume[0]);
    f.effect.assign(static_cast<std::size_t>(Registry::parameter_count), 0.0);
    f.gravity.assign(3, 0.0);
    return f;
}

TEST(CurvedGrid, FindsThePlacesOfItsPoints) {
    const Geometry g = sheet();
    const TotalLagrangian<double> model(g, {});
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        const std::vector<double> points(&g.points[24 * b], &g.points[24 * b] + 24);
        std::vector<std::int32_t> cell;
        for (int q = 0; q < 8; ++q) {
            cell.insert(cell.end(), &g.cell[3 * b], &g.cell[3 * b] + 3);
        }
        const PointWeights w = model.weights(points, cell);
        for (std::size_t q = 0; q < 8; ++q) {
            for (std::size_t c = 0; c < 3; ++c) {
                double place = 0, slope[3] = {};
                for (std::size_t a = 27 * q; a < 27 * (q + 1); ++a) {
                    const double p = model.node_positions()[3 * static_cast<std::size_t>(w.node[a]) + c];
                    place += w.value[a] * p;
                    for (std::size_t j = 0; j < 3; ++j) {
                        slope[j] += w.gradient[3 * a + j] * p;
                    }
                }
                EXPECT_NEAR(place, points[3 * q + c], 1e-15);
                for (std::size_t j = 0; j < 3; ++j) {
                    EXPECT_NEAR(slope[j], c == j ? 1.0 : 0.0, 1e-9);
                }
            }
        }
    }
}

TEST(CurvedGrid, ATurnCostsNothingAndAStretchWhatItIs) {
    const TotalLagrangian<double> model(sheet(), {});
    Fields<double> f = material(model);
    Schedule one{{1}, {1e-9}, 0.0};
    const std::vector<double> mass = model.node_mass(f);
    const auto push = [&](const Eigen::Matrix3d& to) {
        f.displacement0.clear();
        for (std::size_t n = 0; n < model.node_count(); ++n) {
            const Eigen::Map<const Eigen::Vector3d> x(&model.node_positions()[3 * n]);
            const Eigen::Vector3d u = to * x - x;
            f.displacement0.insert(f.displacement0.end(), u.data(), u.data() + 3);
        }
        f.velocity0.assign(f.displacement0.size(), 0.0);
        const auto run = model.simulate(f, one);
        double largest = 0, power = 0;
        for (std::size_t i = 0; i < f.displacement0.size(); ++i) {
            const double force = run.velocity[f.displacement0.size() + i] / 1e-9 * mass[i / 3];
            largest = std::max(largest, std::abs(force));
            power += force * (model.node_positions()[i] + f.displacement0[i]);
        }
        return std::array<double, 2>{largest, power};
    };
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(2.0, Eigen::Vector3d(1, -2, 3).normalized()).toRotationMatrix();
    Eigen::Matrix3d stretch = Eigen::Matrix3d::Identity();
    stretch(0, 0) = 1.01;
    const auto still = push(turn), pulled = push(turn * stretch);
    EXPECT_LT(still[0], 1e-7 * pulled[0]);
    // The virial of a uniform stress: -V tr(P F^T), and of this stretch, neo-Hookean, alike at every point.
    const double j = 1.01, along = 2e6 * (j * j - 1) + 3e6 * std::log(j), across = 3e6 * std::log(j);
    const double volume = f.stress_volume[0] * static_cast<double>(f.mu.size());
    EXPECT_NEAR(pulled[1], -volume * (along + 2 * across), 1e-6 * std::abs(pulled[1]));
}

TEST(CurvedGrid, MassHasTheMomentsOfTheMaterialAcross) {
    const TotalLagrangian<double> model(sheet(), {});
    const Fields<double> f = material(model);
    const std::vector<double> mass = model.node_mass(f);
    double whole = 0, outside = 0;
    for (std::size_t n = 0; n < mass.size(); ++n) {
        EXPECT_GT(mass[n], 0.0);
        whole += mass[n];
        outside += model.node_index()[3 * n + 2] != 1 ? mass[n] : 0.0;
    }
    EXPECT_NEAR(whole, f.mass[0] * static_cast<double>(f.mass.size()), 1e-12 * whole);
    EXPECT_NEAR(outside, whole / 12, 1e-9 * whole);  // at one thickness from the middle: t^2 / 12 of a sheet
}

TEST(CurvedGrid, ANodeWithoutAPlaceOrAPointFarOffIsSaid) {
    Geometry g = sheet();
    g.curved_node.resize(g.curved_node.size() - 3);
    g.curved_position.resize(g.curved_position.size() - 3);
    EXPECT_THROW(TotalLagrangian<double>(g, {}), std::invalid_argument);
    const TotalLagrangian<double> model(sheet(), {});
    EXPECT_THROW(model.weights({1.0, 1.0, 1.0}, {1, 1, 1}), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
