"""Poses in files of many formats, told apart by their content."""

from oaisys_core.files.poses.reading import is_named_columns_file, read_pose_table, with_times
from oaisys_core.files.poses.records import PoseSelection, PoseTable, of_rig

__all__ = [
    "PoseSelection",
    "PoseTable",
    "is_named_columns_file",
    "of_rig",
    "read_pose_table",
    "with_times",
]
