"""What the project needs around itself: set-up of a machine without ROS."""
