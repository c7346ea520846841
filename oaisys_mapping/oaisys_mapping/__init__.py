"""Rebuilding a surface from depth images, and measuring how true it is. No ROS, no Blender."""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:  # as in `python -m oaisys_mapping`
    del sys.path[0]  # the current folder, whose files nothing may import
