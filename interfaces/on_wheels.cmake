# Builds on ROS 2's wheels from PyPI: -DCMAKE_PROJECT_INCLUDE names this file. Their targets name folders of Python and numpy of the
# machine that built them; what does not exist here is taken out, and this package finds its own.

function(drop_missing_folders)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(folders)
      set(there)
      foreach(folder IN LISTS folders)
        if(EXISTS "${folder}" OR folder MATCHES "\\$<")
          list(APPEND there "${folder}")
        endif()
      endforeach()
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${there}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL drop_missing_folders)
