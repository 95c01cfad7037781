// What an MLS-MPM run carries: sorted particles, the grid they stand on, and the substep table.
#pragma once

#include <memory>
#include <mutex>
#include <new>
#include <utility>

#include "mphygs/mls_mpm/model.hpp"

namespace mphygs {

inline constexpr std::size_t tile_size = 64;  // particles that are worked on together
inline constexpr int tile_packs = static_cast<int>(tile_size) / lane_count;

/// A box of grid nodes in the order of the grid's memory: slowest axis first, {px, py, pz, m} each.
struct Box {
    std::array<int, 3> low{}, count{};
    std::size_t nodes() const {
        return static_cast<std::size_t>(count[0]) * static_cast<std::size_t>(count[1]) * static_cast<std::size_t>(count[2]);
    }
    std::size_t plane() const { return static_cast<std::size_t>(count[1]) * static_cast<std::size_t>(count[2]); }
};

/// Smallest and largest nearest node of some particles.
struct CellRange {
    std::array<int, 3> low{1 << 30, 1 << 30, 1 << 30}, high{-(1 << 30), -(1 << 30), -(1 << 30)};
    void cover(const CellRange& other) {
        for (std::size_t c = 0; c < 3; ++c) {
            low[c] = std::min(low[c], other.low[c]);
            high[c] = std::max(high[c], other.high[c]);
        }
    }
};

/// Particles lie in groups of sixteen, the numbers of a group together: one stream of memory.
inline constexpr std::size_t group_size = 16;
inline std::size_t slot_of(std::size_t number, std::size_t numbers, std::size_t particle) {
    return (particle / group_size * numbers + number) * group_size + particle % group_size;
}
/// What moves: u = x - x at rest, then H = F - I row by row. x and F themselves would lose what a substep adds
/// to them: next to 0.2 m a float's last digit is what 0.15 mm/s moves in 0.1 ms, next to 1 a thousandth of the
/// strains of a stiff object.
inline constexpr std::size_t moving_numbers = 12;
inline constexpr std::size_t rest_numbers = 3;
inline constexpr std::size_t fixed_numbers = 4;
enum Fixed : std::size_t { fixed_mu, fixed_lambda, fixed_volume, fixed_mass };

/// Particles in the order of their cells, with everything that does not move. `size` counts the
/// padding: particles without mass and volume.
template <class T>
struct MlsOrder {
    std::size_t size = 0;
    int lanes = 1;
    std::vector<std::int32_t> id;                // the caller's number, >= N: padding
    std::vector<T> fixed;                        // (lanes, groups, Fixed, 16); mass with the attached one,
                                                 // of held particles times hold_weight
    std::vector<T> rest;                         // (groups, 3, 16) place at rest, from the anchor [m]
    std::vector<T> own_mass;                     // (lanes, size) without it, where a volume effect has a body force
    std::vector<T> area;                         // (size,)
    std::vector<std::int32_t> hold;              // (size,)
    std::vector<std::int32_t> place_next;        // (size,) first place of a particle, -1: none
    std::vector<unsigned char> held, exposed, placed;  // of each block of eight

    template <int K>
    MlsOrder(const MlsMpm<T>& model, const Inputs<T, K>& inputs, std::vector<std::int32_t> ids);
};

template <class T>
template <int K>
MlsOrder<T>::MlsOrder(const MlsMpm<T>& model, const Inputs<T, K>& inputs, std::vector<std::int32_t> ids)
    : size(ids.size()), lanes(K + 1), id(std::move(ids)) {
    const MlsGeometry& g = model.geometry_;
    const std::size_t count = g.particle_count();
    const std::size_t all = static_cast<std::size_t>(lanes) * size;
    fixed.assign(fixed_numbers * all, T{});
    for (int l = 0; l < lanes; ++l) {
        const Fields<T>* f = l == 0 ? inputs.primal : inputs.direction[l - 1];
        const std::size_t from = static_cast<std::size_t>(l) * fixed_numbers * size;
        const auto fill = [&](Fixed number, const std::vector<T>* values, T pad) {
            for (std::size_t p = 0; p < size; ++p) {
                const std::size_t i = static_cast<std::size_t>(id[p]);
                fixed[from + slot_of(number, fixed_numbers, p)] = i >= count ? pad : (values && !values->empty() ? (*values)[i] : T{});
            }
        };
        const T unit = l == 0 ? T(1) : T(0);
        fill(fixed_mu, f ? &f->mu : nullptr, unit);
        fill(fixed_lambda, f ? &f->lambda : nullptr, unit);
        fill(fixed_volume, f ? &f->stress_volume : nullptr, T{});
        fill(fixed_mass, f ? &f->mass : nullptr, T{});
    }
    rest.resize(rest_numbers * size);
    for (std::size_t p = 0; p < size; ++p) {
        const std::size_t i = std::min(static_cast<std::size_t>(id[p]), count - 1);  // padding stands on the last particle
        for (std::size_t c = 0; c < 3; ++c) {
            rest[slot_of(c, rest_numbers, p)] = static_cast<T>(g.points[3 * i + c] - model.anchor_[c]);
        }
    }
    if (model.sites_.body_volume) {
        own_mass.resize(all);
        for (std::size_t p = 0; p < size; ++p) {
            for (std::size_t l = 0; l < static_cast<std::size_t>(lanes); ++l) {
                own_mass[l * size + p] = fixed[l * fixed_numbers * size + slot_of(fixed_mass, fixed_numbers, p)];
            }
        }
    }
    hold.assign(size, -1);
    const T weight = static_cast<T>(model.settings_.hold_weight);
    place_next.assign(size, -1);
    held.assign(size / lane_count, 0);
    exposed = placed = held;
    if (model.sites_.surface) {
        area.assign(size, T{});
    }
    std::vector<std::int32_t> first(count, -1);
    for (std::size_t q = g.place_count(); q-- > 0;) {
        first[static_cast<std::size_t>(model.place_particle_[q])] = static_cast<std::int32_t>(q);
    }
    for (std::size_t p = 0; p < size; ++p) {
        const std::size_t i = static_cast<std::size_t>(id[p]);
        if (i >= count) {
            continue;
        }
        if (!g.hold.empty()) {
            hold[p] = g.hold[i];
            held[p / lane_count] |= hold[p] >= 0;
        }
        if (model.sites_.surface && !g.surface_area.empty()) {
            area[p] = static_cast<T>(g.surface_area[i]);
            exposed[p / lane_count] |= area[p] != T{};
        }
        place_next[p] = first[i];
        placed[p / lane_count] |= first[i] >= 0;
        if (first[i] >= 0 && model.sites_.mass) {
            for (std::size_t q = 0; q < g.place_count(); ++q) {
                if (model.place_particle_[q] == id[p]) {
                    for (int l = 0; l < lanes; ++l) {
                        fixed[static_cast<std::size_t>(l) * fixed_numbers * size + slot_of(fixed_mass, fixed_numbers, p)] +=
                            lane_of(inputs.plain(&Fields<T>::place_mass, q), l);
                    }
                }
            }
        }
        for (std::size_t l = 0; hold[p] >= 0 && l < static_cast<std::size_t>(lanes); ++l) {
            fixed[l * fixed_numbers * size + slot_of(fixed_mass, fixed_numbers, p)] *= weight;
        }
    }
}

/// Vectors whose new elements are not set: what a pass writes whole.
template <class T>
struct Unset : std::allocator<T> {
    template <class U>
    struct rebind {
        using other = Unset<U>;
    };
    template <class U>
    void construct(U* p) {
        ::new (static_cast<void*>(p)) U;
    }
    template <class U, class... A>
    void construct(U* p, A&&... a) {
        ::new (static_cast<void*>(p)) U(std::forward<A>(a)...);
    }
};
template <class T>
using Buffer = std::vector<T, Unset<T>>;

/// Buffers of the adjoint's records, kept by the model from one gradient to the next: fresh memory
/// costs more than the substep that fills it.
template <class T>
class MlsPool {
  public:
    Buffer<T> take(std::size_t size) {
        Buffer<T> b;
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            if (!free_.empty()) {
                b = std::move(free_.back());
                free_.pop_back();
            }
        }
        if (b.capacity() < size) {
            b = Buffer<T>();
            b.reserve(size + size / 4);  // grids grow
        }
        b.resize(size);
        return b;
    }
    void give(Buffer<T>&& b) {
        if (b.capacity() > 0) {
            const std::lock_guard<std::mutex> lock(mutex_);
            free_.push_back(std::move(b));
        }
    }

  private:
    std::mutex mutex_;
    std::vector<Buffer<T>> free_;
};
template <class T>
struct MlsWorkspace {
    MlsPool<T> moving, grid;
};

/// State n of a run: the particles at n and the velocities {vx, vy, vz, m} of the grid at n, ready
/// to be gathered. History is that of the effects after their forces at n.
template <class T>
struct MlsState {
    std::shared_ptr<const MlsOrder<T>> order;
    Buffer<T> moving;        // (lanes, groups, 12, 16): u [m], F - I
    std::vector<T> history;  // (lanes, numbers, size)
    Buffer<T> grid;          // (lanes, nodes, 4)
    Box box;
    std::vector<CellRange> ranges;  // of each chunk
};

/// Frame, time and length of every substep.
struct StepTable {
    std::vector<int> frame;
    std::vector<double> time, dt;

    explicit StepTable(const Schedule& schedule) {
        double start = schedule.start;
        for (int f = 0; f < schedule.frame_count(); ++f) {
            const double h = schedule.dt[static_cast<std::size_t>(f)];
            const int count = schedule.steps[static_cast<std::size_t>(f)];
            for (int s = 0; s < count; ++s) {
                frame.push_back(f);
                time.push_back(start + s * h);
                dt.push_back(h);
            }
            start += count * h;
        }
    }
    int count() const { return static_cast<int>(frame.size()); }
    /// Whether state n is an output frame.
    bool is_frame(int n) const {
        return n == 0 || n == count() || frame[static_cast<std::size_t>(n)] != frame[static_cast<std::size_t>(n - 1)];
    }
    int frame_of_state(int n) const { return n == 0 ? 0 : frame[static_cast<std::size_t>(n - 1)] + 1; }
};

}  // namespace mphygs
