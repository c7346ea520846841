"""A planner of another package, in a process of its own: it may hang or crash, and nothing else.

Run as a program, with a pipe's descriptor, a planner's name and a seed, this module is that
process.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, Pipe
from typing import Any, Self

import numpy as np

from oaisys_core.errors import quote
from oaisys_core.system.ending.owner import follow_owner, owner_variables
from oaisys_core.system.python_programs import python_command, python_environment
from oaisys_core.types import Pose
from oaisys_mapping.exploration.occupancy_map import OccupancyMap
from oaisys_mapping.exploration.planner import Planner, Situation, Vehicle
from oaisys_mapping.exploration.planners import make_planner
from oaisys_mapping.exploration.planning import Plan, PlannerError, ask_for_plan, failure_of

START_S = 120.0
"""For importing and making a planner, which may read a network's weights."""
END_S = 2.0
"""From the end of a process's pipe to its own end."""


class PlannerProcess:
    """Asks a planner in another process, which is killed once it takes too long; a context manager.

    Attributes:
        name: Of the planner.
        timeout_s: How long it may take for a pose.
    """

    def __init__(self, name: str, seed: int, timeout_s: float) -> None:
        """Start the process.

        Args:
            name: See `make_planner`.
            seed: Of the planner's random generator.
            timeout_s: How long it may take for a pose.
        """
        self.name, self.timeout_s = name, timeout_s
        self._is_ready = False
        self._connection, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen(
                python_command(__name__, str(theirs.fileno()), name, str(seed)),
                stdin=subprocess.DEVNULL,
                env=python_environment() | owner_variables(signal.SIGKILL),
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, and what the planner has started."""
        self._kill()
        self._process.wait()
        self._connection.close()

    def next_plan(
        self, vehicle: Vehicle, voxels: OccupancyMap, visited: Sequence[Pose]
    ) -> Plan | None:
        """Return the view that the planner asks for; None at the end.

        Raises:
            PlannerError: See `ask_for_plan`; it took too long, or its process ended.
        """
        if not self._is_ready:
            with self._deadline("start", START_S):
                self._answer()
            self._is_ready = True
        with self._deadline("choose a pose", self.timeout_s):
            self._connection.send((vehicle, voxels, list(visited)))
            plan = self._answer()
        if plan is not None and not isinstance(plan, Plan):
            raise PlannerError(f"the planner {self.name!r} answered {quote(plan)}")
        return plan

    def _answer(self) -> Any:
        """Return the next answer; raise `PlannerError` where it is one."""
        answer = self._connection.recv()
        if isinstance(answer, PlannerError):
            raise answer
        return answer

    @contextlib.contextmanager
    def _deadline(self, what: str, timeout_s: float) -> Iterator[None]:
        """Kill the process unless the block ends in time, also if the process is stopped.

        Raises:
            PlannerError: It did not, or the process ended by itself.
        """
        is_late = threading.Event()

        def kill() -> None:
            is_late.set()
            self._kill()

        timer = threading.Timer(timeout_s, kill)
        timer.start()
        try:
            yield
        except (EOFError, OSError):
            reason = f"did not {what} within {timeout_s:g} s"
            if not is_late.is_set():
                reason = f"ended its process ({self._end()})"
            raise PlannerError(f"the planner {self.name!r} {reason}") from None
        finally:
            timer.cancel()

    def _end(self) -> str:
        """Return how the process, which has closed its pipe, ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        self._kill()
        code = self._process.wait()
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)


def _serve(connection: Connection, name: str, seed: int) -> None:
    """Make the planner, and answer until the other end closes."""
    try:
        planner = make_planner(name)
    except BaseException as error:  # noqa: BLE001 - another package's code, which may do anything
        connection.send(failure_of(name, error))
        return
    connection.send(None)
    rng = np.random.default_rng(seed)
    while True:
        try:
            vehicle, voxels, visited = connection.recv()
        except EOFError:
            return
        connection.send(_plan(planner, Situation(vehicle, voxels, visited, rng)))


def _plan(planner: Planner, situation: Situation) -> Plan | PlannerError | None:
    try:
        return ask_for_plan(planner, situation)
    except PlannerError as error:
        return PlannerError(str(error))
    except BaseException as error:  # noqa: BLE001 - such as SystemExit
        return failure_of(planner.name, error)


if __name__ == "__main__":
    _parser = argparse.ArgumentParser(description="Run a planner for the program that starts this.")
    _parser.add_argument("descriptor", type=int, help="of the pipe between the two")
    _parser.add_argument("planner", help="its name")
    _parser.add_argument("seed", type=int, help="of its random numbers")
    _given = _parser.parse_args()
    follow_owner()
    with Connection(_given.descriptor) as _pipe:
        _serve(_pipe, _given.planner, _given.seed)
