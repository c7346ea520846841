"""What is known of the simulator that the bridge is connected to."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

from oaisys_core.types import SimulatorInfo

FIRST_REBUILD_S = 15.0
LONGEST_REBUILD_S = 120.0
"""Between two attempts at a first batch that the simulator itself says it cannot build."""


@dataclass(frozen=True)
class LinkState:
    """What is known of the server.

    Attributes:
        info: The server's own description; None while it does not answer.
        reason: Why it is not ready; empty when it is.
        connections: How often the server was found so far.
        is_starting: Whether it answers, but its worker was lost or is being started.
    """

    info: SimulatorInfo | None
    reason: str
    connections: int
    is_starting: bool = False

    @property
    def ready(self) -> bool:
        """Whether a sample could be rendered now."""
        return self.info is not None and not self.reason


class LinkChange(NamedTuple):
    """Two states of a link, one after the other."""

    before: LinkState
    after: LinkState


class RebuildPauses:
    """When a first batch that could not be built is tried again: each pause is twice the last."""

    def __init__(self) -> None:
        self._pause_s, self._next_s = FIRST_REBUILD_S, 0.0

    def is_due(self) -> bool:
        """Return whether it is time to try."""
        return time.monotonic() >= self._next_s

    def try_now(self) -> None:
        """End the pause: the server or its configuration is another one."""
        self._next_s = 0.0

    def wait_longer(self) -> None:
        """Begin a pause after an attempt that failed."""
        self._next_s = time.monotonic() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_REBUILD_S)
