#include "mphygs/splatting/similarity.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "mphygs/numerics/parallel.hpp"

namespace mphygs {

namespace {

constexpr int reach = 5, taps = 2 * reach + 1;
constexpr float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;

std::array<float, taps> window() {
    std::array<float, taps> w{};
    double sum = 0;
    for (int k = 0; k < taps; ++k) {
        sum += std::exp(-(k - reach) * (k - reach) / (2 * 1.5 * 1.5));
    }
    for (int k = 0; k < taps; ++k) {
        w[static_cast<std::size_t>(k)] = static_cast<float>(std::exp(-(k - reach) * (k - reach) / (2 * 1.5 * 1.5)) / sum);
    }
    return w;
}

/// The window's mean around every pixel. The window is symmetric: the operation is its own adjoint.
void blur(const std::vector<float>& plane, int height, int width, std::vector<float>& out) {
    const auto w = window();
    std::vector<float> padded(static_cast<std::size_t>(width + 2 * reach), 0.0f);
    float* row = padded.data() + reach;
    for (int y = 0; y < height; ++y) {
        std::fill(row, row + width, 0.0f);
        for (int k = std::max(-reach, -y); k <= std::min(reach, height - 1 - y); ++k) {
            const float weight = w[static_cast<std::size_t>(k + reach)];
            const float* in = plane.data() + static_cast<std::ptrdiff_t>(y + k) * width;
            for (int x = 0; x < width; ++x) {
                row[x] += weight * in[x];
            }
        }
        float* to = out.data() + static_cast<std::ptrdiff_t>(y) * width;
        std::fill(to, to + width, 0.0f);
        for (int k = 0; k < taps; ++k) {
            const float weight = w[static_cast<std::size_t>(k)];
            const float* in = padded.data() + k;
            for (int x = 0; x < width; ++x) {
                to[x] += weight * in[x];
            }
        }
    }
}

/// Sum of the similarity over one channel; first_bar: the sum's derivative.
double one_channel(const float* a, const float* b, int height, int width, float* first_bar) {
    const std::size_t n = static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
    std::vector<float> plane(n);
    std::array<std::vector<float>, 5> m;  // means of a, b, a^2, b^2, ab
    for (std::size_t k = 0; k < m.size(); ++k) {
        for (std::size_t i = 0; i < n; ++i) {
            plane[i] = k == 0 ? a[i] : k == 1 ? b[i] : k == 2 ? a[i] * a[i] : k == 3 ? b[i] * b[i] : a[i] * b[i];
        }
        m[k].resize(n);
        blur(plane, height, width, m[k]);
    }
    double sum = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const float ma = m[0][i], mb = m[1][i];
        const float a1 = 2 * ma * mb + c1, b1 = ma * ma + mb * mb + c1;
        const float a2 = 2 * (m[4][i] - ma * mb) + c2, b2 = (m[2][i] - ma * ma) + (m[3][i] - mb * mb) + c2;
        const float scale = 1 / (b1 * b2), s = a1 * a2 * scale;
        sum += s;
        // derivatives with respect to the means of a, a^2 and ab
        m[0][i] = 2 * mb * (a2 - a1) * scale - 2 * ma * s / b1 + 2 * ma * s / b2;
        m[2][i] = -s / b2;
        m[4][i] = 2 * a1 * scale;
    }
    blur(m[0], height, width, plane);
    std::copy(plane.begin(), plane.end(), first_bar);
    blur(m[2], height, width, plane);
    for (std::size_t i = 0; i < n; ++i) {
        first_bar[i] += 2 * a[i] * plane[i];
    }
    blur(m[4], height, width, plane);
    for (std::size_t i = 0; i < n; ++i) {
        first_bar[i] += b[i] * plane[i];
    }
    return sum;
}

}  // namespace

Similarity structural_similarity(const float* first, const float* second, int channels, int height, int width, int threads) {
    const std::size_t n = static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
    Similarity out;
    out.first_bar.resize(n * static_cast<std::size_t>(channels));
    std::vector<double> sums(static_cast<std::size_t>(channels));
    for_each_index(channels, threads, [&](int c) {
        const std::size_t at = n * static_cast<std::size_t>(c);
        sums[static_cast<std::size_t>(c)] = one_channel(first + at, second + at, height, width, out.first_bar.data() + at);
    });
    const double share = 1.0 / static_cast<double>(out.first_bar.size());
    for (const double sum : sums) {
        out.value += sum * share;
    }
    for (float& v : out.first_bar) {
        v *= static_cast<float>(share);
    }
    return out;
}

}  // namespace mphygs
