"""Rebuilding a surface from depth images, and measuring how true it is. No ROS, no Blender."""
