// Set-up of the MLS-MPM transfer: anchor, axes, places, checks.
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "mphygs/mls_mpm/state.hpp"

namespace mphygs {

namespace {

void require(bool condition, const std::string& message) {
    if (!condition) {
        throw std::invalid_argument(message);
    }
}

std::int32_t nearest_particle(const MlsGeometry& g, const double* place) {
    double best = std::numeric_limits<double>::infinity();
    std::int32_t found = 0;
    for (std::size_t i = 0; i < g.particle_count(); ++i) {
        double square = 0;
        for (std::size_t c = 0; c < 3; ++c) {
            const double d = g.points[3 * i + c] - place[c];
            square += d * d;
        }
        if (square < best) {
            best = square;
            found = static_cast<std::int32_t>(i);
        }
    }
    return found;
}

}  // namespace

template <class T>
MlsMpm<T>::MlsMpm(MlsGeometry geometry, MlsSettings settings) : geometry_(std::move(geometry)), settings_(std::move(settings)) {
    const MlsGeometry& g = geometry_;
    const std::size_t count = g.particle_count();
    require(count > 0, "the object has no material: no particle was given");
    require(count < (std::size_t(1) << 30), "more than 2^30 particles");
    require(g.points.size() == 3 * count, "points must be (N, 3) and part (N,): they disagree in size");
    require(std::isfinite(g.spacing) && g.spacing > 0, "the grid spacing must be a positive length");
    require(g.surface_area.empty() || g.surface_area.size() == count, "surface_area must be (N,), one area per particle");
    require(g.hold.empty() || g.hold.size() == count, "hold must be (N,), one hold (or -1) per particle");
    require(g.places.size() % 3 == 0, "places must be (P, 3)");
    require(g.place_particle.empty() || g.place_particle.size() == g.place_count(), "place_particle must be (P,)");
    for (const std::int32_t h : g.hold) {
        require(h >= -1 && h < g.hold_count, "hold " + std::to_string(h) + " does not exist: hold_count is " + std::to_string(g.hold_count));
    }
    for (const std::int32_t p : g.part) {
        require(p >= 0 && p < g.part_count, "part " + std::to_string(p) + " does not exist: part_count is " + std::to_string(g.part_count));
    }
    for (const double x : g.points) {
        require(std::isfinite(x), "points: a coordinate is not finite");
    }
    require(settings_.hold_relaxation >= 1, "hold_relaxation must be at least 1: a held particle would overshoot");
    require(settings_.hold_weight >= 1, "hold_weight must be at least 1");
    require(settings_.sort_interval >= 1, "sort_interval must be at least 1");
    slots_ = make_slots(settings_.active);
    sites_ = active_sites(slots_);
    Registry::each([&](auto tag, int i) {
        using E = typename decltype(tag)::type;
        require(E::info.site != Site::hold || !slots_[static_cast<std::size_t>(i)].active,
                std::string(E::info.name) + " is not possible in MLS-MPM, which imposes the hold's velocity and knows no reaction: "
                                            "use the total-Lagrangian transfer");
    });

    std::array<double, 3> low, high;
    low.fill(std::numeric_limits<double>::infinity());
    high.fill(-std::numeric_limits<double>::infinity());
    for (std::size_t i = 0; i < 3 * count; ++i) {
        low[i % 3] = std::min(low[i % 3], g.points[i]);
        high[i % 3] = std::max(high[i % 3], g.points[i]);
    }
    for (std::size_t c = 0; c < 3; ++c) {
        const double middle = 0.5 * (low[c] + high[c]);
        anchor_[c] = g.origin[c] + std::round((middle - g.origin[c]) / g.spacing) * g.spacing;
    }
    // Chunks are slabs across the longest axis, so that they share as few nodes as possible.
    std::stable_sort(axis_.begin(), axis_.end(), [&](int a, int b) {
        const std::size_t i = static_cast<std::size_t>(a), j = static_cast<std::size_t>(b);
        return high[i] - low[i] > high[j] - low[j];
    });

    for (std::size_t p = 0; p < g.place_count(); ++p) {
        const std::int32_t given = g.place_particle.empty() ? -1 : g.place_particle[p];
        require(given >= -1 && given < static_cast<std::int32_t>(count), "place " + std::to_string(p) + " names particle " +
                                                                             std::to_string(given) + " of " + std::to_string(count));
        place_particle_.push_back(given >= 0 ? given : nearest_particle(g, &g.places[3 * p]));
    }
    geometry_.actuation.settle(count, g.hold_count);
    workspace_ = std::make_shared<MlsWorkspace<T>>();
    padded_ = (count + tile_size - 1) / tile_size * tile_size;
    chunk_count_ = static_cast<int>(std::clamp<std::size_t>(padded_ / 1024, 1, 16));
}

template <class T>
void MlsMpm<T>::check(const Fields<T>& f, const Schedule& s, const Observer* observer) const {
    const auto size = [](const auto& v, std::size_t n, bool optional, const char* name) {
        require((optional && v.empty()) || v.size() == n,
                std::string(name) + " has " + std::to_string(v.size()) + " numbers, expected " + std::to_string(n));
    };
    const std::size_t count = particle_count(), frames = s.steps.size();
    require(!s.implicit, "the implicit step is one of the total-Lagrangian transfer: expected an explicit schedule in MLS-MPM");
    require(s.dt.size() == frames, "the schedule needs one dt per interval");
    size(s.reaction_weight, 2 * static_cast<std::size_t>(s.total_steps()), true, "reaction_weight");
    if (!s.reaction_weight.empty()) {
        size(geometry_.hold_centre, 3 * static_cast<std::size_t>(geometry_.hold_count), false, "hold_centre");
    }
    for (std::size_t k = 0; k < frames; ++k) {
        require(s.steps[k] > 0 && s.dt[k] > 0, "the schedule's steps and dt must be positive");
    }
    size(f.mu, count, false, "mu");
    size(f.lambda, count, false, "lambda");
    size(f.stress_volume, count, false, "stress_volume");
    size(f.mass, count, false, "mass");
    for (const T m : f.mass) {
        require(m > T{}, "mass: a particle's mass is not positive");
    }
    size(f.deformation0, 9 * count, true, "deformation0");
    size(f.effect, static_cast<std::size_t>(Registry::parameter_count), false, "effect");
    size(f.place_mass, geometry_.place_count(), !sites_.mass, "place_mass");
    size(f.place_effect, geometry_.place_count() * static_cast<std::size_t>(sites_.point_parameters), !sites_.point, "place_effect");
    size(f.gravity, 3, false, "gravity");
    size(f.displacement0, 3 * count, true, "displacement0");
    size(f.velocity0, 3 * count, true, "velocity0");
    size(f.node_force, 3 * count * frames, true, "node_force");
    geometry_.actuation.check_channels(f.channel.size(), frames);
    size(f.pose, static_cast<std::size_t>(geometry_.hold_count) * static_cast<std::size_t>(s.total_steps() + 1) * 12,
         geometry_.hold_count == 0, "pose");
    require(observer || f.target.empty(), "the fields have a target but there is no observer");
    if (observer) {
        observer->check(count, frames, f.target.size());
    }
}

template class MlsMpm<float>;
template class MlsMpm<double>;

}  // namespace mphygs
