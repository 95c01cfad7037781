// Forward derivatives: a number with K directional derivatives beside it.
//
// Dual<S, K> is what turns one template, written for values, into the tangent of K directions at
// once. S may itself be a Pack, so the lanes stay eight wide.
#pragma once

#include "mphygs/numerics/pack.hpp"

namespace mphygs {

template <class S, int K>
struct Dual {
    S v{};
    S d[K]{};

    Dual() = default;
    Dual(S value) : v(value) {}
};

template <class S>
struct IsDual {
    static constexpr bool value = false;
    static constexpr int count = 0;
};
template <class S, int K>
struct IsDual<Dual<S, K>> {
    static constexpr bool value = true;
    static constexpr int count = K;
};

template <class S, int K>
struct ScalarOf<Dual<S, K>> {
    using type = typename ScalarOf<S>::type;
};

/// A constant of type S from a plain number.
template <class S>
inline S constant(typename ScalarOf<S>::type x) {
    if constexpr (IsDual<S>::value) {
        return S(constant<decltype(S{}.v)>(x));
    } else {
        return S{} + x;
    }
}

#define MPHYGS_EACH for (int k = 0; k < K; ++k)

template <class S, int K>
inline Dual<S, K> operator-(const Dual<S, K>& a) {
    Dual<S, K> r(-a.v);
    MPHYGS_EACH r.d[k] = -a.d[k];
    return r;
}
template <class S, int K>
inline Dual<S, K> operator+(const Dual<S, K>& a, const Dual<S, K>& b) {
    Dual<S, K> r(a.v + b.v);
    MPHYGS_EACH r.d[k] = a.d[k] + b.d[k];
    return r;
}
template <class S, int K>
inline Dual<S, K> operator-(const Dual<S, K>& a, const Dual<S, K>& b) {
    Dual<S, K> r(a.v - b.v);
    MPHYGS_EACH r.d[k] = a.d[k] - b.d[k];
    return r;
}
template <class S, int K>
inline Dual<S, K> operator*(const Dual<S, K>& a, const Dual<S, K>& b) {
    Dual<S, K> r(a.v * b.v);
    MPHYGS_EACH r.d[k] = a.d[k] * b.v + a.v * b.d[k];
    return r;
}
template <class S, int K>
inline Dual<S, K> operator/(const Dual<S, K>& a, const Dual<S, K>& b) {
    const S inverse = 1 / b.v;
    Dual<S, K> r(a.v * inverse);
    MPHYGS_EACH r.d[k] = (a.d[k] - r.v * b.d[k]) * inverse;
    return r;
}
// Mixed with plain numbers.
template <class S, int K>
inline Dual<S, K> operator+(Dual<S, K> a, typename ScalarOf<S>::type b) {
    a.v = a.v + b;
    return a;
}
template <class S, int K>
inline Dual<S, K> operator+(typename ScalarOf<S>::type b, const Dual<S, K>& a) {
    return a + b;
}
template <class S, int K>
inline Dual<S, K> operator-(const Dual<S, K>& a, typename ScalarOf<S>::type b) {
    return a + (-b);
}
template <class S, int K>
inline Dual<S, K> operator-(typename ScalarOf<S>::type b, const Dual<S, K>& a) {
    return (-a) + b;
}
template <class S, int K>
inline Dual<S, K> operator*(const Dual<S, K>& a, typename ScalarOf<S>::type b) {
    Dual<S, K> r(a.v * b);
    MPHYGS_EACH r.d[k] = a.d[k] * b;
    return r;
}
template <class S, int K>
inline Dual<S, K> operator*(typename ScalarOf<S>::type b, const Dual<S, K>& a) {
    return a * b;
}
template <class S, int K>
inline Dual<S, K> operator/(const Dual<S, K>& a, typename ScalarOf<S>::type b) {
    return a * (1 / b);
}
template <class S, int K>
inline Dual<S, K> operator/(typename ScalarOf<S>::type b, const Dual<S, K>& a) {
    const S value = b / a.v;
    const S slope = -value / a.v;
    Dual<S, K> r(value);
    MPHYGS_EACH r.d[k] = slope * a.d[k];
    return r;
}
template <class S, int K>
inline Dual<S, K>& operator+=(Dual<S, K>& a, const Dual<S, K>& b) {
    a.v = a.v + b.v;
    MPHYGS_EACH a.d[k] = a.d[k] + b.d[k];
    return a;
}
template <class S, int K>
inline Dual<S, K>& operator-=(Dual<S, K>& a, const Dual<S, K>& b) {
    a.v = a.v - b.v;
    MPHYGS_EACH a.d[k] = a.d[k] - b.d[k];
    return a;
}
template <class S, int K>
inline Dual<S, K>& operator*=(Dual<S, K>& a, const Dual<S, K>& b) {
    a = a * b;
    return a;
}

template <class S, int K>
inline Dual<S, K> chain(const Dual<S, K>& a, S value, S slope) {
    Dual<S, K> r(value);
    MPHYGS_EACH r.d[k] = slope * a.d[k];
    return r;
}
template <class S, int K>
inline Dual<S, K> square_root(const Dual<S, K>& a) {
    const S root = square_root(a.v);
    return chain(a, root, S(1 / (root + root)));
}
template <class S, int K>
inline Dual<S, K> logarithm(const Dual<S, K>& a) {
    return chain(a, S(logarithm(a.v)), S(1 / a.v));
}
template <class S, int K>
inline Dual<S, K> exponential(const Dual<S, K>& a) {
    const S value = exponential(a.v);
    return chain(a, value, value);
}
template <class S, int K>
inline Dual<S, K> sine(const Dual<S, K>& a) {
    return chain(a, S(sine(a.v)), S(cosine(a.v)));
}
template <class S, int K>
inline Dual<S, K> cosine(const Dual<S, K>& a) {
    return chain(a, S(cosine(a.v)), S(-sine(a.v)));
}
template <class M, class S, int K>
inline Dual<S, K> select(M mask, const Dual<S, K>& a, const Dual<S, K>& b) {
    Dual<S, K> r(select(mask, a.v, b.v));
    MPHYGS_EACH r.d[k] = select(mask, a.d[k], b.d[k]);
    return r;
}
#undef MPHYGS_EACH

/// The value without its derivatives: for decisions (masks), never for results.
template <class S>
inline auto value_of(const S& a) {
    if constexpr (IsDual<S>::value) {
        return a.v;
    } else {
        return a;
    }
}

}  // namespace mphygs
