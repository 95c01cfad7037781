// What the total-Lagrangian transfer refuses: inputs of a wrong size, and motion that is no longer one.
#include <cmath>
#include <string>

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

namespace {

void require(bool condition, const std::string& message) {
    if (!condition) {
        throw std::invalid_argument(message);
    }
}

template <class T>
void require_size(const std::vector<T>& v, std::size_t n, bool optional, const char* name) {
    require((optional && v.empty()) || v.size() == n,
            std::string(name) + " has " + std::to_string(v.size()) + " numbers, expected " + std::to_string(n));
}

}  // namespace

template <class T>
void TotalLagrangian<T>::check_body(const Fields<T>& f) const {
    const std::size_t points = 8 * geometry_.block_count();
    require_size(f.mu, points, false, "mu");
    require_size(f.lambda, points, false, "lambda");
    require_size(f.stress_volume, points, false, "stress_volume");
    require_size(f.mass, points, false, "mass");
    require_size(f.deformation0, 9 * points, true, "deformation0");
    require_size(f.effect, static_cast<std::size_t>(Registry::parameter_count), false, "effect");
    require_size(f.place_mass, geometry_.place_count(), !sites_.mass, "place_mass");
    require_size(f.place_effect, geometry_.place_count() * static_cast<std::size_t>(sites_.point_parameters), !sites_.point,
                 "place_effect");
    require_size(f.gravity, 3, false, "gravity");
    require_size(f.displacement0, 3 * node_count(), true, "displacement0");
    require_size(f.velocity0, 3 * node_count(), true, "velocity0");
}

template <class T>
void TotalLagrangian<T>::check(const Fields<T>& f, const Schedule& s, const Observer* observer) const {
    const std::size_t frames = s.steps.size();
    require(s.dt.size() == frames, "the schedule needs one dt per interval");
    for (std::size_t k = 0; k < frames; ++k) {
        require(s.steps[k] > 0 && s.dt[k] > 0, "the schedule's steps and dt must be positive");
        require(!s.paired || (s.implicit && s.steps[k] % 2 == 0), "a schedule in pairs must be implicit, with even steps");
    }
    check_body(f);
    require_size(f.node_force, 3 * node_count() * frames, true, "node_force");
    geometry_.actuation.check_channels(f.channel.size(), frames);
    require_size(f.pose, static_cast<std::size_t>(geometry_.hold_count) * static_cast<std::size_t>(s.total_steps() + 1) * 12,
                 geometry_.hold_count == 0, "pose");
    const std::size_t holds = static_cast<std::size_t>(geometry_.hold_count);
    require_size(s.reaction_weight, 2 * static_cast<std::size_t>(s.total_steps()), true, "reaction_weight");
    if (!s.reaction_weight.empty()) {
        require_size(geometry_.hold_centre, 3 * holds, false, "hold_centre");
    }
    require(observer || f.target.empty(), "the fields have a target but there is no observer");
    if (observer) {
        observer->check(node_count(), frames, f.target.size());
    }
}

template <class T>
std::string TotalLagrangian<T>::describe_failure(const std::vector<T>& u, std::size_t offset, int frame, double time,
                                                 int* part) const {
    *part = -1;
    for (std::size_t b = 0; b < rows_.size() && *part < 0; ++b) {
        for (int a = 0; a < 27; ++a) {
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t n = static_cast<std::size_t>(node_of<T>(*reinterpret_cast<const Rows*>(rows_[b].data()), a));
                const T value = u[offset + c * stride_ + n];
                if (!(std::abs(value) < static_cast<T>(settings_.displacement_limit))) {
                    *part = geometry_.part[static_cast<std::size_t>(order_[b])];
                }
            }
        }
    }
    return "unstable before output frame " + std::to_string(frame) + " (t = " + std::to_string(time) + " s), first in part " +
           std::to_string(*part) + ": a displacement is not finite or above " + std::to_string(settings_.displacement_limit) +
           " m; the substep is too long for the stiffest part, or the material has inverted";
}

#define MPHYGS_INSTANTIATE(T)                                                                                          \
    template void TotalLagrangian<T>::check_body(const Fields<T>&) const;                                              \
    template void TotalLagrangian<T>::check(const Fields<T>&, const Schedule&, const Observer*) const;                 \
    template std::string TotalLagrangian<T>::describe_failure(const std::vector<T>&, std::size_t, int, double, int*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
