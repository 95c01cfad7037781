// Pictures of Gaussians: edges of the picture, thread counts, and gradients against differences.
#include <gtest/gtest.h>

#include <cmath>

#include "mphygs/splatting/similarity.hpp"
#include "mphygs/splatting/splatting.hpp"

namespace {

using namespace mphygs;

struct Scene {
    std::vector<float> positions, rotations, scales, opacities, harmonics, features, screen_offsets;
    int harmonic_count, feature_count;

    SplatGaussians gaussians() const {
        return {opacities.size(),   harmonic_count,   feature_count,   positions.data(), rotations.data(),
                scales.data(),      opacities.data(), harmonics.data(), features.data(), screen_offsets.data()};
    }
};

/// Gaussians about the origin, of which a few are huge, behind the camera, or far beside the picture; or,
/// `wide`, faint ones that all cover the whole picture, so that it is smooth in their numbers.
Scene make_scene(std::size_t count, int harmonic_count, int feature_count, bool wide = false) {
    Scene s;
    s.harmonic_count = harmonic_count;
    s.feature_count = feature_count;
    std::uint32_t state = 1;
    const auto draw = [&](double low, double high) {
        state = state * 1664525u + 1013904223u;
        return static_cast<float>(low + (high - low) * (state >> 8) / double(1u << 24));
    };
    for (std::size_t i = 0; i < count; ++i) {
        const bool odd = !wide && i % 10 == 9;
        for (int k = 0; k < 3; ++k) {
            s.positions.push_back(odd ? draw(-3, 3) : draw(-0.3, 0.3));
            s.scales.push_back(wide ? draw(0.5, 1) : odd ? draw(0.1, 1) : draw(0.01, 0.1));
        }
        for (int k = 0; k < 4; ++k) {
            s.rotations.push_back(draw(-1, 1));
        }
        s.opacities.push_back(wide ? draw(0.1, 0.4) : draw(0, 1));
        for (int k = 0; k < 3 * harmonic_count; ++k) {
            s.harmonics.push_back(draw(-0.3, 0.3));
        }
        for (int k = 0; k < feature_count; ++k) {
            s.features.push_back(draw(-1, 1));
        }
        s.screen_offsets.push_back(draw(-1, 1));
        s.screen_offsets.push_back(draw(-1, 1));
    }
    return s;
}

SplatCamera make_camera(int width, int height) {
    SplatCamera c;
    c.width = width;
    c.height = height;
    c.focal[0] = 1.2 * width;
    c.focal[1] = 1.3 * width;
    c.centre[0] = 0.45 * width;
    c.centre[1] = 0.5 * height;
    const double pose[3][4] = {{0.8, 0, 0.6, 0.05}, {0, 1, 0, -0.02}, {-0.6, 0, 0.8, 1.0}};
    for (int r = 0; r < 3; ++r) {
        for (int k = 0; k < 4; ++k) {
            c.camera_from_world[r][k] = pose[r][k];
        }
    }
    return c;
}

std::vector<float> weights(std::size_t count) {
    std::vector<float> w(count);
    for (std::size_t i = 0; i < count; ++i) {
        w[i] = static_cast<float>(std::sin(0.01 * static_cast<double>(i) + 0.3));
    }
    return w;
}

double dot(const std::vector<float>& a, const std::vector<float>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += double(a[i]) * b[i];
    }
    return sum;
}

TEST(Splatting, SameBitsAtAnyThreadCountAndSize) {
    for (const auto& [width, height] : {std::pair{1, 1}, {17, 5}, {40, 33}}) {
        const Scene scene = make_scene(120, 9, 3);
        const SplatPass one(make_camera(width, height), scene.gaussians(), 1);
        const SplatPass three(make_camera(width, height), scene.gaussians(), 3);
        ASSERT_EQ(one.image().size(), 7u * static_cast<std::size_t>(width * height));
        EXPECT_EQ(one.image(), three.image());
        EXPECT_EQ(one.transmittance(), three.transmittance());
        const auto image_bar = weights(one.image().size()), bar = weights(one.transmittance().size());
        const SplatGradient a = one.backward(scene.gaussians(), image_bar.data(), bar.data(), 1);
        const SplatGradient b = three.backward(scene.gaussians(), image_bar.data(), bar.data(), 3);
        EXPECT_EQ(a.positions, b.positions);
        EXPECT_EQ(a.rotations, b.rotations);
        EXPECT_EQ(a.scales, b.scales);
        EXPECT_EQ(a.harmonics, b.harmonics);
        EXPECT_EQ(a.features, b.features);
        for (const float t : one.transmittance()) {
            EXPECT_GE(t, 0.0f);
            EXPECT_LE(t, 1.0f);
        }
    }
}

TEST(Splatting, NothingIsSeenOfNothing) {
    const Scene scene = make_scene(0, 1, 0);
    const SplatPass pass(make_camera(20, 20), scene.gaussians(), 1);
    EXPECT_EQ(pass.transmittance(), std::vector<float>(400, 1.0f));
    const auto image_bar = weights(pass.image().size()), bar = weights(400);
    EXPECT_TRUE(pass.backward(scene.gaussians(), image_bar.data(), bar.data(), 1).positions.empty());
}

TEST(Splatting, GradientAgreesWithDifferences) {
    Scene scene = make_scene(12, 16, 2, true);
    const SplatCamera camera = make_camera(30, 20);
    const SplatPass pass(camera, scene.gaussians(), 1);
    const auto image_bar = weights(pass.image().size()), bar = weights(pass.transmittance().size());
    const SplatGradient g = pass.backward(scene.gaussians(), image_bar.data(), bar.data(), 1);
    const auto value = [&] {
        const SplatPass p(camera, scene.gaussians(), 1);
        return dot(p.image(), image_bar) + dot(p.transmittance(), bar);
    };
    const auto check = [&](std::vector<float>& numbers, const std::vector<float>& gradient, float step, const char* name) {
        const std::vector<float> start = numbers;
        std::vector<float> direction(numbers.size());
        for (std::size_t i = 0; i < direction.size(); ++i) {
            direction[i] = static_cast<float>(std::sin(1.7 * static_cast<double>(i) + 0.3));
        }
        const auto moved = [&](float by) {
            for (std::size_t i = 0; i < start.size(); ++i) {
                numbers[i] = start[i] + by * direction[i];
            }
            const double v = value();
            numbers = start;
            return v;
        };
        const double difference = (moved(step) - moved(-step)) / (2.0 * step), exact = dot(gradient, direction);
        EXPECT_GT(std::abs(exact), 0.02) << name;
        EXPECT_NEAR(difference, exact, 0.002 * std::abs(exact) + 0.004) << name;
    };
    check(scene.positions, g.positions, 1e-3f, "positions");
    check(scene.rotations, g.rotations, 1e-3f, "rotations");
    check(scene.scales, g.scales, 1e-3f, "scales");
    check(scene.opacities, g.opacities, 1e-3f, "opacities");
    check(scene.harmonics, g.harmonics, 1e-2f, "harmonics");
    check(scene.features, g.features, 1e-2f, "features");
    check(scene.screen_offsets, g.screen_offsets, 1e-2f, "screen offsets");
}

TEST(Similarity, GradientAgreesWithDifferences) {
    const int channels = 2, height = 7, width = 19;
    std::vector<float> a(channels * height * width), b(a.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
        a[i] = static_cast<float>(0.5 + 0.4 * std::sin(0.9 * static_cast<double>(i)));
        b[i] = static_cast<float>(0.5 + 0.4 * std::sin(0.8 * static_cast<double>(i)));
    }
    const auto similarity = [&] { return structural_similarity(a.data(), b.data(), channels, height, width, 2); };
    const Similarity at = similarity();
    EXPECT_EQ(at.first_bar, structural_similarity(a.data(), b.data(), channels, height, width, 1).first_bar);
    EXPECT_NEAR(structural_similarity(a.data(), a.data(), channels, height, width, 1).value, 1.0, 1e-6);
    for (const std::size_t i : {std::size_t{0}, std::size_t{40}, a.size() - 1}) {
        const float start = a[i], step = 1e-2f;
        a[i] = start + step;
        const double up = similarity().value;
        a[i] = start - step;
        const double down = similarity().value;
        a[i] = start;
        EXPECT_NEAR((up - down) / (2.0 * step), at.first_bar[i], 2e-5 + 0.01 * std::abs(at.first_bar[i]));
        EXPECT_GT(std::abs(at.first_bar[i]), 1e-5);
    }
}

}  // namespace
