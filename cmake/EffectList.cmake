# Writes effect_list.hpp and law_list.hpp from the files of the effect and law folders: adding a file adds the
# effect or the law. effects/air_drag.hpp defines struct AirDrag, materials/neo_hookean.hpp struct NeoHookean.

# Sets <includes> to the #include lines of the headers of the folders, <names> to the structs, <stems> to their files.
function(mphygs_headers includes names stems)
  set(all_includes "")
  set(all_names "")
  set(all_stems "")
  foreach(folder IN LISTS ARGN)
    file(GLOB files CONFIGURE_DEPENDS "${folder}/*.hpp")
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
      string(APPEND all_includes "#include \"${file}\"\n")
      list(APPEND all_names "${camel}")
      list(APPEND all_stems "${stem}")
    endforeach()
  endforeach()
  set(${includes} "${all_includes}" PARENT_SCOPE)
  set(${names} "${all_names}" PARENT_SCOPE)
  set(${stems} "${all_stems}" PARENT_SCOPE)
endfunction()

# mphygs_write_lists(<folder for the generated headers> <extra folder>...): an extra folder holds effects, and laws
# in its subfolder materials.
function(mphygs_write_lists output)
  set(effect_folders "${PROJECT_SOURCE_DIR}/cpp/include/mphygs/effects")
  set(law_folders "${PROJECT_SOURCE_DIR}/cpp/include/mphygs/materials")
  foreach(folder IN LISTS ARGN)
    file(GLOB found CONFIGURE_DEPENDS "${folder}/*.hpp" "${folder}/materials/*.hpp")
    if(NOT found)
      message(FATAL_ERROR "MPHYGS_EXTRA_EFFECTS: the folder '${folder}' holds no effect header (*.hpp) and no law (materials/*.hpp)")
    endif()
    list(APPEND effect_folders "${folder}")
    list(APPEND law_folders "${folder}/materials")
  endforeach()
  mphygs_headers(includes names stems ${effect_folders})
  list(JOIN names ",\n                         " joined)
  file(CONFIGURE OUTPUT "${output}/mphygs/effect_list.hpp" CONTENT
"// Generated from the effect folders by cmake/EffectList.cmake.
#pragma once

#include \"mphygs/effect.hpp\"
${includes}
namespace mphygs {
using Registry = Effects<${joined}>;
}  // namespace mphygs
" @ONLY)
  mphygs_headers(includes names stems ${law_folders})
  list(JOIN names ", " joined)
  list(JOIN stems ", " numbered)
  file(CONFIGURE OUTPUT "${output}/mphygs/law_list.hpp" CONTENT
"// Generated from the law folders by cmake/EffectList.cmake.
#pragma once

${includes}
namespace mphygs {
enum class Law : int { ${numbered} };
template <class... L>
struct Laws {};
using LawList = Laws<${joined}>;
}  // namespace mphygs
" @ONLY)
endfunction()
