"""Drives: the rig follows a trajectory, and each sensor measures at its own rate."""
