// Gradients of the MLS-MPM transfer.
#include "mphygs/transfers/mls_mpm_reverse.hpp"

namespace mphygs {

template <class T>
Fields<T> MlsMpm<T>::adjoint(const Fields<T>& fields, const Schedule& schedule, const ParticleTrajectory<T>& bar,
                             const Progress& progress, long* recomputed) const {
    check(fields, schedule);
    MlsMpmReverse<T> reverse(*this, fields, schedule);
    return reverse.gradient([&](const ParticleTrajectory<T>&) { return bar; }, false, progress, recomputed);
}

template <class T>
Fields<T> MlsMpm<T>::gradient(const Fields<T>& fields, const Schedule& schedule, const Loss& loss, const Progress& progress,
                              long* recomputed) const {
    check(fields, schedule);
    MlsMpmReverse<T> reverse(*this, fields, schedule);
    return reverse.gradient(loss, true, progress, recomputed);
}

#define MPHYGS_INSTANTIATE(T)                                                                                              \
    template Fields<T> MlsMpm<T>::adjoint(const Fields<T>&, const Schedule&, const ParticleTrajectory<T>&, const Progress&, \
                                          long*) const;                                                                    \
    template Fields<T> MlsMpm<T>::gradient(const Fields<T>&, const Schedule&, const Loss&, const Progress&, long*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
