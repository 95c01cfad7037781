// Loads that change with time and follow the object: forces on its material, tendons, pressure on its surface.
//
// They act at points. A point is carried by the material, x = X + sum_k w_k u_k with carriers k (grid nodes or particles), by
// a hold, x = R X + p, or stands still in space; what acts on it goes to its carriers by the same weights. With channels c_j(t)
// (forces [N], tensions [N], pressures [Pa]):
//   force     f_p = (c_j, c_j+1, c_j+2)
//   tendon    f_p = c_j [(x_p+1 - x_p)/|x_p+1 - x_p| - (x_p - x_p-1)/|x_p - x_p-1|] along its path, without friction
//   pressure  f = -c_j A / 3 at the middles of the three sides of a triangle, A = (x_1 - x_0) x (x_2 - x_0) / 2 its outward
//             area as it is now: -p cof(F) N dA (Nanson) of the surface that its corners span, integrated by a rule that is
//             exact for quadratic weights. Over a closed surface they sum to zero.
// Channels are cubic polynomials in the share s of each output interval. All of this is computed in double.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace mphygs {

struct Actuation {
    std::vector<std::int32_t> row_begin, row_carrier;  // (M + 1,), carriers of each point
    std::vector<double> row_weight;                    // their weights w [-]
    std::vector<double> place;                         // (M, 3) X of each point [m]
    std::vector<std::int32_t> hold;                    // (M,) the hold that carries it, -1: none
    std::vector<std::int32_t> force_point, force_channel;              // the channel of x; y and z are the next two
    std::vector<std::int32_t> path_begin, path_point, path_channel;    // (K + 1,), points of each tendon, (K,)
    std::vector<std::int32_t> triangle, triangle_middle;               // (Q, 3) points at its corners, and amidst its sides
    std::vector<std::int32_t> triangle_channel;                        // (Q,)
    int channel_count = 0;

    bool empty() const { return channel_count == 0; }
    std::size_t point_count() const { return hold.size(); }
    std::size_t channels() const { return static_cast<std::size_t>(channel_count); }

    /// To be called once all is set. Throws std::invalid_argument, one line, where sizes or numbers are wrong.
    void settle(std::size_t carriers, int holds);
    /// numbers: of Fields::channel for so many intervals. Throws std::invalid_argument.
    void check_channels(std::size_t numbers, std::size_t intervals) const;

    /// The carriers whose places matter, each once.
    const std::vector<std::int32_t>& read_carriers() const { return read_; }

    /// c (channels,) of a field (F, channels, 4) in an interval; powers: of the share. No field, or an empty one: zero.
    template <class T>
    void channels_at(const std::vector<T>* field, std::size_t interval, const double (&powers)[4], std::vector<double>& c) const {
        c.assign(channels(), 0.0);
        for (std::size_t i = 0; field && !field->empty() && i < channels(); ++i) {
            for (std::size_t k = 0; k < 4; ++k) {
                c[i] += powers[k] * static_cast<double>((*field)[(interval * channels() + i) * 4 + k]);
            }
        }
    }
    void channels_bar(const std::vector<double>& c_bar, std::size_t interval, const double (&powers)[4], std::vector<double>& field_bar) const {
        for (std::size_t i = 0; i < channels(); ++i) {
            for (std::size_t k = 0; k < 4; ++k) {
                field_bar[(interval * channels() + i) * 4 + k] += powers[k] * c_bar[i];
            }
        }
    }

    /// to: (points, 3) sum_k w_k u_k. read(carrier, component); all: of points that only take forces, too.
    template <class N, class F>
    void gather(const F& read, bool all, std::vector<N>& to) const {
        to.assign(3 * point_count(), N{});
        each_row(all, [&](std::size_t p, std::int32_t carrier, double weight) {
            for (std::size_t c = 0; c < 3; ++c) {
                to[3 * p + c] += weight * read(static_cast<std::size_t>(carrier), c);
            }
        });
    }
    /// The transpose: add(carrier, component, number) for what stands at the points.
    template <class N, class F>
    void scatter(const std::vector<N>& from, bool all, const F& add) const {
        each_row(all, [&](std::size_t p, std::int32_t carrier, double weight) {
            for (std::size_t c = 0; c < 3; ++c) {
                add(static_cast<std::size_t>(carrier), c, weight * from[3 * p + c]);
            }
        });
    }
    /// From displacements to places: X where the material carries a point or nothing does, R X + p on a hold.
    /// pose(hold, i): number i of R by rows and p; nullptr: holds are at rest.
    template <class F>
    void place_points(const F* pose, std::vector<double>& x) const {
        for (std::size_t p = 0; p < point_count(); ++p) {
            if (hold[p] >= 0 && pose) {
                carried(p, *pose, &x[3 * p]);
                continue;
            }
            for (std::size_t c = 0; c < 3; ++c) {
                x[3 * p + c] += place[3 * p + c];
            }
        }
    }
    /// The change of the same where poses change so.
    template <class F>
    void move_points(const F& pose, std::vector<double>& dx) const {
        for (std::size_t p = 0; p < point_count(); ++p) {
            if (hold[p] >= 0) {
                carried(p, pose, &dx[3 * p]);
            }
        }
    }
    /// The transpose: add(hold, i, number).
    template <class F>
    void pose_bar(const std::vector<double>& x_bar, const F& add) const {
        for (std::size_t p = 0; p < point_count(); ++p) {
            for (std::size_t c = 0; c < 3 && hold[p] >= 0; ++c) {
                const std::size_t h = static_cast<std::size_t>(hold[p]);
                add(h, 9 + c, x_bar[3 * p + c]);
                for (std::size_t k = 0; k < 3; ++k) {
                    add(h, 3 * c + k, x_bar[3 * p + c] * place[3 * p + k]);
                }
            }
        }
    }

    /// f: (points, 3) [N] at places x (points, 3) [m] and channels c.
    void forces(const std::vector<double>& x, const std::vector<double>& c, std::vector<double>& f) const;
    /// Its change where places and channels change so.
    void forces_change(const std::vector<double>& x, const std::vector<double>& c, const std::vector<double>& dx,
                       const std::vector<double>& dc, std::vector<double>& df) const;
    /// The transpose: x_bar and c_bar of f_bar.
    void forces_bar(const std::vector<double>& x, const std::vector<double>& c, const std::vector<double>& f_bar,
                    std::vector<double>& x_bar, std::vector<double>& c_bar) const;

  private:
    template <class F>
    void each_row(bool all, const F& f) const {
        for (std::size_t p = 0; p < point_count(); ++p) {
            const auto end = static_cast<std::size_t>(row_begin[p + 1]);
            for (auto r = static_cast<std::size_t>(row_begin[p]); r < end && (all || follows_[p]); ++r) {
                f(p, row_carrier[r], row_weight[r]);
            }
        }
    }
    template <class F>
    void carried(std::size_t p, const F& pose, double* x) const {
        const std::size_t h = static_cast<std::size_t>(hold[p]);
        for (std::size_t c = 0; c < 3; ++c) {
            x[c] = pose(h, 9 + c);
            for (std::size_t k = 0; k < 3; ++k) {
                x[c] += pose(h, 3 * c + k) * place[3 * p + k];
            }
        }
    }

    std::vector<std::uint8_t> follows_;  // points whose places matter
    std::vector<std::int32_t> read_;
};

}  // namespace mphygs
