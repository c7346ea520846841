"""What a ledger of samples has counted, and in words what is missing. No ROS in here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class SampleName:
    """Batch, sample and stamp: the last alone would do, unless simulated time begins again."""

    batch_id: int
    sample_id: int
    stamp_ns: int

    def __str__(self) -> str:
        return f"sample {self.sample_id} of batch {self.batch_id}"


@dataclass(frozen=True)
class LedgerState:
    """Counts since the start.

    Attributes:
        announced: Samples that were announced, or whose announcement was lost.
        settled: Those of them, from the first on without a gap, that are complete or incomplete.
        incomplete: Those of them that lack a message or result.
        lost: How many samples lack a message, by topic or by reason.
        last: The newest of the settled ones.
        lost_by_middleware: Messages that the middleware says were lost, by topic.
    """

    announced: int = 0
    settled: int = 0
    incomplete: int = 0
    lost: Mapping[str, int] = field(default_factory=dict)
    last: SampleName | None = None
    lost_by_middleware: Mapping[str, int] = field(default_factory=dict)

    def since(self, before: LedgerState) -> LedgerState:
        """Return what was counted after ``before``."""
        lost, by_middleware = Counter(self.lost), Counter(self.lost_by_middleware)
        lost.subtract(before.lost)
        by_middleware.subtract(before.lost_by_middleware)
        return LedgerState(
            self.announced - before.announced,
            self.settled - before.settled,
            max(self.incomplete - before.incomplete, 0),
            dict(+lost),
            self.last,
            dict(+by_middleware),
        )


def shortfall(state: LedgerState) -> str:
    """Return in words what is missing; empty: nothing is."""
    found = [samples_shortfall(state), middleware_shortfall(state)]
    return "; ".join(filter(None, found))


def samples_shortfall(state: LedgerState) -> str:
    """Return a sentence about what is missing of samples; empty: nothing is."""
    if not state.incomplete:
        return ""
    lost = counts_in_words(state.lost)
    return f"{state.incomplete} of {state.announced} samples are incomplete; lost: {lost}"


def middleware_shortfall(state: LedgerState) -> str:
    """Return a sentence about what the middleware says was lost; empty: nothing was."""
    lost = counts_in_words(state.lost_by_middleware)
    return f"the middleware lost messages of {lost}" if lost else ""


def counts_in_words(counts: Mapping[str, int]) -> str:
    """Return counts by name in words."""
    return ", ".join(f"{what} {count}" for what, count in sorted(counts.items()))
