// Kelvin-Voigt solid: Cauchy stress 2 eta dev(D), D the symmetric velocity gradient.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Viscosity {
    static constexpr EffectInfo info{
        .name = "viscosity",
        .summary = "Kelvin-Voigt Cauchy stress 2 eta dev(D)",
        .site = Site::volume,
        .needs_rate = true,
        .parameters = {{"eta", "Pa s", 0, 0, 1e6, 10, true}},
    };
    /// P = J sigma F^-T = sigma cof(F), with L = dF/dt F^-1 = dF/dt cof(F)^T / J
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        const Mat3<S> c = cofactor(p.deformation);
        const S scale = q[0] / determinant(p.deformation, c);
        p.stress = p.stress + scale * (strain_rate(p.rate * transpose(c)) * c);
    }

    template <class P>
    struct Linearised {
        using R = typename ScalarOf<P>::type;
        Mat3<P> f, c, rate, sigma, pulled, stress;  // F, cof F, dF/dt, sigma and sigma cof F up to `scale`
        P inverse_j, scale;

        Linearised(const VolumePoint<P>& p, const R* q, const P*)
            : f(p.deformation), c(cofactor(f)), rate(p.rate), inverse_j(R(1) / determinant(f, c)), scale(q[0] * inverse_j) {
            sigma = strain_rate(rate * transpose(c));
            pulled = sigma * c;
            stress = scale * pulled;
        }
        template <class W>
        void change(int lane, VolumeChange<W>& d, const Dual<W, 1>* q) const {
            const Mat3<R> f_ = in_lane(f, lane), c_ = in_lane(c, lane), rate_ = in_lane(rate, lane);
            Mat3<W> dc;
            W volumetric{};  // d ln J
            for (int i = 0; i < 3; ++i) {
                for (int j = 0; j < 3; ++j) {
                    dc[i][j] = cofactor_change(f_, d.deformation, i, j);
                    volumetric += c_[i][j] * d.deformation[i][j];
                }
            }
            volumetric = volumetric * inverse_j[lane];
            const Mat3<W> dsigma = strain_rate(mixed_product<W>(d.rate, transpose(c_)) + mixed_product<W>(rate_, transpose(dc)));
            const Mat3<W> dpulled = mixed_product<W>(dsigma, c_) + mixed_product<W>(in_lane(sigma, lane), dc);
            const W dscale = q[0].d[0] * inverse_j[lane] - scale[lane] * volumetric;
            for (int i = 0; i < 3; ++i) {
                for (int j = 0; j < 3; ++j) {
                    d.stress[i][j] += scale[lane] * dpulled[i][j] + pulled[i][j][lane] * dscale;
                }
            }
        }
    };

  private:
    /// 2 dev(sym L)
    template <class S>
    static Mat3<S> strain_rate(const Mat3<S>& l) {
        using R = typename ScalarOf<S>::type;
        const S mean = (R(2) / R(3)) * trace(l);
        Mat3<S> r;
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                r[i][j] = l[i][j] + l[j][i];
            }
            r[i][i] = r[i][i] - mean;
        }
        return r;
    }
};

}  // namespace mphygs
