// Eight particles at one instant, read from the numbers that are kept of them and written to them.
#pragma once

#include "mphygs/mls_mpm/transfer.hpp"

namespace mphygs {

/// Eight particles at one instant.
template <class S>
struct ParticlePoint {
    Vec3<S> x;  // from the anchor [m]
    Vec3<S> v;  // [m/s]
    Mat3<S> c;  // [1/s]
    Mat3<S> f;  // [-]
    Vec3<S> u;  // x less that at rest [m]
};

/// The twelve numbers as they are kept: u stands in x, F - I in f.
template <class T, int K>
inline ParticlePoint<PackScalar<T, K>> load_moving(const T* moving, std::size_t size, std::size_t p) {
    ParticlePoint<PackScalar<T, K>> r;
    for (int l = 0; l <= K; ++l) {
        const T* from = moving + static_cast<std::size_t>(l) * moving_numbers * size + slot_of(0, moving_numbers, p);
        for (std::size_t k = 0; k < moving_numbers; ++k) {
            auto& to = k < 3 ? r.x[static_cast<int>(k)] : r.f.e[(k - 3) / 3][(k - 3) % 3];
            lane_of(to, l) = load<T>(from + group_size * k);
        }
    }
    return r;
}
/// F from F - I.
template <class S>
inline Mat3<S> with_identity(Mat3<S> f) {
    for (int i = 0; i < 3; ++i) {
        f.e[i][i] = f.e[i][i] + constant<S>(1);
    }
    return f;
}
/// x from u.
template <class T, int K>
inline Vec3<PackScalar<T, K>> placed(const MlsOrder<T>& order, std::size_t p, Vec3<PackScalar<T, K>> u) {
    for (std::size_t c = 0; c < 3; ++c) {
        auto& x = lane_of(u[static_cast<int>(c)], 0);
        x = x + load<T>(&order.rest[slot_of(c, rest_numbers, p)]);
    }
    return u;
}
/// From the numbers as they are kept to x, u and F.
template <class T, int K>
inline void complete(const MlsOrder<T>& order, std::size_t p, ParticlePoint<PackScalar<T, K>>& point) {
    point.u = point.x;
    point.x = placed<T, K>(order, p, point.u);
    point.f = with_identity(point.f);
}
/// F - I a substep later: h C F more.
template <class S>
inline Mat3<S> strained(const Mat3<S>& f_less_identity, const Mat3<S>& c, const S& h) {
    return f_less_identity + h * (c + c * f_less_identity);
}
template <class T, int K>
inline void store_moving(T* moving, std::size_t size, std::size_t p, const ParticlePoint<PackScalar<T, K>>& point) {
    for (int l = 0; l <= K; ++l) {
        T* to = moving + static_cast<std::size_t>(l) * moving_numbers * size + slot_of(0, moving_numbers, p);
        for (std::size_t k = 0; k < moving_numbers; ++k) {
            store<T>(to + group_size * k, lane_of(k < 3 ? point.x[static_cast<int>(k)] : point.f.e[(k - 3) / 3][(k - 3) % 3], l));
        }
    }
}

}  // namespace mphygs
