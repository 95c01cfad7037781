// Three-vectors and 3x3 matrices over any scalar (number, Pack, Dual, Var).
#pragma once

#include "mphygs/numerics/tape.hpp"

namespace mphygs {

template <class S>
struct Vec3 {
    S e[3]{};
    S& operator[](int i) { return e[i]; }
    const S& operator[](int i) const { return e[i]; }
};

template <class S>
struct Mat3 {
    S e[3][3]{};
    S* operator[](int i) { return e[i]; }
    const S* operator[](int i) const { return e[i]; }
    static Mat3 identity() {
        Mat3 r;
        for (int i = 0; i < 3; ++i) {
            r.e[i][i] = r.e[i][i] + typename ScalarOf<S>::type(1);
        }
        return r;
    }
};

#define MPHYGS_IJ              \
    for (int i = 0; i < 3; ++i) \
        for (int j = 0; j < 3; ++j)

template <class S>
inline Vec3<S> operator+(const Vec3<S>& a, const Vec3<S>& b) {
    return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}};
}
template <class S>
inline Vec3<S> operator-(const Vec3<S>& a, const Vec3<S>& b) {
    return {{a[0] - b[0], a[1] - b[1], a[2] - b[2]}};
}
template <class S>
inline Vec3<S> operator*(const S& s, const Vec3<S>& a) {
    return {{s * a[0], s * a[1], s * a[2]}};
}
template <class S>
inline S dot(const Vec3<S>& a, const Vec3<S>& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class S>
inline Mat3<S> operator+(const Mat3<S>& a, const Mat3<S>& b) {
    Mat3<S> r;
    MPHYGS_IJ r[i][j] = a[i][j] + b[i][j];
    return r;
}
template <class S>
inline Mat3<S> operator-(const Mat3<S>& a, const Mat3<S>& b) {
    Mat3<S> r;
    MPHYGS_IJ r[i][j] = a[i][j] - b[i][j];
    return r;
}
template <class S>
inline Mat3<S> operator*(const S& s, const Mat3<S>& a) {
    Mat3<S> r;
    MPHYGS_IJ r[i][j] = s * a[i][j];
    return r;
}
template <class S>
[[gnu::always_inline]] inline Mat3<S> operator*(const Mat3<S>& a, const Mat3<S>& b) {
    Mat3<S> r;
    MPHYGS_IJ r[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
    return r;
}
template <class S>
inline Vec3<S> operator*(const Mat3<S>& a, const Vec3<S>& b) {
    Vec3<S> r;
    for (int i = 0; i < 3; ++i) {
        r[i] = a[i][0] * b[0] + a[i][1] * b[1] + a[i][2] * b[2];
    }
    return r;
}
template <class S>
[[gnu::always_inline]] inline Mat3<S> transpose(const Mat3<S>& a) {
    Mat3<S> r;
    MPHYGS_IJ r[i][j] = a[j][i];
    return r;
}
template <class S>
inline S trace(const Mat3<S>& a) {
    return a[0][0] + a[1][1] + a[2][2];
}
/// a : b = sum of a_ij b_ij.
template <class S>
inline S inner(const Mat3<S>& a, const Mat3<S>& b) {
    S r{};
    MPHYGS_IJ r = r + a[i][j] * b[i][j];
    return r;
}
/// Cofactor matrix, cof(A) = det(A) A^-T.
template <class S>
[[gnu::always_inline]] inline Mat3<S> cofactor(const Mat3<S>& a) {
    Mat3<S> c;
    c[0][0] = a[1][1] * a[2][2] - a[1][2] * a[2][1];
    c[0][1] = a[1][2] * a[2][0] - a[1][0] * a[2][2];
    c[0][2] = a[1][0] * a[2][1] - a[1][1] * a[2][0];
    c[1][0] = a[0][2] * a[2][1] - a[0][1] * a[2][2];
    c[1][1] = a[0][0] * a[2][2] - a[0][2] * a[2][0];
    c[1][2] = a[0][1] * a[2][0] - a[0][0] * a[2][1];
    c[2][0] = a[0][1] * a[1][2] - a[0][2] * a[1][1];
    c[2][1] = a[0][2] * a[1][0] - a[0][0] * a[1][2];
    c[2][2] = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    return c;
}
template <class S>
inline S determinant(const Mat3<S>& a, const Mat3<S>& cof) {
    return a[0][0] * cof[0][0] + a[0][1] * cof[0][1] + a[0][2] * cof[0][2];
}
template <class S>
inline Mat3<S> inverse(const Mat3<S>& a) {
    const Mat3<S> c = cofactor(a);
    const S scale = typename ScalarOf<S>::type(1) / determinant(a, c);
    return scale * transpose(c);
}

/// One lane of a matrix of packs.
template <class P>
inline Mat3<typename ScalarOf<P>::type> in_lane(const Mat3<P>& m, int lane) {
    Mat3<typename ScalarOf<P>::type> r;
    MPHYGS_IJ r[i][j] = m[i][j][lane];
    return r;
}
/// A product of which one factor's elements are plain numbers for the other's.
template <class D, class A, class B>
[[gnu::always_inline]] inline Mat3<D> mixed_product(const Mat3<A>& a, const Mat3<B>& b) {
    Mat3<D> r;
    MPHYGS_IJ r[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
    return r;
}
/// Element (a, b) of the change of cof(f) for df. D: S, or wider.
template <class S, class D>
inline D cofactor_change(const Mat3<S>& f, const Mat3<D>& df, int a, int b) {
    const int a1 = (a + 1) % 3, a2 = (a + 2) % 3, b1 = (b + 1) % 3, b2 = (b + 2) % 3;
    return df[a1][b1] * f[a2][b2] + f[a1][b1] * df[a2][b2] - df[a1][b2] * f[a2][b1] - f[a1][b2] * df[a2][b1];
}
#undef MPHYGS_IJ

}  // namespace mphygs
