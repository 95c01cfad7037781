# Eigen from the system or from the Python package cmeel-eigen, so that a build needs no root.
find_package(Eigen3 3.4 QUIET NO_MODULE)
if(NOT Eigen3_FOUND)
  find_package(Python QUIET COMPONENTS Interpreter)
  if(Python_Interpreter_FOUND)
    # In an isolated build the package lies on a path of the build's own.
    execute_process(
      COMMAND "${Python_EXECUTABLE}" -c
              "import os, sys; print(';'.join(p for p in (os.path.join(s, 'cmeel.prefix') for s in sys.path) if os.path.isdir(p)))"
      OUTPUT_VARIABLE cmeel_prefixes OUTPUT_STRIP_TRAILING_WHITESPACE)
    list(APPEND CMAKE_PREFIX_PATH ${cmeel_prefixes})
    find_package(Eigen3 3.4 QUIET NO_MODULE)
  endif()
endif()
if(NOT Eigen3_FOUND)
  message(FATAL_ERROR "Eigen 3.4 was not found: install it (pip install cmeel-eigen; Debian and Ubuntu: apt-get install libeigen3-dev)")
endif()
