"""Faults that tests inject into a worker to see how its server recovers.

``OAISYS_FAULT`` lists them, separated by commas: ``crash``, ``crash-once:FILE`` (creates the file,
and does nothing if it exists), ``hang``, ``slow:SECONDS``, ``nap:SECONDS``, ``leak:MEGABYTES``,
``fail:SENTENCE`` (raises `RenderError`).
A fault occurs at every sample before it is rendered, or with the suffix ``@NUMBER`` at that sample
of every worker only. A prefix moves it: ``late-`` after depth and labels were sent, ``last-`` after
the sample is complete but before the answer, ``batch-`` to the beginning of every batch. The fault
``crash-asked`` ends the worker at each call whose request holds `CRASH_TEXT`. Nothing happens
unless ``OAISYS_TEST_BUILD=1``.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from oaisys_core.errors import RenderError
from oaisys_core.types import Progress, ProgressCallback

CRASH_TEXT = b"crash, please"

_ASKED = "crash-asked"
_STEP_S = 0.02
_PREFIXES = {"sample": "", "frames": "late-", "end": "last-", "batch": "batch-"}
"""By the moment of a call at which the faults occur."""

Moment = Literal["sample", "frames", "end", "batch"]

_samples = 0
_leaked: list[bytes] = []


def inject(moment: Moment, progress: ProgressCallback) -> None:
    """Inject the faults of a moment: each ``sample`` is counted as it begins."""
    global _samples
    _samples += moment == "sample"
    for fault in _faults_of_sample():
        if fault == _ASKED:
            continue
        prefix = next((p for p in _PREFIXES.values() if p and fault.startswith(p)), "")
        if prefix == _PREFIXES[moment]:
            _inject(fault.removeprefix(prefix), progress)


def inject_asked(request: bytes) -> None:
    """End the worker if a request asks for it and ``OAISYS_FAULT`` lets it."""
    if CRASH_TEXT in request and _ASKED in _faults_of_sample():
        os.abort()


def _faults_of_sample() -> Iterator[str]:
    """Yield the faults of the sample that is being rendered."""
    if os.environ.get("OAISYS_TEST_BUILD") != "1":
        return
    for fault in filter(None, os.environ.get("OAISYS_FAULT", "").split(",")):
        what, _, number = fault.partition("@")
        if not number or int(number) == _samples:
            yield what


def _inject(fault: str, progress: ProgressCallback) -> None:
    name, _, amount = fault.partition(":")
    if name == "crash":
        os.abort()
    elif name == "crash-once":
        with contextlib.suppress(FileExistsError):
            Path(amount).touch(exist_ok=False)
            os.abort()
    elif name == "hang":
        threading.Event().wait()
    elif name == "leak":
        _leaked.append(b"\1" * int(1e6 * float(amount)))
    elif name == "fail":
        raise RenderError(amount)
    elif name == "nap":
        progress(Progress("fault", 0.0))
        time.sleep(float(amount))
    elif name == "slow":
        end_s = time.monotonic() + float(amount)
        while time.monotonic() < end_s:
            progress(Progress("fault", 0.0))
            time.sleep(_STEP_S)
    else:
        raise ValueError(f"OAISYS_FAULT: there is no fault {name!r}")
