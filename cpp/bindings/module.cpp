// The compiled module: a list of what it offers.
#include <pybind11/pybind11.h>

namespace mphygs_python {
void bind_registry(pybind11::module_& m);
void bind_total_lagrangian(pybind11::module_& m);
void bind_equilibrium(pybind11::module_& m);
void bind_mls_mpm(pybind11::module_& m);
void bind_splatting(pybind11::module_& m);
}  // namespace mphygs_python

// The build names the module: _core, or _core_v3 and its kind in a portable wheel.
PYBIND11_MODULE(MPHYGS_MODULE, m) {
    m.doc() = "mphygs core: continuum simulation with exact derivatives.";
    mphygs_python::bind_registry(m);
    mphygs_python::bind_total_lagrangian(m);
    mphygs_python::bind_equilibrium(m);
    mphygs_python::bind_mls_mpm(m);
    mphygs_python::bind_splatting(m);
}
