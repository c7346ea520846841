"""Runs a node as a program: from its arguments to a clean end on SIGINT or SIGTERM."""

from __future__ import annotations

import faulthandler
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Protocol

import rclpy
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node

from oaisys_core.errors import OaisysError, ShortageError
from oaisys_core.system.ending.signals import end_service_at_signals, exit_at_once
from oaisys_ros_bridge.nodes.node_start import start_node
from oaisys_ros_bridge.nodes.spinning import end_spin, spin_until
from oaisys_ros_bridge.private.executor_threads import wait_for_threads
from oaisys_ros_bridge.services import is_any_request_served

CALLBACKS_END_S = 3.0
"""How long callbacks may take to end before their publishers are destroyed."""


class Closable(Protocol):
    """A node that can be closed."""

    def close(self) -> None:
        """End threads and finish files; called once, while callbacks may still run."""


class WaitingExecutor(MultiThreadedExecutor):
    """An executor that can wait for its callbacks, as `shutdown` of rclpy (7.1) does not."""

    def wait_for_callbacks(self, timeout_s: float) -> bool:
        """Return whether all callbacks under way have ended within ``timeout_s``.

        Callbacks that wait for a thread are dropped: they would find the executor's handles
        destroyed ("cannot use Destroyable").
        """
        return wait_for_threads(self, timeout_s)


LOOK_UP_S = 0.2
"""Between two checks of the main thread whether it shall end."""


def stop_on_signals(stop: threading.Event) -> None:
    """Set ``stop`` at a signal that ends programs, on a thread of its own; for the main thread.

    A handler that sets an event deadlocks if its thread holds the event's lock. A `SimpleQueue` may
    be put to wherever a handler interrupts.
    """
    received: SimpleQueue[int] = SimpleQueue()
    end_service_at_signals(lambda number, _: received.put(number))

    def wait() -> None:
        received.get()
        stop.set()

    threading.Thread(target=wait, name="signals", daemon=True).start()


def run_node(
    make_node: Callable[[], Node],
    arguments: Sequence[str] | None = None,
    *,
    threads: int = 6,
    stop: threading.Event | None = None,
) -> int:
    """Run a node (`rclpy.node.Node` and `Closable`) until a signal or ``stop``; return 0.

    Returns 1 where a callback failed (its traceback is on standard error by then) or the process
    may not have the memory, threads or files that the node needs, and 2 where the node cannot be
    made of its arguments; one line on standard error says what is missing or wrong.

    Signals only set a flag: rclpy's own handlers would take the context down while callbacks
    still publish, and a second Ctrl-C would interrupt the first one's cleaning up. SIGABRT writes
    the stacks of all threads to standard error, as a crash does.

    It exits instead of returning while a request is still being served.
    """
    faulthandler.enable()
    stop = stop or threading.Event()
    stop_on_signals(stop)
    given = sys.argv if arguments is None else arguments
    try:
        node = start_node(make_node, given[1:])
    except (OaisysError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1 if isinstance(error, ShortageError) else 2
    try:
        code = _run_until(stop, node, threads)
    finally:
        rclpy.try_shutdown()
        # At exit Python restores the default handlers, and a second signal would kill it: a
        # terminal and ros2 launch each send one.
        end_service_at_signals(signal.SIG_IGN)
    if is_any_request_served():
        # The end of Python, and of libraries such as Open3D, would take away what it works with.
        exit_at_once(code)
    return code


def _run_until(stop: threading.Event, node: Node, threads: int) -> int:
    executor = WaitingExecutor(num_threads=threads)
    executor.add_node(node)
    closed = threading.Event()
    ended_by_itself = threading.Event()

    def spin() -> None:
        try:
            spin_until(executor, closed)
        finally:
            if not stop.is_set():
                ended_by_itself.set()
            stop.set()

    spinner = threading.Thread(target=spin, name="executor", daemon=True)
    spinner.start()
    # Not one long wait: a signal that comes just before a blocking call does not interrupt it, and
    # its handler would have to wait.
    while not stop.wait(LOOK_UP_S):
        pass
    node.close()
    # The executor must not be waiting when its handles are destroyed.
    end_spin(executor, closed)
    spinner.join(timeout=CALLBACKS_END_S)
    # Nor may a callback that ends now wake it afterwards.
    executor.wait_for_callbacks(CALLBACKS_END_S)
    executor.shutdown()
    return int(ended_by_itself.is_set())
