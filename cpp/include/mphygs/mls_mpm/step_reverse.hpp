// A substep of the MLS-MPM run backwards.
//
// A record is the state at n: u, F - I, and the grid's velocities; v and C are gathered from it again.
// Going from n + 1 to n a particle gathers the bars of the grid at n + 1 (of what it gave) and
// scatters the bars of the grid at n (of what it took).
#pragma once

#include "mphygs/mls_mpm/forces_reverse.hpp"
#include "mphygs/mls_mpm/plain_reverse.hpp"
#include "mphygs/mls_mpm/run.hpp"

namespace mphygs {

template <class T>
class MlsStepReverse {
  public:
    using Run = MlsMpmRun<T, 0>;
    using P = Pack<T>;

    MlsStepReverse(const MlsMpm<T>& model, const Fields<T>& fields, const Schedule& schedule, const Observer* observer, Team& team)
        : model_(model), fields_(fields), run_(model, inputs_of(fields, observer), schedule, team), table_(run_.table()),
          forces_(run_.forces_, fields), particles_(model.padded_), sums_(static_cast<std::size_t>(model.chunk_count_)),
          grids_(model.chunk_count_, 1), schedule_(schedule), taken_pose_(static_cast<std::size_t>(model.chunk_count_)) {
        const std::size_t n = model.padded_, count = model.particle_count();
        bars_.assign(moving_numbers * n, T{});
        history_bar_.assign(run_.state_.history.size(), T{});
        for (auto* total : {&mu_, &lambda_, &volume_, &mass_, &own_mass_}) {
            total->assign(count, 0.0);
        }
        parameter_bar_.assign(static_cast<std::size_t>(Registry::parameter_count), 0.0);
        pose_bar_.assign(fields.pose.size(), 0.0);
        target_bar_.assign(fields.target.size(), 0.0);
        channel_bar_.assign(fields.channel.size(), 0.0);
        given_bar_.assign(observer ? 3 * n : 0, T{});
        pushed_bar_.assign(fields.channel.empty() ? 0 : 3 * n, T{});
    }

  protected:
    static Inputs<T, 0> inputs_of(const Fields<T>& fields, const Observer* observer) {
        Inputs<T, 0> inputs;
        inputs.primal = &fields;
        inputs.observer = observer;
        return inputs;
    }

    /// The bars that the loss gives to one particle at a frame.
    void add_seeds(int frame, const MlsOrder<T>& order, std::size_t first, ParticlePoint<P>& bar) const {
        const std::size_t count = model_.particle_count();
        for (int q = 0; q < lane_count; ++q) {
            const std::size_t i = static_cast<std::size_t>(order.id[first + static_cast<std::size_t>(q)]);
            if (i >= count) {
                continue;
            }
            const std::size_t at = static_cast<std::size_t>(frame) * count + i;
            for (std::size_t c = 0; c < 3; ++c) {
                if (!bar_.position.empty()) {
                    bar.x[static_cast<int>(c)][q] += bar_.position[3 * at + c];
                }
                if (!bar_.velocity.empty()) {
                    bar.v[static_cast<int>(c)][q] += bar_.velocity[3 * at + c];
                }
            }
            for (std::size_t k = 0; k < 9 && !bar_.deformation.empty(); ++k) {
                bar.f.e[k / 3][k % 3][q] += bar_.deformation[9 * at + k];
            }
        }
    }

    /// Brings the bars into the order of a record. Orders of substeps without a sort between them
    /// are equal, though they may be different objects.
    void follow(const std::shared_ptr<const MlsOrder<T>>& order) {
        if (order == bar_order_) {
            return;
        }
        const std::size_t n = order->size;
        std::vector<std::int32_t> place(n), from(n);
        for (std::size_t p = 0; p < n; ++p) {
            place[static_cast<std::size_t>(bar_order_->id[p])] = static_cast<std::int32_t>(p);
        }
        for (std::size_t p = 0; p < n; ++p) {
            from[p] = place[static_cast<std::size_t>(order->id[p])];
        }
        Run::permute_moving(bars_, from);
        Run::permute_columns(history_bar_, from);
        bar_order_ = order;
    }
    /// Sums over thousands of substeps are kept in double.
    void flush() {
        const std::size_t count = model_.particle_count();
        for (std::size_t p = 0; p < bar_order_->size; ++p) {
            const std::size_t i = static_cast<std::size_t>(bar_order_->id[p]);
            const auto move = [&](T& from, std::vector<double>& to) {
                if (i < count) {
                    to[i] += static_cast<double>(from);
                }
                from = T{};
            };
            move(*particles_.at(fixed_mu, p), mu_);
            move(*particles_.at(fixed_lambda, p), lambda_);
            move(*particles_.at(fixed_volume, p), volume_);
            move(*particles_.at(fixed_mass, p), mass_);
            move(particles_.own_mass[p], own_mass_);
        }
    }

    void reverse_step(int n, const MlsState<T>& record) {
        if ((n + 1) % model_.settings_.sort_interval == 0) {  // never by what was recomputed: same bits
            flush();
        }
        follow(record.order);
        const bool forces = n + 1 < table_.count();
        if (forces) {
            run_.look(n, record.order, record.moving.data(), record.grid.data(), record.box);
            run_.forces_.refresh(n + 1);
            clear_sums();
        }
        run_.state_.history = record.history;  // evaluated again, to be overwritten
        grids_.prepare(record.box, record.ranges);
        for (std::vector<double>& pose : taken_pose_) {
            pose.assign(12 * static_cast<std::size_t>(model_.geometry_.hold_count), 0.0);
        }
        run_.team_->each(model_.chunk_count_, [&](int c) { reverse_chunk(static_cast<std::size_t>(c), n, record, forces); });
        if (forces) {
            add_sums(n + 1);
        }
        for (const std::vector<double>& pose : taken_pose_) {
            for (std::size_t i = 0; reacting() && i < pose.size(); ++i) {
                pose_bar_[run_.forces_.pose_index(i / 12, n + 1) + i % 12] += pose[i];
            }
        }
        if (forces && run_.pulling()) {
            run_.pulls_->reverse(given_bar_, target_bar_);
            run_.pulls_->unsee(record.moving.data(), record.grid.data(), record.box, static_cast<T>(table_.dt[static_cast<std::size_t>(n)]),
                               run_.inverse_spacing_, bars_.data(), [&](std::size_t c) { return grids_.private_grid(c); });
        }
        if (forces && run_.actuation_) {
            run_.actuation_->reverse(pushed_bar_, channel_bar_, pose_bar_);
            run_.actuation_->unsee(record.moving.data(), record.grid.data(), record.box, static_cast<T>(table_.dt[static_cast<std::size_t>(n)]),
                                   run_.inverse_spacing_, bars_.data(), [&](std::size_t c) { return grids_.private_grid(c); });
        }
        grid_bar(record);
    }

    /// Bars of the velocities, summed, to bars of momentum and mass.
    void grid_bar(const MlsState<T>& record) {
        bar_grid_.resize(4 * record.box.nodes() + 4);
        grids_.clear(record.box, record.ranges, *run_.team_, bar_grid_.data());
        grids_.sum(record.box, record.ranges, *run_.team_, [&](std::size_t first, std::size_t count, const auto& add) {
            T* bar = &bar_grid_[4 * first];
            const T* value = &record.grid[4 * first];
            add(0, bar);
            std::size_t i = 0;
            for (; i + 4 <= count; i += 4) {
                const Row<T> v = read<Row<T>>(value + 4 * i), v_bar = read<Row<T>>(bar + 4 * i), mass = fourth(v);
                const Row<T> inverse = choose(mass > MlsGrids<T>::least_mass, T(1) / mass, Row<T>{});
                write(bar + 4 * i, keep_fourth(v_bar * inverse, -sum_three(v * v_bar) * inverse));
            }
            for (; i < count; ++i) {
                T* b = bar + 4 * i;
                const T* v = value + 4 * i;
                const T inverse = MlsGrids<T>::inverse_mass(v[3]);
                const T work = b[0] * v[0] + b[1] * v[1] + b[2] * v[2];
                for (std::size_t c = 0; c < 3; ++c) {
                    b[c] *= inverse;
                }
                b[3] = -work * inverse;
            }
        });
        bar_box_ = record.box;
        bar_ranges_ = record.ranges;
    }

    static CellRange inside(const Box& box, const CellRange& range) {
        CellRange r;
        for (std::size_t k = 0; k < 3; ++k) {
            r.low[k] = k == 0 ? range.low[0] : box.low[k] + 1;
            r.high[k] = k == 0 ? range.high[0] : box.low[k] + box.count[k] - 2;
        }
        return r;
    }

    void add_slope(const TileSlope<T>& slope, int pack, Vec3<P>& x_bar) const {
        for (std::size_t c = 0; c < 3; ++c) {
            P& to = x_bar[model_.axis_[c]];
            to += run_.inverse_spacing_ * load<T>(&slope.by[c][pack * lane_count]);
        }
    }

    /// Bars of what the particles at `points` gave to the grid whose bars are in bar_grid_.
    void reverse_given(std::size_t c, std::size_t t, const MlsOrder<T>& order, const ParticlePoint<P>* points, const T* history,
                       ParticlePoint<P>* bars) {
        const CellRange limits = inside(bar_box_, bar_ranges_[c]);
        SeenRange<Pack<T>> ignored;
        MlsTile<T, 0> tile, given;
        for (int k = 0; k < tile_packs; ++k) {
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            locate(tile, k, points[k].x, run_.inverse_spacing_, model_.axis_, bar_box_, limits, ignored);
            Vec3<P> momentum;
            Mat3<P> affine;
            run_.forces_.evaluate(order, p, points[k], run_.state_.history.data(), momentum, affine);
            run_.pull(order, p, momentum);
            tile.set_q(k, momentum);
            tile.set_n(k, broadcast<T>(static_cast<T>(model_.geometry_.spacing)) * affine);
            tile.set_mass(k, run_.forces_.fixed(order, fixed_mass, p));
        }
        TileSlope<T> slope;
        reverse_scatter_rows<T>(tile, bar_grid_.data(), model_.axis_, bar_box_, given, slope);
        for (int k = 0; k < tile_packs; ++k) {
            GivenBars<T> g;
            g.momentum = given.get_q(k);
            g.affine = broadcast<T>(static_cast<T>(model_.geometry_.spacing)) * given.get_n(k);
            g.mass = given.get_mass(k);
            add_slope(slope, k, bars[k].x);
            const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
            if (reacts(order, p)) {
                const HeldBars held = held_bars(order, p, run_.forces_.substep(), 1.0, points[k].u, tile.get_q(k), sums_[c].pose, 24, 12);
                g.momentum = g.momentum + held.momentum;
                g.affine = g.affine + held.affine;
                bars[k].x = bars[k].x + held.arm;
            }
            forces_.reverse(order, p, points[k], history, g, history_bar_.data(), bars[k], particles_, sums_[c]);
            if (run_.pulling()) {
                const P mass = run_.forces_.fixed(order, fixed_mass, p);
                T* mass_bar = particles_.at(fixed_mass, p);
                store<T>(mass_bar, load<T>(mass_bar) + dot(g.momentum, run_.pulls_->given(p)));
                for (std::size_t a = 0; a < 3; ++a) {
                    store<T>(&given_bar_[a * order.size + p], mass * g.momentum[static_cast<int>(a)]);
                }
            }
            for (std::size_t a = 0; run_.actuation_ && a < 3; ++a) {
                store<T>(&pushed_bar_[a * order.size + p], g.momentum[static_cast<int>(a)]);
            }
        }
    }

    bool reacting() const { return !bar_.reaction.empty(); }
    bool reacts(const MlsOrder<T>& order, std::size_t first) const { return reacting() && run_.reacts(order, first); }

    /// Bars of what held ones of eight particles give or take: of momentum, affine part and place.
    struct HeldBars {
        Vec3<P> momentum{}, arm{};
        Mat3<P> affine{};
    };
    /// sign: 1 for what is given, -1 for what is taken; pose: gains the centre's share, of hold h from stride h + at on.
    HeldBars held_bars(const MlsOrder<T>& order, std::size_t first, int substep, double sign, const Vec3<P>& u, const Vec3<P>& momentum,
                       std::vector<double>& pose, std::size_t stride, std::size_t at) const {
        HeldBars bars;
        const std::size_t s = static_cast<std::size_t>(substep), own = static_cast<std::size_t>(model_.geometry_.hold_count) * wrench_size;
        const double quarter = 0.25 * model_.geometry_.spacing * model_.geometry_.spacing;
        run_.forces_.each_held(order, first, [&](int q, std::size_t hold, std::size_t id) {
            double wrench[wrench_size] = {}, arm[3], arm_bar[3];
            for (std::size_t side = 0; side < 2; ++side) {
                const double share = sign * schedule_.reaction_weight[2 * s + side] / table_.dt[s];
                for (std::size_t i = 0; i < wrench_size; ++i) {
                    wrench[i] += share * bar_.reaction[(static_cast<std::size_t>(table_.frame[s]) + side) * own + hold * wrench_size + i];
                }
            }
            for (std::size_t c = 0; c < 3; ++c) {
                arm[c] = model_.geometry_.points[3 * id + c] + static_cast<double>(u[static_cast<int>(c)][q]) - run_.centre(0, hold, substep, c);
            }
            const double* torque = wrench + 3;
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
                const int i = static_cast<int>(c), j = static_cast<int>(a), k = static_cast<int>(b);
                bars.momentum[i][q] = static_cast<T>(wrench[c] + torque[a] * arm[b] - torque[b] * arm[a]);
                arm_bar[c] = static_cast<double>(momentum[j][q]) * torque[b] - static_cast<double>(momentum[k][q]) * torque[a];
                bars.arm[i][q] = static_cast<T>(arm_bar[c]);
                bars.affine.e[k][j][q] += static_cast<T>(quarter * torque[c]);
                bars.affine.e[j][k][q] -= static_cast<T>(quarter * torque[c]);
            }
            for (std::size_t c = 0; c < 3; ++c) {
                double* to = &pose[stride * hold + at];
                to[9 + c] -= arm_bar[c];
                for (std::size_t j = 0; j < 3; ++j) {
                    to[3 * c + j] -= arm_bar[c] * model_.geometry_.hold_centre[3 * hold + j];
                }
            }
        });
        return bars;
    }
    /// Bars of what held particles take in substep n, of their velocities; returns those of their places before it.
    Vec3<P> reverse_taken(std::size_t c, int n, const MlsOrder<T>& order, std::size_t p, T h, const ParticlePoint<P>& point,
                          ParticlePoint<P>& bar) {
        const P mass = run_.forces_.fixed(order, fixed_mass, p);
        const Vec3<P> before = point.u - broadcast<T>(h) * point.v;
        const HeldBars held = held_bars(order, p, n, -1.0, before, mass * point.v, taken_pose_[c], 12, 0);
        bar.v = bar.v + mass * held.momentum;
        bar.c = bar.c + mass * held.affine;
        T* mass_bar = particles_.at(fixed_mass, p);
        store<T>(mass_bar, load<T>(mass_bar) + dot(held.momentum, point.v) + inner(held.affine, point.c));
        return held.arm;
    }

    void reverse_chunk(std::size_t c, int n, const MlsState<T>& record, bool forces) {
        const T h = static_cast<T>(table_.dt[static_cast<std::size_t>(n)]);
        const CellRange limits = inside(record.box, record.ranges[c]);
        const std::size_t size = record.order->size;
        SeenRange<Pack<T>> ignored;
        MlsTile<T, 0> tile;
        PlainTile<T> plain;
        Wide<T> gravity_bar[3] = {};
        const PlainPass<T> pass = run_.plain_pass(h, forces);
        const bool hot = forces && run_.forces_.plain() && !table_.is_frame(n + 1);
        for (std::size_t t = run_.chunk_begin(c); t < run_.chunk_begin(c + 1); t += tile_size) {
            if (hot && run_.forces_.plain_tile(*record.order, t) && !(reacting() && run_.tile_reacts(*record.order, t))) {
                run_.stand_tile(plain.took, *record.order, record.moving, record.box, t, limits);
                gather_rows<T>(plain.took, record.grid.data(), model_.axis_, record.box);
                plain_given<T>(plain, record.moving.data(), t, pass, *record.order, model_.axis_, bar_box_, inside(bar_box_, bar_ranges_[c]));
                run_.pull_tile(plain.given, t);
                const auto moved = [&](std::size_t p, std::size_t a) {
                    return record.moving[slot_of(a, moving_numbers, p)] + h * plain.velocity[a][p - t];  // u
                };
                run_.forces_.each_held_of_tile(*record.order, t, [&](std::size_t p, std::size_t hold, std::size_t id) {
                    for (std::size_t a = 0; a < 3; ++a) {
                        run_.give_held(plain.given, p - t, hold, id, a, moved(p, a));
                    }
                });
                reverse_scatter_rows<T>(plain.given, bar_grid_.data(), model_.axis_, bar_box_, plain.bars, plain.slope);
                plain_bars<T>(plain, record.moving.data(), bars_.data(), particles_.fixed.data(), t, pass, *record.order, model_.axis_,
                              gravity_bar);
                for (std::size_t a = 0; run_.pulling() && a < 3; ++a) {
                    const T* given = run_.pulls_->values(t, a);
                    for (std::size_t p = 0; p < tile_size; ++p) {
                        const T bar = plain.bars.q[0][a][p];
                        given_bar_[a * size + t + p] = plain.given.mass[0][p] * bar;
                        *particles_.at(fixed_mass, t + p) += bar * given[p];
                    }
                }
                for (std::size_t a = 0; run_.actuation_ && a < 3; ++a) {
                    std::copy_n(plain.bars.q[0][a], tile_size, &pushed_bar_[a * size + t]);
                }
                run_.forces_.each_held_of_tile(*record.order, t, [&](std::size_t p, std::size_t hold, std::size_t id) {
                    for (std::size_t a = 0; a < 3; ++a) {  // the hold's velocity stood in place of the particle's
                        const T bar = plain.bars.q[0][a][p - t], velocity_bar = plain.given.mass[0][p - t] * bar;
                        const T held = run_.forces_.held_velocity(hold, id, static_cast<int>(a), moved(p, a));
                        *particles_.at(fixed_mass, p) += bar * (held - plain.velocity[a][p - t]);
                        forces_.reverse_held(hold, id, static_cast<int>(a), velocity_bar, sums_[c]);
                        const T x_bar = -run_.forces_.relaxation() * velocity_bar;
                        bars_[slot_of(a, moving_numbers, p)] += x_bar;
                        plain.took.q[0][a][p - t] += h * x_bar - velocity_bar;
                    }
                });
                reverse_gather_rows<T>(plain.took, plain.velocity, record.grid.data(), grids_.private_grid(c), model_.axis_, record.box,
                                       plain.slope);
                plain_slope<T>(plain.slope, bars_.data(), t, run_.inverse_spacing_, model_.axis_);
                continue;
            }
            ParticlePoint<P> points[tile_packs], bars[tile_packs];
            Mat3<P> before[tile_packs];
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                points[k] = load_moving<T, 0>(record.moving.data(), size, p);
                locate(tile, k, placed<T, 0>(*record.order, p, points[k].x), run_.inverse_spacing_, model_.axis_, record.box, limits, ignored);
            }
            gather_tile<T, 0>(tile, record.grid.data(), 0, model_.axis_, record.box);
            alignas(64) T velocity[3][tile_size];
            std::memcpy(velocity, tile.q[0], sizeof velocity);
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                points[k].v = tile.get_q(k);
                points[k].c = run_.affine_velocity(tile.get_n(k));
                before[k] = with_identity(points[k].f);
                points[k].x = points[k].x + broadcast<T>(h) * points[k].v;
                points[k].f = strained(points[k].f, points[k].c, broadcast<T>(h));
                complete<T, 0>(*record.order, p, points[k]);
                bars[k] = load_moving<T, 0>(bars_.data(), size, p);
                if (table_.is_frame(n + 1)) {
                    add_seeds(table_.frame_of_state(n + 1), *record.order, p, bars[k]);
                }
            }
            if (forces) {
                reverse_given(c, t, *record.order, points, record.history.data(), bars);
            }
            Vec3<P> late[tile_packs] = {};  // bars of the places before the substep
            for (int k = 0; k < tile_packs; ++k) {
                const std::size_t p = t + static_cast<std::size_t>(k * lane_count);
                if (reacts(*record.order, p)) {
                    late[k] = reverse_taken(c, n, *record.order, p, h, points[k], bars[k]);
                }
            }
            for (int k = 0; k < tile_packs; ++k) {
                ParticlePoint<P>& bar = bars[k];
                bar.v = bar.v + broadcast<T>(h) * bar.x;
                bar.x = bar.x + late[k];
                bar.c = bar.c + broadcast<T>(h) * (bar.f * transpose(before[k]));
                bar.f = bar.f + broadcast<T>(h) * (transpose(points[k].c) * bar.f);
                tile.set_q(k, bar.v);
                tile.set_n(k, run_.affine_velocity(bar.c));
                tile.set_mass(k, P{});
            }
            TileSlope<T> slope;
            reverse_gather_rows<T>(tile, velocity, record.grid.data(), grids_.private_grid(c), model_.axis_, record.box, slope);
            for (int k = 0; k < tile_packs; ++k) {
                add_slope(slope, k, bars[k].x);
                store_moving<T, 0>(bars_.data(), size, t + static_cast<std::size_t>(k * lane_count), bars[k]);
            }
        }
        for (std::size_t a = 0; a < 3; ++a) {
            for (int q = 0; q < MlsVector<T>::wide_count; ++q) {
                sums_[c].gravity[a] += static_cast<double>(pass.next_dt * gravity_bar[a][q]);
            }
        }
    }

    void clear_sums() {
        for (MlsChunkSums& s : sums_) {
            s = {};
            s.uniform.assign(static_cast<std::size_t>(Registry::total_uniform_count), 0.0);
            s.pose.assign(static_cast<std::size_t>(model_.geometry_.hold_count) * 24, 0.0);
        }
    }
    void add_sums(int n) {
        std::vector<double> uniform(static_cast<std::size_t>(Registry::total_uniform_count), 0.0);
        for (const MlsChunkSums& s : sums_) {
            for (std::size_t i = 0; i < uniform.size(); ++i) {
                uniform[i] += s.uniform[i];
            }
            for (std::size_t c = 0; c < 3; ++c) {
                gravity_bar_[c] += s.gravity[c];
            }
            for (std::size_t h = 0; h < static_cast<std::size_t>(model_.geometry_.hold_count); ++h) {
                for (std::size_t i = 0; i < 24; ++i) {
                    pose_bar_[run_.forces_.pose_index(h, n) + i] += s.pose[24 * h + i];
                }
            }
        }
        forces_.reverse_uniforms(uniform, parameter_bar_);
    }

    const MlsMpm<T>& model_;
    const Fields<T>& fields_;
    Run run_;
    const StepTable& table_;
    MlsForcesReverse<T> forces_;
    MlsParticleBars<T> particles_;
    std::vector<MlsChunkSums> sums_;
    MlsGrids<T> grids_;
    const Schedule& schedule_;
    std::vector<std::vector<double>> taken_pose_;  // by chunk: (holds, 12) of what held particles take
    ParticleTrajectory<T> bar_;  // of the loss
    std::shared_ptr<const MlsOrder<T>> bar_order_;
    Buffer<T> bars_;               // of what moves, laid out like it
    std::vector<T> history_bar_;   // (numbers, size)
    std::vector<T> bar_grid_;      // bars of {px, py, pz, m} at the state above
    Box bar_box_;
    std::vector<CellRange> bar_ranges_;
    std::vector<double> mu_, lambda_, volume_, mass_, own_mass_, parameter_bar_, pose_bar_;  // by the caller's number
    std::vector<double> target_bar_, channel_bar_;
    std::vector<T> given_bar_, pushed_bar_;  // (3, size) of what the observer and the loads gave, where there are any
    double gravity_bar_[3] = {0, 0, 0};
};

}  // namespace mphygs
