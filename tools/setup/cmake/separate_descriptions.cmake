# These files define static variables of the same names, so a unity build cannot join them.
get_target_property(_files ${rosidl_generate_interfaces_TARGET}__rosidl_generator_c SOURCES)
list(FILTER _files INCLUDE REGEX "__description\\.c$")
set_source_files_properties(${_files} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
