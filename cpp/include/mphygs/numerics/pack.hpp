// Eight lanes at once: the number type of every hot loop.
//
// Arithmetic on a Pack<T> compiles to whatever the target has (two SSE, one AVX, half an AVX-512 register; of double twice
// as many). Functions that vectors lack (sqrt, log, exp, select) stand here, with the same bits on every target with
// fused multiply-add contraction fixed by the build.
#pragma once

#include <cmath>
#include <cstdint>

#include "mphygs/numerics/vector.hpp"

namespace mphygs {

inline constexpr int lane_count = 8;

template <class T>
using Pack = Vector<T, lane_count>;
/// Sixteen lanes, one AVX-512 register: two packs side by side.
using PackPair = Vector<float, 2 * lane_count>;
template <class T>
using PackMask = typename VectorOf<Pack<T>>::mask;

template <class V>
struct ScalarOf {
    using type = V;
};
template <NativeVector V>
struct ScalarOf<V> {
    using type = typename VectorOf<V>::element;
};
template <class H>
struct ScalarOf<Halves<H>> {
    using type = typename VectorOf<H>::element;
};

template <class T>
inline Pack<T> load(const T* p) {
    return read<Pack<T>>(p);
}
template <class T>
inline void store(T* p, Pack<T> v) {
    write(p, v);
}
template <class T>
inline Pack<T> broadcast(T x) {
    return fill<Pack<T>>(x);
}
inline PackPair load_pair(const float* p) { return read<PackPair>(p); }
template <class T>
inline T sum_lanes(Pack<T> v) {
    // Fixed tree, so that the order of summation never depends on the target.
    return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
}

// ---- functions on plain numbers, so that templates work on both -------------------------------
inline float square_root(float x) { return std::sqrt(x); }
inline double square_root(double x) { return std::sqrt(x); }
inline float logarithm(float x) { return std::log(x); }
inline double logarithm(double x) { return std::log(x); }
inline float exponential(float x) { return std::exp(x); }
inline double exponential(double x) { return std::exp(x); }
inline float sine(float x) { return std::sin(x); }
inline double sine(double x) { return std::sin(x); }
inline float cosine(float x) { return std::cos(x); }
inline double cosine(double x) { return std::cos(x); }
inline float select(bool m, float a, float b) { return m ? a : b; }
inline double select(bool m, double a, double b) { return m ? a : b; }

// ---- and on vectors ---------------------------------------------------------------------------
#define MPHYGS_LANEWISE(name)                                             \
    template <NativeVector V>                                             \
    inline V name(V x) {                                                  \
        using T = typename VectorOf<V>::element;                          \
        for (int i = 0; i < VectorOf<V>::count; ++i) {                    \
            x[i] = name(static_cast<T>(x[i]));                            \
        }                                                                 \
        return x;                                                         \
    }
MPHYGS_LANEWISE(square_root)
MPHYGS_LANEWISE(sine)
MPHYGS_LANEWISE(cosine)
#undef MPHYGS_LANEWISE

template <class M, NativeVector V>
inline V select(const M& m, const V& a, const V& b) {
    return choose(m, a, b);
}
template <class M, class H>
inline Halves<H> select(const M& m, const Halves<H>& a, const Halves<H>& b) {
    return choose(m, a, b);
}

// ln x = e ln 2 + 2 artanh((m - 1)/(m + 1)), x = m 2^e, m in [sqrt(1/2), sqrt(2)).
// Not a number for x <= 0: an inverted element has no logarithmic strain.
template <NativeVector V>
inline V logarithm(V x) {
    using T = typename VectorOf<V>::element;
    using Mask = typename VectorOf<V>::mask;
    constexpr bool single = sizeof(T) == 4;
    using Bits = std::conditional_t<single, std::uint32_t, std::uint64_t>;  // unsigned: any bits may be subtracted
    constexpr Bits root_half = static_cast<Bits>(single ? 0x3f3504f3ULL : 0x3fe6a09e667f3bcdULL);  // sqrt(1/2)
    constexpr int shift = single ? 23 : 52;
    const auto bits = read<Vector<Bits, VectorOf<V>::count>>(&x);
    const auto shifted = bits - root_half;
    const Mask exponent = read<Mask>(&shifted) >> shift;  // floor(log2(x / sqrt(1/2)))
    const auto mantissa = bits - (read<Vector<Bits, VectorOf<V>::count>>(&exponent) << shift);
    const V m = read<V>(&mantissa);
    const V s = (m - T(1)) / (m + T(1));
    const V z = s * s;
    V series;
    if constexpr (single) {
        series = ((((z / 11.0f + 1.0f / 9.0f) * z + 1.0f / 7.0f) * z + 0.2f) * z + 1.0f / 3.0f) * z + 1.0f;
    } else {
        series = V{} + 1.0 / 23.0;
        for (int k = 21; k >= 1; k -= 2) {
            series = series * z + 1.0 / k;
        }
    }
    const V value = convert<V>(exponent) * T(0.69314718055994530942) + T(2) * s * series;
    return choose(x > T(0), value, V{} + static_cast<T>(NAN));
}

// e^x = 2^n e^r, n = round(x / ln 2), |r| <= ln 2 / 2, e^r by its Taylor series.
template <NativeVector V>
inline V exponential(V x) {
    using T = typename VectorOf<V>::element;
    using Mask = typename VectorOf<V>::mask;
    constexpr bool single = sizeof(T) == 4;
    constexpr T least = single ? -87 : -708, most = single ? 88 : 709;
    constexpr T magic = single ? 12582912.0 : 6755399441055744.0;  // adding it rounds to an integer
    x = choose(x < least, V{} + least, choose(x > most, V{} + most, x));
    const V n = (x * T(1.4426950408889634) + magic) - magic;
    // ln 2 in two parts
    const V r = single ? (x - n * T(0.693359375)) + n * T(2.12194440e-4) : (x - n * T(0.693145751953125)) - n * T(1.42860682030941723212e-6);
    const Mask bits = (convert<Mask>(n) + (single ? 127 : 1023)) << (single ? 23 : 52);
    V sum = V{} + T(1);
    for (int k = single ? 7 : 14; k >= 1; --k) {
        sum = sum * r / T(k) + T(1);
    }
    return sum * read<V>(&bits);
}

#define MPHYGS_HALVES(name)                                                             \
    template <class H>                                                                  \
    inline Halves<H> name(const Halves<H>& x) {                                         \
        return {name(x.low), name(x.high)};                                             \
    }
MPHYGS_HALVES(square_root)
MPHYGS_HALVES(logarithm)
MPHYGS_HALVES(exponential)
MPHYGS_HALVES(sine)
MPHYGS_HALVES(cosine)
#undef MPHYGS_HALVES

}  // namespace mphygs
