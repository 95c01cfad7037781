// Loads of every kind on the objects of the integrators' tests.
#pragma once

#include <vector>

#include "mphygs/physics/actuation.hpp"
#include "random_numbers.hpp"

namespace mphygs::test {

/// Two forces, a tendon from a hold over three points of the material to one in space, and a patch of two triangles.
inline Actuation loads(int carriers, bool hold) {
    Actuation a;
    const auto point = [&](int first, const std::vector<double>& place, int held) {
        for (int k = 0; k < (first < 0 ? 0 : 5); ++k) {
            a.row_carrier.push_back((first + 7 * k) % carriers);
            a.row_weight.push_back(0.2 + 0.05 * (k - 2));
        }
        a.row_begin.push_back(static_cast<std::int32_t>(a.row_carrier.size()));
        a.place.insert(a.place.end(), place.begin(), place.end());
        a.hold.push_back(held);
    };
    a.row_begin = {0};
    point(-1, {0.1, -0.2, 0.045}, hold ? 0 : -1);
    point(3, {0.101, -0.201, 0.06}, -1);
    point(11, {0.104, -0.195, 0.08}, -1);
    point(17, {0.1, -0.2, 0.09}, -1);
    point(-1, {0.12, -0.21, 0.14}, -1);
    point(2, {0.099, -0.19, 0.07}, -1);
    point(23, {0, 0, 0}, -1);
    for (const int first : {2, 9, 14, 20, 25}) {
        point(first, {0, 0, 0}, -1);
    }
    a.path_begin = {0, 5};
    a.path_point = {0, 1, 2, 3, 4};
    a.path_channel = {0};
    a.triangle = {1, 2, 5, 5, 2, 3};
    a.triangle_middle = {7, 8, 9, 8, 10, 11};
    a.triangle_channel = {1, 1};
    a.force_point = {6, 1};
    a.force_channel = {2, 3};
    a.channel_count = 6;
    return a;
}

/// Their channels, (frames, 6, 4) [N or Pa].
template <class T>
std::vector<T> courses(std::size_t frames) {
    Random random(8);
    std::vector<T> all;
    for (std::size_t i = 0; i < frames; ++i) {
        for (const double size : {0.05, 300.0, 0.02, 0.03, 0.02, 0.01}) {
            for (int k = 0; k < 4; ++k) {
                all.push_back(static_cast<T>(size * (k == 0 ? random.between(0.5, 1) : random.between(-0.5, 0.5))));
            }
        }
    }
    return all;
}

}  // namespace mphygs::test
