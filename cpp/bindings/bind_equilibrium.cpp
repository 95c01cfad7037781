#include "mphygs/total_lagrangian/equilibrium.hpp"

#include "arrays.hpp"
#include "fields.hpp"

namespace mphygs_python {

namespace {

using namespace mphygs;

py::dict solution_dict(Equilibrium::Solution&& s, std::size_t nodes) {
    py::dict d;
    d["map"] = to_array(std::move(s.map), {static_cast<py::ssize_t>(nodes), 3});
    const auto points = static_cast<py::ssize_t>(s.volume_ratio.size());
    d["deformation0"] = to_array(std::move(s.deformation0), {9 * points});
    d["volume_ratio"] = to_array(std::move(s.volume_ratio), {points});
    d["iterations"] = s.iterations;
    d["last_step"] = s.last_step;
    return d;
}

}  // namespace

void bind_equilibrium(py::module_& m) {
    using Model = TotalLagrangian<double>;
    py::class_<Equilibrium>(m, "Equilibrium")
        .def(py::init([](std::shared_ptr<Model> model) { return std::make_unique<Equilibrium>(std::move(model)); }), py::arg("model"))
        .def(
            "solve",
            [](Equilibrium& self, const py::dict& fields, const Array<double>& volume, const Array<double>& load,
               const Array<double>& start, double tolerance) {
                const Fields<double> f = to_fields<double>(fields);
                const auto v = to_vector<double>(volume), l = to_vector<double>(load), s = to_vector<double>(start);
                Equilibrium::Solution out;
                {
                    py::gil_scoped_release release;
                    out = self.solve(f, v, l, s, tolerance);
                }
                const std::size_t nodes = out.map.size() / 3;
                return solution_dict(std::move(out), nodes);
            },
            py::arg("fields"), py::arg("volume"), py::arg("load"), py::arg("start"), py::arg("tolerance") = 1e-9)
        .def("tangent",
             [](Equilibrium& self, const py::list& directions) {
                 std::vector<Equilibrium::Direction> d;
                 for (const auto& item : directions) {
                     const auto pair = item.cast<py::tuple>();
                     d.push_back({to_fields<double>(pair[0].cast<py::dict>()), to_vector<double>(pair[1].cast<Array<double>>())});
                 }
                 std::vector<Equilibrium::Solution> s;
                 {
                     py::gil_scoped_release release;
                     s = self.tangent(d);
                 }
                 py::list out;
                 for (auto& x : s) {
                     const std::size_t nodes = x.map.size() / 3;
                     out.append(solution_dict(std::move(x), nodes));
                 }
                 return out;
             })
        .def("adjoint", [](Equilibrium& self, const Array<double>& deformation0_bar, const Array<double>& ratio_bar) {
            const auto a = to_vector<double>(deformation0_bar), b = to_vector<double>(ratio_bar);
            Equilibrium::Direction d;
            {
                py::gil_scoped_release release;
                d = self.adjoint(a, b);
            }
            const auto nodes = static_cast<py::ssize_t>(d.load.size() / 3);
            return py::make_tuple(fields_dict(std::move(d.fields)), to_array(std::move(d.load), {nodes, 3}));
        });
}

}  // namespace mphygs_python
