"""ROS 2 nodes of the simulator: bridge, mapper and recorder."""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:  # as in `python -m oaisys_ros_bridge`
    del sys.path[0]  # the current folder, whose files nothing may import
