"""Shows the current topic and the time left."""

from __future__ import annotations

import time
from collections.abc import Mapping

from rich.console import Console
from rich.status import Status

QUIET_S = 5.0
"""Between two lines with the same text, without a terminal."""

RELIABLE_SHARE = 0.15
"""From this share of a topic on, the time left is extrapolated from its pace."""


class TopicProgress:
    """Shows progress as a status line on a terminal, as plain lines elsewhere.

    Args:
        console: Output.
        expected_s: Expected seconds of each topic, in order.
    """

    def __init__(self, console: Console, expected_s: Mapping[str, float]) -> None:
        self._console = console
        self._expected_s = dict(expected_s)
        self._topic = ""
        self._started_s = 0.0
        self._said, self._said_s = "", 0.0
        self._status: Status | None = console.status("") if console.is_terminal else None

    def begin(self, topic: str) -> None:
        """Begin a topic."""
        self._topic = topic
        self._started_s = time.monotonic()
        if self._status is not None:
            self._status.start()

    def end(self) -> float:
        """End the topic and return the seconds that it took."""
        del self._expected_s[self._topic]
        if self._status is not None:
            self._status.stop()
        return time.monotonic() - self._started_s

    def say(self, share: float, text: str) -> None:
        """Show the share of the topic that is done, 0 to 1, and what comes next."""
        minutes = self.left_s(share) / 60
        line = f"{self._topic}, {100 * share:.0f} %, {minutes:.0f} min left: {text}"
        if self._status is not None:
            self._status.update(line)
        elif text != self._said or time.monotonic() - self._said_s > QUIET_S:
            self._said, self._said_s = text, time.monotonic()
            self._console.print(line, highlight=False)

    def left_s(self, share: float) -> float:
        """Return the expected seconds until all topics are done."""
        expected_s = self._expected_s[self._topic]
        if share > RELIABLE_SHARE:
            expected_s = (time.monotonic() - self._started_s) / share
        others_s = sum(self._expected_s.values()) - self._expected_s[self._topic]
        return expected_s * (1 - share) + others_s
