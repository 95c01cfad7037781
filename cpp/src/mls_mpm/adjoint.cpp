// Gradients of the MLS-MPM transfer.
#include "mphygs/mls_mpm/chunk.hpp"
#include "mphygs/mls_mpm/chunk_reverse.hpp"
#include "mphygs/mls_mpm/held_reverse.hpp"
#include "mphygs/mls_mpm/start.hpp"
#include "mphygs/mls_mpm/start_reverse.hpp"
#include "mphygs/mls_mpm/value_run.hpp"
#include "mphygs/mls_mpm/volume_reverse.hpp"

namespace mphygs {

MPHYGS_MLS_RUN(extern, float)
MPHYGS_MLS_RUN(extern, double)

namespace {

template <class T>
Fields<T> gradient_of(const MlsMpm<T>& model, int threads, const Fields<T>& fields, const Schedule& schedule,
                      const typename MlsMpm<T>::Loss& loss, bool keep, const Progress& progress, long* recomputed,
                      const Observer* observer) {
    Fields<T> result;
    Team::run(threads, [&](Team& team) {
        MlsMpmReverse<T> reverse(model, fields, schedule, observer, team);
        result = reverse.gradient(loss, keep, progress, recomputed);
    });
    return result;
}

}  // namespace

template <class T>
Fields<T> MlsMpm<T>::adjoint(const Fields<T>& fields, const Schedule& schedule, const ParticleTrajectory<T>& bar,
                             const Progress& progress, long* recomputed, const Observer* observer) const {
    check(fields, schedule, observer);
    return gradient_of(*this, settings_.threads, fields, schedule, [&](const ParticleTrajectory<T>&) { return bar; }, false, progress,
                       recomputed, observer);
}

template <class T>
Fields<T> MlsMpm<T>::gradient(const Fields<T>& fields, const Schedule& schedule, const Loss& loss, const Progress& progress,
                              long* recomputed, const Observer* observer) const {
    check(fields, schedule, observer);
    return gradient_of(*this, settings_.threads, fields, schedule, loss, true, progress, recomputed, observer);
}

#define MPHYGS_INSTANTIATE(T)                                                                                              \
    template Fields<T> MlsMpm<T>::adjoint(const Fields<T>&, const Schedule&, const ParticleTrajectory<T>&, const Progress&, \
                                          long*, const Observer*) const;                                                   \
    template Fields<T> MlsMpm<T>::gradient(const Fields<T>&, const Schedule&, const Loss&, const Progress&, long*, \
                                           const Observer*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
