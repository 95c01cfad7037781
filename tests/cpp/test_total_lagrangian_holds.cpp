// Holds in a rollout: followed exactly, or giving way by their compliance.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>
#include <string>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using test::Bar;

TEST(Hold, TheHoldIsFollowedExactly) {
    const int steps = 30;
    Bar bar = test::make_bar({}, {{10, 20}, {1e-4, 5e-5}});
    bar.fields.gravity = {0, 0, -9.81};
    for (int n = 0; n <= steps; ++n) {  // turning about z while rising
        const Mat3<double> r = test::rotation_about(0, 0, 1, 0.01 * n / steps);
        double* pose = &bar.fields.pose[static_cast<std::size_t>(12 * n)];
        for (int i = 0; i < 9; ++i) {
            pose[i] = r[i / 3][i % 3];
        }
        pose[11] = 1e-3 * n / steps;
    }
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count();
    std::map<std::array<int, 3>, std::size_t> node;
    for (std::size_t n = 0; n < nodes; ++n) {
        std::array<int, 3> index{};
        for (std::size_t c = 0; c < 3; ++c) {
            index[c] = static_cast<int>(std::lround((bar.model->node_positions()[3 * n + c] - g.origin[c]) / g.spacing[c]));
        }
        node[index] = n;
    }
    const double* pose = &bar.fields.pose[12 * steps];
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (std::size_t c = 0; c < 3; ++c) {
            double u = 0, target = pose[9 + c] - g.row_target[3 * r + c];
            for (std::size_t k = 0; k < 3; ++k) {
                target += pose[3 * c + k] * g.row_target[3 * r + k];
            }
            for (std::size_t w = static_cast<std::size_t>(g.row_begin[r]); w < static_cast<std::size_t>(g.row_begin[r + 1]); ++w) {
                u += g.row_weight[w] * t.displacement[(2 * nodes + node.at({g.row_node[3 * w], g.row_node[3 * w + 1], g.row_node[3 * w + 2]})) * 3 + c];
            }
            EXPECT_NEAR(u, target, 1e-15);
        }
    }
}

TEST(Hold, ACompliantHoldSinksByItsComplianceTimesTheWeight) {
    Settings settings;
    int index = 0;
    std::vector<int> active;
    Registry::each([&](auto tag, int i) {
        const std::string name = decltype(tag)::type::info.name;
        if (name == "hold_compliance" || name == "mass_damping") {
            active.push_back(i);
        }
        index = i;
    });
    settings.active = test::only_active(active);
    Bar bar = test::make_bar(test::slender, {{4000}, {1e-4}}, settings);
    const Slots slots = make_slots(settings.active);
    const double compliance = 1e-3;
    Registry::each([&](auto tag, int i) {
        const std::string name = decltype(tag)::type::info.name;
        const std::size_t k = static_cast<std::size_t>(slots[static_cast<std::size_t>(i)].parameter);
        if (name == "hold_compliance") {
            bar.fields.effect[k] = compliance;
        } else if (name == "mass_damping") {
            bar.fields.effect[k] = 60;  // settles within the 0.4 s of the run
        }
    });
    bar.fields.gravity = {0, 0, -9.81};
    const Trajectory<double> t = bar.model->simulate(bar.fields, bar.schedule);
    double weight = 0;
    for (const double m : bar.fields.mass) {
        weight += 9.81 * m;
    }
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count();
    double u = 0;  // of the first row
    for (std::size_t n = 0; n < nodes; ++n) {
        for (std::size_t w = 0; w < static_cast<std::size_t>(g.row_begin[1]); ++w) {
            double distance = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                distance += std::abs(bar.model->node_positions()[3 * n + c] - g.origin[c] - g.row_node[3 * w + c] * g.spacing[c]);
            }
            u += distance < 1e-9 ? g.row_weight[w] * t.displacement[(nodes + n) * 3 + 2] : 0.0;
        }
    }
    EXPECT_NEAR(u, -compliance * weight, 1e-3 * compliance * weight);
}

}  // namespace
}  // namespace mphygs
