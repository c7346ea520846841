"""Samples as files, laid out as the original simulator lays them out, and back."""

from oaisys_core.output.poses import POSE_COLUMNS, read_poses

__all__ = ["POSE_COLUMNS", "read_poses"]
