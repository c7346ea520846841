"""The end of a launch, when a program that all else needs has ended."""

from __future__ import annotations

from collections.abc import Callable

from launch.action import Action
from launch.actions import Shutdown
from launch.events.process import ProcessExited

from launch import LaunchContext


def end_all(reason: str) -> Callable[[ProcessExited, LaunchContext], list[Action]]:
    """Return what ends the launch when a process has exited, unless it is ending already.

    The launch system takes a second `Shutdown` for an error, and then exits with 1.
    """

    def end(_: ProcessExited, context: LaunchContext) -> list[Action]:
        return [] if context.is_shutdown else [Shutdown(reason=reason)]

    return end
