"""Faults that tests ask for, to show that the server keeps its promises when a worker fails.

``OAISYS_FAULT`` is ``slow`` or ``slow:SECONDS``, ``hang``, ``crash`` or ``leak`` or
``leak:MEGABYTES``; it strikes each sample, and only where ``OAISYS_TEST_BUILD=1`` says that this is
a test.
"""

from __future__ import annotations

import os
import threading
import time

from oaisys_core.backend.base import ProgressCallback
from oaisys_core.types import Progress

_SLOW_S = 1.0
_STEP_S = 0.02
_LEAK_MB = 50.0
_leaked: list[bytes] = []


def strike(progress: ProgressCallback) -> None:
    """Do what the environment asks for, before a sample is rendered."""
    if os.environ.get("OAISYS_TEST_BUILD") != "1":
        return
    fault, _, amount = os.environ.get("OAISYS_FAULT", "").partition(":")
    if fault == "crash":
        os.abort()
    if fault == "hang":
        threading.Event().wait()
    if fault == "leak":
        _leaked.append(b"\1" * int(1e6 * float(amount or _LEAK_MB)))
    if fault == "slow":
        end_s = time.monotonic() + float(amount or _SLOW_S)
        while time.monotonic() < end_s:
            progress(Progress("fault", 0.0))
            time.sleep(_STEP_S)
