"""What a bag lacks of the samples that were announced while it was recorded, as it says itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Self

from oaisys_ros_bridge.subscribing.sample_ledger import LedgerState, shortfall

METADATA_NAME = "oaisys_samples"
"""Of the MCAP record; rosbag2's ``custom_data`` has the same entries."""

_ANNOUNCED, _INCOMPLETE = "oaisys.samples", "oaisys.samples_incomplete"
_LOST, _LOST_BY_MIDDLEWARE = "oaisys.lost ", "oaisys.lost_by_middleware "


@dataclass(frozen=True)
class BagLosses:
    """What a recorder counted.

    Attributes:
        announced: Samples on ``sample_info``.
        incomplete: Those of them that something is missing of.
        lost: In how many of them, by topic.
        lost_by_middleware: Messages that the middleware says were lost, by topic.
    """

    announced: int = 0
    incomplete: int = 0
    lost: Mapping[str, int] = field(default_factory=dict)
    lost_by_middleware: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, states: Iterable[LedgerState], lost_by_middleware: Mapping[str, int]) -> Self:
        """Return the sum over all bridges that were listened to."""
        states = list(states)
        lost: Counter[str] = Counter()
        for state in states:
            lost.update(state.lost)
        return cls(
            sum(state.announced for state in states),
            sum(state.incomplete for state in states),
            dict(lost),
            {topic: count for topic, count in lost_by_middleware.items() if count},
        )

    @classmethod
    def read(cls, entries: Mapping[str, str]) -> Self:
        """Return what `entries` has made strings of."""

        def counts(prefix: str) -> dict[str, int]:
            return {k.removeprefix(prefix): int(v) for k, v in entries.items() if prefix in k}

        return cls(
            int(entries.get(_ANNOUNCED, 0)),
            int(entries.get(_INCOMPLETE, 0)),
            counts(_LOST),
            counts(_LOST_BY_MIDDLEWARE),
        )

    @property
    def entries(self) -> dict[str, str]:
        """All of it as strings by name."""
        return {
            _ANNOUNCED: str(self.announced),
            _INCOMPLETE: str(self.incomplete),
            **{f"{_LOST}{topic}": str(n) for topic, n in sorted(self.lost.items())},
            **{
                f"{_LOST_BY_MIDDLEWARE}{topic}": str(n)
                for topic, n in sorted(self.lost_by_middleware.items())
            },
        }

    @property
    def any(self) -> bool:
        """Whether anything was lost."""
        return bool(self.incomplete or self.lost_by_middleware)

    @property
    def sentences(self) -> list[str]:
        """What to tell of it."""
        state = LedgerState(self.announced, self.announced, self.incomplete, self.lost)
        told = [shortfall(state) or f"{self.announced} samples, none of them incomplete"]
        if self.lost_by_middleware:
            lost = ", ".join(f"{topic} {n}" for topic, n in sorted(self.lost_by_middleware.items()))
            told.append(f"the middleware lost messages of {lost}")
        return told
