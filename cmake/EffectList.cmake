# Writes effect_list.hpp from the files of the effect folders: adding a file adds the effect.
# effects/air_drag.hpp defines struct AirDrag.
function(mphygs_write_effect_list output)
  set(includes "")
  set(names "")
  foreach(folder IN LISTS ARGN)
    file(GLOB files CONFIGURE_DEPENDS "${folder}/*.hpp")
    if(NOT files)
      message(FATAL_ERROR "MPHYGS_EXTRA_EFFECTS: the folder '${folder}' holds no effect header (*.hpp)")
    endif()
    list(SORT files)
    foreach(file IN LISTS files)
      get_filename_component(stem "${file}" NAME_WE)
      string(REPLACE "_" ";" words "${stem}")
      set(camel "")
      foreach(word IN LISTS words)
        string(SUBSTRING "${word}" 0 1 first)
        string(SUBSTRING "${word}" 1 -1 rest)
        string(TOUPPER "${first}" first)
        string(APPEND camel "${first}${rest}")
      endforeach()
      string(APPEND includes "#include \"${file}\"\n")
      list(APPEND names "${camel}")
    endforeach()
  endforeach()
  list(JOIN names ",\n                         " joined)
  file(CONFIGURE OUTPUT "${output}" CONTENT
"// Generated from the effect folders by cmake/EffectList.cmake.
#pragma once

#include \"mphygs/effect.hpp\"
${includes}
namespace mphygs {
using Registry = Effects<${joined}>;
}  // namespace mphygs
" @ONLY)
endfunction()
