"""How long an operation will still take, judged by the last ones like it."""

from __future__ import annotations

import statistics
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

REMEMBERED = 5
"""Operations of a kind that estimates are made from."""

KINDS = 64
"""Of operations that are remembered; those that came least lately are forgotten."""


@dataclass(frozen=True)
class Course:
    """When an operation was how far.

    Attributes:
        fractions: From 0 to 1, increasing.
        elapsed_s: Since its begin, one for each.
    """

    fractions: tuple[float, ...]
    elapsed_s: tuple[float, ...]

    @property
    def total_s(self) -> float:
        """How long it took."""
        return self.elapsed_s[-1]

    def left_s(self, fraction: float) -> float:
        """Return how long it still took from there."""
        return self.total_s - float(np.interp(fraction, self.fractions, self.elapsed_s))


class Run:
    """One operation under way; any thread may ask it."""

    def __init__(self, like: tuple[Course, ...]) -> None:
        """Begin now.

        Args:
            like: What operations like it took; none: there is no estimate.
        """
        self._like = like
        self._begun_s = time.monotonic()
        self._marks = [(0.0, 0.0)]

    def mark(self, fraction: float) -> None:
        """Note how far it is; a fraction that is no more than the last one says nothing."""
        last_fraction, _ = self._marks[-1]
        if last_fraction < fraction < 1.0:
            self._marks.append((fraction, time.monotonic() - self._begun_s))

    def left_s(self) -> float | None:
        """Return how many seconds are left; None if there is nothing to judge by."""
        if not self._like:
            return None
        fraction, then_s = self._marks[-1]
        since_s = time.monotonic() - self._begun_s - then_s
        return max(0.0, statistics.median(c.left_s(fraction) for c in self._like) - since_s)

    def course(self) -> Course:
        """Return what it took, at its end."""
        fractions, elapsed_s = zip(*self._marks, strict=True)
        return Course((*fractions, 1.0), (*elapsed_s, time.monotonic() - self._begun_s))


class Estimates:
    """The courses of the last operations of each kind; safe to use from any thread."""

    def __init__(self) -> None:
        self._courses: OrderedDict[Hashable, deque[Course]] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, kind: Hashable) -> Run:
        """Return the run of an operation that begins now."""
        return Run(self._like(kind))

    def learn(self, kind: Hashable, run: Run) -> None:
        """Remember how an operation went that has just succeeded."""
        with self._lock:
            self._courses.setdefault(kind, deque(maxlen=REMEMBERED)).append(run.course())
            self._courses.move_to_end(kind)
            while len(self._courses) > KINDS:
                self._courses.popitem(last=False)

    def total_s(self, kind: Hashable) -> float | None:
        """Return how long operations of a kind take; None if there was none yet."""
        like = self._like(kind)
        return statistics.median(course.total_s for course in like) if like else None

    def _like(self, kind: Hashable) -> tuple[Course, ...]:
        with self._lock:
            return tuple(self._courses.get(kind, ()))
