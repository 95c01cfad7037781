// Dictionaries of numpy arrays <-> Geometry, Settings, Schedule, Fields, Trajectory.
#pragma once

#include <optional>

#include "arrays.hpp"
#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs_python {

/// Every key must be known: a misspelt input is an error, not a silent default.
inline void reject_unknown(const py::dict& d, std::initializer_list<const char*> known, const char* what) {
    for (const auto& item : d) {
        const std::string key = py::str(item.first);
        bool found = false;
        for (const char* k : known) {
            found |= key == k;
        }
        if (!found) {
            throw py::key_error(std::string(what) + " has no entry '" + key + "'");
        }
    }
}

template <class T>
std::vector<T> entry(const py::dict& d, const char* key) {
    return d.contains(key) ? to_vector<T>(d[key].template cast<Array<T>>()) : std::vector<T>{};
}

/// Loads that change with time: rows, places and holds of their points, what acts at them, and how many channels.
inline mphygs::Actuation to_actuation(const py::dict& geometry) {
    mphygs::Actuation a;
    if (!geometry.contains("actuation")) {
        return a;
    }
    const auto d = geometry["actuation"].cast<py::dict>();
    reject_unknown(d,
                   {"row_begin", "row_carrier", "row_weight", "place", "hold", "force_point", "force_channel", "path_begin", "path_point",
                    "path_channel", "triangle", "triangle_middle", "triangle_channel", "channel_count"},
                   "actuation");
    a.row_begin = entry<std::int32_t>(d, "row_begin");
    a.row_carrier = entry<std::int32_t>(d, "row_carrier");
    a.row_weight = entry<double>(d, "row_weight");
    a.place = entry<double>(d, "place");
    a.hold = entry<std::int32_t>(d, "hold");
    a.force_point = entry<std::int32_t>(d, "force_point");
    a.force_channel = entry<std::int32_t>(d, "force_channel");
    a.path_begin = entry<std::int32_t>(d, "path_begin");
    a.path_point = entry<std::int32_t>(d, "path_point");
    a.path_channel = entry<std::int32_t>(d, "path_channel");
    a.triangle = entry<std::int32_t>(d, "triangle");
    a.triangle_middle = entry<std::int32_t>(d, "triangle_middle");
    a.triangle_channel = entry<std::int32_t>(d, "triangle_channel");
    a.channel_count = d["channel_count"].cast<int>();
    return a;
}

inline mphygs::Geometry to_geometry(const py::dict& d) {
    reject_unknown(d,
                   {"origin", "spacing", "grid_width", "curved_node", "curved_position", "cell", "part", "points", "volume", "sparse", "surface_cell", "surface_points", "surface_area", "place_cell",
                    "places", "row_begin", "row_node", "row_weight", "row_target", "row_hold", "hold_count", "hold_centre", "part_count",
                    "actuation"},
                   "geometry");
    mphygs::Geometry g;
    // (3,) of one grid, or (G, 3) of those that stand beside each other.
    g.grid_origin = entry<double>(d, "origin");
    g.grid_spacing = entry<double>(d, "spacing");
    for (std::size_t c = 0; c < 3; ++c) {
        g.origin[c] = g.grid_origin.at(c);
        g.spacing[c] = g.grid_spacing.at(c);
    }
    if (g.grid_origin.size() == 3) {
        g.grid_origin.clear();
    }
    if (g.grid_spacing.size() == 3) {
        g.grid_spacing.clear();
    }
    g.grid_width = d.contains("grid_width") ? d["grid_width"].cast<int>() : 0;
    g.curved_node = entry<std::int32_t>(d, "curved_node");
    g.curved_position = entry<double>(d, "curved_position");
    g.cell = entry<std::int32_t>(d, "cell");
    g.part = entry<std::int32_t>(d, "part");
    g.points = entry<double>(d, "points");
    g.volume = entry<double>(d, "volume");
    g.sparse = entry<double>(d, "sparse");
    g.surface_cell = entry<std::int32_t>(d, "surface_cell");
    g.surface_points = entry<double>(d, "surface_points");
    g.surface_area = entry<double>(d, "surface_area");
    g.place_cell = entry<std::int32_t>(d, "place_cell");
    g.places = entry<double>(d, "places");
    g.row_begin = entry<std::int32_t>(d, "row_begin");
    g.row_node = entry<std::int32_t>(d, "row_node");
    g.row_weight = entry<double>(d, "row_weight");
    g.row_target = entry<double>(d, "row_target");
    g.row_hold = entry<std::int32_t>(d, "row_hold");
    g.hold_count = d.contains("hold_count") ? d["hold_count"].cast<int>() : 0;
    g.hold_centre = entry<double>(d, "hold_centre");
    g.part_count = d.contains("part_count") ? d["part_count"].cast<int>() : 1;
    g.actuation = to_actuation(d);
    return g;
}

/// Which effects of the registry are named.
inline std::vector<bool> to_active(const py::list& names) {
    std::vector<bool> active(static_cast<std::size_t>(mphygs::Registry::count), false);
    for (const auto& item : names) {
        const auto name = item.cast<std::string>();
        bool found = false;
        for (std::size_t i = 0; i < active.size(); ++i) {
            if (name == mphygs::Registry::infos[i]->name) {
                active[i] = found = true;
            }
        }
        if (!found) {
            throw py::value_error("effect '" + name + "' is not one of this build's");
        }
    }
    return active;
}

inline mphygs::Law to_law(const std::string& name) {
    std::string known;
    for (int i = 0; i < mphygs::AllLaws::count; ++i) {
        if (name == mphygs::AllLaws::names[i]) {
            return static_cast<mphygs::Law>(i);
        }
        known += (i > 0 ? ", " : "") + std::string(mphygs::AllLaws::names[i]);
    }
    throw py::value_error("law '" + name + "': expected one of " + known);
}

inline mphygs::Settings to_settings(const py::dict& d) {
    reject_unknown(d, {"law", "active", "threads", "memory_budget", "displacement_limit"}, "settings");
    mphygs::Settings s;
    if (d.contains("law")) {
        s.law = to_law(d["law"].cast<std::string>());
    }
    s.active = to_active(d.contains("active") ? py::list(d["active"]) : py::list());
    if (d.contains("threads")) {
        s.threads = d["threads"].cast<int>();
    }
    if (d.contains("memory_budget")) {
        s.memory_budget = d["memory_budget"].cast<std::size_t>();
    }
    if (d.contains("displacement_limit")) {
        s.displacement_limit = d["displacement_limit"].cast<double>();
    }
    return s;
}

/// None, or a dictionary of an observer's rows, reach, gains and shares.
inline std::optional<mphygs::Observer> to_observer(const py::object& given) {
    if (given.is_none()) {
        return std::nullopt;
    }
    const py::dict d = given.cast<py::dict>();
    reject_unknown(d,
                   {"row_begin", "row_carrier", "row_weight", "reach_row", "reach_begin", "reach_channel", "reach_weight", "stiffness",
                    "damping", "share"},
                   "observer");
    mphygs::Observer o;
    o.row_begin = entry<std::int32_t>(d, "row_begin");
    o.row_carrier = entry<std::int32_t>(d, "row_carrier");
    o.row_weight = entry<double>(d, "row_weight");
    o.reach_row = entry<std::int32_t>(d, "reach_row");
    o.reach_begin = entry<std::int32_t>(d, "reach_begin");
    o.reach_channel = entry<std::int32_t>(d, "reach_channel");
    o.reach_weight = entry<double>(d, "reach_weight");
    o.stiffness = d["stiffness"].cast<double>();
    o.damping = d["damping"].cast<double>();
    o.share = entry<double>(d, "share");
    return o;
}

inline mphygs::Schedule to_schedule(const py::dict& d) {
    reject_unknown(d, {"steps", "dt", "start", "reaction_weight", "implicit", "paired"}, "schedule");
    mphygs::Schedule s;
    s.steps = entry<int>(d, "steps");
    s.dt = entry<double>(d, "dt");
    s.start = d.contains("start") ? d["start"].cast<double>() : 0.0;
    s.reaction_weight = entry<double>(d, "reaction_weight");
    s.implicit = d.contains("implicit") && d["implicit"].cast<bool>();
    s.paired = d.contains("paired") && d["paired"].cast<bool>();
    return s;
}

template <class T>
mphygs::Fields<T> to_fields(const py::dict& d) {
    using F = mphygs::Fields<T>;
    F fields;
    for (const auto& item : d) {
        const std::string key = py::str(item.first);
        bool found = false;
        for (int i = 0; i < F::count; ++i) {
            if (key == F::names[static_cast<std::size_t>(i)]) {
                *fields.all()[static_cast<std::size_t>(i)] = to_vector<T>(item.second.template cast<Array<T>>());
                found = true;
            }
        }
        if (!found) {
            throw py::key_error("fields have no entry '" + key + "'");
        }
    }
    return fields;
}

template <class T>
py::dict fields_dict(mphygs::Fields<T>&& fields) {
    py::dict d;
    for (int i = 0; i < mphygs::Fields<T>::count; ++i) {
        auto* v = fields.all()[static_cast<std::size_t>(i)];
        const auto n = static_cast<py::ssize_t>(v->size());
        d[mphygs::Fields<T>::names[static_cast<std::size_t>(i)]] = to_array(std::move(*v), {n});
    }
    return d;
}

/// (displacement, velocity), and the holds' reactions where they were asked for.
template <class T>
py::tuple trajectory_arrays(mphygs::Trajectory<T>&& t, std::size_t nodes) {
    const auto n = static_cast<py::ssize_t>(nodes);
    const auto frames = static_cast<py::ssize_t>(t.displacement.size()) / (3 * n);
    const auto holds = static_cast<py::ssize_t>(t.reaction.size()) / (6 * frames);
    py::object displacement = to_array(std::move(t.displacement), {frames, n, 3}), velocity = to_array(std::move(t.velocity), {frames, n, 3});
    if (holds == 0) {
        return py::make_tuple(displacement, velocity);
    }
    return py::make_tuple(displacement, velocity, to_array(std::move(t.reaction), {frames, holds, py::ssize_t(6)}));
}

/// Python callable frame -> bool, also polling for Ctrl-C; safe to call without the GIL.
inline mphygs::Progress to_progress(const py::object& f) {
    return [&f](int frame) {
        py::gil_scoped_acquire acquire;
        if (PyErr_CheckSignals() != 0) {
            throw py::error_already_set();
        }
        return f.is_none() || f(frame).cast<bool>();
    };
}

/// (gradient, substeps computed again) of run(progress, recomputed), which makes the gradient without the interpreter's lock.
template <class Run>
py::tuple gradient_tuple(const py::object& progress, Run&& run) {
    const mphygs::Progress p = to_progress(progress);
    long recomputed = 0;
    auto g = [&] {
        py::gil_scoped_release release;
        return run(p, &recomputed);
    }();
    return py::make_tuple(fields_dict(std::move(g)), recomputed);
}

}  // namespace mphygs_python
