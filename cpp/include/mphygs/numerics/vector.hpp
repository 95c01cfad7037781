// Vectors of a fixed number of lanes on any processor.
//
// Vector<T, N> is the compiler's own vector where a register holds N numbers, and two vectors of half the lanes where
// none does: g++ keeps a vector that is wider than a register in memory and goes through there with every operation,
// which takes six times as long and more. Both kinds take the same operators; what those lack is here as `choose`, `convert`,
// `shuffle`.
#pragma once

#include <array>
#include <cstddef>
#include <cstring>
#include <type_traits>
#include <utility>

namespace mphygs {

#if defined(__AVX512F__)
inline constexpr std::size_t register_bytes = 64;
#elif defined(__AVX2__)
inline constexpr std::size_t register_bytes = 32;
#else
inline constexpr std::size_t register_bytes = 16;
#endif

template <class H>
struct Halves;

template <class T, int N>
struct VectorChoice {
    struct Native {
        using type __attribute__((vector_size(N * sizeof(T)))) = T;
    };
    struct Split {
        using type = Halves<typename VectorChoice<T, N / 2>::type>;
    };
    using type = typename std::conditional_t<N * sizeof(T) <= register_bytes, Native, Split>::type;
};
template <class T>
struct VectorChoice<T, 1> {  // ends the recursion; no vector has one lane
    using type = T;
};
template <class T, int N>
using Vector = typename VectorChoice<T, N>::type;

/// Element and number of lanes.
template <class V>
struct VectorOf {
    using element = std::remove_cvref_t<decltype(std::declval<const V&>()[0])>;
    static constexpr int count = sizeof(V) / sizeof(element);
    using mask = std::remove_cvref_t<decltype(std::declval<const V&>() < std::declval<const V&>())>;
};
template <class V>
struct IsHalves : std::false_type {};
template <class H>
struct IsHalves<Halves<H>> : std::true_type {};
/// One of the compiler's own vectors.
template <class V>
concept NativeVector = !std::is_class_v<V> && !std::is_pointer_v<V> && !std::is_array_v<V> && requires(const V& v) { v[0]; };

#define MPHYGS_BINARY(op)                                                                                          \
    friend Halves operator op(const Halves& a, const Halves& b) { return {a.low op b.low, a.high op b.high}; }     \
    friend Halves operator op(const Halves& a, element b) { return {a.low op b, a.high op b}; }                    \
    friend Halves operator op(element a, const Halves& b) { return {a op b.low, a op b.high}; }                    \
    friend Halves& operator op##=(Halves& a, const Halves& b) { return a = a op b; }                               \
    friend Halves& operator op##=(Halves& a, element b) { return a = a op b; }
#define MPHYGS_COMPARISON(op)                                                                                      \
    friend auto operator op(const Halves& a, const Halves& b) { return pair_of(a.low op b.low, a.high op b.high); } \
    friend auto operator op(const Halves& a, element b) { return pair_of(a.low op b, a.high op b); }

template <class H>
struct Halves {
    using element = typename VectorOf<H>::element;
    static constexpr int half = VectorOf<H>::count;
    H low, high;

    /// A lane that can be written to.
    struct Lane {
        Halves& of;
        int at;
        operator element() const { return std::as_const(of)[at]; }
        Lane& operator=(element x) {
            if (at < half) {
                of.low[at] = x;
            } else {
                of.high[at - half] = x;
            }
            return *this;
        }
        Lane& operator=(const Lane& x) { return *this = static_cast<element>(x); }
        Lane& operator+=(element x) { return *this = *this + x; }
        Lane& operator-=(element x) { return *this = *this - x; }
    };
    template <class I>
    element operator[](I i) const {
        const int at = static_cast<int>(i);
        return at < half ? low[at] : high[at - half];
    }
    template <class I>
    Lane operator[](I i) {
        return {*this, static_cast<int>(i)};
    }

    friend Halves operator-(const Halves& a) { return {-a.low, -a.high}; }
    friend Halves operator~(const Halves& a) { return {~a.low, ~a.high}; }
    friend Halves operator<<(const Halves& a, int n) { return {a.low << n, a.high << n}; }
    friend Halves operator>>(const Halves& a, int n) { return {a.low >> n, a.high >> n}; }
    MPHYGS_BINARY(+)
    MPHYGS_BINARY(-)
    MPHYGS_BINARY(*)
    MPHYGS_BINARY(/)
    MPHYGS_BINARY(&)
    MPHYGS_BINARY(|)
    MPHYGS_COMPARISON(<)
    MPHYGS_COMPARISON(<=)
    MPHYGS_COMPARISON(>)
    MPHYGS_COMPARISON(>=)
    MPHYGS_COMPARISON(==)
    MPHYGS_COMPARISON(!=)

  private:
    template <class M>
    static Halves<M> pair_of(M a, M b) {
        return {a, b};
    }
};
#undef MPHYGS_BINARY
#undef MPHYGS_COMPARISON

/// As many bytes as V has, from memory. Half by half: a copy of both at once would be one of 16 bytes a time, and the
/// register waits for all of them.
template <class V>
[[gnu::always_inline]] inline V read(const void* p) {
    if constexpr (IsHalves<V>::value) {
        using H = decltype(V::low);
        return {read<H>(p), read<H>(static_cast<const char*>(p) + sizeof(H))};
    } else {
        V v;
        std::memcpy(&v, p, sizeof v);
        return v;
    }
}
template <class V>
[[gnu::always_inline]] inline void write(void* p, const V& v) {
    if constexpr (IsHalves<V>::value) {
        write(p, v.low);
        write(static_cast<char*>(p) + sizeof v.low, v.high);
    } else {
        std::memcpy(p, &v, sizeof v);
    }
}

/// The same number in every lane.
template <class V>
inline V fill(typename VectorOf<V>::element x) {
    if constexpr (IsHalves<V>::value) {
        const auto half = fill<decltype(V::low)>(x);
        return {half, half};
    } else {
        return [&]<std::size_t... i>(std::index_sequence<i...>) {  // one instruction; an added zero would be a second one
            return V{(static_cast<void>(i), x)...};
        }(std::make_index_sequence<static_cast<std::size_t>(VectorOf<V>::count)>{});
    }
}

/// a in lanes whose mask is set, b in the others.
template <class M, class V>
inline V choose(const M& mask, const V& a, const V& b) {
    if constexpr (IsHalves<V>::value) {
        return {choose(mask.low, a.low, b.low), choose(mask.high, a.high, b.high)};
    } else {
        return mask ? a : b;
    }
}

/// The same lanes as numbers of another type; rounds towards zero.
template <class W, class V>
inline W convert(const V& v) {
    if constexpr (IsHalves<V>::value && IsHalves<W>::value) {
        using H = decltype(W::low);
        return {convert<H>(v.low), convert<H>(v.high)};
    } else if constexpr (IsHalves<V>::value || IsHalves<W>::value) {
        typename VectorOf<V>::element from[VectorOf<V>::count];
        typename VectorOf<W>::element to[VectorOf<V>::count];
        write(from, v);
        for (int i = 0; i < VectorOf<V>::count; ++i) {
            to[i] = static_cast<typename VectorOf<W>::element>(from[i]);
        }
        return read<W>(to);
    } else {
        return __builtin_convertvector(v, W);
    }
}

namespace detail {

/// Of vectors in halves: which half (0, 1: of a; 2, 3: of b) a lane comes from, and lanes of those two halves.
template <int N>
struct HalfPlan {
    int source[2] = {-1, -1};
    std::array<int, N> lane{};
    bool possible = true;
};
template <int N>
constexpr HalfPlan<N> half_plan(const std::array<int, 2 * N>& lanes, int from) {
    HalfPlan<N> plan;
    for (int i = 0; i < N; ++i) {
        const int lane = lanes[static_cast<std::size_t>(from + i)], source = lane / N;
        int which = plan.source[0] == source || plan.source[0] < 0 ? 0 : 1;
        if (plan.source[which] < 0) {
            plan.source[which] = source;
        }
        plan.possible = plan.possible && plan.source[which] == source;
        plan.lane[static_cast<std::size_t>(i)] = which * N + lane % N;
    }
    plan.source[1] = plan.source[1] < 0 ? plan.source[0] : plan.source[1];
    return plan;
}

}  // namespace detail

/// Lanes of a (0 to N - 1) and of b (N to 2 N - 1). Each half of the result may take from two halves.
template <int... lanes, class V>
[[gnu::always_inline]] inline V shuffle(const V& a, const V& b) {
    if constexpr (IsHalves<V>::value) {
        using H = decltype(V::low);
        constexpr int n = V::half;
        const auto half = [&]<std::size_t... i, class From>(std::index_sequence<i...>, From) -> H {
            constexpr auto plan = detail::half_plan<n>({lanes...}, From::value);
            static_assert(plan.possible, "half of a shuffled vector takes from more than two halves");
            const auto source = [&]<int s>(std::integral_constant<int, s>) -> const H& {
                return s == 0 ? a.low : s == 1 ? a.high : s == 2 ? b.low : b.high;
            };
            return shuffle<plan.lane[i]...>(source(std::integral_constant<int, plan.source[0]>{}),
                                            source(std::integral_constant<int, plan.source[1]>{}));
        };
        constexpr auto each = std::make_index_sequence<static_cast<std::size_t>(n)>{};
        return {half(each, std::integral_constant<int, 0>{}), half(each, std::integral_constant<int, n>{})};
    } else {
        return __builtin_shufflevector(a, b, lanes...);
    }
}

}  // namespace mphygs
