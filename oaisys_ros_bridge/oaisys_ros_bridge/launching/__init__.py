"""What the launch files are made of; the only part that needs ROS's launch system."""
