// Every effect of the registry: its description, its null, its tangent, its adjoint.
#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <string>
#include <vector>

#include "effect_evaluation.hpp"

namespace mphygs {
namespace {

using P = Pack<double>;
/// Every law of the build.
std::vector<Law> all_laws() {
    std::vector<Law> all;
    for (int i = 0; i < AllLaws::count; ++i) {
        all.push_back(static_cast<Law>(i));
    }
    return all;
}
const std::vector<Law> laws = all_laws();

template <class R>
struct TypesOf;
template <class... E>
struct TypesOf<Effects<E...>> {
    using type = testing::Types<E...>;
};
struct NameOf {
    template <class E>
    static std::string GetName(int) {
        return E::info.name;
    }
};

template <class E>
class Effect : public testing::Test {};
TYPED_TEST_SUITE(Effect, TypesOf<Registry>::type, NameOf);

TYPED_TEST(Effect, DescribesItself) {
    constexpr const EffectInfo& info = TypeParam::info;
    EXPECT_GT(std::string(info.name).size(), 0u);
    EXPECT_GT(std::string(info.summary).size(), 0u);
    ASSERT_GT(info.parameter_count(), 0);
    std::set<std::string> names;
    for (int k = 0; k < info.parameter_count(); ++k) {
        const ParameterInfo& p = info.parameters[k];
        ASSERT_NE(p.unit, nullptr) << p.name;
        EXPECT_TRUE(names.insert(p.name).second) << p.name << " twice";
        EXPECT_GT(std::string(p.unit).size(), 0u) << p.name;
        EXPECT_LT(p.lower, p.upper) << p.name;
        EXPECT_LE(p.lower, p.null) << p.name;
        EXPECT_LE(p.null, p.upper) << p.name;
        EXPECT_GT(p.scale, 0) << p.name;
        EXPECT_LE(p.low, p.high) << p.name;
        EXPECT_TRUE((p.low == 0 && p.high == 0) || (p.lower <= p.low && p.high <= p.upper)) << p.name << " is tried beyond its bounds";
        EXPECT_TRUE(p.role != Role::level || (p.low > 0 && p.lower > 0)) << p.name << ": a level is tried from low > 0 to high";
        const bool vector = p.role == Role::direction || p.role == Role::axis || p.role == Role::flow || p.role == Role::anchor;
        int together = 0;
        for (int i = 0; i < info.parameter_count(); ++i) {
            together += info.parameters[i].role == p.role;
        }
        EXPECT_TRUE(!vector || together == 3) << p.name << ": expected three components";
    }
    double q[max_effect_parameters] = {};
    for (int k = 0; k < info.parameter_count(); ++k) {
        q[k] = info.parameters[k].null;
    }
    EXPECT_EQ(stiffness_factor<TypeParam>(q), 1.0) << "a null that changes the substep";
    EXPECT_TRUE(info.site == Site::volume || (info.history_count == 0 && !info.needs_rate)) << "only volume points carry these";
}

TYPED_TEST(Effect, IsAbsentAtItsNull) {
    using E = TypeParam;
    if constexpr (!test::has_function<E>()) {
        GTEST_SKIP() << "acts inside the integrator: see test_total_lagrangian_gradient.cpp";
    } else {
        for (const Law law : laws) {
            test::Random random(11);
            const test::EffectInputs inputs = test::effect_inputs<E>(random, law, true);
            const std::vector<P> with = test::evaluate<E>(inputs.value, law), without = test::evaluate<E>(inputs.value, law, false);
            // The numbers that the effect carries for itself may change; what it acts on may not.
            const std::size_t count = with.size() - static_cast<std::size_t>(E::info.history_count);
            double size = 0;
            for (std::size_t i = 0; i < count; ++i) {
                for (int q = 0; q < lane_count; ++q) {
                    size = std::max(size, std::abs(without[i][q]));
                }
            }
            EXPECT_TRUE(E::info.site != Site::volume || size > 1e3);
            for (std::size_t i = 0; i < count; ++i) {
                for (int q = 0; q < lane_count; ++q) {
                    EXPECT_NEAR(with[i][q], without[i][q], 1e-13 * size) << "output " << i;
                }
            }
        }
    }
}

/// Derivative of all outputs along `direction`, by dual numbers.
template <class E>
std::vector<P> tangent(const std::vector<P>& inputs, const std::vector<P>& direction, Law law) {
    using D = Dual<P, 1>;
    std::vector<D> dual;
    for (std::size_t i = 0; i < inputs.size(); ++i) {
        dual.emplace_back(inputs[i]);
        dual.back().d[0] = direction[i];
    }
    std::vector<P> slopes;
    for (const D& x : test::evaluate<E>(dual, law)) {
        slopes.push_back(x.d[0]);
    }
    return slopes;
}

TYPED_TEST(Effect, TangentAgreesWithCentralDifferences) {
    using E = TypeParam;
    if constexpr (!test::has_function<E>()) {
        GTEST_SKIP() << "acts inside the integrator: see test_total_lagrangian_gradient.cpp";
    } else {
        for (const Law law : laws) {
            test::Random random(12);
            const test::EffectInputs inputs = test::effect_inputs<E>(random, law, false);
            for (std::size_t k = 0; k < inputs.value.size(); ++k) {
                std::vector<P> direction(inputs.value.size(), P{});
                direction[k] += inputs.size[k];
                const std::vector<P> slopes = tangent<E>(inputs.value, direction, law);
                const auto at = [&](double step) {
                    std::vector<P> moved = inputs.value;
                    moved[k] += step * inputs.size[k];
                    return test::evaluate<E>(moved, law);
                };
                const double h = 1e-4;
                const std::vector<P> a = at(-2 * h), b = at(-h), c = at(h), d = at(2 * h);
                // Stress, acceleration and history have units of their own, and round-off with them.
                const auto group = [](std::size_t i) { return i < 9 ? 0 : i < 12 ? 1 : 2; };
                double size[3] = {0, 0, 0}, largest = 0;
                for (std::size_t i = 0; i < slopes.size(); ++i) {
                    for (int q = 0; q < lane_count; ++q) {
                        size[group(i)] = std::max(size[group(i)], std::abs(b[i][q]));
                    }
                }
                for (std::size_t i = 0; i < slopes.size(); ++i) {
                    for (int q = 0; q < lane_count; ++q) {
                        const double difference = (8 * (c[i][q] - b[i][q]) - (d[i][q] - a[i][q])) / (12 * h);
                        EXPECT_NEAR(slopes[i][q], difference, 1e-7 * std::abs(difference) + 2e-11 * size[group(i)])
                            << "input " << k << ", output " << i << ", lane " << q;
                        largest = std::max(largest, std::abs(slopes[i][q]));
                    }
                }
                if (static_cast<int>(k) < E::info.parameter_count()) {
                    EXPECT_GT(largest, 0.0) << "nothing depends on " << E::info.parameters[k].name;
                }
            }
        }
    }
}

TYPED_TEST(Effect, AdjointIsTheTransposeOfTheTangent) {
    using E = TypeParam;
    if constexpr (!test::has_function<E>()) {
        GTEST_SKIP() << "acts inside the integrator: see test_total_lagrangian_gradient.cpp";
    } else {
        using V = Var<P>;
        for (const Law law : laws) {
            test::Random random(13);
            const test::EffectInputs inputs = test::effect_inputs<E>(random, law, false);
            Tape<P>& tape = Tape<P>::current();
            tape.reset();
            std::vector<V> recorded;
            for (const P& x : inputs.value) {
                recorded.push_back(V::input(x));
            }
            const std::vector<V> outputs = test::evaluate<E>(recorded, law);
            std::vector<P> bar;
            tape.prepare();
            for (const V& x : outputs) {
                bar.push_back(random.pack(-1, 1));
                if (x.i >= 0) {
                    tape.adjoint(x.i) += bar.back();
                }
            }
            tape.sweep();
            for (std::size_t k = 0; k < inputs.value.size(); ++k) {
                std::vector<P> direction(inputs.value.size(), P{});
                direction[k] += 1.0;
                const std::vector<P> slopes = tangent<E>(inputs.value, direction, law);
                const P adjoint = tape.adjoint(recorded[k].i);
                bool depends = false;
                for (int q = 0; q < lane_count; ++q) {
                    double sum = 0, size = 0;
                    for (std::size_t i = 0; i < slopes.size(); ++i) {
                        sum += bar[i][q] * slopes[i][q];
                        size += std::abs(bar[i][q] * slopes[i][q]);
                    }
                    EXPECT_NEAR(adjoint[q], sum, 1e-11 * size) << "input " << k << ", lane " << q;
                    depends |= adjoint[q] != 0;
                }
                if (static_cast<int>(k) < E::info.parameter_count()) {
                    EXPECT_TRUE(depends) << "no gradient by " << E::info.parameters[k].name;
                }
            }
        }
    }
}

TEST(Registry, NamesAreUniqueAndSlotsDoNotOverlap) {
    std::set<std::string> names;
    for (const EffectInfo* info : Registry::infos) {
        EXPECT_TRUE(names.insert(info->name).second) << info->name;
    }
    const Slots slots = make_slots(std::vector<bool>(static_cast<std::size_t>(Registry::count), true));
    int parameter = 0, uniform = 0, history = 0;
    Registry::each([&](auto tag, int i) {
        using E = typename decltype(tag)::type;
        const EffectSlot& s = slots[static_cast<std::size_t>(i)];
        EXPECT_EQ(s.parameter, parameter);
        EXPECT_EQ(s.uniform, uniform);
        EXPECT_EQ(s.history, history);
        parameter += E::info.parameter_count();
        uniform += uniform_count<E>();
        history += E::info.history_count;
    });
    EXPECT_EQ(parameter, Registry::parameter_count);
    EXPECT_EQ(uniform, Registry::total_uniform_count);
    EXPECT_EQ(history, active_sites(slots).history);
}

}  // namespace
}  // namespace mphygs
