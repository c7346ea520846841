"""Checked when it is imported, before rclpy: /dev/shm has room for what ROS loads.

For modules that import rclpy and that commands load by name, such as outputs of drives.

Raises:
    ShortageError: It is full; loading rclpy would end the process by SIGBUS.
"""

from oaisys_ros_bridge.shared_memory import require_shared_memory

require_shared_memory()
