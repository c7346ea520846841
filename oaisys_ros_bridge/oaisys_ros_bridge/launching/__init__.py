"""The content of the launch files; the only modules that need ROS's launch system."""
