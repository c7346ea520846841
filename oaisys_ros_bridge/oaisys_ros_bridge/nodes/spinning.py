"""How a thread runs an executor of rclpy, and how another one ends that."""

from __future__ import annotations

import threading

from rclpy.executors import Executor, ExternalShutdownException

SPIN_WAIT_S = 2.0
"""Limit of a wait for something to do. Each wait costs rclpy (7.1) a new wait set of all entities,
milliseconds of a node with many topics."""


def spin_until(executor: Executor, closed: threading.Event) -> None:
    """Run callbacks until `end_spin` of another thread, or until ROS is shut down."""
    try:
        while not closed.is_set():
            executor.spin_once(timeout_sec=SPIN_WAIT_S)
    except ExternalShutdownException:
        return


def end_spin(executor: Executor, closed: threading.Event) -> None:
    """Let `spin_until` of another thread return now."""
    closed.set()
    # A task ends the wait; after `Executor.wake` it would go on.
    executor.create_task(lambda: None)
