// Reverse derivatives of one small function.
//
// Var<S> records the operations of a template written for values; `Tape::sweep` then turns the
// adjoints of its results into adjoints of its inputs. The tape lives in thread-local memory, is
// reset for every block of eight points, and holds a few hundred entries: it never leaves the
// first-level cache. S is a Pack.
#pragma once

#include <vector>

#include "mphygs/numerics/dual.hpp"

namespace mphygs {

template <class S>
class Tape {
  public:
    struct Entry {
        int a, b;
        S da, db;
    };
    static Tape& current() {
        thread_local Tape tape;
        return tape;
    }
    void reset() { entries_.clear(); }
    int push(int a, S da, int b, S db) {
        entries_.push_back({a, b, da, db});
        return static_cast<int>(entries_.size()) - 1;
    }
    int input() { return push(-1, S{}, -1, S{}); }
    /// Clears all adjoints; set those of the results with `adjoint(i) = ...` and then `sweep`.
    void prepare() { adjoints_.assign(entries_.size(), S{}); }
    S& adjoint(int i) { return adjoints_[static_cast<std::size_t>(i)]; }
    void sweep() {
        for (int i = static_cast<int>(entries_.size()) - 1; i >= 0; --i) {
            const Entry& e = entries_[static_cast<std::size_t>(i)];
            const S bar = adjoints_[static_cast<std::size_t>(i)];
            if (e.a >= 0) {
                adjoints_[static_cast<std::size_t>(e.a)] += e.da * bar;
            }
            if (e.b >= 0) {
                adjoints_[static_cast<std::size_t>(e.b)] += e.db * bar;
            }
        }
    }

  private:
    std::vector<Entry> entries_;
    std::vector<S> adjoints_;
};

template <class S>
struct Var {
    S v{};
    int i = -1;  // -1: a constant

    Var() = default;
    Var(S value) : v(value) {}
    static Var input(S value) {
        Var r(value);
        r.i = Tape<S>::current().input();
        return r;
    }
};

template <class S>
struct IsVar {
    static constexpr bool value = false;
};
template <class S>
struct IsVar<Var<S>> {
    static constexpr bool value = true;
};
template <class S>
struct ScalarOf<Var<S>> {
    using type = typename ScalarOf<S>::type;
};
template <class S>
inline S value_of(const Var<S>& a) {
    return a.v;
}

template <class S>
inline Var<S> record(S value, const Var<S>& a, S da, const Var<S>& b, S db) {
    Var<S> r(value);
    if (a.i >= 0 || b.i >= 0) {
        r.i = Tape<S>::current().push(a.i, da, b.i, db);
    }
    return r;
}
template <class S>
inline Var<S> record(S value, const Var<S>& a, S da) {
    Var<S> r(value);
    if (a.i >= 0) {
        r.i = Tape<S>::current().push(a.i, da, -1, S{});
    }
    return r;
}
template <class S>
inline Var<S> operator-(const Var<S>& a) {
    return record<S>(-a.v, a, S{} - 1);
}
template <class S>
inline Var<S> operator+(const Var<S>& a, const Var<S>& b) {
    return record<S>(a.v + b.v, a, S{} + 1, b, S{} + 1);
}
template <class S>
inline Var<S> operator-(const Var<S>& a, const Var<S>& b) {
    return record<S>(a.v - b.v, a, S{} + 1, b, S{} - 1);
}
template <class S>
inline Var<S> operator*(const Var<S>& a, const Var<S>& b) {
    return record<S>(a.v * b.v, a, b.v, b, a.v);
}
template <class S>
inline Var<S> operator/(const Var<S>& a, const Var<S>& b) {
    const S inverse = 1 / b.v;
    const S value = a.v * inverse;
    return record<S>(value, a, inverse, b, -value * inverse);
}
template <class S>
inline Var<S> operator+(const Var<S>& a, typename ScalarOf<S>::type b) {
    return record<S>(a.v + b, a, S{} + 1);
}
template <class S>
inline Var<S> operator+(typename ScalarOf<S>::type b, const Var<S>& a) {
    return a + b;
}
template <class S>
inline Var<S> operator-(const Var<S>& a, typename ScalarOf<S>::type b) {
    return a + (-b);
}
template <class S>
inline Var<S> operator-(typename ScalarOf<S>::type b, const Var<S>& a) {
    return record<S>(b - a.v, a, S{} - 1);
}
template <class S>
inline Var<S> operator*(const Var<S>& a, typename ScalarOf<S>::type b) {
    return record<S>(a.v * b, a, S{} + b);
}
template <class S>
inline Var<S> operator*(typename ScalarOf<S>::type b, const Var<S>& a) {
    return a * b;
}
template <class S>
inline Var<S> operator/(const Var<S>& a, typename ScalarOf<S>::type b) {
    return a * (1 / b);
}
template <class S>
inline Var<S> operator/(typename ScalarOf<S>::type b, const Var<S>& a) {
    const S value = b / a.v;
    return record<S>(value, a, -value / a.v);
}
template <class S>
inline Var<S>& operator+=(Var<S>& a, const Var<S>& b) {
    a = a + b;
    return a;
}
template <class S>
inline Var<S>& operator-=(Var<S>& a, const Var<S>& b) {
    a = a - b;
    return a;
}
template <class S>
inline Var<S>& operator*=(Var<S>& a, const Var<S>& b) {
    a = a * b;
    return a;
}
template <class S>
inline Var<S> square_root(const Var<S>& a) {
    const S root = square_root(a.v);
    return record<S>(root, a, 1 / (root + root));
}
template <class S>
inline Var<S> logarithm(const Var<S>& a) {
    return record<S>(logarithm(a.v), a, 1 / a.v);
}
template <class S>
inline Var<S> exponential(const Var<S>& a) {
    const S value = exponential(a.v);
    return record<S>(value, a, value);
}
template <class S>
inline Var<S> sine(const Var<S>& a) {
    return record<S>(sine(a.v), a, cosine(a.v));
}
template <class S>
inline Var<S> cosine(const Var<S>& a) {
    return record<S>(cosine(a.v), a, -sine(a.v));
}
template <class M, class S>
inline Var<S> select(M mask, const Var<S>& a, const Var<S>& b) {
    const S one = S{} + 1;
    return record<S>(select(mask, a.v, b.v), a, select(mask, one, S{}), b, select(mask, S{}, one));
}

}  // namespace mphygs
