"""A typed client of the simulator, without Blender or protobuf in its interface."""
