// One run of the MLS-MPM transfer: values and tangents, substep by substep.
//
// A pass goes from state n to state n + 1 in one sweep over the particles: gather at n, move,
// stress, scatter at n + 1; the velocities and C never leave the tile. Chunks of consecutive
// sorted particles scatter to grids of their own, which are summed in the order of the chunks.
#pragma once

#include <algorithm>
#include <optional>

#include "mphygs/mls_mpm/actuation.hpp"
#include "mphygs/mls_mpm/grids.hpp"
#include "mphygs/mls_mpm/particles.hpp"
#include "mphygs/mls_mpm/plain.hpp"
#include "mphygs/mls_mpm/pulls.hpp"
#include "mphygs/numerics/team.hpp"
#include "mphygs/physics/reaction.hpp"

namespace mphygs {

template <class T, int K>
class MlsMpmRun : public MlsParticles<T, K> {
  public:
    using Particles = MlsParticles<T, K>;
    using typename Particles::P, typename Particles::S;
    using Particles::lanes, Particles::size;

    /// team: whose threads share the work of a substep.
    MlsMpmRun(const MlsMpm<T>& model, const Inputs<T, K>& inputs, const Schedule& schedule, Team& team)
        : Particles(model, inputs, schedule), team_(&team), forces_(model, inputs_, table_), grids_(model.chunk_count_, lanes),
          reactions_(model.geometry_.hold_count, schedule, lanes) {
        if (reactions_.wanted()) {
            const std::size_t numbers = lanes * static_cast<std::size_t>(model.geometry_.hold_count) * wrench_size;
            given_.assign(static_cast<std::size_t>(model.chunk_count_), std::vector<double>(numbers, 0.0));
            taken_ = given_;
        }
        start_velocity_ = velocity_;
        if (inputs.observer) {
            pulls_.emplace(model, inputs_, schedule, table_);
        }
        if (!inputs.primal->channel.empty()) {
            actuation_.emplace(model, inputs_, schedule, table_);
        }
    }

    /// From the initial particles to state 0.
    void begin();

    /// Rounds that find C_0; none where the motion starts from rest.
    int start_rounds() const { return inputs_.primal->velocity0.empty() ? 0 : 4; }

    /// Scatters the initial velocities with what is known of C_0, after improving it from the grid
    /// of the round before. A linear field is its fixed point, also at the surface.
    void start_round(const Box& box, bool improve, bool real);

    /// What every hold exerts at the output frames, of the values or of a direction: see `ParticleTrajectory`.
    std::vector<double> reaction(int lane) const { return reactions_.of(static_cast<std::size_t>(lane)); }

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
            look(n, state_.order, from_->data(), state_.grid.data(), state_.box);
            forces_.refresh(n + 1);
            grids_.prepare(next, state_.ranges);
        }
        now_ = n;
        std::vector<CellRange> ranges(state_.ranges.size());
        team_->each(model_.chunk_count_, [&](int c) {
            advance_chunk(static_cast<std::size_t>(c), h, next, forces, output, ranges[static_cast<std::size_t>(c)]);
        });
        stop_if_failed(n);
        react(taken_, n, -1.0);
        if (forces) {
            react(given_, n + 1, 1.0);
        }
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

    /// Finds what the observer and the loads give at n + 1, from the state at n.
    void look(int n, const std::shared_ptr<const MlsOrder<T>>& order, const T* moving, const T* grid, const Box& box) {
        if (pulls_ && pulls_->enter(n + 1)) {
            follow(order);
            pulls_->see(moving, grid, box, static_cast<T>(table_.dt[static_cast<std::size_t>(n)]));
            pulls_->spread(*team_);
        }
        if (actuation_) {
            actuation_->enter(n + 1);
            follow_loads(order);
            actuation_->see(moving, grid, box, static_cast<T>(table_.dt[static_cast<std::size_t>(n)]));
            actuation_->spread();
        }
    }

    /// K = 1, at the initial state: turns lane 1 of the grid from a field u of velocities into the
    /// acceleration that follows from the deformation u grad (`rates` false) or from the velocity u
    /// itself, its inertia left out (`rates` true). `field`: (nodes, 4).
    void linearise(std::vector<T>& field, bool rates);

  private:
    template <class TT>
    friend class MlsStepReverse;
    template <class TT>
    friend class MlsMpmReverse;
    template <class TT>
    friend class MlsMpm;

    /// C = 4/h^2 sum w v (x_i - x)^T from the moment in cell units.
    Mat3<S> affine_velocity(const Mat3<S>& moment) const {
        return constant<S>(T(4) * inverse_spacing_) * moment;
    }

    /// Whether any of eight particles, or of a tile, is held by something whose reaction is asked for.
    bool reacts(const MlsOrder<T>& order, std::size_t first) const { return reactions_.wanted() && order.held[first / lane_count]; }
    bool tile_reacts(const MlsOrder<T>& order, std::size_t first) const {
        bool any = false;
        for (std::size_t p = first; p < first + tile_size; p += lane_count) {
            any = any || reacts(order, p);
        }
        return any;
    }
    /// Centre of a hold's box after a substep, coordinate c of a lane [m].
    double centre(int lane, std::size_t hold, int substep, std::size_t c) const {
        const std::size_t pose = forces_.pose_index(hold, substep + 1);
        double sum = static_cast<double>(lane_of(inputs_.plain(&Fields<T>::pose, pose + 9 + c), lane));
        for (std::size_t j = 0; j < 3; ++j) {
            const T turn = lane_of(inputs_.plain(&Fields<T>::pose, pose + 3 * c + j), lane);
            sum += static_cast<double>(turn) * model_.geometry_.hold_centre[3 * hold + j];
        }
        return sum;
    }
    /// What the held ones of eight particles, displaced by u, give to the grid or take from it in a substep.
    void sum_held(std::vector<double>& sums, const MlsOrder<T>& order, std::size_t first, int substep, const Vec3<S>& u,
                  const Vec3<S>& momentum, const Mat3<S>& affine) const {
        const std::size_t stride = static_cast<std::size_t>(model_.geometry_.hold_count) * wrench_size;
        const double quarter = 0.25 * model_.geometry_.spacing * model_.geometry_.spacing;
        forces_.each_held(order, first, [&](int q, std::size_t hold, std::size_t id) {
            double own[3 * lanes], arm[3 * lanes], turn[3 * lanes];
            for (int l = 0; l < lanes; ++l) {
                for (int c = 0; c < 3; ++c) {
                    const int i = 3 * l + c, a = (c + 1) % 3, b = (c + 2) % 3;
                    own[i] = static_cast<double>(lane_of(momentum[c], l)[q]);
                    turn[i] = static_cast<double>(lane_of(affine.e[b][a], l)[q]) - static_cast<double>(lane_of(affine.e[a][b], l)[q]);
                    arm[i] = static_cast<double>(lane_of(u[c], l)[q]) - centre(l, hold, substep, static_cast<std::size_t>(c));
                    arm[i] += l == 0 ? model_.geometry_.points[3 * id + static_cast<std::size_t>(c)] : 0.0;
                }
            }
            add_momentum(lanes, own, arm, turn, quarter, &sums[hold * wrench_size], stride);
        });
    }
    /// Adds what all chunks found to the reactions, and clears it.
    void react(std::vector<std::vector<double>>& chunks, int n, double sign) {
        const std::size_t stride = static_cast<std::size_t>(model_.geometry_.hold_count) * wrench_size;
        for (std::vector<double>& sums : chunks) {
            for (std::size_t l = 0; l < static_cast<std::size_t>(lanes); ++l) {
                reactions_.add_sums(l, n, table_.frame[static_cast<std::size_t>(n)], &sums[l * stride], sign);
            }
            std::fill(sums.begin(), sums.end(), 0.0);
        }
    }

    /// chunk: whose sums of what held particles give are added to, where reactions are asked for.
    void give(MlsTile<T, K>& tile, int pack, std::size_t p, const ParticlePoint<S>& point, T* history, std::size_t chunk) {
        Vec3<S> momentum;
        Mat3<S> affine;
        forces_.evaluate(*state_.order, p, point, history, momentum, affine);
        pull(*state_.order, p, momentum);
        if (reacts(*state_.order, p)) {
            sum_held(given_[chunk], *state_.order, p, forces_.substep(), point.u, momentum, affine);
        }
        tile.set_q(pack, momentum);
        tile.set_n(pack, constant<S>(static_cast<T>(model_.geometry_.spacing)) * affine);
        tile.set_mass(pack, forces_.fixed(*state_.order, fixed_mass, p));
    }

    bool pulling() const { return pulls_ && pulls_->pulling(); }
    void follow_loads(const std::shared_ptr<const MlsOrder<T>>& order) {
        actuation_->follow(order, static_cast<std::size_t>(model_.chunk_count_), [this](std::size_t c) { return chunk_begin(c); });
    }
    void follow(const std::shared_ptr<const MlsOrder<T>>& order) {
        pulls_->follow(order, static_cast<std::size_t>(model_.chunk_count_), [this](std::size_t c) { return chunk_begin(c); });
    }
    /// Adds what the observer and the loads give to eight particles.
    void pull(const MlsOrder<T>& order, std::size_t first, Vec3<S>& momentum) const {
        if (pulling()) {
            momentum = momentum + forces_.fixed(order, fixed_mass, first) * pulls_->given(first);
        }
        if (actuation_) {
            actuation_->give(first, momentum);
        }
    }
    /// The same for a hot tile.
    void pull_tile(MlsTile<T, 0>& tile, std::size_t first) const {
        for (std::size_t c = 0; pulling() && c < 3; ++c) {
            const T* given = pulls_->values(first, c);
            for (std::size_t p = 0; p < tile_size; ++p) {
                tile.q[0][c][p] += tile.mass[0][p] * given[p];
            }
        }
        for (std::size_t c = 0; actuation_ && c < 3; ++c) {
            const T* given = actuation_->values(first, c);
            for (std::size_t p = 0; p < tile_size; ++p) {
                tile.q[0][c][p] += given[p];
            }
        }
    }

    ParticlePoint<S> load_start(std::size_t p) const;

    void start_chunk(std::size_t c, const Box& box, bool improve, bool real);
    void give_velocity(MlsTile<T, K>& tile, int pack, std::size_t p, const ParticlePoint<S>& point) const;

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

    void advance_chunk(std::size_t c, T h, const Box& next, bool forces, bool output, CellRange& range);

    using Particles::chunk_begin, Particles::failed_, Particles::inputs_, Particles::inverse_spacing_, Particles::limits;
    using Particles::load_particles, Particles::model_, Particles::permute_columns, Particles::permute_moving, Particles::reach;
    using Particles::sort, Particles::state_, Particles::stop_if_failed, Particles::stop_if_not_finite, Particles::table_;
    using Particles::velocity_;

    Team* team_;
    MlsForces<T, K> forces_;
    std::optional<MlsPulls<T, K>> pulls_;
    std::optional<MlsActuation<T, K>> actuation_;
    const Buffer<T>* from_ = nullptr;               // what moves, before the pass
    std::vector<T> start_velocity_, start_affine_;  // (lanes, 3 or 9, size)
    MlsGrids<T> grids_;
    ReactionSums reactions_;
    std::vector<std::vector<double>> given_, taken_;  // by chunk: (lanes, holds, 6) of what held particles give and take
    int now_ = 0;  // the substep of the present pass
};

}  // namespace mphygs
