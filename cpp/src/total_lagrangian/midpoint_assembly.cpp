// The matrix of an implicit step, cell by cell.
#include "mphygs/total_lagrangian/midpoint_assembly.hpp"
#include "mphygs/total_lagrangian/value_run.hpp"

namespace mphygs {

MPHYGS_TOTAL_LAGRANGIAN_RUN(extern, float)
MPHYGS_TOTAL_LAGRANGIAN_RUN(extern, double)

template <class T>
std::unique_ptr<MidpointAssembly<T>> TotalLagrangian<T>::midpoint_assembly(const Fields<T>& fields, const Schedule& schedule, Team& team) const {
    return std::make_unique<CellAssembly<T, register_lanes<T>>>(*this, fields, schedule, team);
}

template <class T>
std::vector<CellNodes> TotalLagrangian<T>::coupled_nodes() const {
    std::vector<CellNodes> cells;
    for (const auto* blocks : {&rows_, &surface_rows_}) {
        for (std::size_t b = 0; b < blocks->size(); ++b) {
            if (b == 0 || (*blocks)[b] != (*blocks)[b - 1]) {
                cells.push_back(nodes_of_rows<T>((*blocks)[b]));
            }
        }
    }
    for (const auto& place : places_) {
        cells.push_back(place.node);
    }
    return cells;
}

#define MPHYGS_INSTANTIATE(T)                                                                                                         \
    template std::unique_ptr<MidpointAssembly<T>> TotalLagrangian<T>::midpoint_assembly(const Fields<T>&, const Schedule&, Team&) const; \
    template std::vector<CellNodes> TotalLagrangian<T>::coupled_nodes() const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
