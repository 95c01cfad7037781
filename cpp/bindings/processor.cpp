// What this processor can run: built for any x86-64, so that asking never crashes.
#include <pybind11/pybind11.h>

namespace {

/// Highest level of x86-64 (psABI) that processor and operating system support, 1 to 4.
int processor_level() {
    __builtin_cpu_init();
    if (!(__builtin_cpu_supports("sse3") && __builtin_cpu_supports("ssse3") && __builtin_cpu_supports("sse4.1") &&
          __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt"))) {
        return 1;
    }
    if (!(__builtin_cpu_supports("avx") && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") &&
          __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("fma"))) {
        return 2;
    }
    if (!(__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
          __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))) {
        return 3;
    }
    return 4;
}

}  // namespace

PYBIND11_MODULE(_processor, m) {
    m.doc() = "The processor's instruction sets.";
    m.def("level", &processor_level, "Highest level of x86-64 that this processor runs, 1 to 4.");
}
