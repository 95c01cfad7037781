#include "mphygs/splatting/projection.hpp"

#include <algorithm>
#include <cmath>

#include "mphygs/splatting/harmonics.hpp"

namespace mphygs {

namespace {

using splatting::harmonics_at;

/// Everything between a Gaussian's numbers and its footprint.
struct Footprint {
    double q[4], q_length;     // unit quaternion, and how long it was
    double rotation[3][3];
    double scaled[3][3];       // rotation diag(scale)
    double covariance[3][3];   // [m^2]
    double view[3];            // in the camera's axes [m]
    double ratio[2];           // x / z and y / z, limited
    bool limited[2];
    double jacobian[2][3];     // of the projection [px/m]
    double lift[2][3];         // jacobian times the camera's rotation
    double spread[3];          // projected covariance: xx, xy, yy [px^2]
    double inverse[3];         // a, b, c
};

bool footprint_of(const SplatCamera& camera, const SplatGaussians& g, std::size_t i, Footprint& f) {
    const float* p = g.positions + 3 * i;
    const auto& w = camera.camera_from_world;
    for (int r = 0; r < 3; ++r) {
        f.view[r] = w[r][0] * p[0] + w[r][1] * p[1] + w[r][2] * p[2] + w[r][3];
    }
    const double z = f.view[2];
    if (!(z > camera.nearest)) {
        return false;
    }
    const float* q = g.rotations + 4 * i;
    f.q_length = std::sqrt(double(q[0]) * q[0] + double(q[1]) * q[1] + double(q[2]) * q[2] + double(q[3]) * q[3]);
    for (int k = 0; k < 4; ++k) {
        f.q[k] = q[k] / f.q_length;
    }
    const double qw = f.q[0], qx = f.q[1], qy = f.q[2], qz = f.q[3];
    const double rotation[3][3] = {{1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)},
                                   {2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)},
                                   {2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)}};
    for (int r = 0; r < 3; ++r) {
        for (int k = 0; k < 3; ++k) {
            f.rotation[r][k] = rotation[r][k];
            f.scaled[r][k] = rotation[r][k] * g.scales[3 * i + static_cast<std::size_t>(k)];
        }
    }
    for (int r = 0; r < 3; ++r) {
        for (int k = 0; k < 3; ++k) {
            f.covariance[r][k] = f.scaled[r][0] * f.scaled[k][0] + f.scaled[r][1] * f.scaled[k][1] + f.scaled[r][2] * f.scaled[k][2];
        }
    }
    // Far outside the picture the linearised projection is wrong without bound: limited as in 3DGS.
    const int size[2] = {camera.width, camera.height};
    for (int k = 0; k < 2; ++k) {
        const double margin = 0.15 * size[k] / camera.focal[k];
        const double low = -camera.centre[k] / camera.focal[k] - margin;
        const double high = (size[k] - camera.centre[k]) / camera.focal[k] + margin;
        const double ratio = f.view[k] / z;
        f.ratio[k] = std::clamp(ratio, low, high);
        f.limited[k] = ratio < low || ratio > high;
        f.jacobian[k][0] = f.jacobian[k][1] = 0;
        f.jacobian[k][k] = camera.focal[k] / z;
        f.jacobian[k][2] = -camera.focal[k] * f.ratio[k] / z;
        for (int c = 0; c < 3; ++c) {
            f.lift[k][c] = f.jacobian[k][k] * w[k][c] + f.jacobian[k][2] * w[2][c];
        }
    }
    double half[2][3];
    for (int k = 0; k < 2; ++k) {
        for (int c = 0; c < 3; ++c) {
            half[k][c] = f.lift[k][0] * f.covariance[0][c] + f.lift[k][1] * f.covariance[1][c] + f.lift[k][2] * f.covariance[2][c];
        }
    }
    const auto along = [&](int k, int l) {
        return half[k][0] * f.lift[l][0] + half[k][1] * f.lift[l][1] + half[k][2] * f.lift[l][2];
    };
    f.spread[0] = along(0, 0) + camera.blur;
    f.spread[1] = along(0, 1);
    f.spread[2] = along(1, 1) + camera.blur;
    const double determinant = f.spread[0] * f.spread[2] - f.spread[1] * f.spread[1];
    f.inverse[0] = f.spread[2] / determinant;
    f.inverse[1] = -f.spread[1] / determinant;
    f.inverse[2] = f.spread[0] / determinant;
    return determinant > 0 && std::isfinite(f.inverse[0] + f.inverse[1] + f.inverse[2]);
}

/// Unit vector from the camera to Gaussian `i`; returns the distance [m].
double direction_to(const SplatCamera& camera, const SplatGaussians& g, std::size_t i, double direction[3]) {
    const auto& w = camera.camera_from_world;
    double length = 0;
    for (int c = 0; c < 3; ++c) {
        const double eye = -(w[0][c] * w[0][3] + w[1][c] * w[1][3] + w[2][c] * w[2][3]);
        direction[c] = g.positions[3 * i + static_cast<std::size_t>(c)] - eye;
        length += direction[c] * direction[c];
    }
    length = std::sqrt(length);
    for (int c = 0; c < 3; ++c) {
        direction[c] /= length;
    }
    return length;
}

}  // namespace

bool project_gaussian(const SplatCamera& camera, const SplatGaussians& g, std::size_t i, Splat& splat, float values[4]) {
    Footprint f;
    const double opacity = g.opacities[i];
    if (!(opacity > least_alpha) || !footprint_of(camera, g, i, f)) {
        return false;
    }
    double centre[2];
    const double reach = std::log(opacity / least_alpha);
    const int size[2] = {camera.width, camera.height};
    std::int32_t* range[2] = {splat.column, splat.row};
    for (int k = 0; k < 2; ++k) {
        const double offset = g.screen_offsets ? g.screen_offsets[2 * i + static_cast<std::size_t>(k)] : 0.0;
        centre[k] = camera.focal[k] * f.view[k] / f.view[2] + camera.centre[k] + offset;
        // The ellipse s = reach in its bounding box, pixel centres at halves; 1e-3 px against rounding.
        const double extent = std::sqrt(2 * reach * f.spread[2 * k]) + 1e-3;
        const double first = std::ceil(centre[k] - extent - 0.5), last = std::floor(centre[k] + extent - 0.5);
        if (!(first < size[k] && last >= 0 && first <= last)) {
            return false;
        }
        range[k][0] = static_cast<std::int32_t>(std::max(first, 0.0));
        range[k][1] = static_cast<std::int32_t>(std::min(last + 1, double(size[k])));
    }
    splat.x = static_cast<float>(centre[0]);
    splat.y = static_cast<float>(centre[1]);
    splat.a = static_cast<float>(f.inverse[0]);
    splat.b = static_cast<float>(f.inverse[1]);
    splat.c = static_cast<float>(f.inverse[2]);
    splat.opacity = static_cast<float>(opacity);
    splat.reach = static_cast<float>(reach);
    double direction[3], harmonic[16], slope[16][3];
    direction_to(camera, g, i, direction);
    harmonics_at(direction, g.harmonic_count, harmonic, slope);
    const float* sh = g.harmonics + 3 * static_cast<std::size_t>(g.harmonic_count) * i;
    for (int c = 0; c < 3; ++c) {
        double colour = 0.5;
        for (int k = 0; k < g.harmonic_count; ++k) {
            colour += harmonic[k] * sh[3 * k + c];
        }
        values[c] = static_cast<float>(std::max(colour, 0.0));
    }
    values[3] = static_cast<float>(f.view[2]);
    return true;
}

void project_gaussian_reverse(const SplatCamera& camera, const SplatGaussians& g, std::size_t i, const SplatBar& bar,
                              SplatGradient& out) {
    Footprint f;
    if (!footprint_of(camera, g, i, f)) {
        return;
    }
    const auto& w = camera.camera_from_world;
    const double z = f.view[2];
    double view_bar[3] = {0, 0, bar.values[3]};
    const double centre_bar[2] = {bar.x, bar.y};

    // inverse covariance: spread_bar = -inverse bar inverse, b standing for both off-diagonal elements
    const double a = f.inverse[0], b = f.inverse[1], c = f.inverse[2];
    const double m[2][2] = {{bar.a, bar.b / 2}, {bar.b / 2, bar.c}}, inverse[2][2] = {{a, b}, {b, c}};
    double left[2][2], spread_bar[2][2];
    for (int r = 0; r < 2; ++r) {
        for (int k = 0; k < 2; ++k) {
            left[r][k] = inverse[r][0] * m[0][k] + inverse[r][1] * m[1][k];
        }
    }
    for (int r = 0; r < 2; ++r) {
        for (int k = 0; k < 2; ++k) {
            spread_bar[r][k] = -(left[r][0] * inverse[0][k] + left[r][1] * inverse[1][k]);
        }
    }

    // spread = lift covariance lift'
    double carried[2][3], covariance_bar[3][3], lift_bar[2][3];
    for (int r = 0; r < 2; ++r) {
        for (int k = 0; k < 3; ++k) {
            carried[r][k] = spread_bar[r][0] * f.lift[0][k] + spread_bar[r][1] * f.lift[1][k];
        }
    }
    for (int r = 0; r < 3; ++r) {
        for (int k = 0; k < 3; ++k) {
            covariance_bar[r][k] = f.lift[0][r] * carried[0][k] + f.lift[1][r] * carried[1][k];
        }
    }
    for (int r = 0; r < 2; ++r) {
        for (int k = 0; k < 3; ++k) {
            lift_bar[r][k] =
                2 * (carried[r][0] * f.covariance[0][k] + carried[r][1] * f.covariance[1][k] + carried[r][2] * f.covariance[2][k]);
        }
    }

    // projection: centre = focal view / z + principal point; jacobian = focal (1, -ratio) / z
    for (int k = 0; k < 2; ++k) {
        const double focal = camera.focal[k];
        view_bar[k] += focal / z * centre_bar[k];
        view_bar[2] -= focal * f.view[k] / (z * z) * centre_bar[k];
        double diagonal_bar = 0, last_bar = 0;
        for (int col = 0; col < 3; ++col) {
            diagonal_bar += lift_bar[k][col] * w[k][col];
            last_bar += lift_bar[k][col] * w[2][col];
        }
        view_bar[2] += (-focal * diagonal_bar + focal * f.ratio[k] * last_bar) / (z * z);
        if (!f.limited[k]) {
            const double ratio_bar = -focal / z * last_bar;
            view_bar[k] += ratio_bar / z;
            view_bar[2] -= ratio_bar * f.view[k] / (z * z);
        }
        out.screen_offsets[2 * i + static_cast<std::size_t>(k)] = static_cast<float>(centre_bar[k]);
    }

    // covariance = scaled scaled', scaled = rotation diag(scale)
    double scaled_bar[3][3], r_bar[3][3];
    for (int r = 0; r < 3; ++r) {
        for (int k = 0; k < 3; ++k) {
            scaled_bar[r][k] = 2 * (covariance_bar[r][0] * f.scaled[0][k] + covariance_bar[r][1] * f.scaled[1][k] +
                                    covariance_bar[r][2] * f.scaled[2][k]);
            r_bar[r][k] = scaled_bar[r][k] * g.scales[3 * i + static_cast<std::size_t>(k)];
        }
    }
    for (int k = 0; k < 3; ++k) {
        out.scales[3 * i + static_cast<std::size_t>(k)] = static_cast<float>(
            f.rotation[0][k] * scaled_bar[0][k] + f.rotation[1][k] * scaled_bar[1][k] + f.rotation[2][k] * scaled_bar[2][k]);
    }
    const double qw = f.q[0], qx = f.q[1], qy = f.q[2], qz = f.q[3];
    const double q_bar[4] = {
        2 * (-qz * r_bar[0][1] + qy * r_bar[0][2] + qz * r_bar[1][0] - qx * r_bar[1][2] - qy * r_bar[2][0] + qx * r_bar[2][1]),
        2 * (qy * r_bar[0][1] + qz * r_bar[0][2] + qy * r_bar[1][0] - 2 * qx * r_bar[1][1] - qw * r_bar[1][2] + qz * r_bar[2][0] +
             qw * r_bar[2][1] - 2 * qx * r_bar[2][2]),
        2 * (-2 * qy * r_bar[0][0] + qx * r_bar[0][1] + qw * r_bar[0][2] + qx * r_bar[1][0] + qz * r_bar[1][2] - qw * r_bar[2][0] +
             qz * r_bar[2][1] - 2 * qy * r_bar[2][2]),
        2 * (-2 * qz * r_bar[0][0] - qw * r_bar[0][1] + qx * r_bar[0][2] + qw * r_bar[1][0] - 2 * qz * r_bar[1][1] + qy * r_bar[1][2] +
             qx * r_bar[2][0] + qy * r_bar[2][1])};
    const double radial = q_bar[0] * qw + q_bar[1] * qx + q_bar[2] * qy + q_bar[3] * qz;
    for (int k = 0; k < 4; ++k) {
        out.rotations[4 * i + static_cast<std::size_t>(k)] = static_cast<float>((q_bar[k] - radial * f.q[k]) / f.q_length);
    }

    // colour = max(0, 1/2 + sum of harmonics along the direction of sight)
    double direction[3], harmonic[16], slope[16][3], direction_bar[3]{};
    const double distance = direction_to(camera, g, i, direction);
    harmonics_at(direction, g.harmonic_count, harmonic, slope);
    const std::size_t first = 3 * static_cast<std::size_t>(g.harmonic_count) * i;
    for (int col = 0; col < 3; ++col) {
        double colour = 0.5;
        for (int k = 0; k < g.harmonic_count; ++k) {
            colour += harmonic[k] * g.harmonics[first + static_cast<std::size_t>(3 * k + col)];
        }
        const double colour_bar = colour >= 0 ? bar.values[col] : 0.0;
        for (int k = 0; k < g.harmonic_count; ++k) {
            const std::size_t at = first + static_cast<std::size_t>(3 * k + col);
            out.harmonics[at] = static_cast<float>(colour_bar * harmonic[k]);
            for (int d = 0; d < 3; ++d) {
                direction_bar[d] += colour_bar * g.harmonics[at] * slope[k][d];
            }
        }
    }
    const double along = direction_bar[0] * direction[0] + direction_bar[1] * direction[1] + direction_bar[2] * direction[2];
    for (int d = 0; d < 3; ++d) {
        const double through_view = w[0][d] * view_bar[0] + w[1][d] * view_bar[1] + w[2][d] * view_bar[2];
        out.positions[3 * i + static_cast<std::size_t>(d)] =
            static_cast<float>(through_view + (direction_bar[d] - along * direction[d]) / distance);
    }
    out.opacities[i] = static_cast<float>(bar.opacity);
}

}  // namespace mphygs
