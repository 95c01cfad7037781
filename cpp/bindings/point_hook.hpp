// A Python object with `forward` and `reverse` as the core's PointHook.
#pragma once

#include <stdexcept>

#include "arrays.hpp"
#include "mphygs/physics/point_hook.hpp"

namespace mphygs_python {

template <class T>
py::array_t<T> lanes_array(const std::vector<T>& v, int lanes, bool matrices) {
    const auto n = static_cast<py::ssize_t>(lanes);
    const auto points = static_cast<py::ssize_t>(v.size()) / (n * (matrices ? 9 : 3));
    py::array_t<T> a(matrices ? std::vector<py::ssize_t>{n, points, 3, 3} : std::vector<py::ssize_t>{n, points, 3});
    std::copy(v.begin(), v.end(), a.mutable_data());
    return a;
}

template <class T>
std::vector<T> optional_vector(const py::handle& item, std::size_t wanted, const char* what) {
    if (item.is_none()) {
        return {};
    }
    const auto a = item.cast<Array<T>>();
    if (static_cast<std::size_t>(a.size()) != wanted) {
        throw std::invalid_argument(std::string("the hook's ") + what + " has " + std::to_string(a.size()) + " numbers, expected " +
                                    std::to_string(wanted));
    }
    return to_vector<T>(a);
}

/// object.forward(first_direction, time, position, velocity, deformation) -> (force or None, stress or None);
/// object.reverse(time, position, velocity, deformation, force_bar or None, stress_bar or None)
///   -> (position_bar, velocity_bar, deformation_bar). The object must outlive the hook.
template <class T>
mphygs::PointHook<T> to_hook(const py::object& object) {
    mphygs::PointHook<T> hook;
    if (object.is_none()) {
        return hook;
    }
    hook.forward = [&object](const mphygs::PointState<T>& s) {
        py::gil_scoped_acquire acquire;
        const py::tuple out = object.attr("forward")(s.first_direction, s.time, lanes_array(s.position, s.lanes, false),
                                                     lanes_array(s.velocity, s.lanes, false), lanes_array(s.deformation, s.lanes, true));
        mphygs::PointForces<T> f;
        f.force = optional_vector<T>(out[0], s.position.size(), "force");
        f.stress = optional_vector<T>(out[1], s.deformation.size(), "stress");
        return f;
    };
    hook.reverse = [&object](const mphygs::PointState<T>& s, const mphygs::PointForces<T>& bar) {
        py::gil_scoped_acquire acquire;
        const auto or_none = [&](const std::vector<T>& v, bool matrices) {
            return v.empty() ? py::object(py::none()) : py::object(lanes_array(v, 1, matrices));
        };
        const py::tuple out = object.attr("reverse")(s.time, lanes_array(s.position, 1, false), lanes_array(s.velocity, 1, false),
                                                     lanes_array(s.deformation, 1, true), or_none(bar.force, false),
                                                     or_none(bar.stress, true));
        mphygs::PointState<T> r;
        r.position = to_vector<T>(out[0].cast<Array<T>>());
        r.velocity = to_vector<T>(out[1].cast<Array<T>>());
        r.deformation = to_vector<T>(out[2].cast<Array<T>>());
        return r;
    };
    return hook;
}

}  // namespace mphygs_python
