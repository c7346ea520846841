"""The programs: each module is one node. What must be settled before rclpy is loaded is done here.

Raises:
    ShortageError: /dev/shm is full; loading rclpy would end the process by SIGBUS. Or the current
        folder has been removed, without which Open3D cannot be loaded.
"""

import sys

from oaisys_core.errors import ShortageError
from oaisys_core.system.ending.owner import follow_owner
from oaisys_core.system.ending.signals import exit_at_signals
from oaisys_core.system.shortages import check_current_folder
from oaisys_core.system.standard_streams import open_standard_streams
from oaisys_ros_bridge.shared_memory import require_shared_memory

_IS_PROGRAM = sys.argv[:1] == ["-m"]  # as in `python -m oaisys_ros_bridge.nodes.bridge`

if _IS_PROGRAM:
    exit_at_signals()
    follow_owner()
    open_standard_streams()
if "rclpy" not in sys.modules:
    try:
        check_current_folder()
        require_shared_memory()
    except ShortageError as error:
        if _IS_PROGRAM:
            sys.exit(str(error))
        raise
