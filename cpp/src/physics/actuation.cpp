// What tendons, pressures and known forces do to the points that they act at; their tangent and adjoint beside it.
#include "mphygs/physics/actuation.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "mphygs/small.hpp"

namespace mphygs {

namespace {

using Vec = Vec3<double>;

void require(bool good, const std::string& what) {
    if (!good) {
        throw std::invalid_argument("actuation: " + what);
    }
}

void within(const std::vector<std::int32_t>& numbers, std::size_t count, const char* name) {
    for (const std::int32_t n : numbers) {
        require(n >= 0 && static_cast<std::size_t>(n) < count, std::string(name) + " names a number out of range");
    }
}

void rising(const std::vector<std::int32_t>& begin, std::size_t rows, std::size_t numbers, const char* name) {
    require(begin.size() == rows + 1 && begin.front() == 0 && static_cast<std::size_t>(begin.back()) == numbers &&
                std::is_sorted(begin.begin(), begin.end()),
            std::string(name) + " must rise from 0 to the number of entries");
}

Vec at(const std::vector<double>& from, std::int32_t p) {
    const std::size_t i = 3 * static_cast<std::size_t>(p);
    return {{from[i], from[i + 1], from[i + 2]}};
}

void add(std::vector<double>& to, std::int32_t p, const Vec& v, double factor = 1.0) {
    for (int c = 0; c < 3; ++c) {
        to[3 * static_cast<std::size_t>(p) + static_cast<std::size_t>(c)] += factor * v[c];
    }
}

Vec crossed(const Vec& a, const Vec& b) {
    return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}

/// A segment of a tendon from point a to point b.
struct Segment {
    std::int32_t a, b;
    double length;
    Vec along;  // of length 1; 0 where the points meet: then it has no direction, and does nothing

    Segment(const std::vector<double>& x, std::int32_t from, std::int32_t to) : a(from), b(to) {
        const Vec d = at(x, b) - at(x, a);
        length = std::sqrt(dot(d, d));
        along = length > 0.0 ? (1.0 / length) * d : Vec{};
    }
    /// Derivative of `along` in a direction, symmetric.
    Vec turned(const Vec& d) const { return length > 0.0 ? (1.0 / length) * (d - dot(along, d) * along) : Vec{}; }
};

template <class F>
void each_segment(const Actuation& a, const std::vector<double>& x, const F& f) {
    for (std::size_t k = 0; k < a.path_channel.size(); ++k) {
        for (auto p = static_cast<std::size_t>(a.path_begin[k]); p + 1 < static_cast<std::size_t>(a.path_begin[k + 1]); ++p) {
            f(Segment(x, a.path_point[p], a.path_point[p + 1]), static_cast<std::size_t>(a.path_channel[k]));
        }
    }
}

template <class F>
void each_triangle(const Actuation& a, const F& f) {
    for (std::size_t q = 0; q < a.triangle_channel.size(); ++q) {
        f(&a.triangle[3 * q], &a.triangle_middle[3 * q], static_cast<std::size_t>(a.triangle_channel[q]));
    }
}

}  // namespace

void Actuation::settle(std::size_t carriers, int holds) {
    const std::size_t points = point_count();
    if (empty()) {
        return;
    }
    rising(row_begin, points, row_carrier.size(), "row_begin");
    require(row_weight.size() == row_carrier.size(), "every carrier needs a weight");
    require(place.size() == 3 * points, "place must be (points, 3)");
    require(force_point.size() == force_channel.size(), "every force needs a channel");
    rising(path_begin, path_channel.size(), path_point.size(), "path_begin");
    require(triangle.size() == 3 * triangle_channel.size() && triangle_middle.size() == triangle.size(),
            "triangle and triangle_middle must be (triangles, 3)");
    within(row_carrier, carriers, "row_carrier");
    within(path_channel, channels(), "path_channel");
    within(triangle_channel, channels(), "triangle_channel");
    within(force_channel, channels() < 3 ? 0 : channels() - 2, "force_channel");
    for (const auto* named : {&force_point, &path_point, &triangle, &triangle_middle}) {
        within(*named, points, "a force, path or triangle");
    }
    for (std::size_t p = 0; p < points; ++p) {
        require(hold[p] >= -1 && hold[p] < holds, "hold " + std::to_string(hold[p]) + " does not exist");
    }
    follows_.assign(points, 0);
    for (const auto* named : {&path_point, &triangle}) {
        for (const std::int32_t p : *named) {
            follows_[static_cast<std::size_t>(p)] = 1;
        }
    }
    std::vector<std::int32_t> read_place(carriers, -1), pushed_place(carriers, -1);
    const auto number = [](std::vector<std::int32_t>& place, std::vector<std::int32_t>& all, std::int32_t carrier) {
        std::int32_t& at = place[static_cast<std::size_t>(carrier)];
        if (at < 0) {
            at = static_cast<std::int32_t>(all.size());
            all.push_back(carrier);
        }
        return at;
    };
    std::vector<std::uint8_t> takes(points, 0);
    for (const auto* named : {&force_point, &path_point, &triangle_middle}) {
        for (const std::int32_t p : *named) {
            takes[static_cast<std::size_t>(p)] = 1;
        }
    }
    read_.clear();
    pushed_.clear();
    read_at_.assign(row_carrier.size(), -1);
    pushed_at_ = read_at_;
    for (std::size_t p = 0; p < points; ++p) {
        for (auto r = static_cast<std::size_t>(row_begin[p]); r < static_cast<std::size_t>(row_begin[p + 1]); ++r) {
            read_at_[r] = follows_[p] ? number(read_place, read_, row_carrier[r]) : -1;
            pushed_at_[r] = takes[p] ? number(pushed_place, pushed_, row_carrier[r]) : -1;
        }
    }
}

void Actuation::check_channels(std::size_t numbers, std::size_t intervals) const {
    require(numbers == 0 || numbers == 4 * channels() * intervals,
            "channel has " + std::to_string(numbers) + " numbers, expected " + std::to_string(4 * channels() * intervals));
}

void Actuation::forces(const std::vector<double>& x, const std::vector<double>& c, std::vector<double>& f) const {
    f.assign(x.size(), 0.0);
    for (std::size_t i = 0; i < force_point.size(); ++i) {
        const std::size_t first = static_cast<std::size_t>(force_channel[i]);
        add(f, force_point[i], {{c[first], c[first + 1], c[first + 2]}});
    }
    each_segment(*this, x, [&](const Segment& s, std::size_t channel) {
        add(f, s.a, s.along, c[channel]);
        add(f, s.b, s.along, -c[channel]);
    });
    each_triangle(*this, [&](const std::int32_t* p, const std::int32_t* middle, std::size_t channel) {
        const Vec area = 0.5 * crossed(at(x, p[1]) - at(x, p[0]), at(x, p[2]) - at(x, p[0]));
        for (int k = 0; k < 3; ++k) {
            add(f, middle[k], area, -c[channel] / 3.0);
        }
    });
}

void Actuation::forces_change(const std::vector<double>& x, const std::vector<double>& c, const std::vector<double>& dx,
                              const std::vector<double>& dc, std::vector<double>& df) const {
    df.assign(x.size(), 0.0);
    for (std::size_t i = 0; i < force_point.size(); ++i) {
        const std::size_t first = static_cast<std::size_t>(force_channel[i]);
        add(df, force_point[i], {{dc[first], dc[first + 1], dc[first + 2]}});
    }
    each_segment(*this, x, [&](const Segment& s, std::size_t channel) {
        const Vec change = dc[channel] * s.along + c[channel] * s.turned(at(dx, s.b) - at(dx, s.a));
        add(df, s.a, change);
        add(df, s.b, change, -1.0);
    });
    each_triangle(*this, [&](const std::int32_t* p, const std::int32_t* middle, std::size_t channel) {
        const Vec one = at(x, p[1]) - at(x, p[0]), two = at(x, p[2]) - at(x, p[0]);
        const Vec d_one = at(dx, p[1]) - at(dx, p[0]), d_two = at(dx, p[2]) - at(dx, p[0]);
        const Vec change = dc[channel] * crossed(one, two) + c[channel] * (crossed(d_one, two) + crossed(one, d_two));
        for (int k = 0; k < 3; ++k) {
            add(df, middle[k], change, -0.5 / 3.0);
        }
    });
}

void Actuation::forces_bar(const std::vector<double>& x, const std::vector<double>& c, const std::vector<double>& f_bar,
                           std::vector<double>& x_bar, std::vector<double>& c_bar) const {
    x_bar.assign(x.size(), 0.0);
    c_bar.assign(channels(), 0.0);
    for (std::size_t i = 0; i < force_point.size(); ++i) {
        const Vec bar = at(f_bar, force_point[i]);
        for (int k = 0; k < 3; ++k) {
            c_bar[static_cast<std::size_t>(force_channel[i] + k)] += bar[k];
        }
    }
    each_segment(*this, x, [&](const Segment& s, std::size_t channel) {
        const Vec bar = at(f_bar, s.a) - at(f_bar, s.b);
        c_bar[channel] += dot(bar, s.along);
        const Vec turned = c[channel] * s.turned(bar);
        add(x_bar, s.b, turned);
        add(x_bar, s.a, turned, -1.0);
    });
    each_triangle(*this, [&](const std::int32_t* p, const std::int32_t* middle, std::size_t channel) {
        const Vec one = at(x, p[1]) - at(x, p[0]), two = at(x, p[2]) - at(x, p[0]);
        const Vec bar = (-0.5 / 3.0) * (at(f_bar, middle[0]) + at(f_bar, middle[1]) + at(f_bar, middle[2]));
        c_bar[channel] += dot(bar, crossed(one, two));
        const Vec one_bar = c[channel] * crossed(two, bar), two_bar = c[channel] * crossed(bar, one);
        add(x_bar, p[1], one_bar);
        add(x_bar, p[2], two_bar);
        add(x_bar, p[0], one_bar + two_bar, -1.0);
    });
}

}  // namespace mphygs
