// A small bar of two parts on the grid, held at one end: the object of the integrator's tests.
#pragma once

#include <cmath>
#include <memory>

#include "effect_values.hpp"
#include "mphygs/total_lagrangian/model.hpp"
#include "random_numbers.hpp"

namespace mphygs::test {

struct BarOptions {
    int cells[3] = {2, 2, 5};
    bool held = true;
    bool held_along_top = false;  // else at the bottom
    bool two_grids = false;        // one for each part, tied where they meet
    bool springs = false;          // on what the points of each second cell do not see
    double young[2] = {1e6, 4e5};  // of the lower and the upper part [Pa]
    double density = 1000;         // [kg/m^3]
};

/// As few cells as have neighbours along two axes and a layer of every kind: what implicit steps cost goes with the square.
inline const BarOptions smaller{.cells = {1, 2, 4}};
/// One cell across: for what is asked of the steps in time alone.
inline const BarOptions slender{.cells = {1, 1, 5}};

inline constexpr double bar_spacing[3] = {0.010, 0.012, 0.011};
inline constexpr double poisson = 0.3;

/// Rows that impose the held plane: one for every column of nodes, at its Greville point.
inline void hold_plane(Geometry& g, const BarOptions& o, int cell, double s) {
    const SplineWeights<double> w = spline_weights(s);
    const int hold = g.hold_count++;
    if (g.row_begin.empty()) {
        g.row_begin.push_back(0);
    }
    for (int i = -1; i <= o.cells[0]; ++i) {
        for (int j = -1; j <= o.cells[1]; ++j) {
            for (int k = 0; k < 3; ++k) {
                if (w.value[k] != 0) {
                    g.row_node.insert(g.row_node.end(), {i, j, cell + k - 1});
                    g.row_weight.push_back(w.value[k]);
                }
            }
            g.row_begin.push_back(static_cast<std::int32_t>(g.row_weight.size()));
            g.row_target.insert(g.row_target.end(), {g.origin[0] + i * g.spacing[0], g.origin[1] + j * g.spacing[1],
                                                     g.origin[2] + (cell + s) * g.spacing[2]});
            g.row_hold.push_back(hold);
        }
    }
}

/// Gives each part a grid of its own and ties them over the face between them: force, torque and saddle.
inline void part_grids(Geometry& g, const BarOptions& o) {
    g.grid_width = o.cells[0] + 6;
    const int below = (o.cells[2] + 1) / 2 - 1;  // the uppermost layer of the lower part
    const auto numbered = [&](int i, bool upper) { return i + 1 + (upper ? g.grid_width : 0); };
    g.origin[0] -= g.spacing[0];
    const auto renumber = [&](std::vector<std::int32_t>& cells) {
        for (std::size_t k = 0; k < cells.size(); k += 3) {
            cells[k] = numbered(cells[k], cells[k + 2] > below);
        }
    };
    renumber(g.cell);
    renumber(g.surface_cell);
    renumber(g.place_cell);
    const bool from_top = o.held_along_top;
    for (std::size_t k = 0; k < g.row_node.size(); k += 3) {
        g.row_node[k] = numbered(g.row_node[k], from_top);
    }
    if (g.row_begin.empty()) {
        g.row_begin.push_back(0);
    }
    for (int pattern = 0; pattern < 4; ++pattern) {
        for (int side = 0; side < 2; ++side) {
            const SplineWeights<double> across = spline_weights(side == 0 ? 0.5 : -0.5);
            for (int i = -1; i <= o.cells[0]; ++i) {
                for (int j = -1; j <= o.cells[1]; ++j) {
                    double sum = 0;  // over two Gauss points a cell and axis
                    for (int p = 0; p < 4 * o.cells[0] * o.cells[1]; ++p) {
                        const double gauss = 0.5 / std::sqrt(3.0);
                        const int ci = p / 4 / o.cells[1], cj = p / 4 % o.cells[1];
                        const double si = p & 2 ? gauss : -gauss, sj = p & 1 ? gauss : -gauss;
                        if (std::abs(i - ci) > 1 || std::abs(j - cj) > 1) {
                            continue;
                        }
                        const double x = ci + si - 0.5 * (o.cells[0] - 1), y = cj + sj - 0.5 * (o.cells[1] - 1);
                        const double shape[4] = {1.0, x, y, x * y};
                        sum += shape[pattern] * spline_weights(si).value[i - ci + 1] * spline_weights(sj).value[j - cj + 1];
                    }
                    for (int k = 0; k < 3; ++k) {
                        if (across.value[k] != 0) {
                            g.row_node.insert(g.row_node.end(), {numbered(i, side == 1), j, below + side + k - 1});
                            g.row_weight.push_back((side == 0 ? 1.0 : -1.0) * sum * across.value[k] / (4 * o.cells[0] * o.cells[1]));
                        }
                    }
                }
            }
        }
        g.row_begin.push_back(static_cast<std::int32_t>(g.row_weight.size()));
        g.row_target.insert(g.row_target.end(), {0.0, 0.0, 0.0});
        g.row_hold.push_back(-1);
    }
}

/// Cells (0, 0, 0) ... of the grid, filled; in the uppermost layer the points fill the lower half.
inline Geometry bar_geometry(const BarOptions& o) {
    Geometry g;
    g.origin = {0.1, -0.2, 0.05};
    g.spacing = {bar_spacing[0], bar_spacing[1], bar_spacing[2]};
    g.part_count = 2;
    const double gauss = 0.5 / std::sqrt(3.0);
    for (int k = o.cells[2] - 1; k >= 0; --k) {  // not in the order of the cells: the model sorts
        for (int i = 0; i < o.cells[0]; ++i) {
            for (int j = 0; j < o.cells[1]; ++j) {
                const bool half = k == o.cells[2] - 1;
                g.cell.insert(g.cell.end(), {i, j, k});
                g.part.push_back(2 * k >= o.cells[2] ? 1 : 0);
                for (int q = 0; q < 8; ++q) {
                    const double sz = (q & 1 ? gauss : -gauss);
                    const double s[3] = {i + (q & 4 ? gauss : -gauss), j + (q & 2 ? gauss : -gauss), k + (half ? 0.5 * sz - 0.25 : sz)};
                    for (std::size_t c = 0; c < 3; ++c) {
                        g.points.push_back(g.origin[c] + s[c] * g.spacing[c]);
                    }
                }
                if (half) {  // the exposed end: four samples in every cell, the rest pads
                    g.surface_cell.insert(g.surface_cell.end(), {i, j, k});
                    for (int q = 0; q < 8; ++q) {
                        const double x[3] = {i + (q & 2 ? 0.25 : -0.25), j + (q & 1 ? 0.25 : -0.25), static_cast<double>(k)};
                        for (std::size_t c = 0; c < 3; ++c) {
                            g.surface_points.push_back(g.origin[c] + x[c] * g.spacing[c]);
                        }
                        g.surface_area.push_back(q < 4 ? g.spacing[0] * g.spacing[1] / 4 : 0.0);
                    }
                }
            }
        }
    }
    g.place_cell = {0, 0, 2, o.cells[0] - 1, o.cells[1] - 1, 3};
    for (std::size_t c = 0; c < 3; ++c) {
        g.places.push_back(g.origin[c] + (g.place_cell[c] + 0.2) * g.spacing[c]);
    }
    for (std::size_t c = 0; c < 3; ++c) {
        g.places.push_back(g.origin[c] + (g.place_cell[3 + c] - 0.3) * g.spacing[c]);
    }
    if (o.held) {
        if (o.held_along_top) {
            hold_plane(g, o, o.cells[2] - 1, 0.0);  // the end of the half-filled layer
        } else {
            hold_plane(g, o, 0, -0.5);
        }
    }
    if (o.two_grids) {
        part_grids(g, o);
    }
    for (std::size_t b = 0; o.springs && b < g.block_count(); ++b) {
        g.sparse.push_back(b % 2 == 0 ? 0.4 : 0.0);
    }
    return g;
}

/// Volume of every point, (B, 8) [m^3].
inline std::vector<double> bar_volumes(const BarOptions& o, const Geometry& g) {
    std::vector<double> volume;
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        const double share = g.cell[3 * b + 2] == o.cells[2] - 1 ? 0.5 : 1.0;
        volume.insert(volume.end(), 8, share * g.spacing[0] * g.spacing[1] * g.spacing[2] / 8);
    }
    return volume;
}

struct Bar {
    std::shared_ptr<TotalLagrangian<double>> model;
    Fields<double> fields;  // at rest, no gravity
    Schedule schedule;
    std::vector<double> volume;  // (B, 8) [m^3]
};

/// Fields of a bar at rest, for any number type.
template <class T>
Fields<T> fields_at_rest(const BarOptions& o, const Geometry& g, const Schedule& schedule) {
    Fields<T> f;
    const std::vector<double> volume = bar_volumes(o, g);
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        const double young = o.young[g.part[b]];
        f.mu.insert(f.mu.end(), 8, static_cast<T>(young / (2 * (1 + poisson))));
        f.lambda.insert(f.lambda.end(), 8, static_cast<T>(young * poisson / ((1 + poisson) * (1 - 2 * poisson))));
    }
    for (const double v : volume) {
        f.stress_volume.push_back(static_cast<T>(v));
        f.mass.push_back(static_cast<T>(o.density * v));
    }
    Registry::each([&](auto tag, int) {
        using E = typename decltype(tag)::type;
        for (int k = 0; k < E::info.parameter_count(); ++k) {
            f.effect.push_back(static_cast<T>(E::info.parameters[k].null));
        }
    });
    f.gravity.assign(3, T{});
    const T still[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
    for (int n = 0; n < g.hold_count * (schedule.total_steps() + 1); ++n) {
        f.pose.insert(f.pose.end(), still, still + 12);
    }
    return f;
}

inline Bar make_bar(const BarOptions& options, const Schedule& schedule, Settings settings = {}) {
    Bar bar;
    Geometry g = bar_geometry(options);
    bar.volume = bar_volumes(options, g);
    bar.schedule = schedule;
    bar.fields = fields_at_rest<double>(options, g, schedule);
    bar.model = std::make_shared<TotalLagrangian<double>>(std::move(g), std::move(settings));
    return bar;
}

inline std::vector<bool> only_active(const std::vector<int>& effects) {
    std::vector<bool> active(static_cast<std::size_t>(Registry::count), false);
    for (const int i : effects) {
        active[static_cast<std::size_t>(i)] = true;
    }
    return active;
}

/// Gives the bar everything that it may be differentiated against: strain, motion, loads, a moving
/// hold, prestress, and the trial values of the active effects.
inline void stir(Bar& bar, unsigned seed) {
    Random random(seed);
    const Geometry& g = bar.model->geometry();
    const std::size_t nodes = bar.model->node_count(), points = 8 * g.block_count();
    Fields<double>& f = bar.fields;
    f.gravity = {0.5, -1.0, -9.0};
    f.displacement0 = random.numbers(3 * nodes, -3e-4, 3e-4);
    f.velocity0 = random.numbers(3 * nodes, -0.5, 0.5);
    f.node_force = random.numbers(3 * nodes * bar.schedule.steps.size(), -1e-3, 1e-3);
    f.deformation0.assign(9 * points, 0.0);
    for (std::size_t b = 0; b < g.block_count(); ++b) {
        for (std::size_t i = 0; i < 72; ++i) {
            f.deformation0[72 * b + i] = (i / 8 % 4 == 0 ? 1.0 : 0.0) + random.between(-0.02, 0.02);
        }
    }
    for (std::size_t i = 0; i < f.pose.size(); ++i) {
        f.pose[i] += random.between(-1e-5, 1e-5);
    }
    std::size_t k = 0;
    int point_parameters = 0;
    std::vector<double> at_place;
    Registry::each([&](auto tag, int i) {
        using E = typename decltype(tag)::type;
        const bool active = bar.model->settings().active.size() > static_cast<std::size_t>(i) &&
                            bar.model->settings().active[static_cast<std::size_t>(i)];
        for (int p = 0; p < E::info.parameter_count(); ++p, ++k) {
            f.effect[k] = active ? trial_value(E::info, p) : E::info.parameters[p].null;
            if (E::info.site == Site::point) {
                at_place.push_back(f.effect[k]);
                ++point_parameters;
            }
        }
        if (E::info.site == Site::mass && active) {
            f.place_mass.assign(g.place_count(), 0.002);
        }
    });
    for (std::size_t p = 0; p < g.place_count(); ++p) {
        f.place_effect.insert(f.place_effect.end(), at_place.begin(), at_place.end());
    }
}

}  // namespace mphygs::test
