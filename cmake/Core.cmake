# The core library and its Python module: once for one processor, or once per level of x86-64.
#
# A portable build compiles everything for x86-64-v2, -v3 and -v4 into modules of their own, and a
# small module that asks the processor; mphygs/_load_core.py picks. On other machines than x86-64
# portable means the compiler's default.
file(GLOB core_sources CONFIGURE_DEPENDS cpp/src/*/*.cpp)
file(GLOB binding_sources CONFIGURE_DEPENDS cpp/bindings/*.cpp)
list(FILTER binding_sources EXCLUDE REGEX "processor\\.cpp$")

if(MPHYGS_PYTHON)
  find_package(Python REQUIRED COMPONENTS Interpreter Development.Module)
  find_package(pybind11 CONFIG QUIET)
  if(NOT pybind11_FOUND)
    # pip puts it where only Python knows.
    execute_process(COMMAND "${Python_EXECUTABLE}" -m pybind11 --cmakedir
                    OUTPUT_VARIABLE pybind11_DIR OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
    find_package(pybind11 CONFIG QUIET)
  endif()
  if(NOT pybind11_FOUND)
    message(FATAL_ERROR "pybind11 was not found: install it (pip install pybind11) or configure with -DMPHYGS_PYTHON=OFF")
  endif()
endif()

# mphygs_core<suffix> and _core<suffix>, compiled with the options that follow.
function(mphygs_add_core suffix)
  add_library(mphygs_core${suffix} STATIC ${core_sources})
  target_compile_options(mphygs_core${suffix} PUBLIC ${ARGN})
  target_link_libraries(mphygs_core${suffix} PUBLIC mphygs_options)
  if(MPHYGS_PYTHON)
    pybind11_add_module(_core${suffix} MODULE NO_EXTRAS ${binding_sources})
    target_compile_definitions(_core${suffix} PRIVATE MPHYGS_MODULE=_core${suffix})
    target_link_libraries(_core${suffix} PRIVATE mphygs_core${suffix})
    # They copy arrays and call the core: no loop of theirs is worth the time that more optimisation takes.
    target_compile_options(_core${suffix} PRIVATE $<$<CONFIG:Release>:-O1>)
    # Read once, not once per file: a third of the time that the bindings take.
    target_precompile_headers(_core${suffix} PRIVATE
      <pybind11/functional.h> <pybind11/numpy.h> <pybind11/pybind11.h> <pybind11/stl.h>)
    install(TARGETS _core${suffix} DESTINATION mphygs)
  endif()
endfunction()

if(NOT MPHYGS_ARCHITECTURE STREQUAL "portable")
  if(MPHYGS_ARCHITECTURE)
    target_compile_options(mphygs_options INTERFACE -march=${MPHYGS_ARCHITECTURE})
  endif()
  mphygs_add_core("")
elseif(CMAKE_SYSTEM_PROCESSOR MATCHES "^(x86_64|AMD64|amd64)$")
  if(MPHYGS_TESTS OR NOT MPHYGS_PYTHON)
    message(FATAL_ERROR "MPHYGS_ARCHITECTURE=portable builds Python modules only: set MPHYGS_PYTHON=ON and MPHYGS_TESTS=OFF, "
                        "or choose one architecture")
  endif()
  foreach(level v2 v3 v4)
    mphygs_add_core(_${level} -march=x86-64-${level})
  endforeach()
  pybind11_add_module(_processor MODULE NO_EXTRAS cpp/bindings/processor.cpp)
  install(TARGETS _processor DESTINATION mphygs)
else()
  mphygs_add_core("")
endif()
