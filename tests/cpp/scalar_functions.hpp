// Every operation that Dual and Var define, by name, as a template over the scalar.
#pragma once

#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "mphygs/numerics/tape.hpp"

namespace mphygs::test {

template <class S>
struct ScalarFunction {
    std::string name;
    std::function<S(S, S)> f;
};

template <class S>
std::vector<ScalarFunction<S>> scalar_functions() {
    using R = typename ScalarOf<S>::type;
    return {
        {"a + b", [](S a, S b) { return S(a + b); }},
        {"a - b", [](S a, S b) { return S(a - b); }},
        {"a * b", [](S a, S b) { return S(a * b); }},
        {"a / b", [](S a, S b) { return S(a / b); }},
        {"-a", [](S a, S) { return S(-a); }},
        {"a + r", [](S a, S) { return S(a + R(2)); }},
        {"r + a", [](S a, S) { return S(R(2) + a); }},
        {"a - r", [](S a, S) { return S(a - R(2)); }},
        {"r - a", [](S a, S) { return S(R(2) - a); }},
        {"a * r", [](S a, S) { return S(a * R(3)); }},
        {"r * a", [](S a, S) { return S(R(3) * a); }},
        {"a / r", [](S a, S) { return S(a / R(3)); }},
        {"r / a", [](S a, S) { return S(R(3) / a); }},
        {"a += b", [](S a, S b) { a += b * b; return a; }},
        {"a -= b", [](S a, S b) { a -= b * b; return a; }},
        {"a *= b", [](S a, S b) { a *= b; return a; }},
        {"sqrt", [](S a, S b) { return S(square_root(a * b)); }},
        {"log", [](S a, S b) { return S(logarithm(a * b)); }},
        {"exp", [](S a, S b) { return S(exponential(a * b)); }},
        {"sin", [](S a, S b) { return S(sine(a * b)); }},
        {"cos", [](S a, S b) { return S(cosine(a * b)); }},
        {"select, first", [](S a, S b) { return S(select(value_of(a) < value_of(a + R(1)), a * a, b)); }},
        {"select, second", [](S a, S b) { return S(select(value_of(a) > value_of(a + R(1)), a * a, b * b)); }},
        {"a a", [](S a, S) { return S(a * a); }},
    };
}

template <class S>
std::function<S(S, S)> scalar_function(const std::string& name) {
    for (const auto& f : scalar_functions<S>()) {
        if (f.name == name) {
            return f.f;
        }
    }
    throw std::invalid_argument("no function is called " + name);
}

}  // namespace mphygs::test
