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
                       ParticlePoint<P>* bars);

    bool reacting() const { return !bar_.reaction.empty(); }
    bool reacts(const MlsOrder<T>& order, std::size_t first) const { return reacting() && run_.reacts(order, first); }

    /// Bars of what held ones of eight particles give or take: of momentum, affine part and place.
    struct HeldBars {
        Vec3<P> momentum{}, arm{};
        Mat3<P> affine{};
    };
    /// sign: 1 for what is given, -1 for what is taken; pose: gains the centre's share, of hold h from stride h + at on.
    HeldBars held_bars(const MlsOrder<T>& order, std::size_t first, int substep, double sign, const Vec3<P>& u, const Vec3<P>& momentum,
                       std::vector<double>& pose, std::size_t stride, std::size_t at) const;
    /// Bars of what held particles take in substep n, of their velocities; returns those of their places before it.
    Vec3<P> reverse_taken(std::size_t c, int n, const MlsOrder<T>& order, std::size_t p, T h, const ParticlePoint<P>& point,
                          ParticlePoint<P>& bar);

    void reverse_chunk(std::size_t c, int n, const MlsState<T>& record, bool forces);

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
