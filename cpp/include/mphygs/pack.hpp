// Eight lanes at once: the number type of every hot loop.
//
// A Pack<T> is a GCC/Clang vector of eight T; arithmetic on it compiles to whatever the target
// has (two SSE, one AVX, half an AVX-512 register). Functions that the vector extension lacks
// (sqrt, log, exp, select) stand here, with the same bits on every target with fused
// multiply-add contraction fixed by the build.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#ifdef __AVX512F__
#include <immintrin.h>
#endif

namespace mphygs {

inline constexpr int lane_count = 8;

template <class T>
struct PackOf;
template <>
struct PackOf<float> {
    using type __attribute__((vector_size(32))) = float;
    using mask __attribute__((vector_size(32))) = std::int32_t;
    using bits __attribute__((vector_size(32))) = std::uint32_t;
};
template <>
struct PackOf<double> {
    using type __attribute__((vector_size(64))) = double;
    using mask __attribute__((vector_size(64))) = std::int64_t;
    using bits __attribute__((vector_size(64))) = std::uint64_t;
};
template <class T>
using Pack = typename PackOf<T>::type;
/// Sixteen lanes, one AVX-512 register: two packs side by side.
using PackPair __attribute__((vector_size(64))) = float;
template <class T>
using PackMask = typename PackOf<T>::mask;
template <class T>
using PackBits = typename PackOf<T>::bits;  // unsigned: the bits of any number may be subtracted

template <class V>
struct ScalarOf {
    using type = V;
};
template <>
struct ScalarOf<Pack<float>> {
    using type = float;
};
template <>
struct ScalarOf<Pack<double>> {
    using type = double;
};
template <>
struct ScalarOf<PackPair> {
    using type = float;
};

template <class T>
inline Pack<T> load(const T* p) {
    Pack<T> v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
template <class T>
inline void store(T* p, Pack<T> v) {
    std::memcpy(p, &v, sizeof v);
}
// g++ 12 goes through memory where a shuffle changes the number of lanes, and waits for the store.
#ifdef __AVX512F__
inline PackPair join(Pack<float> low, Pack<float> high) {
    const __m512d whole = _mm512_castps_pd(_mm512_castps256_ps512(reinterpret_cast<__m256>(low)));
    return reinterpret_cast<PackPair>(_mm512_maskz_insertf64x4(0xff, whole, reinterpret_cast<__m256d>(high), 1));
}
/// Eight times one number, eight times another.
inline PackPair broadcast_pair(const float* low, const float* high) {
    return reinterpret_cast<PackPair>(_mm512_mask_broadcastss_ps(_mm512_set1_ps(*low), 0xff00, _mm_load_ss(high)));
}
inline Pack<float> upper(PackPair x) {
    return reinterpret_cast<Pack<float>>(_mm512_maskz_extractf64x4_pd(0xf, reinterpret_cast<__m512d>(x), 1));
}
inline Pack<float> lower(PackPair x) {
    return reinterpret_cast<Pack<float>>(_mm512_maskz_extractf64x4_pd(0xf, reinterpret_cast<__m512d>(x), 0));
}
#else
inline PackPair join(Pack<float> low, Pack<float> high) {
    return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
}
inline PackPair broadcast_pair(const float* low, const float* high) {
    const float a = *low, b = *high;
    return PackPair{a, a, a, a, a, a, a, a, b, b, b, b, b, b, b, b};
}
inline Pack<float> upper(PackPair x) { return __builtin_shufflevector(x, x, 8, 9, 10, 11, 12, 13, 14, 15); }
inline Pack<float> lower(PackPair x) { return __builtin_shufflevector(x, x, 0, 1, 2, 3, 4, 5, 6, 7); }
#endif
inline PackPair load_pair(const float* p) {
    PackPair v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
template <class T>
inline Pack<T> broadcast(T x) {
    return Pack<T>{x, x, x, x, x, x, x, x};  // one instruction; an added zero would be a second one
}
using PackPairMask __attribute__((vector_size(64))) = std::int32_t;
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

// ---- and on packs -----------------------------------------------------------------------------
#define MPHYGS_LANEWISE(name)                          \
    inline Pack<float> name(Pack<float> x) {           \
        for (int i = 0; i < lane_count; ++i) {         \
            x[i] = name(static_cast<float>(x[i]));     \
        }                                              \
        return x;                                      \
    }                                                  \
    inline Pack<double> name(Pack<double> x) {         \
        for (int i = 0; i < lane_count; ++i) {         \
            x[i] = name(static_cast<double>(x[i]));    \
        }                                              \
        return x;                                      \
    }
MPHYGS_LANEWISE(square_root)
MPHYGS_LANEWISE(sine)
MPHYGS_LANEWISE(cosine)
#undef MPHYGS_LANEWISE

inline Pack<float> select(PackMask<float> m, Pack<float> a, Pack<float> b) { return m ? a : b; }
inline Pack<double> select(PackMask<double> m, Pack<double> a, Pack<double> b) { return m ? a : b; }

// ln x = e ln 2 + 2 artanh((m - 1)/(m + 1)), x = m 2^e, m in [sqrt(1/2), sqrt(2)).
// Not a number for x <= 0: an inverted element has no logarithmic strain.
inline Pack<float> logarithm(Pack<float> x) {
    PackBits<float> bits;
    std::memcpy(&bits, &x, sizeof bits);
    const PackMask<float> exponent = reinterpret_cast<PackMask<float>>(bits - 0x3f3504f3U) >> 23;  // floor(log2(x / sqrt(1/2)))
    const PackBits<float> mantissa = bits - (reinterpret_cast<PackBits<float>>(exponent) << 23);
    Pack<float> m;
    std::memcpy(&m, &mantissa, sizeof m);
    const Pack<float> s = (m - 1.0f) / (m + 1.0f);
    const Pack<float> z = s * s;
    const Pack<float> series = ((((z / 11.0f + 1.0f / 9.0f) * z + 1.0f / 7.0f) * z + 0.2f) * z + 1.0f / 3.0f) * z + 1.0f;
    const Pack<float> value = __builtin_convertvector(exponent, Pack<float>) * 0.693147180559945f + 2.0f * s * series;
    return x > 0.0f ? value : Pack<float>{} + NAN;
}
inline Pack<double> logarithm(Pack<double> x) {
    PackBits<double> bits;
    std::memcpy(&bits, &x, sizeof bits);
    const PackMask<double> exponent = reinterpret_cast<PackMask<double>>(bits - 0x3fe6a09e667f3bcdULL) >> 52;
    const PackBits<double> mantissa = bits - (reinterpret_cast<PackBits<double>>(exponent) << 52);
    Pack<double> m;
    std::memcpy(&m, &mantissa, sizeof m);
    const Pack<double> s = (m - 1.0) / (m + 1.0);
    const Pack<double> z = s * s;
    Pack<double> series = Pack<double>{} + 1.0 / 23.0;
    for (int k = 21; k >= 1; k -= 2) {
        series = series * z + 1.0 / k;
    }
    const Pack<double> value = __builtin_convertvector(exponent, Pack<double>) * 0.69314718055994530942 + 2.0 * s * series;
    return x > 0.0 ? value : Pack<double>{} + static_cast<double>(NAN);
}

// e^x = 2^n e^r, n = round(x / ln 2), |r| <= ln 2 / 2, e^r by its Taylor series.
template <class T>
inline Pack<T> exponential_series(Pack<T> r, int degree) {
    Pack<T> sum = Pack<T>{} + T(1);
    for (int k = degree; k >= 1; --k) {
        sum = sum * r / T(k) + T(1);
    }
    return sum;
}
inline Pack<float> exponential(Pack<float> x) {
    x = x < -87.0f ? Pack<float>{} - 87.0f : (x > 88.0f ? Pack<float>{} + 88.0f : x);
    const Pack<float> shifted = x * 1.44269504f + 12582912.0f;  // rounds to an integer
    const Pack<float> n = shifted - 12582912.0f;
    const Pack<float> r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    PackMask<float> bits = (__builtin_convertvector(n, PackMask<float>) + 127) << 23;
    Pack<float> scale;
    std::memcpy(&scale, &bits, sizeof scale);
    return exponential_series<float>(r, 7) * scale;
}
inline Pack<double> exponential(Pack<double> x) {
    x = x < -708.0 ? Pack<double>{} - 708.0 : (x > 709.0 ? Pack<double>{} + 709.0 : x);
    const Pack<double> shifted = x * 1.4426950408889634 + 6755399441055744.0;
    const Pack<double> n = shifted - 6755399441055744.0;
    const Pack<double> r = (x - n * 0.693145751953125) - n * 1.42860682030941723212e-6;
    PackMask<double> bits = (__builtin_convertvector(n, PackMask<double>) + 1023) << 52;
    Pack<double> scale;
    std::memcpy(&scale, &bits, sizeof scale);
    return exponential_series<double>(r, 14) * scale;
}

// ---- and on two packs side by side: the same bits as one after the other ------------------------
#define MPHYGS_HALVES(name) \
    inline PackPair name(PackPair x) { return join(name(lower(x)), name(upper(x))); }
MPHYGS_HALVES(square_root)
MPHYGS_HALVES(logarithm)
MPHYGS_HALVES(exponential)
MPHYGS_HALVES(sine)
MPHYGS_HALVES(cosine)
#undef MPHYGS_HALVES
inline PackPair select(PackPairMask m, PackPair a, PackPair b) { return m ? a : b; }

}  // namespace mphygs
