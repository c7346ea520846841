"""What colour costs here, and how much of it fits into a sample's time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf, sqrt
from statistics import median
from typing import Literal, NamedTuple

REMEMBERED = 8
"""Views whose cost is remembered."""

TRUSTED = 3
"""Views from which on what an effort took is believed: the first one loads what it needs."""

MOST_TIMES = 2.0
"""How many times what the others let expect an effort is believed to take, at most."""

COMPARABLE = 0.25
"""Share of a picture's pixels that another had at least, whose denoising tells of it: what does not
grow with the picture is most of what a small one takes."""

OVER = 0.12
"""Share of its time by which a view may be late, so as not to be early by a whole light sample."""

EARLY = 0.05
"""Share of its time by which a view of one light sample aims to be early, as fewer pixels allow:
what takes longer than expected is late by more than what takes less is early."""

SLOW = 1.1
"""Times of what denoising is expected to take that are kept for it, once nothing can follow it."""

Effort = Literal["fast", "balanced", "thorough"]
"""How a picture is denoised, see `Denoiser.denoised`."""


class EffortCost(NamedTuple):
    """When an effort pays.

    Attributes:
        least_samples: Light samples from which on it is worth more than those it takes the time of.
        least_spare: From how many on it does good where it takes the time of nothing else.
        times: What it takes, in times of the fast one, as long as that is not known.
    """

    least_samples: int
    least_spare: int
    times: float


EFFORTS: dict[Effort, EffortCost] = {
    "fast": EffortCost(0, 0, 1.0),
    "balanced": EffortCost(3, 1, 1.8),
    "thorough": EffortCost(8, 8, 5.0),
}
"""From the least on."""

LEAST_AREA = 1 / 16
"""Of an image: it is not rendered any smaller, however little time there is."""

AT_ONCE_S = 1e-3
"""Time for light samples that ends with the first of them."""


@dataclass(frozen=True)
class Plan:
    """How a view is rendered so that it fits.

    Attributes:
        scale: Factor on the image's sides; below 1 where one sample of each pixel takes too long.
        sampling_s: Light samples are begun for that long, the last one ends later; 0: no limit.
        effort: Of denoising, that time is kept for.
    """

    scale: float
    sampling_s: float
    effort: Effort = "fast"


@dataclass(frozen=True)
class Cost:
    """What a view took.

    Attributes:
        pixels: That were rendered.
        samples: Light samples of each.
        preparing_s: Until the first light sample began.
        sampling_s: Until the last one ended.
        beside_s: By how much that was longer because something else was computed beside it.
        finishing_s: What came after that: denoising, mostly.
        effort: How it was denoised.
    """

    pixels: int
    samples: int
    preparing_s: float
    sampling_s: float
    finishing_s: float
    effort: Effort = "fast"
    beside_s: float = 0.0


class TimeBudget:
    """Knows what recent views took.

    A view is prepared (whatever its size; long where the world has changed), sampled, and finished.
    Cycles takes its light samples by the clock, so that how dear this view is need not be known;
    what comes before and after them is the median of recent views, which one slow view of them
    does not move.
    """

    def __init__(self) -> None:
        self._preparing_s = {changed: _history() for changed in (False, True)}
        self._beside_s = _history()
        self._pixel_sample_s = _history()
        self._finished = {effort: _costs() for effort in EFFORTS}
        self._has_changed = True

    def world_changed(self) -> None:
        """Expect that the next view takes longer to prepare."""
        self._has_changed = True

    def learn(self, cost: Cost) -> None:
        """Remember what a view took."""
        self._preparing_s[self._has_changed].append(cost.preparing_s)
        self._has_changed = False
        self._beside_s.append(cost.beside_s)
        alone_s = cost.sampling_s - cost.beside_s
        self._pixel_sample_s.append(alone_s / (cost.samples * cost.pixels))
        self._finished[cost.effort].append(cost)

    def plan(self, pixels: int, seconds: float) -> Plan:
        """Return how a view of so many pixels fits into the time: one sample if none was timed.

        All the time there is (``inf``) is no limit.
        """
        if seconds == inf:
            return Plan(1.0, 0.0, "thorough")
        if not self._pixel_sample_s:
            return Plan(1.0, AT_ONCE_S)
        # A world that stays takes next to nothing, also before one was seen to.
        beside_s = median(self._beside_s)
        left_s = seconds - median(self._preparing_s[self._has_changed] or (0.0,)) - beside_s
        sample_s = median(self._pixel_sample_s) * pixels
        finish_s = {effort: self._finish_s(pixels, effort) for effort in EFFORTS}
        pay: list[Effort] = [
            each
            for each, cost in EFFORTS.items()
            if left_s - finish_s[each] >= cost.least_samples * sample_s
        ]
        effort: Effort = pay[-1] if pay else "fast"
        area = (left_s - EARLY * seconds) / (sample_s + finish_s[effort])
        if area < 1:
            return Plan(sqrt(max(area, LEAST_AREA)), AT_ONCE_S)
        # A sample that begins in time may end one sample late, and what comes after it may be what
        # takes least or most of what `effort` will choose from: both ends are to be equally far.
        least_s, most_s = finish_s[effort], finish_s[effort]
        if effort != "thorough":
            least_s, most_s = finish_s["fast"], max(finish_s["fast"], finish_s["balanced"])
        begun_s = left_s - (sample_s + least_s + most_s) / 2
        latest_s = left_s - sample_s - least_s + OVER * seconds
        return Plan(1.0, max(min(begun_s, latest_s) + beside_s, AT_ONCE_S), effort)

    def effort(self, pixels: int, samples: int, left_s: float, seconds: float) -> Effort:
        """Return how a view of so many pixels is denoised, now that its light samples are taken.

        Of all that do good it is the one that takes nearest to the time left of its ``seconds``:
        what light samples, of which one may be a third of them, leave too early or too late.
        """
        if not self._pixel_sample_s:
            return "fast"
        late_s = {effort: SLOW * self._finish_s(pixels, effort) - left_s for effort in EFFORTS}
        fit: list[Effort] = [
            effort
            for effort, cost in EFFORTS.items()
            if samples >= cost.least_spare and late_s[effort] <= OVER * seconds
        ]
        return min(fit, key=lambda effort: abs(late_s[effort]), default="fast")

    def _finish_s(self, pixels: int, effort: Effort) -> float:
        own = self._pixel_finish_s(pixels, effort)
        of_others = [
            value * EFFORTS[effort].times / EFFORTS[other].times
            for other in EFFORTS
            if other != effort
            for value in self._pixel_finish_s(pixels, other)
        ]
        if not of_others:
            return median(own) * pixels
        # Not much more than the others let expect: it would not be tried again.
        most = median(of_others) * (MOST_TIMES if len(own) >= TRUSTED else 1.0)
        return min(median(own or (inf,)), most) * pixels

    def _pixel_finish_s(self, pixels: int, effort: Effort) -> list[float]:
        """Return what an effort took per pixel of comparable pictures, or else of any."""
        costs = self._finished[effort]
        comparable = [each for each in costs if each.pixels >= COMPARABLE * pixels]
        return [each.finishing_s / each.pixels for each in comparable or costs]


def effort_for(samples: int) -> Effort:
    """Return how a picture of so many light samples is denoised where time has no limit."""
    return [each for each, cost in EFFORTS.items() if cost.least_samples <= samples][-1]


def least_effort(*efforts: Effort) -> Effort:
    """Return the least of some."""
    return min(efforts, key=list(EFFORTS).index)


def _history() -> deque[float]:
    return deque(maxlen=REMEMBERED)


def _costs() -> deque[Cost]:
    return deque(maxlen=REMEMBERED)
