// What an effect at its null adds to a run per unit of its strength: forces along a motion that it does not change yet.
//
// A candidate effect leaves the motion as it is, and how the forces answer to a change of the motion; of the derivative by
// its strength only the part at a fixed motion is its own. So directions by many candidates share the derivatives of the
// law, each adds forces computed from the values alone, and constants of its own (a wind's direction, a relaxation's time)
// are no other's.
#pragma once

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

template <class T>
class AddedForces {
  public:
    using P = Dual<Pack<T>, 1>;
    using U = Dual<T, 1>;

    /// present: effects of the model itself; direction: of the parameters of all effects, empty for none.
    AddedForces(const Added<T>& added, const std::vector<bool>& present, const std::vector<T>& direction, std::size_t blocks) {
        std::vector<bool> both = added.active;
        both.resize(static_cast<std::size_t>(Registry::count));
        own_slots_ = make_slots(both);
        own_ = active_sites(own_slots_);
        for (std::size_t i = 0; i < both.size(); ++i) {
            both[i] = both[i] || (i < present.size() && present[i]);
        }
        slots_ = make_slots(both);
        all_ = active_sites(slots_);
        for (std::size_t i = 0; i < added.effect.size(); ++i) {
            U value(added.effect[i]);
            value.d[0] = direction.empty() ? T{} : direction[i];
            parameters_.push_back(value);
        }
        plain_.resize(static_cast<std::size_t>(Registry::total_uniform_count));
        uniforms_.resize(plain_.size());
        history_.assign(own_.volume ? blocks * static_cast<std::size_t>(all_.history) : 0, P{});
    }

    const ActiveSites& own() const { return own_; }
    bool needs_rate() const { return own_.volume && all_.rate; }

    /// Once a substep.
    void refresh(double time, double dt) {
        all_uniforms(slots_, parameters_.data(), static_cast<T>(time), static_cast<T>(dt), plain_.data());
        for (std::size_t i = 0; i < plain_.size(); ++i) {
            uniforms_[i].v = broadcast<T>(plain_[i].v);
            uniforms_[i].d[0] = broadcast<T>(plain_[i].d[0]);
        }
    }

    /// Stress per unit of strength at the points of block b, and body force per mass in p's derivative lane; `point` has
    /// the values at a block: deformation, rate, mu, lambda, law, time, dt.
    Mat3<Pack<T>> stress(std::size_t b, VolumePoint<P>& point) {
        const std::size_t count = static_cast<std::size_t>(all_.history);
        thread_local std::vector<P> before, after;
        const auto own = history_.begin() + static_cast<std::ptrdiff_t>(b * count);
        before.assign(own, own + static_cast<std::ptrdiff_t>(count));
        after.resize(count);
        point.acceleration = {};
        evaluate_volume(slots_, uniforms_.data(), point, before.data(), after.data());
        std::copy(after.begin(), after.end(), own);
        return get_lane<Pack<T>>(point.stress, 1);
    }
    Vec3<Pack<T>> surface(const SurfacePoint<P>& point) const { return slope(evaluate_surface(own_slots_, uniforms_.data(), point)); }
    Vec3<Pack<T>> acceleration(const BodyPoint<P>& point) const { return slope(evaluate_body(own_slots_, uniforms_.data(), point)); }

    static Vec3<Pack<T>> slope(const Vec3<P>& a) { return {{a[0].d[0], a[1].d[0], a[2].d[0]}}; }

  private:
    Slots own_slots_, slots_;
    ActiveSites own_, all_;
    std::vector<U> parameters_, plain_;
    std::vector<P> uniforms_, history_;
};

}  // namespace mphygs
