// A value and K directional derivatives, stored as K + 1 separate arrays ("lanes").
#pragma once

#include <type_traits>

#include "mphygs/model.hpp"
#include "mphygs/physics/observer.hpp"
#include "mphygs/physics/point_hook.hpp"
#include "mphygs/small.hpp"

namespace mphygs {

template <class T, int K>
using PackScalar = std::conditional_t<K == 0, Pack<T>, Dual<Pack<T>, K == 0 ? 1 : K>>;
template <class T, int K>
using PlainScalar = std::conditional_t<K == 0, T, Dual<T, K == 0 ? 1 : K>>;

/// Lane l of a scalar: the value (0) or derivative l - 1.
template <class S>
inline auto& lane_of(S& s, int l) {
    if constexpr (IsDual<S>::value) {
        return l == 0 ? s.v : s.d[l - 1];
    } else {
        (void)l;
        return s;
    }
}
template <class S>
inline const auto& lane_of(const S& s, int l) {
    if constexpr (IsDual<S>::value) {
        return l == 0 ? s.v : s.d[l - 1];
    } else {
        (void)l;
        return s;
    }
}

template <class S, class P>
inline void set_lane(Mat3<S>& m, int l, const Mat3<P>& value) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            lane_of(m[i][j], l) = value[i][j];
        }
    }
}
template <class P, class S>
inline Mat3<P> get_lane(const Mat3<S>& m, int l) {
    Mat3<P> r;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            r[i][j] = lane_of(m[i][j], l);
        }
    }
    return r;
}

/// Primal inputs with up to K directions beside them.
template <class T, int K>
struct Inputs {
    const Fields<T>* primal = nullptr;
    const Fields<T>* direction[K == 0 ? 1 : K] = {};
    const PointHook<T>* hook = nullptr;  // nullptr: none
    const Observer* observer = nullptr;  // nullptr: a free run
    int first_direction = 0;             // number of direction[0] among the caller's

    using Member = std::vector<T> Fields<T>::*;

    /// Eight consecutive numbers of a field, as a scalar of packs.
    PackScalar<T, K> pack(Member member, std::size_t offset) const {
        PackScalar<T, K> s{};
        lane_of(s, 0) = load<T>((primal->*member).data() + offset);
        for (int k = 0; k < K; ++k) {
            if (direction[k] && !(direction[k]->*member).empty()) {
                lane_of(s, k + 1) = load<T>((direction[k]->*member).data() + offset);
            }
        }
        return s;
    }
    /// One number of a field; absent fields read as zero.
    PlainScalar<T, K> plain(Member member, std::size_t index) const {
        PlainScalar<T, K> s{};
        if (!(primal->*member).empty()) {
            lane_of(s, 0) = (primal->*member)[index];
        }
        for (int k = 0; k < K; ++k) {
            if (direction[k] && !(direction[k]->*member).empty()) {
                lane_of(s, k + 1) = (direction[k]->*member)[index];
            }
        }
        return s;
    }
};

}  // namespace mphygs
