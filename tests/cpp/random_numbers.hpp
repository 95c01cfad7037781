// Repeatable random numbers for the tests.
#pragma once

#include <random>
#include <vector>

#include "mphygs/small.hpp"

namespace mphygs::test {

class Random {
  public:
    explicit Random(unsigned seed) : engine_(seed) {}
    /// Uniform in [low, high), the same on every platform (std::uniform_real_distribution is not).
    double between(double low, double high) { return low + (high - low) * (static_cast<double>(engine_()) / 4294967296.0); }
    std::vector<double> numbers(std::size_t count, double low, double high) {
        std::vector<double> x(count);
        for (double& e : x) {
            e = between(low, high);
        }
        return x;
    }
    Pack<double> pack(double low, double high) {
        Pack<double> p{};
        for (int i = 0; i < lane_count; ++i) {
            p[i] = between(low, high);
        }
        return p;
    }
    /// The identity plus entries of at most `size`.
    Mat3<double> deformation(double size) {
        Mat3<double> f = Mat3<double>::identity();
        for (int i = 0; i < 9; ++i) {
            f[i / 3][i % 3] += between(-size, size);
        }
        return f;
    }

  private:
    std::mt19937 engine_;
};

/// Rotation by `angle` about a (normalised here) axis, Rodrigues' formula.
inline Mat3<double> rotation_about(double x, double y, double z, double angle) {
    const double norm = std::sqrt(x * x + y * y + z * z);
    Mat3<double> k;
    k[0][1] = -z / norm;
    k[0][2] = y / norm;
    k[1][0] = z / norm;
    k[1][2] = -x / norm;
    k[2][0] = -y / norm;
    k[2][1] = x / norm;
    return Mat3<double>::identity() + std::sin(angle) * k + (1.0 - std::cos(angle)) * (k * k);
}

}  // namespace mphygs::test
