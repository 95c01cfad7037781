// Effects that one direction alone has, at their null: its derivative is the one of a run that has them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using F = Fields<double>;
const Schedule usual{{9, 12}, {1e-4, 8e-5}, 0.01};
const Schedule implicit = [] {
    Schedule s{{1, 2}, {4e-4, 3e-4}, 0.01};
    s.implicit = true;
    return s;
}();

bool may_be_added(const EffectInfo& info) {
    const bool fitted = std::any_of(info.parameters, info.parameters + info.parameter_count(), [](const ParameterInfo& p) { return p.fitted; });
    return fitted && (info.site == Site::volume || info.site == Site::surface || info.site == Site::body) && !info.threshold;
}

/// Parameters with which an effect does nothing yet and its strength still shows: constants away from their null.
std::vector<double> at_null(std::size_t first, const EffectInfo& info, const std::vector<double>& others) {
    std::vector<double> effect = others;
    for (int p = 0; p < info.parameter_count(); ++p) {
        const bool constant = !info.parameters[p].fitted || info.parameters[p].null != 0.0;
        effect[first + static_cast<std::size_t>(p)] = info.parameters[p].null;
        if (constant) {
            effect[first + static_cast<std::size_t>(p)] += 0.3 * info.parameters[p].scale;
        }
    }
    const double flow[] = {2.0, -3.0, 0.0};
    for (int p = 0, k = 0; p < info.parameter_count(); ++p) {
        if (info.parameters[p].role == Role::flow) {
            effect[first + static_cast<std::size_t>(p)] = flow[k++];
        }
    }
    return effect;
}

/// beside: whether the run has effects of its own, with memory, of strain and of the surface.
void expect_added_as_active(bool beside, bool prestressed, const Schedule& schedule = usual) {
    const double solved = schedule.implicit ? 100.0 : 1.0;  // implicit steps are solved for to a rest
    const std::vector<std::string> own = {"viscosity", "relaxation", "stiffening", "air_drag", "eigenstrain"};
    std::size_t first = 0;
    for (int e = 0; e < Registry::count; first += static_cast<std::size_t>(Registry::infos[e++]->parameter_count())) {
        const EffectInfo& info = *Registry::infos[e];
        if (!may_be_added(info)) {
            continue;
        }
        Settings settings, whole;
        std::vector<int> present;
        for (int i = 0; beside && i < Registry::count; ++i) {
            if (i != e && std::find(own.begin(), own.end(), Registry::infos[i]->name) != own.end()) {
                present.push_back(i);
            }
        }
        settings.active = test::only_active(present);
        present.push_back(e);
        whole.active = test::only_active(present);
        test::Bar b = test::make_bar(test::smaller, schedule, settings);
        test::stir(b, 41);
        if (!prestressed) {
            b.fields.deformation0.clear();
        }
        const TotalLagrangian<double> with(b.model->geometry(), whole);
        const std::vector<double> effect = at_null(first, info, b.fields.effect);
        F all = b.fields;
        all.effect = effect;
        const std::size_t count = static_cast<std::size_t>(info.parameter_count());
        std::vector<F> directions(count);
        for (std::size_t p = 0; p < count; ++p) {
            directions[p].effect.assign(effect.size(), 0.0);
            directions[p].effect[first + p] = 1.0;
        }
        const auto expected = with.tangent(all, directions, schedule);
        // Beside a direction that has nothing of it, and behind it.
        F other;
        other.gravity = {1, 2, 3};
        std::vector<F> behind{other};
        behind.insert(behind.end(), directions.begin(), directions.end());
        std::vector<Added<double>> added(count, {test::only_active({e}), effect});
        added.insert(added.begin(), Added<double>{});
        const auto found = b.model->tangent(b.fields, behind, schedule, {}, nullptr, added);
        const auto plain = b.model->tangent(b.fields, {other}, schedule);
        for (std::size_t i = 0; i < expected[0].velocity.size(); ++i) {
            EXPECT_NEAR(found[0].velocity[i], expected[0].velocity[i], solved * 1e-12) << info.name;
            EXPECT_NEAR(found[1].velocity[i], plain[1].velocity[i], schedule.implicit ? 1e-9 : 1e-15) << info.name;
        }
        double largest = 0;
        for (std::size_t p = 0; p < count; ++p) {
            double size = 0;
            for (const double x : expected[p + 1].velocity) {
                size = std::max(size, std::abs(x));
            }
            largest = std::max(largest, size);
            for (std::size_t i = 0; i < expected[0].velocity.size(); ++i) {
                EXPECT_NEAR(found[p + 2].velocity[i], expected[p + 1].velocity[i], solved * 1e-10 * size) << info.name << ", parameter " << p;
            }
        }
        EXPECT_GT(largest, 1e-9) << info.name;
    }
}

TEST(Added, IsTheDerivativeOfARunThatHasTheEffect) { expect_added_as_active(false, false); }
TEST(Added, AlsoOfAPrestressedObject) { expect_added_as_active(false, true); }
TEST(Added, AlsoBesideEffectsWithMemory) { expect_added_as_active(true, true); }

TEST(Added, AlsoInImplicitSteps) { expect_added_as_active(true, true, implicit); }

TEST(Added, EachHasConstantsOfItsOwn) {
    Settings settings, whole;
    std::size_t first = 0;
    int e = 0;
    while (std::string(Registry::infos[e]->name) != "relaxation") {
        first += static_cast<std::size_t>(Registry::infos[e++]->parameter_count());
    }
    settings.active = test::only_active({});
    whole.active = test::only_active({e});
    test::Bar b = test::make_bar({}, usual, settings);
    test::stir(b, 42);
    const TotalLagrangian<double> with(b.model->geometry(), whole);
    F direction;
    direction.effect.assign(b.fields.effect.size(), 0.0);
    direction.effect[first] = 1.0;
    std::vector<Added<double>> added;
    for (const double time : {1e-3, 0.1}) {
        Added<double> one{whole.active, b.fields.effect};
        one.effect[first] = 0.0;
        one.effect[first + 1] = time;
        added.push_back(one);
    }
    const auto both = b.model->tangent(b.fields, {direction, direction}, usual, {}, nullptr, added);
    double apart = 0;
    for (std::size_t k = 0; k < 2; ++k) {
        F all = b.fields;
        all.effect = added[k].effect;
        const auto alone = with.tangent(all, {direction}, usual);
        for (std::size_t i = 0; i < alone[1].velocity.size(); ++i) {
            EXPECT_NEAR(both[k + 1].velocity[i], alone[1].velocity[i], 1e-10 * std::abs(alone[1].velocity[i]) + 1e-13);
            apart = std::max(apart, std::abs(both[1].velocity[i] - both[2].velocity[i]));
        }
    }
    EXPECT_GT(apart, 1e-6);
}

TEST(Added, TellsWhatItNeeds) {
    Settings settings;
    settings.active = test::only_active({});
    test::Bar b = test::make_bar({}, usual, settings);
    EXPECT_THROW(b.model->tangent(b.fields, {F{}}, usual, {}, nullptr, {{}, {}}), std::invalid_argument);
    const Added<double> bare{test::only_active({0}), {}};
    EXPECT_THROW(b.model->tangent(b.fields, {F{}}, usual, {}, nullptr, {bare}), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
