// Adjoint of the MLS-MPM run: its substeps backwards, and its start.
#pragma once

#include "mphygs/mls_mpm/step_reverse.hpp"
#include "mphygs/numerics/checkpoint.hpp"

namespace mphygs {

template <class T>
class MlsMpmReverse : public MlsStepReverse<T> {
  public:
    using Steps = MlsStepReverse<T>;
    using typename Steps::P;
    using Loss = typename MlsMpm<T>::Loss;
    using Steps::Steps;

    /// loss is called once, with the whole trajectory where `keep` asks for it; progress then is told of the run forward too.
    Fields<T> gradient(const Loss& loss, bool keep, const Progress& progress, long* recomputed) {
        const int steps = table_.count();
        keep_ = keep;
        if (keep_) {
            keep_frame(0);
        }
        run_.begin();
        bar_order_ = run_.state_.order;
        const std::size_t particles = (run_.state_.moving.size() + run_.state_.history.size()) * sizeof(T);
        const std::size_t bytes = particles + run_.state_.grid.size() * 2 * sizeof(T);  // a box may grow
        bool first = true;
        const auto tell = [&](int frame) {
            if (progress && !progress(frame)) {
                throw SimulationError("interrupted");
            }
        };
        const auto advance = [&](int n, MlsState<T>* record) {
            run_.step(n, record);
            if (first && keep_ && table_.is_frame(n + 1)) {
                const int frame = table_.frame_of_state(n + 1);
                keep_frame(frame);
                tell(frame);
            }
        };
        const auto forward = [&](int n) { advance(n, nullptr); };
        const auto save = [&] { return run_.state_; };
        const auto restore = [&](const MlsState<T>& s) { run_.state_ = s; };
        const auto forward_recorded = [&](int n) {
            MlsState<T> s;
            advance(n, &s);
            return s;
        };
        const auto backward = [&](int n, MlsState<T>& record) {
            if (first) {
                take_loss(loss);
                first = false;
            }
            if (table_.is_frame(n + 1)) {
                tell(table_.frame_of_state(n + 1));
            }
            reverse_step(n, record);
            if (n == 0) {
                reverse_start(record);
            }
            model_.workspace_->moving.give(std::move(record.moving));
            model_.workspace_->grid.give(std::move(record.grid));
        };
        const long computed =
            reverse_all(steps, bytes, bytes, model_.settings_.memory_budget, save, restore, forward, forward_recorded, backward);
        if (first) {
            take_loss(loss);
        }
        if (recomputed) {
            *recomputed = computed - steps;
        }
        return collect();
    }

  private:

    void keep_frame(int frame) {
        const std::size_t count = model_.particle_count(), at = static_cast<std::size_t>(frame);
        trajectory_.position.resize((at + 1) * 3 * count);
        trajectory_.velocity.resize((at + 1) * 3 * count);
        trajectory_.deformation.resize((at + 1) * 9 * count);
        run_.output(0, &trajectory_.position[at * 3 * count], &trajectory_.velocity[at * 3 * count],
                    &trajectory_.deformation[at * 9 * count]);
    }

    void take_loss(const Loss& loss) {
        if (keep_) {
            trajectory_.reaction = run_.reaction(0);
        }
        bar_ = loss(trajectory_);
        const std::size_t count = model_.particle_count();
        const std::size_t frames = static_cast<std::size_t>(table_.frame_of_state(table_.count())) + 1;
        const auto size = [](const std::vector<T>& v, std::size_t wanted, const char* name) {
            if (!v.empty() && v.size() != wanted) {
                throw std::invalid_argument(std::string("the bar of the ") + name + " has " + std::to_string(v.size()) +
                                            " numbers, expected " + std::to_string(wanted));
            }
        };
        size(bar_.position, frames * 3 * count, "position");
        size(bar_.velocity, frames * 3 * count, "velocity");
        size(bar_.deformation, frames * 9 * count, "deformation");
        const std::size_t reactions = this->schedule_.reaction_weight.empty() ? 0 : frames * wrench_size * static_cast<std::size_t>(model_.geometry_.hold_count);
        if (!bar_.reaction.empty() && bar_.reaction.size() != reactions) {
            throw std::invalid_argument("the bar of the reactions must be (frames + 1, holds, 6), and the schedule ask for them");
        }
    }

    /// The initial scatter, and the rounds that found C_0, backwards; record: state 0.
    void reverse_start(const MlsState<T>& record);

    /// f(chunk, first particle, tile, points, bars) for the tiles of the initial state; keeps the bars.
    template <class F>
    void start_tiles(const MlsState<T>& record, F&& f);

    Fields<T> collect() {
        flush();
        const std::size_t count = model_.particle_count(), size = model_.padded_;
        for (std::size_t i = 0; i < model_.geometry_.hold.size(); ++i) {
            mass_[i] *= model_.geometry_.hold[i] >= 0 ? model_.settings_.hold_weight : 1.0;
        }
        if (table_.count() == 0) {  // the loss sees the initial state alone
            v_bar_.assign(3 * size, T{});
            for (std::size_t p = 0; p < size; p += lane_count) {
                ParticlePoint<P> bar{};
                add_seeds(0, *bar_order_, p, bar);
                store_moving<T, 0>(bars_.data(), size, p, bar);
                for (std::size_t c = 0; c < 3; ++c) {
                    store<T>(&v_bar_[c * size + p], bar.v[static_cast<int>(c)]);
                }
            }
        }
        Fields<T> out;
        const auto narrow = [](const std::vector<double>& from) { return std::vector<T>(from.begin(), from.end()); };
        out.mu = narrow(mu_);
        out.lambda = narrow(lambda_);
        out.stress_volume = narrow(volume_);
        if (model_.sites_.mass) {
            for (const std::int32_t p : model_.place_particle_) {
                out.place_mass.push_back(static_cast<T>(mass_[static_cast<std::size_t>(p)]));
            }
        }
        out.mass.resize(count);
        for (std::size_t i = 0; i < count; ++i) {
            out.mass[i] = static_cast<T>(mass_[i] + own_mass_[i]);
        }
        out.effect = narrow(parameter_bar_);
        out.place_effect = narrow(forces_.place_effect_bar);
        out.gravity = {static_cast<T>(gravity_bar_[0]), static_cast<T>(gravity_bar_[1]), static_cast<T>(gravity_bar_[2])};
        out.displacement0.resize(3 * count);
        out.velocity0.resize(fields_.velocity0.size());
        out.deformation0.resize(9 * count);
        for (std::size_t p = 0; p < size; ++p) {
            const std::size_t i = static_cast<std::size_t>(bar_order_->id[p]);
            // Padding stands on the last particle but gives nothing: its bars are zero.
            for (std::size_t c = 0; i < count && c < 3; ++c) {
                out.displacement0[3 * i + c] = bars_[slot_of(c, moving_numbers, p)];
                if (!out.velocity0.empty()) {
                    out.velocity0[3 * i + c] = v_bar_[c * size + p];
                }
            }
            for (std::size_t k = 0; i < count && k < 9; ++k) {
                out.deformation0[9 * i + k] = bars_[slot_of(3 + k, moving_numbers, p)];
            }
        }
        out.node_force = forces_.node_force_bar;
        out.pose = narrow(pose_bar_);
        out.target = narrow(target_bar_);
        out.channel = narrow(channel_bar_);
        return out;
    }

    using Steps::add_seeds, Steps::add_slope, Steps::add_sums, Steps::bar_, Steps::bar_grid_, Steps::bar_order_, Steps::bars_;
    using Steps::channel_bar_, Steps::clear_sums, Steps::fields_, Steps::flush, Steps::forces_, Steps::given_bar_, Steps::gravity_bar_, Steps::grid_bar, Steps::grids_;
    using Steps::inside, Steps::lambda_, Steps::mass_, Steps::model_, Steps::mu_, Steps::own_mass_, Steps::parameter_bar_;
    using Steps::particles_, Steps::pose_bar_, Steps::pushed_bar_, Steps::reverse_given, Steps::reverse_step, Steps::run_, Steps::table_;
    using Steps::target_bar_, Steps::volume_;

    ParticleTrajectory<T> trajectory_;
    bool keep_ = false;
    std::vector<T> v_bar_, c_bar_;  // (3 or 9, size)
};

}  // namespace mphygs
