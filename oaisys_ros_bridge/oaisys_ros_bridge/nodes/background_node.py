"""A ROS node that spins in a background thread of a program that does something else."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.task import Future

from oaisys_core.errors import DeadlineExceededError
from oaisys_ros_bridge.nodes.node_start import start_node
from oaisys_ros_bridge.nodes.spinning import end_spin, spin_until
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.parameters.table import ParameterTable

CLOSE_TIMEOUT_S = 2.0
CHECK_PERIOD_S = 0.5
"""How often `BackgroundNode.wait` calls its check while nothing is received."""


class BackgroundNode:
    """A node whose subscriptions are handled in a background thread; a context manager.

    Callbacks of `subscribe` run one at a time under the lock of ``changed``.

    Attributes:
        node: The rclpy node.
        changed: Notified after every message.
    """

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Initialise rclpy and make the node; `start` begins to handle messages.

        Args:
            name: Of the node.
            arguments: Of the program, without its name; ROS's begin with ``--ros-args``.

        Raises:
            InvalidInputError: ROS cannot use these arguments.
            ShortageError: This process may not have what the node needs.
        """
        self.node = start_node(lambda: _node_without_parameters(name), arguments)
        self.changed = threading.Condition()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._closed = threading.Event()
        self._thread = threading.Thread(
            target=spin_until,
            args=(self._executor, self._closed),
            name=f"{name} executor",
            daemon=True,
        )

    def start(self) -> None:
        """Begin to handle messages."""
        self._thread.start()

    def close(self) -> None:
        """Destroy the node and shut rclpy down."""
        end_spin(self._executor, self._closed)
        # Its thread must not begin to wait while handles and context are destroyed.
        if self._thread.is_alive():
            self._thread.join(timeout=CLOSE_TIMEOUT_S)
        self._executor.shutdown(timeout_sec=CLOSE_TIMEOUT_S)
        # A program that a signal ends leaves no time to what would destroy these in the end. The
        # node itself does not destroy its clients of actions.
        for each in list(self.node.waitables):
            if isinstance(each, ActionClient):
                each.destroy()
        self.node.destroy_node()
        rclpy.try_shutdown()
        self.node.context.destroy()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def subscribe(
        self,
        message_type: type[Any],
        topic: str,
        handle: Callable[[Any], None],
        qos: QoSProfile | int,
    ) -> None:
        """Call ``handle`` with each message of a topic."""

        def handle_and_notify(message: Any) -> None:
            with self.changed:
                handle(message)
                self.changed.notify_all()

        self.node.create_subscription(message_type, topic, handle_and_notify, qos)

    def send(self, begin: Callable[[], Future], name: str, timeout_s: float) -> Future:
        """Return the future of what ``begin`` asks an action for, in the thread that is answered.

        rclpy notes that it awaits an answer after it has asked: in another thread, a fast answer
        came before that and was dropped.

        Raises:
            DeadlineExceededError: That thread did not get to it in time.
        """
        future: Future = result_of(self._executor.create_task(begin), name, timeout_s)
        return future

    def wait(
        self,
        what: str,
        condition: Callable[[], bool],
        timeout_s: float,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait until ``condition`` holds, which is evaluated under the lock after every message.

        Args:
            what: Is waited for, in an error's words.
            condition: What to wait for.
            timeout_s: How long.
            check: Called every `CHECK_PERIOD_S` or more often; may raise to stop waiting.

        Raises:
            DeadlineExceededError: It does not hold in time.
        """
        deadline_s = time.monotonic() + timeout_s
        with self.changed:
            while not condition():
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    raise DeadlineExceededError(f"waited {timeout_s:g} s for {what}")
                check()
                self.changed.wait(min(left_s, CHECK_PERIOD_S))


def _node_without_parameters(name: str) -> ParameterNode:
    node = ParameterNode(name)
    node.declare_table(ParameterTable(()))
    return node


def result_of(future: Future, name: str, timeout_s: float) -> Any:
    """Return the result of a call to ``name``; `DeadlineExceededError` without one in time."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    if not done.wait(timeout_s):
        raise DeadlineExceededError(f"{name} did not answer within {timeout_s:g} s")
    return future.result()
