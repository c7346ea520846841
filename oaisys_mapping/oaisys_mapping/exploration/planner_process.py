"""A planner of another package, in a process of its own: it may hang or crash, and nothing else.

Run as a program, with a socket's descriptor, a planner's name and a seed, this module is that
process.
"""

from __future__ import annotations

import argparse
import contextlib
import pickle
import signal
import socket
import subprocess
import time
from collections.abc import Sequence
from typing import Self

import numpy as np

from oaisys_core.system.ending.descendants import command_with_descendants
from oaisys_core.system.python_programs import python_command, python_environment
from oaisys_core.types import Pose
from oaisys_mapping.exploration.occupancy_map import OccupancyMap
from oaisys_mapping.exploration.planner import Planner, Situation, Vehicle
from oaisys_mapping.exploration.planners import make_planner
from oaisys_mapping.exploration.planning import (
    Plan,
    PlannerError,
    answer_from_json,
    answer_to_json,
    ask_for_plan,
    failure_of,
)

START_S = 120.0
"""For importing and making a planner, which may read a network's weights."""
END_S = 2.0
"""From the end of a process's socket, or the order to end, to its own end."""
MAX_ANSWER_BYTES = 4_000_000
"""Of one answer: a path of 50,000 positions."""


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
        self._received = b""
        self._socket, theirs = socket.socketpair()
        command = python_command(__name__, str(theirs.fileno()), name, str(seed))
        with theirs:
            self._process = subprocess.Popen(
                command_with_descendants(command),
                stdin=subprocess.DEVNULL,
                env=python_environment(),
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, and what the planner has started."""
        self._kill()
        self._socket.close()

    def next_plan(
        self, vehicle: Vehicle, voxels: OccupancyMap, visited: Sequence[Pose]
    ) -> Plan | None:
        """Return the view that the planner asks for; None at the end.

        Raises:
            PlannerError: See `ask_for_plan`; it took too long, its process ended, or what it sent
                is no answer.
        """
        if not self._is_ready:
            self._ask(b"", "start", START_S)
            self._is_ready = True
        question = pickle.dumps((vehicle, voxels, list(visited)), pickle.HIGHEST_PROTOCOL)
        return self._ask(question, "choose a pose", self.timeout_s)

    def _ask(self, question: bytes, what: str, timeout_s: float) -> Plan | None:
        """Send a question and return what is answered, also where the process is stopped.

        Raises:
            PlannerError: There is no answer in time, or it is an error, or none.
        """
        until_s = time.monotonic() + timeout_s
        try:
            self._wait_at_most_until(until_s)
            self._socket.sendall(question)
            text = self._line(until_s)
        except TimeoutError:
            self._kill()
            reason = f"did not {what} within {timeout_s:g} s"
        except (EOFError, OSError):
            reason = self._end()
        else:
            return answer_from_json(self.name, text)
        raise PlannerError(f"the planner {self.name!r} {reason}")

    def _line(self, until_s: float) -> bytes:
        """Return the next line that the process sends.

        Raises:
            TimeoutError: It sends none in time.
            EOFError: It has closed its socket.
            PlannerError: It sends more than any answer has.
        """
        while b"\n" not in self._received:
            if len(self._received) > MAX_ANSWER_BYTES:
                what = f"sent more than {MAX_ANSWER_BYTES} bytes, which are no answer"
                raise PlannerError(f"the planner {self.name!r} {what}")
            self._wait_at_most_until(until_s)
            part = self._socket.recv(1 << 16)
            if not part:
                raise EOFError
            self._received += part
        line, _, self._received = self._received.partition(b"\n")
        return line

    def _wait_at_most_until(self, until_s: float) -> None:
        """Limit what is sent or received next."""
        self._socket.settimeout(max(until_s - time.monotonic(), 1e-3))

    def _end(self) -> str:
        """Return how the process, which has closed its socket, ended."""
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._kill()
            return "closed the connection of its process"
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"ended its process ({how})"

    def _kill(self) -> None:
        """End the process and all that it has started, see `command_with_descendants`."""
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        self._process.kill()
        self._process.wait()


def _serve(connection: socket.socket, name: str, seed: int) -> None:
    """Make the planner, and answer until the other end closes."""
    with connection.makefile("rwb") as stream:

        def answer(what: Plan | PlannerError | None) -> None:
            stream.write(answer_to_json(what) + b"\n")
            stream.flush()

        try:
            planner = make_planner(name)
        except BaseException as error:  # noqa: BLE001 - another package's code
            answer(failure_of(name, error))
            return
        answer(None)
        rng = np.random.default_rng(seed)
        while True:
            try:
                vehicle, voxels, visited = pickle.load(stream)  # noqa: S301 - our own program's
            except EOFError:
                return
            answer(_plan(planner, Situation(vehicle, voxels, visited, rng)))


def _plan(planner: Planner, situation: Situation) -> Plan | PlannerError | None:
    try:
        return ask_for_plan(planner, situation)
    except PlannerError as error:
        return PlannerError(str(error))
    except BaseException as error:  # noqa: BLE001 - such as SystemExit
        return failure_of(planner.name, error)


if __name__ == "__main__":
    _parser = argparse.ArgumentParser(description="Run a planner for the program that starts this.")
    _parser.add_argument("descriptor", type=int, help="of the socket between the two")
    _parser.add_argument("planner", help="its name")
    _parser.add_argument("seed", type=int, help="of its random numbers")
    _given = _parser.parse_args()
    try:
        _connection = socket.socket(fileno=_given.descriptor)
    except OSError as error:
        _parser.error(f"descriptor: {error.strerror}")
    with _connection:
        _serve(_connection, _given.planner, _given.seed)
