// The run of the values alone, which simulations, adjoints and the runs of directions share: compiled in model.cpp.
#pragma once

#include "mphygs/total_lagrangian/midpoint.hpp"

namespace mphygs {

#define MPHYGS_TOTAL_LAGRANGIAN_RUN(keyword, T)                                                                                  \
    keyword template TotalLagrangianForces<T, 0>::TotalLagrangianForces(const TotalLagrangian<T>&, const Inputs<T, 0>&);        \
    keyword template void TotalLagrangianForces<T, 0>::chunk_forces(std::size_t, double, double);                               \
    keyword template TotalLagrangianRun<T, 0>::TotalLagrangianRun(const TotalLagrangian<T>&, const Inputs<T, 0>&, const Schedule&, Team&); \
    keyword template void TotalLagrangianRun<T, 0>::step(int, int, double, double, bool);                                       \
    keyword template void TotalLagrangianRun<T, 0>::solve_midpoint(int, int, double, double);                                   \
    keyword template void TotalLagrangianRun<T, 0>::finish_midpoint(int, int, double);

}  // namespace mphygs
