// Rollouts of the MLS-MPM transfer: values.
#include "mphygs/mls_mpm/rollout.hpp"
#include "mphygs/mls_mpm/value_run.hpp"

namespace mphygs {

template <class T>
ParticleTrajectory<T> MlsMpm<T>::simulate(const Fields<T>& fields, const Schedule& schedule, const Progress& progress,
                                          const Observer* observer) const {
    check(fields, schedule, observer);
    Inputs<T, 0> inputs;
    inputs.primal = &fields;
    inputs.observer = observer;
    return std::move(roll<T, 0>(*this, inputs, 0, schedule, progress)[0]);
}

#define MPHYGS_INSTANTIATE(T)                                                                                                      \
    template ParticleTrajectory<T> MlsMpm<T>::simulate(const Fields<T>&, const Schedule&, const Progress&, const Observer*) const; \
    MPHYGS_MLS_RUN(, T)
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
