# ROS's generators look for Python eight times in a package, and each time takes six starts of it.
if(NOT Python3_NumPy_FOUND)
  set(Python3_FIND_COMPONENTS Interpreter Development.Module NumPy)
  foreach(_component ${Python3_FIND_COMPONENTS})
    set(Python3_FIND_REQUIRED_${_component} TRUE)
  endforeach()
  include(${CMAKE_ROOT}/Modules/FindPython3.cmake)
endif()
