"""Starts ROS in this process with a program's arguments, and makes the program's node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from oaisys_core.errors import OaisysError
from oaisys_core.system.shortages import shortage
from oaisys_ros_bridge.nodes.program_arguments import check_ros_arguments
from oaisys_ros_bridge.transport import hide_shared_memory, prepare_transport

AnyNode = TypeVar("AnyNode", bound=Node)


def start_node(make_node: Callable[[], AnyNode], arguments: Sequence[str]) -> AnyNode:
    """Initialise rclpy and return the node; where that fails, rclpy is shut down again.

    Args:
        make_node: Makes the node, which has all that the arguments say.
        arguments: Of the program, without its name; ROS's begin with ``--ros-args``.

    Raises:
        InvalidInputError: ROS cannot use these arguments.
        ShortageError: This process may not have the memory, threads or files that the node needs.
        OaisysError: What else ``make_node`` raises.
    """
    prepare_transport()
    try:
        with check_ros_arguments(arguments):
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
            node = make_node()
            hide_shared_memory()
    except (OaisysError, MemoryError, OSError, RuntimeError) as error:
        rclpy.try_shutdown()
        if (lack := shortage(error)) is not None:
            raise lack from error
        raise
    return node
