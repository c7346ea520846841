"""Estimates how long an operation will still take from the last ones like it."""

from __future__ import annotations

import statistics
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

REMEMBERED = 5
"""Operations of each kind that estimates are made from."""

KINDS = 64
"""Kinds of operations that are remembered; the least recent ones are forgotten."""


@dataclass(frozen=True)
class ProgressCurve:
    """The progress of one operation over time.

    Attributes:
        fractions: From 0 to 1, increasing.
        elapsed_s: Since its beginning, one for each fraction.
    """

    fractions: tuple[float, ...]
    elapsed_s: tuple[float, ...]

    @property
    def total_s(self) -> float:
        """How long it took."""
        return self.elapsed_s[-1]

    def left_s(self, fraction: float) -> float:
        """Return how long it still took from a fraction on."""
        return self.total_s - float(np.interp(fraction, self.fractions, self.elapsed_s))


class RunningJob:
    """The progress of an operation that runs; any thread may ask it."""

    def __init__(self, like: tuple[ProgressCurve, ...]) -> None:
        """Begin now.

        Args:
            like: The curves of similar operations; none: there is no estimate.
        """
        self._like = like
        self._begun_s = time.monotonic()
        self._marks = [(0.0, 0.0)]

    def mark(self, fraction: float) -> None:
        """Note how far it is; a fraction not above the last one is ignored."""
        last_fraction, _ = self._marks[-1]
        if last_fraction < fraction < 1.0:
            self._marks.append((fraction, time.monotonic() - self._begun_s))

    def left_s(self) -> float | None:
        """Return how many seconds are left; None without similar operations."""
        if not self._like:
            return None
        fraction, then_s = self._marks[-1]
        since_s = time.monotonic() - self._begun_s - then_s
        return max(0.0, statistics.median(c.left_s(fraction) for c in self._like) - since_s)

    def curve(self) -> ProgressCurve:
        """Return its curve, once it has ended."""
        fractions, elapsed_s = zip(*self._marks, strict=True)
        return ProgressCurve((*fractions, 1.0), (*elapsed_s, time.monotonic() - self._begun_s))


class Estimates:
    """The curves of the last operations of each kind; safe to use from any thread."""

    def __init__(self) -> None:
        self._curves: OrderedDict[Hashable, deque[ProgressCurve]] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, kind: Hashable) -> RunningJob:
        """Return the progress of an operation that begins now."""
        return RunningJob(self._like(kind))

    def learn(self, kind: Hashable, run: RunningJob) -> None:
        """Remember the curve of an operation that has just succeeded."""
        with self._lock:
            self._curves.setdefault(kind, deque(maxlen=REMEMBERED)).append(run.curve())
            self._curves.move_to_end(kind)
            while len(self._curves) > KINDS:
                self._curves.popitem(last=False)

    def total_s(self, kind: Hashable) -> float | None:
        """Return how long operations of a kind take; None if there was none yet."""
        like = self._like(kind)
        return statistics.median(curve.total_s for curve in like) if like else None

    def _like(self, kind: Hashable) -> tuple[ProgressCurve, ...]:
        with self._lock:
            return tuple(self._curves.get(kind, ()))
