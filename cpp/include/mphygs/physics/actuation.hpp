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

#include <cstddef>
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

    /// The carriers whose places matter, and those that get forces, each once.
    const std::vector<std::int32_t>& read_carriers() const { return read_; }
    const std::vector<std::int32_t>& pushed_carriers() const { return pushed_; }

    /// f: (points, 3) [N] at places x (points, 3) [m] and channels c.
    void forces(const std::vector<double>& x, const std::vector<double>& c, std::vector<double>& f) const;
    /// Its change where places and channels change so.
    void forces_change(const std::vector<double>& x, const std::vector<double>& c, const std::vector<double>& dx,
                       const std::vector<double>& dc, std::vector<double>& df) const;
    /// The transpose: x_bar and c_bar of f_bar.
    void forces_bar(const std::vector<double>& x, const std::vector<double>& c, const std::vector<double>& f_bar,
                    std::vector<double>& x_bar, std::vector<double>& c_bar) const;

  private:
    friend class ActuationStep;
    std::vector<std::uint8_t> follows_;             // points whose places matter
    std::vector<std::int32_t> read_, pushed_;
    std::vector<std::int32_t> read_at_, pushed_at_;  // of each entry of the rows, which of these; -1: none
};

/// An actuation in one substep, between carriers and points. Transfers fill `seen`, `channels` and `poses`, or bars of
/// `pushed`, call, and take what comes out.
class ActuationStep {
  public:
    std::vector<double> seen;      // (read carriers, 3) displacement [m]
    std::vector<double> pushed;    // (pushed carriers, 3) [N]
    std::vector<double> channels;  // (channels,)
    std::vector<double> poses;

    explicit ActuationStep(const Actuation& loads) : seen(3 * loads.read_.size()), pushed(3 * loads.pushed_.size()), loads_(loads) {}

    /// Channels of a field (F, channels, 4) in an interval; powers: of the share. No field, or an empty one: zero.
    template <class T>
    void channels_of(const std::vector<T>* field, std::size_t interval, const double (&powers)[4]);
    /// Adds the bars of channels to those of the field.
    void add_channels_bar(std::size_t interval, const double (&powers)[4], std::vector<double>& field_bar) const;

    /// pushed of the values, kept for what follows. poses: (holds, 12) R by rows and p; empty: holds are at rest.
    void value();
    /// pushed of a direction, of which seen, channels and poses are the changes; poses may be empty.
    void change();
    /// seen, channels and poses of the bars of pushed, at the values.
    void reverse();

  private:
    void gather();
    void scatter(const std::vector<double>& at_points);
    void carry(bool change);

    const Actuation& loads_;
    std::vector<double> x_, c_;            // of the values: places (points, 3), channels
    std::vector<double> points_, force_;  // (points, 3)
};

}  // namespace mphygs
