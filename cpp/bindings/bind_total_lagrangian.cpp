#include <optional>

#include "arrays.hpp"
#include "fields.hpp"
#include "mphygs/total_lagrangian/midpoint_cost.hpp"
#include "point_hook.hpp"

namespace mphygs_python {

namespace {

using namespace mphygs;

/// Of each direction None, or (names of effects, parameters of all effects).
template <class T>
std::vector<Added<T>> to_added(const py::list& list) {
    std::vector<Added<T>> all(list.size());
    for (std::size_t i = 0; i < all.size(); ++i) {
        if (!list[i].is_none()) {
            const auto pair = list[i].cast<py::tuple>();
            all[i] = {to_active(pair[0].cast<py::list>()), to_vector<T>(pair[1].cast<Array<T>>())};
            for (int e = 0; e < Registry::count; ++e) {
                const Site site = Registry::infos[e]->site;
                if (all[i].active[static_cast<std::size_t>(e)] && site != Site::volume && site != Site::surface && site != Site::body) {
                    throw py::value_error(std::string("effect '") + Registry::infos[e]->name +
                                          "' acts at a place or a hold: expected one of the volume, the surface or the body");
                }
            }
        }
    }
    return all;
}

/// What every run is given.
template <class T>
struct RunInputs {
    RunInputs(const py::dict& from, const py::dict& steps, const py::object& hook, const py::object& observer)
        : fields(to_fields<T>(from)), schedule(to_schedule(steps)), hooked_(!hook.is_none()), hook_(to_hook<T>(hook)), observer_(to_observer(observer)) {}
    const PointHook<T>* hook() const { return hooked_ ? &hook_ : nullptr; }
    const Observer* observer() const { return observer_ ? &*observer_ : nullptr; }

    const Fields<T> fields;
    const Schedule schedule;

  private:
    bool hooked_;
    PointHook<T> hook_;
    std::optional<Observer> observer_;
};

template <class T>
Trajectory<T> to_trajectory_bar(const py::tuple& t) {
    if (t.size() != 2 && t.size() != 3) {
        throw py::value_error("a trajectory's bar must be (displacement, velocity), and the reactions' where asked for");
    }
    const auto part = [&](std::size_t i) { return t[i].is_none() ? std::vector<T>{} : to_vector<T>(t[i].template cast<Array<T>>()); };
    const bool reacting = t.size() == 3 && !t[2].is_none();
    return {part(0), part(1), reacting ? to_vector<double>(t[2].template cast<Array<double>>()) : std::vector<double>{}};
}

template <class T>
void bind(py::module_& m, const char* name) {
    using Model = TotalLagrangian<T>;
    py::class_<Model, std::shared_ptr<Model>>(m, name)
        .def(py::init([](const py::dict& geometry, const py::dict& settings) {
                 return std::make_shared<Model>(to_geometry(geometry), to_settings(settings));
             }),
             py::arg("geometry"), py::arg("settings"))
        .def_property_readonly("node_count", &Model::node_count)
        .def_property_readonly("node_positions",
                               [](const Model& self) {
                                   std::vector<double> p = self.node_positions();
                                   const auto n = static_cast<py::ssize_t>(self.node_count());
                                   return to_array(std::move(p), {n, 3});
                               })
        .def_property_readonly("node_index",
                               [](const Model& self) {
                                   std::vector<std::int32_t> index = self.node_index();
                                   const auto n = static_cast<py::ssize_t>(self.node_count());
                                   return to_array(std::move(index), {n, 3});
                               })
        .def("node_mass", [](const Model& self, const py::dict& fields) { return to_array(self.node_mass(to_fields<T>(fields)), {static_cast<py::ssize_t>(self.node_count())}); })
        .def("shared_mass",
             [](const Model& self, const py::dict& fields) {
                 const SharedMass<T> shared = self.shared_mass(to_fields<T>(fields));
                 std::vector<std::int32_t> node;
                 std::vector<T> value;
                 for (Eigen::Index n = 0; n < shared.outerSize(); ++n) {
                     for (typename SharedMass<T>::InnerIterator it(shared, n); it; ++it) {
                         node.insert(node.end(), {static_cast<std::int32_t>(n), static_cast<std::int32_t>(it.col())});
                         value.push_back(it.value());
                     }
                 }
                 const auto count = static_cast<py::ssize_t>(value.size());
                 return py::make_tuple(to_array(std::move(node), {count, 2}), to_array(std::move(value), {count}));
             })
        .def("rest_forces", [](const Model& self, const py::dict& fields) { return to_array(self.rest_forces(to_fields<T>(fields)), {static_cast<py::ssize_t>(self.node_count()), 3}); })
        .def("weights",
             [](const Model& self, const Array<double>& points, const Array<std::int32_t>& cell) {
                 PointWeights w = self.weights(to_vector<double>(points), to_vector<std::int32_t>(cell));
                 const auto n = static_cast<py::ssize_t>(w.node.size() / 27);
                 return py::make_tuple(to_array(std::move(w.node), {n, 27}), to_array(std::move(w.value), {n, 27}),
                                       to_array(std::move(w.gradient), {n, 27, 3}));
             })
        .def("implicit_cost",
             [](const Model& self) {
                 const MidpointCost cost = midpoint_cost(self);
                 return py::make_tuple(cost.iteration, cost.renewal);
             })
        .def_property(
            "threads", [](const Model& self) { return self.settings().threads; }, &Model::set_threads)
        .def("largest_rates",
             [](const Model& self, const py::dict& fields, int iterations, const py::object& hook) {
                 const Fields<T> f = to_fields<T>(fields);
                 const PointHook<T> h = to_hook<T>(hook);
                 py::gil_scoped_release release;
                 return self.largest_rates(f, iterations, hook.is_none() ? nullptr : &h);
             },
             py::arg("fields"), py::arg("iterations") = 60, py::arg("hook") = py::none())
        .def("simulate",
             [](const Model& self, const py::dict& fields, const py::dict& schedule, const py::object& progress, const py::object& hook,
                const py::object& observer) {
                 const RunInputs<T> in(fields, schedule, hook, observer);
                 Trajectory<T> t;
                 {
                     const Progress p = to_progress(progress);
                     py::gil_scoped_release release;
                     t = self.simulate(in.fields, in.schedule, p, in.hook(), in.observer());
                 }
                 return trajectory_arrays(std::move(t), self.node_count());
             },
             py::arg("fields"), py::arg("schedule"), py::arg("progress") = py::none(), py::arg("hook") = py::none(),
             py::arg("observer") = py::none())
        .def("tangent",
             [](const Model& self, const py::dict& fields, const py::list& directions, const py::dict& schedule,
                const py::object& progress, const py::object& hook, const py::list& added, const py::object& observer) {
                 const RunInputs<T> in(fields, schedule, hook, observer);
                 const std::vector<Added<T>> a = to_added<T>(added);
                 std::vector<Fields<T>> d;
                 for (const auto& item : directions) {
                     d.push_back(to_fields<T>(item.cast<py::dict>()));
                 }
                 std::vector<Trajectory<T>> t;
                 {
                     const Progress p = to_progress(progress);
                     py::gil_scoped_release release;
                     t = self.tangent(in.fields, d, in.schedule, p, in.hook(), a, in.observer());
                 }
                 py::list out;
                 for (auto& x : t) {
                     out.append(trajectory_arrays(std::move(x), self.node_count()));
                 }
                 return out;
             },
             py::arg("fields"), py::arg("directions"), py::arg("schedule"), py::arg("progress") = py::none(),
             py::arg("hook") = py::none(), py::arg("added") = py::list(), py::arg("observer") = py::none())
        .def("adjoint",
             [](const Model& self, const py::dict& fields, const py::dict& schedule, const Array<T>& displacement_bar,
                const Array<T>& velocity_bar, const py::object& progress, const py::object& hook, const py::object& observer,
                const py::object& reaction_bar) {
                 const RunInputs<T> in(fields, schedule, hook, observer);
                 const Trajectory<T> bar{to_vector<T>(displacement_bar), to_vector<T>(velocity_bar),
                                         reaction_bar.is_none() ? std::vector<double>{} : to_vector<double>(reaction_bar.cast<Array<double>>())};
                 return gradient_tuple(progress, [&](const Progress& p, long* recomputed) {
                     return self.adjoint(in.fields, in.schedule, bar, p, recomputed, in.hook(), in.observer());
                 });
             },
             py::arg("fields"), py::arg("schedule"), py::arg("displacement_bar"), py::arg("velocity_bar"),
             py::arg("progress") = py::none(), py::arg("hook") = py::none(), py::arg("observer") = py::none(),
             py::arg("reaction_bar") = py::none())
        .def("gradient",
             [](const Model& self, const py::dict& fields, const py::dict& schedule, const py::function& loss, const py::object& progress,
                const py::object& hook, const py::object& observer) {
                 const RunInputs<T> in(fields, schedule, hook, observer);
                 const auto call = [&](const Trajectory<T>& t) {
                     py::gil_scoped_acquire acquire;
                     Trajectory<T> copy = t;
                     return to_trajectory_bar<T>(py::tuple(loss(*trajectory_arrays(std::move(copy), self.node_count()))));
                 };
                 return gradient_tuple(progress, [&](const Progress& p, long* recomputed) {
                     return self.gradient(in.fields, in.schedule, call, p, recomputed, in.hook(), in.observer());
                 });
             },
             py::arg("fields"), py::arg("schedule"), py::arg("loss"), py::arg("progress") = py::none(), py::arg("hook") = py::none(),
             py::arg("observer") = py::none(),
             "loss(displacement, velocity), and the reactions where they are asked for, returns its derivatives by each, None where "
             "absent; one forward run less than simulate and adjoint.");
}

}  // namespace

void bind_total_lagrangian(py::module_& m) {
    bind<float>(m, "TotalLagrangianFloat32");
    bind<double>(m, "TotalLagrangianFloat64");
}

}  // namespace mphygs_python
