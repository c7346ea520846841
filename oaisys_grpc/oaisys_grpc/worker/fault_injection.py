"""Faults that tests ask for, to show that the server keeps its promises when a worker fails.

``OAISYS_FAULT`` names them, separated by commas: ``crash``, ``crash-once:FILE`` (which makes the
file, and does nothing where it is), ``hang``, ``slow:SECONDS``, ``nap:SECONDS``,
``leak:MEGABYTES``. Each strikes every sample, or with ``@NUMBER`` behind it that one of every
worker. It strikes before anything is rendered; with ``late-`` before it once depth and labels have
been sent; with ``last-`` when the sample is complete, but nobody was told; with ``batch-`` before
it, whenever a batch begins. All only where ``OAISYS_TEST_BUILD=1`` says that this is a test.
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


def strike(progress: ProgressCallback) -> None:
    """Do what the environment asks for, before a sample is rendered."""
    global _samples
    _samples += 1
    for fault in _wanted():
        if not fault.startswith((_LATE, _LAST, _BATCH)):
            _strike(*fault.partition(":")[::2], progress)


def strike_batch(progress: ProgressCallback) -> None:
    """Do what the environment asks for, before a batch is built."""
    for fault in _wanted():
        if fault.startswith(_BATCH):
            _strike(*fault.removeprefix(_BATCH).partition(":")[::2], progress)


def strike_late(progress: ProgressCallback) -> None:
    """Do what the environment asks for, once the first frames of a sample were sent."""
    for fault in _wanted():
        if fault.startswith(_LATE):
            _strike(*fault.removeprefix(_LATE).partition(":")[::2], progress)


def strike_last(progress: ProgressCallback) -> None:
    """Do what the environment asks for, between the end of a sample and the answer."""
    for fault in _wanted():
        if fault.startswith(_LAST):
            _strike(*fault.removeprefix(_LAST).partition(":")[::2], progress)


def _wanted() -> Iterator[str]:
    """Yield the faults of the sample that is being rendered."""
    if os.environ.get("OAISYS_TEST_BUILD") != "1":
        return
    for fault in filter(None, os.environ.get("OAISYS_FAULT", "").split(",")):
        what, _, number = fault.partition("@")
        if not number or int(number) == _samples:
            yield what


def _strike(name: str, amount: str, progress: ProgressCallback) -> None:
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
