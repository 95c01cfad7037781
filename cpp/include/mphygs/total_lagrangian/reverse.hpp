// Adjoint of the total-Lagrangian run: the steps of TotalLagrangianRun<T, 0>, backwards.
#pragma once

#include "mphygs/numerics/checkpoint.hpp"
#include "mphygs/total_lagrangian/hook_reverse.hpp"
#include "mphygs/total_lagrangian/rollout.hpp"

namespace mphygs {

template <class T>
class TotalLagrangianReverse : public TotalLagrangianForcesReverse<T> {
  public:
    using Forces = TotalLagrangianForcesReverse<T>;
    using Loss = typename TotalLagrangian<T>::Loss;

    /// What one substep leaves behind for its reversal.
    struct Record {
        std::vector<T> u, v, f;
        std::vector<Pack<T>> history;
        std::vector<double> reactions;
        // Of an implicit step, whose f and reactions are those of its middle: the velocity there, and the impulses that give
        // the velocity at the end what the holds prescribe.
        std::vector<T> middle = {};
        std::vector<double> prescribed = {};
        // Of pairs: the state at a pair's start, and what the second of it begins from.
        std::vector<T> past_u = {}, past_v = {}, begin_u = {}, begin_v = {};
    };

    TotalLagrangianReverse(const TotalLagrangian<T>& model, const Fields<T>& fields, const Schedule& schedule,
                           const PointHook<T>* hook, const Observer* observer, Team& team)
        : Forces(model, fields, schedule, hook, observer, team), schedule_(schedule) {
        double time = schedule.start;
        for (int f = 0; f < schedule.frame_count(); ++f) {
            for (int s = 0; s < schedule.steps[static_cast<std::size_t>(f)]; ++s) {
                const double dt = schedule.dt[static_cast<std::size_t>(f)];
                step_time_.push_back(time + s * dt);
                step_dt_.push_back(dt);
                step_frame_.push_back(f);
            }
            // As the rollout adds it: the steps computed again have the same bits.
            time += schedule.steps[static_cast<std::size_t>(f)] * schedule.dt[static_cast<std::size_t>(f)];
        }
    }

    /// loss is called once, with the whole trajectory where `keep` asks for it; progress then is told of the run forward too.
    Fields<T> gradient(const Loss& loss, bool keep, const Progress& progress, long* recomputed) {
        if (keep) {
            trajectory_ = std::move(room<T>(1, (schedule_.steps.size() + 1) * 3 * model_.node_count())[0]);
            keep_frame(0);
        }
        bool taken = false;
        const auto take_loss = [&] {
            if (keep) {
                trajectory_.reaction = run_.reaction(0);
            }
            bar_ = loss(trajectory_);
            check_bar();
            trajectory_ = {};
            taken = true;
        };
        const auto tell = [&](int frame) {
            if (progress && !progress(frame)) {
                throw SimulationError("interrupted");
            }
        };
        const int steps = schedule_.total_steps();
        const std::size_t state_bytes = (schedule_.paired ? 4 : 2) * run_.size_ * sizeof(T) + run_.history_.size() * sizeof(Pack<T>);
        const std::size_t record_bytes =
            state_bytes + (schedule_.paired ? 4 : schedule_.implicit ? 2 : 1) * (run_.size_ * sizeof(T) + run_.lambda_rows_.size() * sizeof(double));
        const auto forward = [&](int n) {
            run_.step(n, step_frame_[index(n)], step_time_[index(n)], step_dt_[index(n)]);
            if (n + 1 == steps || step_frame_[index(n + 1)] != step_frame_[index(n)]) {
                const int frame = step_frame_[index(n)] + 1;
                stop_if_unstable(frame, step_time_[index(n)] + step_dt_[index(n)]);
                if (keep && !taken) {
                    keep_frame(frame);
                    tell(frame);
                }
            }
        };
        const auto save = [&] {
            Record r{run_.u_, run_.v_, {}, run_.history_, {}};
            r.past_u = run_.past_u_;
            r.past_v = run_.past_v_;
            return r;
        };
        const auto restore = [&](const Record& r) {
            run_.u_ = r.u;
            run_.v_ = r.v;
            run_.history_ = r.history;
            run_.past_u_ = r.past_u;
            run_.past_v_ = r.past_v;
            if (run_.midpoint_) {
                run_.midpoint_->forget_changes();
            }
        };
        const auto forward_recorded = [&](int n) {
            Record r = save();
            forward(n);
            r.f = run_.f_;
            r.reactions = run_.lambda_rows_;
            if (schedule_.implicit) {
                r.middle = run_.midpoint_->middle;
                if (run_.rule(n).second) {
                    r.begin_u = run_.midpoint_->u0;
                    r.begin_v = run_.midpoint_->v0;
                }
                r.reactions = run_.midpoint_->impulse;
                r.prescribed = run_.lambda_rows_;
            }
            return r;
        };
        const auto backward = [&](int n, const Record& r) {
            if (!taken) {
                take_loss();
            }
            if (n + 1 == steps || step_frame_[index(n + 1)] != step_frame_[index(n)]) {
                const int frame = step_frame_[index(n)] + 1;
                add_bar(frame);
                tell(frame);
            }
            restore(r);
            reverse_step(n, r);
        };
        const long computed = reverse_all(steps, state_bytes, record_bytes, model_.settings_.memory_budget, save, restore,
                                          forward, forward_recorded, backward);
        if (recomputed) {
            *recomputed = computed - steps;
        }
        if (!taken) {
            take_loss();
        }
        add_bar(0);
        return collect();
    }

  private:
    void keep_frame(int frame) {
        const std::size_t at = index(frame) * 3 * model_.node_count();
        run_.output(0, &trajectory_.displacement[at], &trajectory_.velocity[at]);
    }

    void check_bar() const {
        const std::size_t frames = schedule_.steps.size() + 1, wanted = frames * 3 * model_.node_count();
        if ((!bar_.displacement.empty() && bar_.displacement.size() != wanted) || (!bar_.velocity.empty() && bar_.velocity.size() != wanted)) {
            throw std::invalid_argument("the bar of the trajectory must be (frames + 1, nodes, 3)");
        }
        const std::size_t reacting = schedule_.reaction_weight.empty() ? 0 : frames * wrench_size * static_cast<std::size_t>(model_.geometry_.hold_count);
        if (!bar_.reaction.empty() && bar_.reaction.size() != reacting) {
            throw std::invalid_argument("the bar of the reactions must be (frames + 1, holds, 6), and the schedule ask for them");
        }
    }

    void stop_if_unstable(int frame, double time) {
        if (!run_.finite()) {
            throw model_.failure(run_.u_, frame, time);
        }
    }

    void add_bar(int frame) {
        const std::size_t nodes = model_.node_count();
        const std::size_t from = static_cast<std::size_t>(frame) * 3 * nodes;
        for (std::size_t n = 0; n < nodes; ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                if (!bar_.displacement.empty()) {
                    ubar_[run_.at(0, c, n)] += bar_.displacement[from + 3 * n + c];
                }
                if (!bar_.velocity.empty()) {
                    vbar_[run_.at(0, c, n)] += bar_.velocity[from + 3 * n + c];
                }
            }
        }
    }

    void reverse_midpoint(int n, const Record& r);  // see `midpoint_reverse.hpp`
    void reverse_shared_mass(const std::vector<T>& start, const std::vector<T>& middle, double rate);

    void reverse_step(int n, const Record& r) {
        if (schedule_.implicit) {
            reverse_midpoint(n, r);
            return;
        }
        const double dt = step_dt_[index(n)];
        const T h = static_cast<T>(dt);
        // u_n+1 = u_n + dt v_n+1
        for (std::size_t i = 0; i < vbar_.size(); ++i) {
            vbar_[i] += h * ubar_[i];
        }
        reverse_hold(n, r, r.reactions, dt, true);
        still_without_mass();
        reverse_accelerations(n, r, step_time_[index(n)], dt, dt);
    }

    /// Nodes without mass stay where they are.
    void still_without_mass() {
        for (std::size_t i = 0; i < run_.stride_; ++i) {
            if (run_.inverse_mass_[i] == T{}) {
                for (std::size_t c = 0; c < 3; ++c) {
                    vbar_[run_.at(0, c, i)] = T{};
                }
            }
        }
    }

    /// v* = v + span (f / m + gravity + effects), f at the state of the run and at `time`, dt after it was last asked for.
    void reverse_accelerations(int n, const Record& r, double time, double dt, double span);

    void reverse_actuation(int n, int frame, double dt);

    /// Of linear rows the adjoint is the transpose: no value is needed.
    void reverse_observer(int n, int frame, double dt);

    /// impulses: of the rows; aimed: as in the run.
    void reverse_hold(int n, const Record& r, const std::vector<double>& impulses, double dt, bool aimed);

    /// What the reactions' bars make of the impulses of a substep, taken off s, (rows, 4), and of the holds' turns.
    void reverse_reaction(int n, const Record& r, std::vector<double>& s);

    Fields<T> collect() {
        const std::size_t nodes = model_.node_count();
        Fields<T> out;
        const auto narrow = [](const std::vector<double>& from) { return std::vector<T>(from.begin(), from.end()); };
        out.mu = narrow(mu_bar_);
        out.lambda = narrow(lambda_bar_);
        out.stress_volume = narrow(volume_bar_);
        std::vector<double> node_mass_bar(nodes, 0.0);
        for (std::size_t n = 0; n < nodes; ++n) {
            const double inverse = static_cast<double>(run_.inverse_mass_[n]);
            node_mass_bar[n] = -inverse * inverse * inverse_mass_bar_[n];
        }
        for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
            const MassTable<T>& table = model_.masses_[static_cast<std::size_t>(model_.table_[b])];
            double* to = &mass_bar_[8 * static_cast<std::size_t>(model_.order_[b])];
            for (int a = 0; a < 27; ++a) {
                const double bar = node_mass_bar[static_cast<std::size_t>(model_.rows_[b][static_cast<std::size_t>(a / 3)] + a % 3)];
                for (int q = 0; q < 8; ++q) {
                    to[q] += bar * static_cast<double>(table.by_node[a][q]);
                }
            }
        }
        out.mass = narrow(mass_bar_);
        out.deformation0 = narrow(deformation0_bar_);
        Registry::each([&](auto tag, int i) {
            using E = typename decltype(tag)::type;
            if constexpr (E::info.site == Site::hold) {
                const EffectSlot& s = this->model_.slots_[static_cast<std::size_t>(i)];
                if (s.active) {
                    this->parameter_bar_[static_cast<std::size_t>(s.parameter)] += this->compliance_bar_;
                }
            }
        });
        out.effect = narrow(parameter_bar_);
        if (model_.sites_.mass) {
            for (std::size_t p = 0; p < model_.places_.size(); ++p) {
                const auto& place = model_.places_[p];
                double sum = place_mass_bar_.empty() ? 0.0 : place_mass_bar_[p];
                for (std::size_t a = 0; a < 27; ++a) {
                    sum += static_cast<double>(place.value[a]) * node_mass_bar[static_cast<std::size_t>(place.node[a])];
                }
                out.place_mass.push_back(static_cast<T>(sum));
            }
        }
        out.place_effect = narrow(place_effect_bar_);
        out.gravity = {static_cast<T>(gravity_bar_[0]), static_cast<T>(gravity_bar_[1]), static_cast<T>(gravity_bar_[2])};
        out.displacement0.resize(3 * nodes);
        out.velocity0.resize(3 * nodes);
        for (std::size_t n = 0; n < nodes; ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                out.displacement0[3 * n + c] = ubar_[run_.at(0, c, n)];
                out.velocity0[3 * n + c] = vbar_[run_.at(0, c, n)];
            }
        }
        out.node_force = node_force_bar_;
        out.pose = narrow(pose_bar_);
        out.target = narrow(target_bar_);
        out.channel = narrow(channel_bar_);
        return out;
    }

    using Forces::add_uniform_bar, Forces::compliance_bar_, Forces::chunk_bar_, Forces::chunk_uniform_bar_, Forces::deformation0_bar_;
    using Forces::channel_bar_, Forces::fbar_, Forces::gravity_bar_, Forces::index, Forces::inverse_mass_bar_, Forces::lambda_bar_, Forces::mass_bar_;
    using Forces::model_, Forces::mu_bar_, Forces::node_force_bar_, Forces::parameter_bar_, Forces::place_effect_bar_;
    using Forces::pose_bar_, Forces::reverse_body, Forces::reverse_chunk, Forces::reverse_hook, Forces::reverse_places;
    using Forces::history_bar_, Forces::hook_answer_, Forces::hook_told_, Forces::reverse_uniforms, Forces::run_, Forces::target_bar_, Forces::ubar_, Forces::vbar_, Forces::volume_bar_;

    std::vector<double> place_mass_bar_;      // of what nodes share of places' masses
    std::vector<T> past_u_bar_, past_v_bar_;  // of the state at the start of the pair that is being reversed
    const Schedule& schedule_;
    Trajectory<T> trajectory_, bar_;
    std::vector<double> step_time_, step_dt_;
    std::vector<int> step_frame_;
    bool pulled_ = false;                    // in the present substep
    std::vector<T> asked_bar_, blend_bar_;  // see ObserverRows
    typename Forces::Sums trial_;           // what trial steps add to
};

}  // namespace mphygs
