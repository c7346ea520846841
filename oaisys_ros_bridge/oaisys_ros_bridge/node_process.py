"""A node's life as a program: from its arguments to a clean end on SIGINT or SIGTERM."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from oaisys_ros_bridge.transport import prepare_transport


class Closable(Protocol):
    """What a node offers beside rclpy's own."""

    def close(self) -> None:
        """End threads and finish files; called once, when nothing is executed any more."""


def run_node(
    make_node: Callable[[], Node], arguments: Sequence[str] | None = None, *, threads: int = 6
) -> int:
    """Run a node (`rclpy.node.Node` and `Closable`) until SIGINT or SIGTERM; return 0.

    Signals only set a flag: rclpy's own handlers would take the context down while callbacks
    still publish, and a second Ctrl-C would interrupt the first one's cleaning up.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    prepare_transport()
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = make_node()
    executor = MultiThreadedExecutor(num_threads=threads)
    executor.add_node(node)
    spinner = threading.Thread(target=_spin, args=(executor, stop), name="executor")
    spinner.start()
    stop.wait()
    node.close()
    executor.shutdown(timeout_sec=2.0)
    rclpy.try_shutdown()
    spinner.join(timeout=2.0)
    return 0


def _spin(executor: MultiThreadedExecutor, stop: threading.Event) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass
    finally:
        stop.set()
