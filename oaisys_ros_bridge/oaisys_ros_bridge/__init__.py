"""ROS 2 nodes of the simulator: bridge, mapper and recorder."""
