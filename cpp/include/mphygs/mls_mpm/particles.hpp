// The particles of an MLS-MPM run: placed, sorted by the cells of the grid, handed out at frames, checked.
#pragma once

#include <algorithm>
#include <cmath>
#include <sstream>

#include "mphygs/mls_mpm/forces.hpp"
#include "mphygs/mls_mpm/lanes.hpp"

namespace mphygs {

template <class T, int K>
class MlsParticles {
  public:
    using S = PackScalar<T, K>;
    using P = Pack<T>;
    static constexpr int lanes = K + 1;

    MlsParticles(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const Schedule& schedule)
        : model_(model), inputs_(inputs), table_(schedule), inverse_spacing_(static_cast<T>(1.0 / model.geometry_.spacing)) {
        failed_.assign(static_cast<std::size_t>(model.chunk_count_), -1);
        place_particles();
    }

    /// Copies lane l to (N, 3), (N, 3), (N, 3, 3) arrays. Velocities are those of the last frame.
    void output(int l, T* position, T* velocity, T* deformation) const {
        const std::size_t count = model_.particle_count(), n = size(), lane = static_cast<std::size_t>(l);
        for (std::size_t p = 0; p < n; ++p) {
            const std::size_t i = static_cast<std::size_t>(state_.order->id[p]);
            if (i >= count) {
                continue;
            }
            for (std::size_t c = 0; c < 3; ++c) {
                position[3 * i + c] = state_.moving[lane * moving_numbers * n + slot_of(c, moving_numbers, p)];
                if (l == 0) {
                    position[3 * i + c] = static_cast<T>(static_cast<double>(position[3 * i + c]) + model_.geometry_.points[3 * i + c]);
                }
                velocity[3 * i + c] = velocity_[(3 * lane + c) * n + p];
            }
            for (std::size_t k = 0; k < 9; ++k) {
                deformation[9 * i + k] = state_.moving[lane * moving_numbers * n + slot_of(3 + k, moving_numbers, p)] + identity(k, l);
            }
        }
    }

    const StepTable& table() const { return table_; }
    MlsState<T>& state() { return state_; }
    std::size_t size() const { return model_.padded_; }

  protected:
    std::size_t chunk_begin(std::size_t c) const {
        return tile_size * part_begin(size() / tile_size, model_.chunk_count_, static_cast<int>(c));
    }

    /// Number k of the identity, in lane l: the derivatives have none.
    static T identity(std::size_t k, int l) { return l == 0 && k % 4 == 0 ? T(1) : T(0); }

    void place_particles() {
        const std::size_t n = size(), count = model_.particle_count();
        std::vector<std::int32_t> ids(n);
        state_.moving.assign(lanes * moving_numbers * n, T{});
        state_.history.assign(lanes * static_cast<std::size_t>(model_.sites_.history) * n, T{});
        velocity_.assign(lanes * 3 * n, T{});
        for (std::size_t p = 0; p < n; ++p) {
            ids[p] = static_cast<std::int32_t>(p);
            const std::size_t i = std::min(p, count - 1);  // padding stands on the last particle
            for (int l = 0; l < lanes; ++l) {
                const std::size_t lane = static_cast<std::size_t>(l);
                for (std::size_t c = 0; c < 3; ++c) {
                    state_.moving[lane * moving_numbers * n + slot_of(c, moving_numbers, p)] =
                        lane_of(inputs_.plain(&Fields<T>::displacement0, 3 * i + c), l);
                    velocity_[(3 * lane + c) * n + p] = lane_of(inputs_.plain(&Fields<T>::velocity0, 3 * i + c), l);
                }
                for (std::size_t k = 0; k < 9; ++k) {
                    T& f = state_.moving[lane * moving_numbers * n + slot_of(3 + k, moving_numbers, p)];
                    if (!inputs_.primal->deformation0.empty() && p < count) {
                        f = lane_of(inputs_.plain(&Fields<T>::deformation0, 9 * i + k), l) - identity(k, l);
                    } else {
                        f = T{};
                    }
                }
            }
        }
        state_.order = std::make_shared<MlsOrder<T>>(model_, inputs_, std::move(ids));
        sort();
    }

    /// Cells in the order of the grid's memory, a stable counting sort.
    void sort() {
        const std::size_t n = size();
        std::vector<std::int32_t> key(n), from(n);
        std::array<std::vector<std::int32_t>, 3> node;
        CellRange all;
        for (std::size_t c = 0; c < 3; ++c) {
            node[c].resize(n);
            for (std::size_t p = 0; p < n; p += lane_count) {
                const std::size_t a = static_cast<std::size_t>(model_.axis_[c]);
                const P scaled = (load<T>(&state_.order->rest[slot_of(a, rest_numbers, p)]) +
                                  load<T>(&state_.moving[slot_of(a, moving_numbers, p)])) *
                                 inverse_spacing_;
                const PackMask<T> index = convert<PackMask<T>>(nearest(scaled));
                for (int q = 0; q < lane_count; ++q) {
                    node[c][p + static_cast<std::size_t>(q)] = static_cast<std::int32_t>(index[q]);
                }
            }
            const auto [low, high] = std::minmax_element(node[c].begin(), node[c].end());
            all.low[c] = *low;
            all.high[c] = *high;
        }
        check_extent(all);
        std::size_t cells = 1;
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t width = static_cast<std::size_t>(all.high[c] - all.low[c] + 1);
            for (std::size_t p = 0; p < n; ++p) {
                key[p] = key[p] * static_cast<std::int32_t>(width) + (node[c][p] - all.low[c]);
            }
            cells *= width;
        }
        std::vector<std::int32_t> start(cells + 1, 0);
        for (const std::int32_t k : key) {
            ++start[static_cast<std::size_t>(k) + 1];
        }
        for (std::size_t k = 0; k < cells; ++k) {
            start[k + 1] += start[k];
        }
        for (std::size_t p = 0; p < n; ++p) {
            from[static_cast<std::size_t>(start[static_cast<std::size_t>(key[p])]++)] = static_cast<std::int32_t>(p);
        }
        permute(from);
        state_.ranges.assign(static_cast<std::size_t>(model_.chunk_count_), {});
        for (std::size_t k = 0; k < state_.ranges.size(); ++k) {
            for (std::size_t p = chunk_begin(k); p < chunk_begin(k + 1); ++p) {
                for (std::size_t c = 0; c < 3; ++c) {
                    const int at = node[c][static_cast<std::size_t>(from[p])];
                    state_.ranges[k].low[c] = std::min(state_.ranges[k].low[c], at);
                    state_.ranges[k].high[c] = std::max(state_.ranges[k].high[c], at);
                }
            }
        }
    }

    void permute(const std::vector<std::int32_t>& from) {
        const std::size_t n = size();
        std::vector<std::int32_t> ids(n);
        bool moved = false;
        for (std::size_t p = 0; p < n; ++p) {
            ids[p] = state_.order->id[static_cast<std::size_t>(from[p])];
            moved |= from[p] != static_cast<std::int32_t>(p);
        }
        if (!moved) {
            return;
        }
        permute_moving(state_.moving, from);
        permute_columns(state_.history, from);
        permute_columns(velocity_, from);
        state_.order = std::make_shared<MlsOrder<T>>(model_, inputs_, std::move(ids));
    }
    static void permute_moving(Buffer<T>& moving, const std::vector<std::int32_t>& from) {
        Buffer<T> next(moving.size());
        for (std::size_t start = 0; start < moving.size(); start += moving_numbers * from.size()) {
            for (std::size_t p = 0; p < from.size(); ++p) {
                for (std::size_t k = 0; k < moving_numbers; ++k) {
                    next[start + slot_of(k, moving_numbers, p)] =
                        moving[start + slot_of(k, moving_numbers, static_cast<std::size_t>(from[p]))];
                }
            }
        }
        moving = std::move(next);
    }
    static void permute_columns(std::vector<T>& columns, const std::vector<std::int32_t>& from) {
        std::vector<T> next(columns.size());
        for (std::size_t start = 0; start < columns.size(); start += from.size()) {
            for (std::size_t p = 0; p < from.size(); ++p) {
                next[start + p] = columns[start + static_cast<std::size_t>(from[p])];
            }
        }
        columns = std::move(next);
    }

    /// The nodes that particles may touch within one substep: each may move by one cell.
    Box reach() const {
        CellRange all;
        for (const CellRange& r : state_.ranges) {
            all.cover(r);
        }
        check_extent(all);
        Box box;
        for (std::size_t c = 0; c < 3; ++c) {
            box.low[c] = all.low[c] - 2;
            box.count[c] = all.high[c] - all.low[c] + 5;
        }
        return box;
    }

    /// The grid is dense over the particles' box: scattered particles would ask for all memory.
    void check_extent(const CellRange& all) const {
        double bytes = 4.0 * sizeof(T) * lanes;
        std::ostringstream text;
        for (std::size_t c = 0; c < 3; ++c) {
            const double width = static_cast<double>(all.high[c]) - static_cast<double>(all.low[c]) + 5;
            bytes *= width;
            text << (c ? " x " : "") << width;
        }
        if (!(bytes < 4.0 * (1u << 30)) || all.low[0] < -(1 << 28)) {
            throw SimulationError("the particles spread over a box of " + text.str() +
                                  " cells, more than 4 GB of grid: a position is wrong, the run is unstable, or the spacing is "
                                  "too small for the object");
        }
    }

    /// Where the nearest nodes of chunk c may lie after one substep.
    CellRange limits(std::size_t c, const Box& box, int motion) const {
        CellRange r;
        for (std::size_t k = 0; k < 3; ++k) {
            r.low[k] = k == 0 ? state_.ranges[c].low[0] - motion : box.low[k] + 1;
            r.high[k] = k == 0 ? state_.ranges[c].high[0] + motion : box.low[k] + box.count[k] - 2;
        }
        return r;
    }

    ParticlePoint<S> load_particles(std::size_t p, const Buffer<T>& from) const {
        ParticlePoint<S> point = load_moving<T, K>(from.data(), size(), p);
        complete<T, K>(*state_.order, p, point);
        return point;
    }

    [[noreturn]] void stop(std::size_t p, int frame, double time, const std::string& cause) const {
        const std::size_t i = static_cast<std::size_t>(state_.order->id[p]);
        const int part = model_.geometry_.part[std::min(i, model_.particle_count() - 1)];
        std::ostringstream text;
        text << "unstable before output frame " << frame << " (t = " << time << " s), first in part " << part << ": " << cause
             << "; the substep is too long for the stiffest part, or the material has inverted";
        SimulationError error(text.str());
        error.frame = frame;
        error.part = part;
        throw error;
    }

    void stop_if_failed(int n) {
        for (const long f : failed_) {
            if (f < 0) {
                continue;
            }
            for (std::size_t p = static_cast<std::size_t>(f) / lane_count * lane_count; p < size(); ++p) {
                for (std::size_t c = 0; c < 3; ++c) {
                    if (!std::isfinite(state_.moving[slot_of(c, moving_numbers, p)])) {
                        stop(p, table_.frame[static_cast<std::size_t>(n)] + 1, table_.time[static_cast<std::size_t>(n)],
                             "a position is not finite");
                    }
                }
            }
            stop(static_cast<std::size_t>(f), table_.frame[static_cast<std::size_t>(n)] + 1,
                 table_.time[static_cast<std::size_t>(n)], "a particle moved by more than one cell in one substep");
        }
    }

    void stop_if_not_finite(int frame, double time) const {
        const T limit = static_cast<T>(model_.settings_.displacement_limit);
        const std::size_t n = size();
        for (std::size_t p = 0; p < n; ++p) {
            bool good = true;
            for (int l = 0; l < lanes; ++l) {
                const std::size_t lane = static_cast<std::size_t>(l);
                for (std::size_t c = 0; c < 3; ++c) {
                    good &= std::isfinite(velocity_[(3 * lane + c) * n + p]);
                }
                for (std::size_t k = 0; k < moving_numbers; ++k) {
                    good &= std::isfinite(state_.moving[lane * moving_numbers * n + slot_of(k, moving_numbers, p)]);
                }
            }
            if (!good) {
                stop(p, frame, time, "a position or deformation is not finite");
            }
            const std::size_t i = static_cast<std::size_t>(state_.order->id[p]);
            for (std::size_t c = 0; i < model_.particle_count() && c < 3; ++c) {
                if (!(std::abs(state_.moving[slot_of(c, moving_numbers, p)]) < limit)) {
                    stop(p, frame, time, "a displacement is above the limit");
                }
            }
        }
    }

    const MlsMpm<T>& model_;
    Inputs<T, K> inputs_;
    StepTable table_;
    T inverse_spacing_;
    MlsState<T> state_;
    std::vector<T> velocity_;   // (lanes, 3, size)
    std::vector<long> failed_;  // per chunk, first particle that left its limits, -1: none
};

}  // namespace mphygs
