#include "mphygs/mls_mpm/model.hpp"

#include "arrays.hpp"
#include "fields.hpp"

namespace mphygs_python {

namespace {

using namespace mphygs;

MlsGeometry to_mls_geometry(const py::dict& d) {
    reject_unknown(d, {"origin", "spacing", "points", "part", "surface_area", "hold", "places", "place_particle", "hold_count", "hold_centre", "part_count", "actuation"},
                   "geometry");
    MlsGeometry g;
    if (d.contains("origin")) {
        g.origin = d["origin"].cast<std::array<double, 3>>();
    }
    g.spacing = d["spacing"].cast<double>();
    g.points = entry<double>(d, "points");
    g.part = entry<std::int32_t>(d, "part");
    g.surface_area = entry<double>(d, "surface_area");
    g.hold = entry<std::int32_t>(d, "hold");
    g.places = entry<double>(d, "places");
    g.hold_centre = entry<double>(d, "hold_centre");
    g.place_particle = entry<std::int32_t>(d, "place_particle");
    g.hold_count = d.contains("hold_count") ? d["hold_count"].cast<int>() : 0;
    g.part_count = d.contains("part_count") ? d["part_count"].cast<int>() : 1;
    g.actuation = to_actuation(d);
    return g;
}

/// The common settings and those of this transfer.
MlsSettings to_mls_settings(const py::dict& d) {
    py::dict common(py::reinterpret_steal<py::dict>(PyDict_Copy(d.ptr())));
    MlsSettings s;
    const auto take = [&](const char* key, auto& value) {
        if (common.contains(key)) {
            value = common[key].cast<std::remove_reference_t<decltype(value)>>();
            PyDict_DelItemString(common.ptr(), key);
        }
    };
    take("hold_relaxation", s.hold_relaxation);
    take("hold_weight", s.hold_weight);
    take("sort_interval", s.sort_interval);
    static_cast<Settings&>(s) = to_settings(common);
    return s;
}

template <class T>
py::tuple particle_arrays(ParticleTrajectory<T>&& t, std::size_t particles) {
    const auto n = static_cast<py::ssize_t>(particles);
    const auto frames = static_cast<py::ssize_t>(t.position.size()) / (3 * n);
    const auto holds = static_cast<py::ssize_t>(t.reaction.size()) / (6 * frames);
    py::object position = to_array(std::move(t.position), {frames, n, 3}), velocity = to_array(std::move(t.velocity), {frames, n, 3});
    py::object deformation = to_array(std::move(t.deformation), {frames, n, 3, 3});
    if (holds == 0) {
        return py::make_tuple(position, velocity, deformation);
    }
    return py::make_tuple(position, velocity, deformation, to_array(std::move(t.reaction), {frames, holds, py::ssize_t(6)}));
}

template <class T>
ParticleTrajectory<T> to_particle_trajectory(const py::tuple& t) {
    if (t.size() != 3 && t.size() != 4) {
        throw py::value_error("a trajectory's bar must be (position, velocity, deformation), and the reactions' where asked for");
    }
    const auto part = [&](std::size_t i) { return t[i].is_none() ? std::vector<T>{} : to_vector<T>(t[i].template cast<Array<T>>()); };
    const bool reacting = t.size() == 4 && !t[3].is_none();
    return {part(0), part(1), part(2), reacting ? to_vector<double>(t[3].template cast<Array<double>>()) : std::vector<double>{}};
}

template <class T>
void bind(py::module_& m, const char* name) {
    using Model = MlsMpm<T>;
    py::class_<Model, std::shared_ptr<Model>>(m, name)
        .def(py::init([](const py::dict& geometry, const py::dict& settings) {
                 return std::make_shared<Model>(to_mls_geometry(geometry), to_mls_settings(settings));
             }),
             py::arg("geometry"), py::arg("settings"))
        .def_property_readonly("particle_count", &Model::particle_count)
        .def_property(
            "threads", [](const Model& self) { return self.settings().threads; }, &Model::set_threads)
        .def("largest_rates",
             [](const Model& self, const py::dict& fields, int iterations) {
                 const Fields<T> f = to_fields<T>(fields);
                 py::gil_scoped_release release;
                 return self.largest_rates(f, iterations);
             },
             py::arg("fields"), py::arg("iterations") = 60)
        .def("simulate",
             [](const Model& self, const py::dict& fields, const py::dict& schedule, const py::object& progress,
                const py::object& observer) {
                 const Fields<T> f = to_fields<T>(fields);
                 const Schedule s = to_schedule(schedule);
                 const std::optional<Observer> o = to_observer(observer);
                 ParticleTrajectory<T> t;
                 {
                     const Progress p = to_progress(progress);
                     py::gil_scoped_release release;
                     t = self.simulate(f, s, p, o ? &*o : nullptr);
                 }
                 return particle_arrays(std::move(t), self.particle_count());
             },
             py::arg("fields"), py::arg("schedule"), py::arg("progress") = py::none(), py::arg("observer") = py::none())
        .def("tangent",
             [](const Model& self, const py::dict& fields, const py::list& directions, const py::dict& schedule,
                const py::object& progress, const py::object& observer) {
                 const Fields<T> f = to_fields<T>(fields);
                 const Schedule s = to_schedule(schedule);
                 const std::optional<Observer> o = to_observer(observer);
                 std::vector<Fields<T>> d;
                 for (const auto& item : directions) {
                     d.push_back(to_fields<T>(item.cast<py::dict>()));
                 }
                 std::vector<ParticleTrajectory<T>> t;
                 {
                     const Progress p = to_progress(progress);
                     py::gil_scoped_release release;
                     t = self.tangent(f, d, s, p, o ? &*o : nullptr);
                 }
                 py::list out;
                 for (auto& x : t) {
                     out.append(particle_arrays(std::move(x), self.particle_count()));
                 }
                 return out;
             },
             py::arg("fields"), py::arg("directions"), py::arg("schedule"), py::arg("progress") = py::none(),
             py::arg("observer") = py::none())
        .def("adjoint",
             [](const Model& self, const py::dict& fields, const py::dict& schedule, const py::tuple& bar, const py::object& progress,
                const py::object& observer) {
                 const Fields<T> f = to_fields<T>(fields);
                 const Schedule s = to_schedule(schedule);
                 const std::optional<Observer> o = to_observer(observer);
                 const ParticleTrajectory<T> b = to_particle_trajectory<T>(bar);
                 return gradient_tuple(progress, [&](const Progress& p, long* recomputed) {
                     return self.adjoint(f, s, b, p, recomputed, o ? &*o : nullptr);
                 });
             },
             py::arg("fields"), py::arg("schedule"), py::arg("bar"), py::arg("progress") = py::none(), py::arg("observer") = py::none(),
             "bar: (position, velocity, deformation) derivatives of the loss, None where absent.")
        .def("gradient",
             [](const Model& self, const py::dict& fields, const py::dict& schedule, const py::function& loss, const py::object& progress,
                const py::object& observer) {
                 const Fields<T> f = to_fields<T>(fields);
                 const Schedule s = to_schedule(schedule);
                 const std::optional<Observer> o = to_observer(observer);
                 const auto call = [&](const ParticleTrajectory<T>& t) {
                     py::gil_scoped_acquire acquire;
                     ParticleTrajectory<T> copy = t;
                     return to_particle_trajectory<T>(py::tuple(loss(*particle_arrays(std::move(copy), self.particle_count()))));
                 };
                 return gradient_tuple(progress, [&](const Progress& p, long* recomputed) {
                     return self.gradient(f, s, call, p, recomputed, o ? &*o : nullptr);
                 });
             },
             py::arg("fields"), py::arg("schedule"), py::arg("loss"), py::arg("progress") = py::none(), py::arg("observer") = py::none(),
             "loss(position, velocity, deformation) returns its derivatives, None where absent; one forward run less than "
             "simulate and adjoint.");
}

}  // namespace

void bind_mls_mpm(py::module_& m) {
    bind<float>(m, "MlsMpmFloat32");
    bind<double>(m, "MlsMpmFloat64");
}

}  // namespace mphygs_python
