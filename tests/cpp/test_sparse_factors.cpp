// The sparse direct solver: exact beside dense factors, in both directions, and cheap where a body branches.
#include <gtest/gtest.h>

#include <cmath>

#include "bar_scene.hpp"
#include "mphygs/numerics/elimination_order.hpp"
#include "mphygs/numerics/sparse_factors.hpp"
#include "mphygs/total_lagrangian/saddle_vertices.hpp"

namespace mphygs {
namespace {

/// A stem of so many vertices and limbs of as many, each on the stem's end; every vertex is coupled to the next two.
VertexGraph branched(int limbs, int length, int weight) {
    VertexGraph g;
    g.weight.assign(static_cast<std::size_t>((limbs + 1) * length), weight);
    g.beside.resize(g.weight.size());
    const auto couple = [&](int a, int b) {
        g.beside[static_cast<std::size_t>(a)].push_back(b);
        g.beside[static_cast<std::size_t>(b)].push_back(a);
    };
    for (int limb = 0; limb <= limbs; ++limb) {
        for (int k = 0; k < length; ++k) {
            const int own = limb * length + k;
            if (k + 1 < length) {
                couple(own, own + 1);
            }
            if (k + 2 < length) {
                couple(own, own + 2);
            }
        }
        if (limb > 0) {
            couple(length - 1, limb * length);
        }
    }
    for (std::vector<int>& beside : g.beside) {
        std::sort(beside.begin(), beside.end());
    }
    return g;
}

std::vector<std::vector<int>> unknowns_of(const VertexGraph& g) {
    std::vector<std::vector<int>> vertices;
    int next = 0;
    for (const int weight : g.weight) {
        vertices.emplace_back();
        for (int k = 0; k < weight; ++k) {
            vertices.back().push_back(next++);
        }
    }
    return vertices;
}

/// Random numbers where a graph has them, none of them the same on both sides of the diagonal, which is not larger than they.
Eigen::SparseMatrix<double> matrix_on(const VertexGraph& g, const std::vector<std::vector<int>>& vertices, unsigned seed) {
    test::Random random(seed);
    std::vector<Eigen::Triplet<double>> entries;
    for (std::size_t v = 0; v < vertices.size(); ++v) {
        std::vector<int> beside = g.beside[v];
        beside.push_back(static_cast<int>(v));
        for (const int w : beside) {
            for (const int r : vertices[static_cast<std::size_t>(w)]) {
                for (const int c : vertices[v]) {
                    entries.emplace_back(r, c, random.between(-1, 1));
                }
            }
        }
    }
    const int n = vertices.back().back() + 1;
    Eigen::SparseMatrix<double> matrix(n, n);
    matrix.setFromTriplets(entries.begin(), entries.end());
    return matrix;
}

Eigen::MatrixXd random_columns(Eigen::Index rows, Eigen::Index columns, unsigned seed) {
    test::Random random(seed);
    Eigen::MatrixXd x(rows, columns);
    for (Eigen::Index i = 0; i < x.size(); ++i) {
        x.data()[i] = random.between(-1, 1);
    }
    return x;
}

TEST(SparseFactors, SolveAsDenseOnesDoInBothDirections) {
    const VertexGraph g = branched(3, 6, 4);
    const std::vector<std::vector<int>> vertices = unknowns_of(g);
    SparseFactors factors;
    for (const unsigned seed : {1u, 2u}) {  // one analysis, two matrices
        const Eigen::SparseMatrix<double> matrix = matrix_on(g, vertices, seed);
        if (seed == 1u) {
            factors.analyse(matrix, vertices);
        }
        ASSERT_TRUE(factors.factorise(matrix));
        const Eigen::MatrixXd dense(matrix), right = random_columns(matrix.rows(), 5, 3);
        const Eigen::MatrixXd expected = dense.fullPivLu().solve(right), found = factors.solve_all(right);
        EXPECT_LT((found - expected).norm(), 1e-9 * expected.norm());
        const Eigen::VectorXd one = right.col(2);
        EXPECT_LT((factors.solve(one) - found.col(2)).norm(), 1e-10 * found.col(2).norm());
        const Eigen::VectorXd back = dense.transpose().fullPivLu().solve(one);
        EXPECT_LT((factors.solve_transposed(one) - back).norm(), 1e-9 * back.norm());
    }
}

TEST(SparseFactors, GiveTheSameBitsWhereverTheyStand) {
    const VertexGraph g = branched(3, 12, 7);
    const std::vector<std::vector<int>> vertices = unknowns_of(g);
    const Eigen::SparseMatrix<double> matrix = matrix_on(g, vertices, 6);
    const Eigen::VectorXd right = random_columns(matrix.rows(), 1, 7);
    std::vector<std::vector<char>> between;
    Eigen::VectorXd forward, back;
    for (std::size_t k = 0; k < 24; ++k) {
        between.emplace_back(24 + 16 * (k % 5) + 5000 * (k % 3));
        SparseFactors factors;
        factors.analyse(matrix, vertices);
        ASSERT_TRUE(factors.factorise(matrix));
        const Eigen::VectorXd x = factors.solve(right), y = factors.solve_transposed(right);
        if (k > 0) {
            EXPECT_TRUE((x.array() == forward.array()).all() && (y.array() == back.array()).all()) << k;
        }
        forward = x;
        back = y;
    }
}

TEST(SparseFactors, RowsThatComeLastFollowWhatTheyTie) {
    VertexGraph g = branched(4, 8, 3);
    const int nodes = g.count(), tips[4] = {15, 23, 31, 39};
    for (int tie = 0; tie < 3; ++tie) {  // the tips, each to the next; their rows see three vertices of both limbs
        std::vector<int> tied;
        for (int k = 0; k < 3; ++k) {
            tied.insert(tied.end(), {tips[tie] - k, tips[tie + 1] - k});
        }
        std::sort(tied.begin(), tied.end());
        for (const int v : tied) {
            g.beside[static_cast<std::size_t>(v)].push_back(nodes + tie);
        }
        g.beside.push_back(tied);
        g.weight.push_back(4);
    }
    const std::vector<std::vector<int>> vertices = unknowns_of(g);
    Eigen::SparseMatrix<double> matrix = matrix_on(g, vertices, 4);
    for (Eigen::Index i = 3 * nodes; i < matrix.rows(); ++i) {
        for (Eigen::Index k = 3 * nodes; k < matrix.rows(); ++k) {
            if (matrix.coeff(i, k) != 0.0) {
                matrix.coeffRef(i, k) = 0.0;  // a saddle
            }
        }
    }
    g.last.assign(g.weight.size(), false);
    std::fill(g.last.begin() + nodes, g.last.end(), true);
    const EliminationTree tree = cheapest_elimination(g);
    std::vector<int> place(g.weight.size(), -1);
    int next = 0;
    for (const EliminationTree::Front& front : tree.fronts) {
        for (const int v : front.pivots) {
            place[static_cast<std::size_t>(v)] = next++;
        }
    }
    EXPECT_EQ(next, g.count());
    for (int tie = nodes; tie < g.count(); ++tie) {
        for (const int v : g.beside[static_cast<std::size_t>(tie)]) {
            EXPECT_GT(place[static_cast<std::size_t>(tie)], place[static_cast<std::size_t>(v)]);
        }
    }
    SparseFactors factors;
    factors.analyse(matrix, vertices, g.last);
    ASSERT_TRUE(factors.factorise(matrix));
    const Eigen::VectorXd right = random_columns(matrix.rows(), 1, 5);
    const Eigen::VectorXd expected = Eigen::MatrixXd(matrix).fullPivLu().solve(right);
    EXPECT_LT((factors.solve(right) - expected).norm(), 1e-9 * expected.norm());
}

TEST(SparseFactors, AMatrixWithoutInverseIsTold) {
    const VertexGraph g = branched(1, 4, 2);
    const std::vector<std::vector<int>> vertices = unknowns_of(g);
    Eigen::SparseMatrix<double> matrix = matrix_on(g, vertices, 1);
    SparseFactors factors;
    factors.analyse(matrix, vertices);
    for (int i = 0; i < matrix.cols(); ++i) {
        matrix.coeffRef(5, i) = 0.0;
    }
    EXPECT_FALSE(factors.factorise(matrix));
}

TEST(SparseFactors, ALimbCostsWhatItDoesAlone) {
    const auto work = [](int limbs) { return cheapest_elimination(branched(limbs, 20, 30)).work; };
    const double alone = work(0), three = work(6) - work(3);
    EXPECT_NEAR(three, 3 * alone, 0.6 * alone);
    EXPECT_NEAR(work(12) - work(6), 2 * three, 0.05 * three);
}

TEST(SparseFactors, ARowOfVerticesCostsWhatItsBandDoes) {
    const int length = 100, w = 60;
    const double p = w, b = 2 * w, band = length * (2.0 / 3.0 * p * p * p + 2 * p * p * b + 2 * p * b * b);
    const double found = cheapest_elimination(branched(0, length, w)).work;
    EXPECT_GT(found, 0.9 * band);
    EXPECT_LT(found, 1.15 * band);
}

/// Graph Laplacian of a bar's nodes, of all three components, with the rows of its holds and joints: nothing but these
/// fixes a part in space.
Eigen::SparseMatrix<double> floating(const TotalLagrangian<double>& model, const std::vector<std::int32_t>& node) {
    const Geometry& g = model.geometry();
    const int count = static_cast<int>(model.node_count()), all = 3 * (count + static_cast<int>(g.row_count()));
    const std::vector<std::int32_t>& at = model.node_index();
    std::vector<Eigen::Triplet<double>> entries;
    for (int a = 0; a < count; ++a) {
        for (int b = 0; b < count; ++b) {
            const auto apart = [&](int c) { return std::abs(at[static_cast<std::size_t>(3 * a + c)] - at[static_cast<std::size_t>(3 * b + c)]); };
            if (a != b && std::max({apart(0), apart(1), apart(2)}) <= 2) {
                for (int i = 0; i < 9; ++i) {
                    entries.emplace_back(3 * a + i / 3, 3 * b + i % 3, i / 3 == i % 3 ? -1.0 : 0.0);
                    entries.emplace_back(3 * a + i / 3, 3 * a + i % 3, i / 3 == i % 3 ? 1.0 : 0.0);
                }
            }
        }
    }
    for (std::size_t r = 0; r < g.row_count(); ++r) {
        for (int w = g.row_begin[r]; w < g.row_begin[r + 1]; ++w) {
            for (int c = 0; c < 3; ++c) {
                const int row = 3 * count + 3 * static_cast<int>(r) + c, of = 3 * node[static_cast<std::size_t>(w)] + c;
                entries.emplace_back(row, of, g.row_weight[static_cast<std::size_t>(w)]);
                entries.emplace_back(of, row, g.row_weight[static_cast<std::size_t>(w)]);
            }
        }
    }
    for (int i = 3 * count; i < all; ++i) {
        entries.emplace_back(i, i, 0.0);
    }
    Eigen::SparseMatrix<double> matrix(all, all);
    matrix.setFromTriplets(entries.begin(), entries.end());
    return matrix;
}

TEST(SparseFactors, APartThatOnlyAJointHoldsMakesNoFrontSingular) {
    test::BarOptions o;
    o.two_grids = true;
    const test::Bar bar = test::make_bar(o, {});
    const Geometry& g = bar.model->geometry();
    std::vector<std::int32_t> node;
    for (std::size_t w = 0; w < g.row_weight.size(); ++w) {
        for (std::size_t n = 0; n < bar.model->node_count(); ++n) {
            if (std::equal(&g.row_node[3 * w], &g.row_node[3 * w] + 3, &bar.model->node_index()[3 * n])) {
                node.push_back(static_cast<std::int32_t>(n));
            }
        }
    }
    ASSERT_EQ(node.size(), g.row_weight.size());
    const Eigen::SparseMatrix<double> matrix = floating(*bar.model, node);
    const std::vector<std::vector<int>> vertices = saddle_vertices(g, node, bar.model->node_count(), matrix);
    std::vector<int> times(static_cast<std::size_t>(matrix.rows()), 0);
    for (const std::vector<int>& vertex : vertices) {
        for (const int i : vertex) {
            ++times[static_cast<std::size_t>(i)];
        }
    }
    EXPECT_EQ(std::count(times.begin(), times.end(), 1), matrix.rows());
    SparseFactors factors;
    factors.analyse(matrix, vertices);
    ASSERT_TRUE(factors.factorise(matrix));
    const Eigen::VectorXd right = random_columns(matrix.rows(), 1, 7);
    const Eigen::VectorXd expected = Eigen::MatrixXd(matrix).fullPivLu().solve(right);
    EXPECT_LT((factors.solve(right) - expected).norm(), 1e-9 * expected.norm());
}

}  // namespace
}  // namespace mphygs
