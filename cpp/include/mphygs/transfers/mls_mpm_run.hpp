// One run of the MLS-MPM transfer: values and tangents, substep by substep.
//
// A pass goes from state n to state n + 1 in one sweep over the particles: gather at n, move,
// stress, scatter at n + 1; the velocities and C never leave the tile. Chunks of consecutive
// sorted particles scatter to grids of their own, which are summed in the order of the chunks.
#pragma once

#include <algorithm>
#include <cmath>
#include <sstream>

#include "mphygs/team.hpp"
#include "mphygs/transfers/mls_mpm_forces.hpp"
#include "mphygs/transfers/mls_mpm_grids.hpp"
#include "mphygs/transfers/mls_mpm_plain.hpp"

namespace mphygs {

template <class T, int K>
class MlsMpmRun {
  public:
    using S = PackScalar<T, K>;
    using P = Pack<T>;
    static constexpr int lanes = K + 1;

    /// team: whose threads share the work of a substep.
    MlsMpmRun(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const Schedule& schedule, Team& team)
        : model_(model), team_(&team), inputs_(inputs), table_(schedule), forces_(model, inputs, table_),
          inverse_spacing_(static_cast<T>(1.0 / model.geometry_.spacing)), grids_(model.chunk_count_, lanes) {
        failed_.assign(static_cast<std::size_t>(model.chunk_count_), -1);
        place_particles();
    }

    /// From the initial particles to state 0.
    void begin() {
        if (table_.count() == 0) {
            return;
        }
        const Box box = reach();
        start_affine_.assign(static_cast<std::size_t>(lanes) * 9 * size(), T{});
        for (int round = 0; round <= start_rounds(); ++round) {
            start_round(box, round > 0, round == start_rounds());
        }
        for (std::vector<T>* done : {&start_velocity_, &start_affine_}) {
            done->clear();
            done->shrink_to_fit();
        }
    }

    /// Rounds that find C_0; none where the motion starts from rest.
    int start_rounds() const { return inputs_.primal->velocity0.empty() ? 0 : 4; }

    /// Scatters the initial velocities with what is known of C_0, after improving it from the grid
    /// of the round before. A linear field is its fixed point, also at the surface.
    void start_round(const Box& box, bool improve, bool real) {
        if (real) {
            forces_.refresh(0);
        }
        grids_.prepare(box, state_.ranges);
        team_->each(model_.chunk_count_, [&](int c) { start_chunk(static_cast<std::size_t>(c), box, improve, real); });
        grids_.reduce(box, state_.ranges, *team_, state_.grid);
        state_.box = box;
    }

    /// Sorts the particles where substep `n` calls for it; to be called before the state is kept.
    void prepare(int n) {
        if (n % model_.settings_.sort_interval == 0) {
            sort();
        }
    }

    /// Substep `n`: from state n to state n + 1. `record`: keeps state n as it was.
    void step(int n, MlsState<T>* record = nullptr) {
        prepare(n);
        from_ = &state_.moving;
        if (record) {
            record->order = state_.order;
            record->history = state_.history;
            record->box = state_.box;
            record->ranges = state_.ranges;
            record->moving = std::move(state_.moving);
            from_ = &record->moving;
            state_.moving = model_.workspace_->moving.take(record->moving.size());
        }
        const bool forces = n + 1 < table_.count();
        const bool output = table_.is_frame(n + 1);
        const T h = static_cast<T>(table_.dt[static_cast<std::size_t>(n)]);
        if (output) {
            velocity_.resize(static_cast<std::size_t>(lanes) * 3 * size());
        }
        const Box next = reach();
        if (forces) {
            forces_.refresh(n + 1);
            grids_.prepare(next, state_.ranges);
        }
        std::vector<CellRange> ranges(state_.ranges.size());
        team_->each(model_.chunk_count_, [&](int c) {
            advance_chunk(static_cast<std::size_t>(c), h, next, forces, output, ranges[static_cast<std::size_t>(c)]);
        });
        stop_if_failed(n);
        state_.ranges = std::move(ranges);
        if (record) {
            record->grid = std::move(state_.grid);
            state_.grid = model_.workspace_->grid.take(record->grid.size());
        }
        if (forces) {
            grids_.reduce(next, state_.ranges, *team_, state_.grid);
            state_.box = next;
        }
        if (output) {
            stop_if_not_finite(table_.frame_of_state(n + 1), table_.time[static_cast<std::size_t>(n)] + static_cast<double>(h));
        }
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

    /// K = 1, at the initial state: turns lane 1 of the grid from a field u of velocities into the
    /// acceleration that follows from the deformation u grad (`rates` false) or from the velocity u
    /// itself, its inertia left out (`rates` true). `field`: (nodes, 4).
    void linearise(std::vector<T>& field, bool rates) {
        const Box box = reach();
        forces_.refresh(0);
        const T h = forces_.dt();
        const std::size_t numbers = 4 * box.nodes();
        field.resize(numbers, T{});
        state_.grid.assign(lanes * numbers + 4, T{});
        std::copy(field.begin(), field.end(), state_.grid.begin() + static_cast<std::ptrdiff_t>(numbers));
        grids_.prepare(box, state_.ranges);
        std::vector<T> history = state_.history;
        for (std::size_t c = 0; c < state_.ranges.size(); ++c) {
            const CellRange inside = limits(c, box, 0);
            SeenRange<Pack<T>> seen;
            MlsTile<T, K> tile;
            for (std::size_t t = chunk_begin(c); t < chunk_begin(c + 1); t += tile_size) {
                ParticlePoint<S> points[tile_packs];
                for (int k = 0; k < tile_packs; ++k) {
                    points[k] = load_particles(t + static_cast<std::size_t>(k * lane_count), state_.moving);
                    locate(tile, k, points[k].x, inverse_spacing_, model_.axis_, box, inside, seen);
                }
                gather_tile<T, K>(tile, state_.grid.data(), numbers, model_.axis_, box);
                for (int k = 0; k < tile_packs; ++k) {
                    const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                    const Mat3<S> gradient = affine_velocity(tile.get_n(k));
                    if (rates) {
                        points[k].v = tile.get_q(k);
                        points[k].c = gradient;
                    } else {
                        points[k].f = points[k].f + gradient * points[k].f;
                    }
                    give(tile, k, p, points[k], history.data());
                    const S mass = tile.get_mass(k);
                    tile.set_q(k, tile.get_q(k) - mass * points[k].v);
                    tile.set_n(k, tile.get_n(k) - (static_cast<T>(model_.geometry_.spacing) * mass) * points[k].c);
                }
                scatter_tile<T, K>(tile, grids_.private_grid(c), grids_.lane_stride(c), model_.axis_, box);
            }
        }
        // The sum sets the planes that particles reach; what was read must not stay on the others.
        std::fill(state_.grid.begin(), state_.grid.end(), T{});
        grids_.reduce(box, state_.ranges, *team_, state_.grid);
        for (std::size_t i = 0; i < numbers; ++i) {
            field[i] = i % 4 == 3 ? T{} : state_.grid[numbers + i] / h;
        }
    }

    const StepTable& table() const { return table_; }
    MlsState<T>& state() { return state_; }
    std::size_t size() const { return model_.padded_; }

  private:
    template <class TT>
    friend class MlsMpmReverse;
    template <class TT>
    friend class MlsMpm;

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
        start_velocity_ = velocity_;
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
                const PackMask<T> index = __builtin_convertvector(nearest(scaled), PackMask<T>);
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

    /// C = 4/h^2 sum w v (x_i - x)^T from the moment in cell units.
    Mat3<S> affine_velocity(const Mat3<S>& moment) const {
        return constant<S>(T(4) * inverse_spacing_) * moment;
    }

    void give(MlsTile<T, K>& tile, int pack, std::size_t p, const ParticlePoint<S>& point, T* history) const {
        Vec3<S> momentum;
        Mat3<S> affine;
        forces_.evaluate(*state_.order, p, point, history, momentum, affine);
        tile.set_q(pack, momentum);
        tile.set_n(pack, constant<S>(static_cast<T>(model_.geometry_.spacing)) * affine);
        tile.set_mass(pack, forces_.fixed(*state_.order, fixed_mass, p));
    }

    ParticlePoint<S> load_start(std::size_t p) const {
        ParticlePoint<S> point = load_particles(p, state_.moving);
        const std::size_t n = size();
        for (int l = 0; l < lanes; ++l) {
            const std::size_t lane = static_cast<std::size_t>(l);
            for (std::size_t c = 0; c < 3; ++c) {
                lane_of(point.v[static_cast<int>(c)], l) = load<T>(&start_velocity_[(3 * lane + c) * n + p]);
            }
            for (std::size_t k = 0; k < 9; ++k) {
                lane_of(point.c.e[k / 3][k % 3], l) = load<T>(&start_affine_[(9 * lane + k) * n + p]);
            }
        }
        return point;
    }

    void start_chunk(std::size_t c, const Box& box, bool improve, bool real) {
        const CellRange inside = limits(c, box, 0);
        SeenRange<Pack<T>> seen;
        MlsTile<T, K> tile;
        const std::size_t n = size();
        for (std::size_t t = chunk_begin(c); t < chunk_begin(c + 1); t += tile_size) {
            ParticlePoint<S> points[tile_packs];
            for (int k = 0; k < tile_packs; ++k) {
                points[k] = load_start(t + static_cast<std::size_t>(k * lane_count));
                locate(tile, k, points[k].x, inverse_spacing_, model_.axis_, box, inside, seen);
            }
            if (improve) {
                gather_tile<T, K>(tile, state_.grid.data(), 4 * box.nodes(), model_.axis_, box);
            }
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                if (improve) {
                    points[k].c = affine_velocity(tile.get_n(k));
                    for (int l = 0; l < lanes; ++l) {
                        for (std::size_t e = 0; e < 9; ++e) {
                            store<T>(&start_affine_[(9 * static_cast<std::size_t>(l) + e) * n + p], lane_of(points[k].c.e[e / 3][e % 3], l));
                        }
                    }
                }
                if (real) {
                    give(tile, k, p, points[k], state_.history.data());
                } else {
                    give_velocity(tile, k, p, points[k]);
                }
            }
            scatter_tile<T, K>(tile, grids_.private_grid(c), grids_.lane_stride(c), model_.axis_, box);
        }
    }
    void give_velocity(MlsTile<T, K>& tile, int pack, std::size_t p, const ParticlePoint<S>& point) const {
        const S mass = forces_.fixed(*state_.order, fixed_mass, p);
        tile.set_mass(pack, mass);
        tile.set_q(pack, mass * point.v);
        tile.set_n(pack, (static_cast<T>(model_.geometry_.spacing) * mass) * point.c);
    }

    /// Overwrites the momentum of a held particle of a hot tile.
    void give_held(MlsTile<T, 0>& tile, std::size_t at, std::size_t hold, std::size_t id, std::size_t c, T u) const {
        const int k = static_cast<int>(c);
        tile.q[0][c][at] = tile.mass[0][at] * (forces_.held_velocity(hold, id, k, u) + forces_.dt() * forces_.gravity(k));
    }
    PlainPass<T> plain_pass(T h, bool forces) const {
        return {size(), inverse_spacing_, h, forces, forces_.dt(),
                {forces_.gravity(0), forces_.gravity(1), forces_.gravity(2)}};
    }
    /// Stands a tile where its particles are; they are known to be inside.
    void stand_tile(MlsTile<T, 0>& tile, const MlsOrder<T>& order, const Buffer<T>& from, const Box& box, std::size_t first,
                    const CellRange& inside) const {
        using W = Wide<T>;
        SeenRange<W> ignored;
        for (std::size_t k = 0; k < tile_size; k += MlsVector<T>::wide_count) {
            W scaled[3];
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t a = static_cast<std::size_t>(model_.axis_[c]);
                scaled[c] = (read<W>(&order.rest[slot_of(a, rest_numbers, first + k)]) + read<W>(&from[slot_of(a, moving_numbers, first + k)])) *
                            inverse_spacing_;
            }
            stand<W, T>(scaled, static_cast<int>(k), tile.s[0], tile.corner, box, inside, ignored);
        }
    }

    void advance_chunk(std::size_t c, T h, const Box& next, bool forces, bool output, CellRange& range) {
        SeenRange<Pack<T>> seen;
        const CellRange now = limits(c, state_.box, 0), then = limits(c, next, 1);
        SeenRange<Pack<T>> ignored;
        MlsTile<T, K> tile;
        T* out = forces ? grids_.private_grid(c) : nullptr;
        const std::size_t n = size();
        SeenRange<Wide<T>> seen_wide;
        const bool plain = K == 0 && forces_.plain();
        for (std::size_t t = chunk_begin(c); t < chunk_begin(c + 1); t += tile_size) {
            if constexpr (K == 0) {
                if (plain && forces_.plain_tile(*state_.order, t)) {
                    stand_tile(tile, *state_.order, *from_, state_.box, t, now);
                    gather_rows<T>(tile, state_.grid.data(), model_.axis_, state_.box);
                    const PlainPass<T> pass = plain_pass(h, forces);
                    const long failed = mphygs::plain_tile<T>(tile, t, pass, from_->data(), state_.moving.data(), output ? velocity_.data() : nullptr,
                                                                *state_.order, model_.axis_, next, then, seen_wide);
                    failed_[c] = failed_[c] < 0 ? failed : failed_[c];
                    if (forces) {
                        forces_.each_held_of_tile(*state_.order, t, [&](std::size_t p, std::size_t hold, std::size_t id) {
                            for (std::size_t a = 0; a < 3; ++a) {
                                give_held(tile, p - t, hold, id, a, state_.moving[slot_of(a, moving_numbers, p)]);
                            }
                        });
                        scatter_rows<T>(tile, out, model_.axis_, next);
                    }
                    continue;
                }
            }
            ParticlePoint<S> points[tile_packs];
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                points[k] = load_moving<T, K>(from_->data(), n, p);
                locate(tile, k, placed<T, K>(*state_.order, p, points[k].x), inverse_spacing_, model_.axis_, state_.box, now, ignored);
            }
            gather_tile<T, K>(tile, state_.grid.data(), 4 * state_.box.nodes(), model_.axis_, state_.box);
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                ParticlePoint<S>& point = points[k];
                point.v = tile.get_q(k);
                point.c = affine_velocity(tile.get_n(k));
                for (int a = 0; a < 3; ++a) {
                    point.x[a] = point.x[a] + h * point.v[a];
                }
                point.f = strained(point.f, point.c, constant<S>(h));
                store_moving<T, K>(state_.moving.data(), n, p, point);
                complete<T, K>(*state_.order, p, point);
                for (int l = 0; output && l < lanes; ++l) {
                    for (std::size_t a = 0; a < 3; ++a) {
                        store<T>(&velocity_[(3 * static_cast<std::size_t>(l) + a) * n + p], lane_of(point.v[static_cast<int>(a)], l));
                    }
                }
                const PackMask<T> bad = locate(tile, k, point.x, inverse_spacing_, model_.axis_, next, then, seen);
                if (any(bad) && failed_[c] < 0) {
                    int q = 0;
                    while (bad[q] == 0) {
                        ++q;
                    }
                    failed_[c] = static_cast<long>(p) + q;
                }
                if (forces) {
                    give(tile, k, p, point, state_.history.data());
                }
            }
            if (forces) {
                scatter_tile<T, K>(tile, out, grids_.lane_stride(c), model_.axis_, next);
            }
        }
        range = seen.range();
        range.cover(seen_wide.range());
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
    Team* team_;
    Inputs<T, K> inputs_;
    StepTable table_;
    MlsForces<T, K> forces_;
    T inverse_spacing_;
    MlsState<T> state_;
    const Buffer<T>* from_ = nullptr;  // what moves, before the pass
    std::vector<T> velocity_, start_velocity_, start_affine_;  // (lanes, 3 or 9, size)
    MlsGrids<T> grids_;
    std::vector<long> failed_;  // per chunk, first particle that left its limits, -1: none
};

}  // namespace mphygs
