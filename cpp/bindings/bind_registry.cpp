#include "arrays.hpp"
#include "mphygs/model.hpp"
#include "mphygs/registry.hpp"

namespace mphygs_python {

void bind_registry(py::module_& m) {
    using namespace mphygs;
    py::register_exception_translator([](std::exception_ptr p) {
        try {
            if (p) {
                std::rethrow_exception(p);
            }
        } catch (const SimulationError& e) {
            py::object type = py::module_::import("mphygs.simulate.errors").attr("SimulationError");
            py::object error = type(e.what(), py::arg("frame") = e.frame, py::arg("part") = e.part);
            PyErr_SetObject(type.ptr(), error.ptr());
        }
    });
    m.def(
        "effects",
        [] {
            constexpr const char* sites[] = {"volume", "body", "surface", "point", "mass", "hold"};
            py::list list;
            for (const EffectInfo* info : Registry::infos) {
                py::list parameters;
                for (int i = 0; i < info->parameter_count; ++i) {
                    const ParameterInfo& p = info->parameters[i];
                    py::dict d;
                    d["name"] = p.name;
                    d["unit"] = p.unit;
                    d["null"] = p.null;
                    d["lower"] = p.lower;
                    d["upper"] = p.upper;
                    d["scale"] = p.scale;
                    d["fitted"] = p.fitted;
                    parameters.append(d);
                }
                py::dict d;
                d["name"] = info->name;
                d["summary"] = info->summary;
                d["site"] = sites[static_cast<int>(info->site)];
                d["threshold"] = info->threshold;
                d["parameters"] = parameters;
                list.append(d);
            }
            return list;
        },
        "All effects of this build, in the order of their parameters in the flat array.");
}

}  // namespace mphygs_python
