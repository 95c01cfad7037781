// Real spherical harmonics of degree 0 to 3, with the signs and the order of the original 3DGS code.
#pragma once

namespace mphygs::splatting {

inline constexpr double sh0 = 0.28209479177387814;
inline constexpr double sh1 = 0.4886025119029199;
inline constexpr double sh2[5] = {1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396};
inline constexpr double sh3[7] = {-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
                           -0.4570457994644658, 1.445305721320277,  -0.5900435899266435};

/// The first `count` harmonics at the unit vector d, and their derivatives along x, y, z.
inline void harmonics_at(const double d[3], int count, double value[16], double slope[16][3]) {
    const double x = d[0], y = d[1], z = d[2];
    const auto put = [&](int k, double v, double sx, double sy, double sz) {
        value[k] = v;
        slope[k][0] = sx;
        slope[k][1] = sy;
        slope[k][2] = sz;
    };
    put(0, sh0, 0, 0, 0);
    if (count < 4) {
        return;
    }
    put(1, -sh1 * y, 0, -sh1, 0);
    put(2, sh1 * z, 0, 0, sh1);
    put(3, -sh1 * x, -sh1, 0, 0);
    if (count < 9) {
        return;
    }
    const double xx = x * x, yy = y * y, zz = z * z;
    put(4, sh2[0] * x * y, sh2[0] * y, sh2[0] * x, 0);
    put(5, sh2[1] * y * z, 0, sh2[1] * z, sh2[1] * y);
    put(6, sh2[2] * (2 * zz - xx - yy), -2 * sh2[2] * x, -2 * sh2[2] * y, 4 * sh2[2] * z);
    put(7, sh2[3] * x * z, sh2[3] * z, 0, sh2[3] * x);
    put(8, sh2[4] * (xx - yy), 2 * sh2[4] * x, -2 * sh2[4] * y, 0);
    if (count < 16) {
        return;
    }
    put(9, sh3[0] * y * (3 * xx - yy), 6 * sh3[0] * x * y, 3 * sh3[0] * (xx - yy), 0);
    put(10, sh3[1] * x * y * z, sh3[1] * y * z, sh3[1] * x * z, sh3[1] * x * y);
    put(11, sh3[2] * y * (4 * zz - xx - yy), -2 * sh3[2] * x * y, sh3[2] * (4 * zz - xx - 3 * yy), 8 * sh3[2] * y * z);
    put(12, sh3[3] * z * (2 * zz - 3 * xx - 3 * yy), -6 * sh3[3] * x * z, -6 * sh3[3] * y * z, sh3[3] * (6 * zz - 3 * xx - 3 * yy));
    put(13, sh3[4] * x * (4 * zz - xx - yy), sh3[4] * (4 * zz - 3 * xx - yy), -2 * sh3[4] * x * y, 8 * sh3[4] * x * z);
    put(14, sh3[5] * z * (xx - yy), 2 * sh3[5] * x * z, -2 * sh3[5] * y * z, sh3[5] * (xx - yy));
    put(15, sh3[6] * x * (xx - 3 * yy), 3 * sh3[6] * (xx - yy), -6 * sh3[6] * x * y, 0);
}

}  // namespace mphygs::splatting
