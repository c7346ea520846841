"""The experiments of the paper: a whole system started, driven through ROS, and measured."""
