"""The machine's speed at this moment: seconds of a frozen scene in a process of its own."""

from __future__ import annotations

import contextlib
import itertools
import os
import selectors
import subprocess
import time
from pathlib import Path
from typing import Self

from oaisys_core.errors import OaisysError
from oaisys_core.system.python_programs import python_command
from tools.programs import ROOT, tool_environment

SAMPLES = 2
"""Samples per pixel that times are divided by; some 0.4 s on two cores."""
TIMEOUT_S = 300.0
PATIENCE_S = 20.0


class CalibrationError(OaisysError):
    """The calibration's process ended or did not answer."""


class SpeedCalibration:
    """A process that renders the frozen scene on request and is idle otherwise.

    It inherits the affinity of the calling thread and uses a render thread for each of its cores.

    Args:
        log: File for what Blender prints.
    """

    def __init__(self, log: Path) -> None:
        log.parent.mkdir(parents=True, exist_ok=True)
        self._log = log
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                python_command("tools.bench.calibration_scene"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                cwd=ROOT,
                env=tool_environment(),
            )

    def __enter__(self) -> Self:
        """Render once, because the first render loads kernels and builds the scene."""
        try:
            self.seconds()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._end()

    def seconds(self, samples: int = SAMPLES) -> float:
        """Return the seconds of one render.

        Raises:
            CalibrationError: The process ended, or did not answer in `TIMEOUT_S`.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{samples}\n".encode())
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise CalibrationError(f"the calibration's process ended, see {self._log}") from error
        return float(self._line())

    def _line(self) -> str:
        assert self._process.stdout is not None
        end_s, line = time.monotonic() + TIMEOUT_S, b""
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while not line.endswith(b"\n"):
                if not selector.select(max(end_s - time.monotonic(), 0.0)):
                    raise CalibrationError(f"no answer after {TIMEOUT_S:g} s, see {self._log}")
                chunk = os.read(self._process.stdout.fileno(), 4096)
                if not chunk:
                    raise CalibrationError(f"the calibration's process ended, see {self._log}")
                line += chunk
        return line.decode()

    def _end(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def calibrate(seconds: list[float], calibration_s: list[float]) -> list[float]:
    """Return each time as a ratio to the calibrations just before and after it.

    Args:
        seconds: Times of n samples.
        calibration_s: Times of n + 1 calibrations, around and between the samples.
    """
    pairs = itertools.pairwise(calibration_s)
    return [
        2 * value / (before + after) for value, (before, after) in zip(seconds, pairs, strict=True)
    ]
