// The shapes that a cell's points do not see.
#include "mphygs/total_lagrangian/cell_springs.hpp"

namespace mphygs {
namespace {

constexpr int nodes = 27;
// Of a column, a multiple of four: what is beyond its last number is zero.
constexpr int length = 28;

using Column = double[length];

double product(const Column& a, const Column& b) {
    double sum[4] = {};
    for (int i = 0; i < length; i += 4) {
        for (int k = 0; k < 4; ++k) {
            sum[k] += a[i + k] * b[i + k];
        }
    }
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

void turn(Column& a, Column& b, double cosine, double sine) {
    for (int i = 0; i < length; ++i) {
        const double x = a[i], y = b[i];
        a[i] = cosine * x - sine * y;
        b[i] = sine * x + cosine * y;
    }
}

/// Turns columns into each other until they are orthogonal (one-sided Jacobi: Hestenes 1958), and sorts them by length, the
/// longest first: their lengths are the singular values, they themselves the left singular vectors, and what `right`
/// becomes of a unit matrix the right ones. Eigen's SVD finds the same, and takes twenty seconds to compile.
template <int count>
void make_orthogonal(Column (&column)[count], Column* right = nullptr) {
    constexpr double least = 4e-16;
    bool turned = true;
    for (int sweep = 0; turned && sweep < 60; ++sweep) {
        turned = false;
        double square[count], largest = 0;
        for (int p = 0; p < count; ++p) {
            square[p] = product(column[p], column[p]);
            largest = std::max(largest, square[p]);
        }
        for (int p = 0; p < count; ++p) {
            for (int q = p + 1; q < count; ++q) {
                const double both = product(column[p], column[q]);
                // Columns that are nothing beside the longest are orthogonal to all.
                if (std::abs(both) <= least * std::max(std::sqrt(square[p] * square[q]), least * largest)) {
                    continue;
                }
                turned = true;
                const double ratio = (square[q] - square[p]) / (2 * both);
                const double tangent = std::copysign(1.0, ratio) / (std::abs(ratio) + std::sqrt(1 + ratio * ratio));
                const double cosine = 1 / std::sqrt(1 + tangent * tangent);
                square[p] = std::max(square[p] - tangent * both, 0.0);
                square[q] += tangent * both;
                turn(column[p], column[q], cosine, cosine * tangent);
                if (right != nullptr) {
                    turn(right[p], right[q], cosine, cosine * tangent);
                }
            }
        }
    }
    for (int p = 0; p < count; ++p) {
        for (int q = p + 1; q < count; ++q) {
            if (product(column[q], column[q]) > product(column[p], column[p])) {
                std::swap(column[p], column[q]);
                if (right != nullptr) {
                    std::swap(right[p], right[q]);
                }
            }
        }
    }
}

}  // namespace

void flat_shapes(const double (&share)[27], const double (&slopes)[24][27], double (&shape)[cell_shapes][27]) {
    double root[nodes];
    Column polynomial[10] = {}, weighed[nodes] = {}, right[nodes] = {}, beside[cell_shapes + 1] = {};
    for (int a = 0; a < nodes; ++a) {
        const double x = a / 9 - 1, y = (a / 3) % 3 - 1, z = a % 3 - 1;
        root[a] = std::max(std::sqrt(share[a]), 1e-9);
        const double value[10] = {1, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x};
        for (int k = 0; k < 10; ++k) {
            polynomial[k][a] = root[a] * value[k];
        }
        for (int i = 0; i < 24; ++i) {
            weighed[a][i] = slopes[i][a] / root[a];
        }
        right[a][a] = 1;
    }
    // In coordinates of length root[a] u_a: what has least slope (and the constant), and of that what no polynomial is.
    make_orthogonal(weighed, right);
    make_orthogonal(polynomial);
    for (int k = 0; k <= cell_shapes; ++k) {
        const Column& flat = right[nodes - 1 - cell_shapes + k];
        std::copy(flat, flat + length, beside[k]);
        for (const Column& p : polynomial) {
            const double part = product(p, flat) / product(p, p);
            for (int a = 0; a < nodes; ++a) {
                beside[k][a] -= part * p[a];
            }
        }
    }
    make_orthogonal(beside);
    for (int k = 0; k < cell_shapes; ++k) {
        const double size = std::sqrt(product(beside[k], beside[k]));
        for (int a = 0; a < nodes; ++a) {
            // What is next to a polynomial is left out.
            shape[k][a] = size > 0.1 ? root[a] * beside[k][a] / size : 0.0;
        }
    }
}

}  // namespace mphygs
