"""Faults that tests inject into a worker to see how its server recovers.

``OAISYS_FAULT`` lists them, separated by commas: ``crash``, ``crash-once:FILE`` (creates the file,
and does nothing if it exists), ``hang``, ``slow:SECONDS``, ``nap:SECONDS``, ``leak:MEGABYTES``.
A fault occurs at every sample before it is rendered, or with the suffix ``@NUMBER`` at that sample
of every worker only. A prefix moves it: ``late-`` after depth and labels were sent, ``last-`` after
the sample is complete but before the answer, ``batch-`` to the beginning of every batch. Nothing
happens unless ``OAISYS_TEST_BUILD=1``.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from oaisys_core.backend.base import ProgressCallback
from oaisys_core.types import Progress

_STEP_S = 0.02
_LATE, _LAST, _BATCH = "late-", "last-", "batch-"
_samples = 0
_leaked: list[bytes] = []


def inject_in_sample(progress: ProgressCallback) -> None:
    """Inject the faults of a sample that is about to be rendered."""
    global _samples
    _samples += 1
    for fault in _wanted():
        if not fault.startswith((_LATE, _LAST, _BATCH)):
            _inject(fault, progress)


def inject_in_batch(progress: ProgressCallback) -> None:
    """Inject the faults of a batch that is about to be built."""
    _inject_with_prefix(_BATCH, progress)


def inject_after_frames(progress: ProgressCallback) -> None:
    """Inject the faults of a sample whose first frames were sent."""
    _inject_with_prefix(_LATE, progress)


def inject_at_end(progress: ProgressCallback) -> None:
    """Inject the faults of a sample that is complete but not answered."""
    _inject_with_prefix(_LAST, progress)


def _inject_with_prefix(prefix: str, progress: ProgressCallback) -> None:
    for fault in _wanted():
        if fault.startswith(prefix):
            _inject(fault.removeprefix(prefix), progress)


def _wanted() -> Iterator[str]:
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
