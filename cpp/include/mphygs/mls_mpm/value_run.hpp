// The run of the values alone, which simulations and adjoints share: compiled in model.cpp.
#pragma once

#include "mphygs/mls_mpm/chunk.hpp"
#include "mphygs/mls_mpm/start.hpp"

namespace mphygs {

#define MPHYGS_MLS_RUN(keyword, T)                                                                                        \
    keyword template MlsMpmRun<T, 0>::MlsMpmRun(const MlsMpm<T>&, const Inputs<T, 0>&, const Schedule&, Team&);           \
    keyword template void MlsMpmRun<T, 0>::advance_chunk(std::size_t, T, const Box&, bool, bool, CellRange&);             \
    keyword template void MlsMpmRun<T, 0>::start_chunk(std::size_t, const Box&, bool, bool);                              \
    keyword template void MlsParticles<T, 0>::sort();                                                                     \
    keyword template void MlsForces<T, 0>::evaluate(const MlsOrder<T>&, std::size_t, const ParticlePoint<Pack<T>>&, T*, \
                                                    Vec3<Pack<T>>&, Mat3<Pack<T>>&) const;

}  // namespace mphygs
