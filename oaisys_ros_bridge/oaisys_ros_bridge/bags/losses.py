"""Counts of the messages that a recorder has lost, as its bag stores them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Self

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.subscribing.ledger_state import (
    LedgerState,
    counts_in_words,
    middleware_shortfall,
    samples_shortfall,
)

METADATA_NAME = "oaisys_samples"
"""Name of the MCAP metadata record; rosbag2's ``custom_data`` has the same entries."""

_ANNOUNCED, _INCOMPLETE = "oaisys.samples", "oaisys.samples_incomplete"
_LOST, _LOST_BY_MIDDLEWARE = "oaisys.lost ", "oaisys.lost_by_middleware "
_UNWRITTEN = "oaisys.unwritten "
_COUNT = re.compile(r"[0-9]{1,20}")


@dataclass(frozen=True)
class BagLosses:
    """What a recorder has counted.

    Attributes:
        announced: Samples on ``sample_info``.
        incomplete: Those of them of which a message is missing.
        lost: Number of samples whose message is missing, by topic.
        lost_by_middleware: Messages that the middleware reports as lost, by topic.
        unwritten: Messages that were received, but too late for its longest end, or that could not
            be written, by topic.
    """

    announced: int = 0
    incomplete: int = 0
    lost: Mapping[str, int] = field(default_factory=dict)
    lost_by_middleware: Mapping[str, int] = field(default_factory=dict)
    unwritten: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        states: Iterable[LedgerState],
        lost_by_middleware: Mapping[str, int],
        unwritten: Mapping[str, int],
    ) -> Self:
        """Return the sum over the bridges whose samples were recorded."""
        states = list(states)
        lost: Counter[str] = Counter()
        for state in states:
            lost.update(state.lost)
        return cls(
            sum(state.announced for state in states),
            sum(state.incomplete for state in states),
            dict(lost),
            {topic: count for topic, count in lost_by_middleware.items() if count},
            {topic: count for topic, count in unwritten.items() if count},
        )

    @classmethod
    def read(cls, entries: Mapping[str, str]) -> Self:
        """Return the losses from their `entries` in a bag.

        Raises:
            InvalidInputError: One of the counts is none.
        """

        def counts(prefix: str) -> dict[str, int]:
            return {k.removeprefix(prefix): number(k) for k in entries if prefix in k}

        def number(name: str) -> int:
            text = entries.get(name, "0")
            if not _COUNT.fullmatch(text):
                raise InvalidInputError(name, text, "a count")
            return int(text)

        return cls(
            number(_ANNOUNCED),
            number(_INCOMPLETE),
            counts(_LOST),
            counts(_LOST_BY_MIDDLEWARE),
            counts(_UNWRITTEN),
        )

    @property
    def entries(self) -> dict[str, str]:
        """The counts as a bag stores them: strings by name."""
        return {
            _ANNOUNCED: str(self.announced),
            _INCOMPLETE: str(self.incomplete),
            **{f"{_LOST}{topic}": str(n) for topic, n in sorted(self.lost.items())},
            **{
                f"{_LOST_BY_MIDDLEWARE}{topic}": str(n)
                for topic, n in sorted(self.lost_by_middleware.items())
            },
            **{f"{_UNWRITTEN}{topic}": str(n) for topic, n in sorted(self.unwritten.items())},
        }

    @property
    def any(self) -> bool:
        """Whether anything was lost."""
        return bool(self.incomplete or self.lost_by_middleware or self.unwritten)

    @property
    def sentences(self) -> list[str]:
        """The losses in words, one sentence to three."""
        state = LedgerState(
            self.announced,
            self.announced,
            self.incomplete,
            self.lost,
            lost_by_middleware=self.lost_by_middleware,
        )
        complete = f"{self.announced} samples, none of them incomplete"
        found = [samples_shortfall(state) or complete, middleware_shortfall(state)]
        if self.unwritten:
            found.append(
                f"the end came before messages of {counts_in_words(self.unwritten)} were written"
            )
        return list(filter(None, found))


class MissingNumbers:
    """Counts messages that did not come, by the gaps in the numbers that publishers give them.

    The middleware does not say what a full queue of the subscriber drops.
    """

    def __init__(self) -> None:
        self._newest: dict[str, int] = {}

    def before(self, topic: str, number: int) -> int:
        """Take the number of the next message; return how many are missing before it.

        Numbers that begin again are those of another publisher.
        """
        newest, self._newest[topic] = self._newest.get(topic), number
        return 0 if newest is None else max(number - newest - 1, 0)
