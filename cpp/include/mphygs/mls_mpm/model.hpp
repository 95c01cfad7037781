// MLS-MPM transfer: APIC, quadratic B-splines, an updated-Lagrangian material point method.
//
// One substep from particles (x, v, C, F) at n, f every force on a particle:
//   P2G   p_i = sum_p w_ip (m v + dt f + A (x_i - x_p)),  m_i = sum_p w_ip m,
//         A = m C - dt V (4/h^2) tau,  tau = P F^T,
//   G2P   v_n+1 = sum_i w_ip v_i,  C_n+1 = 4/h^2 sum_i w_ip v_i (x_i - x_p)^T,
//         x_n+1 = x_n + dt v_n+1,  F_n+1 = (I + dt C_n+1) F_n,   v_i = p_i / m_i.
// F is counted from the stress-free state, V is the volume there. C_0 is gathered from the field
// of the initial velocities, so that an initial rotation is not lost.
// Sources: Jiang, Schroeder, Selle, Teran, Stomakhin, "The affine particle-in-cell method", 2015;
// Hu et al., "A moving least squares material point method", 2018.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "mphygs/model.hpp"
#include "mphygs/physics/evaluation.hpp"
#include "mphygs/physics/observer.hpp"

namespace mphygs {

template <class T>
struct MlsWorkspace;

/// Called at every output frame; returning false stops the run (SimulationError "interrupted").
using Progress = std::function<bool(int frame)>;

/// The particles of an object, N of them.
struct MlsGeometry {
    std::array<double, 3> origin{};  // of grid node (0, 0, 0) [m]
    double spacing = 0;              // of the grid [m]
    std::vector<double> points;      // (N, 3) at rest [m]
    std::vector<std::int32_t> part;  // (N,)
    std::vector<double> surface_area;          // (N,) exposed area that a particle stands for [m^2]; empty: 0
    std::vector<std::int32_t> hold;            // (N,) hold that carries a particle, -1: free; empty: all free
    std::vector<double> places;                // (P, 3) of point and mass effects at rest [m]
    std::vector<std::int32_t> place_particle;  // (P,) particle of a place, -1 or empty: the nearest
    int hold_count = 0;
    std::vector<double> hold_centre;  // (H, 3) about which torques are told [m]; needed for reactions only
    int part_count = 1;
    Actuation actuation;  // loads that change with time and follow the object; its carriers are the particles

    std::size_t particle_count() const { return part.size(); }
    std::size_t place_count() const { return places.size() / 3; }
};

struct MlsSettings : Settings {
    /// kappa of the hold's velocity (x_n+1 - x_n)/dt + (x_n - x)/(kappa dt); at least 1.
    double hold_relaxation = 10;
    /// Held particles count this many times in the mass and momentum of the grid: nodes that they
    /// share with free ones follow the hold, so that the clamp lies on its face. On a cantilever
    /// ten times as long as a 10 mm (5 mm) cell the modulus seen is 0.945 (0.983) of the true one
    /// with 100, and 0.71 (0.84) with 1, nearly whatever kappa is.
    double hold_weight = 100;
    /// Substeps between two sorts of the particles by cell: speed only.
    int sort_interval = 32;
};

/// Particles at the output frames (the initial state is frame 0).
template <class T>
struct ParticleTrajectory {
    std::vector<T> position;     // (F + 1, N, 3) [m]
    std::vector<T> velocity;     // (F + 1, N, 3) [m/s]
    std::vector<T> deformation;  // (F + 1, N, 3, 3) [-]
    std::vector<double> reaction = {};  // (F + 1, H, 6) what each hold exerts on the free particles [N, N m], where asked for
};

/// The shapes of Fields where they differ from the total-Lagrangian ones: mu, lambda,
/// stress_volume, mass (N,), deformation0 (N, 3, 3), displacement0 and velocity0 (N, 3),
/// node_force (F, N, 3) on the particles.
template <class T>
class MlsMpm {
  public:
    /// Throws std::invalid_argument where sizes disagree, a place or hold does not exist, or
    /// `hold_compliance` is asked for (this scheme imposes velocities, whatever that takes).
    MlsMpm(MlsGeometry geometry, MlsSettings settings);

    std::size_t particle_count() const { return geometry_.particle_count(); }
    const MlsGeometry& geometry() const { return geometry_; }
    const MlsSettings& settings() const { return settings_; }
    /// Threads that share a run from now on; not to be changed while one is under way.
    void set_threads(int threads) { settings_.threads = threads; }

    /// observer: feedback to the fields' target, or nullptr.
    ParticleTrajectory<T> simulate(const Fields<T>& fields, const Schedule& schedule, const Progress& progress = {},
                                   const Observer* observer = nullptr) const;

    /// The trajectory and its derivative in each direction (directions may leave fields empty).
    std::vector<ParticleTrajectory<T>> tangent(const Fields<T>& fields, const std::vector<Fields<T>>& directions,
                                               const Schedule& schedule, const Progress& progress = {},
                                               const Observer* observer = nullptr) const;

    /// Gradient of a loss whose derivatives by the trajectory are given (members may be empty);
    /// checkpointed. velocity0 has a gradient where it is given. `recomputed` returns the number of substeps computed again.
    Fields<T> adjoint(const Fields<T>& fields, const Schedule& schedule, const ParticleTrajectory<T>& bar,
                      const Progress& progress = {}, long* recomputed = nullptr, const Observer* observer = nullptr) const;

    /// The same where the loss is only known once the trajectory is: one forward run less.
    using Loss = std::function<ParticleTrajectory<T>(const ParticleTrajectory<T>&)>;
    Fields<T> gradient(const Fields<T>& fields, const Schedule& schedule, const Loss& loss, const Progress& progress = {},
                       long* recomputed = nullptr, const Observer* observer = nullptr) const;

    /// Largest squared natural frequency [1/s^2] and largest damping rate [1/s] of the grid
    /// linearised at rest, channels of an actuation as at the start of one interval, by power iteration: symplectic Euler needs dt < 2/omega and dt < 2/rate.
    std::array<double, 2> largest_rates(const Fields<T>& fields, int iterations = 60) const;

    /// Checks the sizes of all inputs; std::invalid_argument names the one that is wrong.
    void check(const Fields<T>& fields, const Schedule& schedule, const Observer* observer = nullptr) const;

  private:
    template <class U, int K>
    friend class MlsParticles;
    template <class U, int K>
    friend class MlsMpmRun;
    template <class U, int K>
    friend class MlsAhead;
    template <class U, int K>
    friend class MlsPulls;
    template <class U, int K>
    friend class MlsActuation;
    template <class U>
    friend class MlsStepReverse;
    template <class U>
    friend class MlsMpmReverse;
    template <class U, int K>
    friend class MlsForces;
    template <class U>
    friend class MlsForcesReverse;
    template <class U>
    friend struct MlsOrder;

    MlsGeometry geometry_;
    MlsSettings settings_;
    Slots slots_;
    ActiveSites sites_;
    std::array<int, 3> axis_{0, 1, 2};  // coordinates in the order of the grid's memory, slowest first
    std::array<double, 3> anchor_{};    // the node that positions are counted from [m]
    std::vector<std::int32_t> place_particle_;
    std::size_t padded_ = 0;  // particles, filled up to whole tiles
    int chunk_count_ = 1;
    std::shared_ptr<MlsWorkspace<T>> workspace_;  // memory that gradients of this model use again
};

extern template class MlsMpm<float>;
extern template class MlsMpm<double>;

}  // namespace mphygs
