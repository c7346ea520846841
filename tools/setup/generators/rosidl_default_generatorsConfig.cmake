# Stands in for ROS's package of this name where the set-up builds interfaces: it leaves out the
# generators whose code rclpy never loads. Those for C++ alone take two thirds of a build's time.
find_package(ament_cmake_core QUIET REQUIRED)
find_package(rosidl_core_generators QUIET REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:|_introspection_")
