"""How a thread waits in rclpy's `spin_once`, and how another one ends that wait."""

from __future__ import annotations

from rclpy.executors import Executor

SPIN_WAIT_S = 2.0
"""Limit of a wait for something to do. Each wait costs rclpy (7.1) a new wait set of all entities,
milliseconds of a node with many topics."""


def end_spin(executor: Executor) -> None:
    """Let `spin_once` of another thread return now; `Executor.wake` lets it wait again."""
    executor.create_task(lambda: None)
