#include "fields.hpp"
#include "mphygs/model.hpp"
#include "mphygs/physics/registry.hpp"

namespace mphygs_python {

namespace {

using namespace mphygs;

py::list parameters_of(const EffectInfo& info) {
    constexpr const char* roles[] = {"plain",  "strength", "level",     "direction", "axis",  "flow",
                                     "anchor", "offset",   "frequency", "phase",     "switch", "constant"};
    py::list parameters;
    for (int i = 0; i < info.parameter_count(); ++i) {
        const ParameterInfo& p = info.parameters[i];
        py::dict d;
        d["name"] = p.name;
        d["unit"] = p.unit;
        d["null"] = p.null;
        d["lower"] = p.lower;
        d["upper"] = p.upper;
        d["scale"] = p.scale;
        d["fitted"] = p.fitted;
        d["role"] = roles[static_cast<int>(p.part())];
        if (p.low != 0 || p.high != 0) {
            d["scan"] = py::make_tuple(p.low, p.high);
        }
        parameters.append(d);
    }
    return parameters;
}

py::list effects() {
    constexpr const char* sites[] = {"volume", "body", "surface", "point", "mass", "hold"};
    py::list list;
    for (const EffectInfo* info : Registry::infos) {
        py::dict d;
        d["name"] = info->name;
        d["summary"] = info->summary;
        d["site"] = sites[static_cast<int>(info->site)];
        d["threshold"] = info->threshold;
        d["history"] = info->history_count;
        d["loads_at_rest"] = info->loads_at_rest;
        d["corrects_gravity"] = info->corrects_gravity;
        d["carries_gravity"] = info->carries_gravity;
        d["simpler"] = info->simpler;
        d["not_with_mls"] = info->not_with_mls;
        d["parameters"] = parameters_of(*info);
        list.append(d);
    }
    return list;
}

py::list laws() {
    py::list list;
    for (int i = 0; i < AllLaws::count; ++i) {
        py::dict d;
        d["name"] = AllLaws::names[i];
        d["usual"] = AllLaws::usual[i];
        list.append(d);
    }
    return list;
}

/// The numbers of all effects, (parameters of all effects,).
std::vector<double> numbers(const Array<double>& parameters) {
    std::vector<double> values = to_vector<double>(parameters);
    if (values.size() != static_cast<std::size_t>(Registry::parameter_count)) {
        throw py::value_error("parameters: expected those of all effects");
    }
    return values;
}

py::object array_of(std::vector<double>&& values) {
    const auto n = static_cast<py::ssize_t>(values.size());
    return to_array(std::move(values), {n});
}

}  // namespace

void bind_registry(py::module_& m) {
    py::register_exception_translator([](std::exception_ptr p) {
        try {
            if (p) {
                std::rethrow_exception(p);
            }
        } catch (const SimulationError& e) {
            py::object type = py::module_::import("mphygs.simulate.errors").attr("SimulationError");
            py::object error = type(e.what(), py::arg("frame") = e.frame, py::arg("part") = e.part, py::arg("shorter") = e.shorter);
            PyErr_SetObject(type.ptr(), error.ptr());
        }
    });
    m.def("effects", &effects, "All effects of this build, in the order of their parameters in the flat array.");
    m.def("laws", &laws, "All elastic laws of this build, by name, and which of them is the usual one.");
    m.def(
        "stiffness_factor",
        [](const Array<double>& parameters, const py::list& active) {
            return all_stiffness_factors(make_slots(to_active(active)), numbers(parameters).data());
        },
        py::arg("parameters"), py::arg("active"), "By how much active effects multiply the stiffness that bounds the substep.");
    m.def(
        "worst_case",
        [](const Array<double>& parameters, const py::list& active) {
            std::vector<double> values = numbers(parameters);
            all_worst_cases(make_slots(to_active(active)), values.data());
            return array_of(std::move(values));
        },
        py::arg("parameters"), py::arg("active"), "The flat array with active effects as they bound the substep most.");
    m.def(
        "complete",
        [](const Array<double>& parameters, const py::list& active, double youngs_modulus, double spacing) {
            std::vector<double> values = numbers(parameters);
            complete_all(make_slots(to_active(active)), values.data(), {youngs_modulus, spacing, 0.0});
            return array_of(std::move(values));
        },
        py::arg("parameters"), py::arg("active"), py::arg("youngs_modulus"), py::arg("spacing"),
        "The flat array with what active effects choose themselves: least Young's modulus [Pa] and edge of a cell [m].");
    m.def(
        "simplified",
        [](const std::string& name, const Array<double>& own, double shear_modulus) {
            std::vector<double> result;
            const std::vector<double> q = to_vector<double>(own);
            Registry::each([&](auto tag, int) {
                using E = typename decltype(tag)::type;
                if (name != E::info.name) {
                    return;
                }
                if (q.size() != static_cast<std::size_t>(E::info.parameter_count())) {
                    throw py::value_error(name + ": expected all of its numbers");
                }
                double numbers[max_effect_parameters] = {};
                if (simplify<E>(q.data(), {0.0, 0.0, shear_modulus}, numbers)) {
                    result.assign(numbers, numbers + max_effect_parameters);
                }
            });
            return result;
        },
        py::arg("name"), py::arg("own"), py::arg("shear_modulus"),
        "First numbers of the simpler effect that one is in a limit, of its own; empty where it does not say.");
}

}  // namespace mphygs_python
