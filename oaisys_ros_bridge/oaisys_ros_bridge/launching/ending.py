"""The end of a launch, when a program that all else needs has ended."""

from __future__ import annotations

from collections.abc import Callable

from launch.action import Action
from launch.actions import Shutdown
from launch.events.process import ProcessExited

from launch import LaunchContext


class ProgramFailedError(Exception):
    """Makes the launch system end with 1, as nothing but an exception does."""


def end_all(reason: str) -> Callable[[ProcessExited, LaunchContext], list[Action]]:
    """Return what ends the launch when a process has exited, unless it is ending already.

    The launch's exit code is 1 where the process's was not 0. The launch system takes a second
    `Shutdown` for an error, too, and then exits with 1.
    """

    def end(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if context.is_shutdown:
            return []
        if event.returncode != 0:
            raise ProgramFailedError(f"{reason}: exit code {event.returncode}")
        return [Shutdown(reason=reason)]

    return end
