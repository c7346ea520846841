# Stands in for ROS's package of this name where the set-up builds interfaces: it leaves out the
# generators for C++, whose code rclpy never loads.
find_package(ament_cmake_core QUIET REQUIRED)
find_package(rosidl_core_generators QUIET REQUIRED)
set(_extensions ${AMENT_EXTENSIONS_rosidl_generate_idl_interfaces})
list(FILTER _extensions EXCLUDE REGEX "_cpp:")
list(APPEND _extensions "rosidl_default_generators:separate_descriptions.cmake")
set(AMENT_EXTENSIONS_rosidl_generate_idl_interfaces ${_extensions})
