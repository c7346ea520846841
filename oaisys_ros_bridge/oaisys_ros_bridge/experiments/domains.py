"""A ROS domain for a system of its own: no other of this machine's is in it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

from oaisys_core.errors import OaisysError

VARIABLE = "ROS_DOMAIN_ID"
LARGEST = 101
"""Above it, DDS's ports run into those that Linux gives to clients."""


@contextlib.contextmanager
def own_domain() -> Iterator[None]:
    """Be in a domain that is claimed for as long as the block lasts, unless one is set already.

    A file lock claims it, so it goes with a process that is killed.

    Raises:
        OaisysError: All are taken.
    """
    if VARIABLE in os.environ:
        yield
        return
    folder = Path(tempfile.gettempdir(), f"oaisys-ros-domains-{os.getuid()}")
    folder.mkdir(exist_ok=True)
    for number in random.SystemRandom().sample(range(1, LARGEST + 1), LARGEST):
        with (folder / str(number)).open("w") as claim:
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            os.environ[VARIABLE] = str(number)
            try:
                yield
            finally:
                del os.environ[VARIABLE]
            return
    raise OaisysError(f"all ROS domains from 1 to {LARGEST} are in use: set {VARIABLE}")
