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
"""Views from which on what an denoising took is believed: the first one loads what it needs."""

MOST_TIMES = 2.0
"""How many times what the others let expect an denoising is believed to take, at most."""

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

DenoisingQuality = Literal["fast", "balanced", "thorough"]
"""How a picture is denoised, see `Denoiser.denoised`."""


class DenoisingCost(NamedTuple):
    """When an denoising pays.

    Attributes:
        least_samples: Light samples from which on it is worth more than those it takes the time of.
        least_spare: From how many on it does good where it takes the time of nothing else.
        times: What it takes, in times of the fast one, as long as that is not known.
    """

    least_samples: int
    least_spare: int
    times: float


DENOISING_COSTS: dict[DenoisingQuality, DenoisingCost] = {
    "fast": DenoisingCost(0, 0, 1.0),
    "balanced": DenoisingCost(3, 1, 1.8),
    "thorough": DenoisingCost(8, 8, 5.0),
}
"""From the least on."""

LEAST_AREA = 1 / 16
"""Of an image: it is not rendered any smaller, however little time there is."""

AT_ONCE_S = 1e-3
"""Time for light samples that ends with the first of them."""


@dataclass(frozen=True)
class ViewPlan:
    """How a view is rendered so that it fits.

    Attributes:
        scale: Factor on the image's sides; below 1 where one sample of each pixel takes too long.
        sampling_s: Light samples are begun for that long, the last one ends later; 0: no limit.
        denoising: Of denoising, that time is kept for.
    """

    scale: float
    sampling_s: float
    denoising: DenoisingQuality = "fast"


@dataclass(frozen=True)
class ViewCost:
    """What a view took.

    Attributes:
        pixels: That were rendered.
        samples: Light samples of each.
        preparing_s: Until the first light sample began.
        sampling_s: Until the last one ended.
        beside_s: By how much that was longer because something else was computed beside it.
        finishing_s: What came after that: denoising, mostly.
        denoising: How it was denoised.
    """

    pixels: int
    samples: int
    preparing_s: float
    sampling_s: float
    finishing_s: float
    denoising: DenoisingQuality = "fast"
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
        self._finished = {denoising: _costs() for denoising in DENOISING_COSTS}
        self._has_changed = True

    def world_changed(self) -> None:
        """Expect that the next view takes longer to prepare."""
        self._has_changed = True

    def learn(self, cost: ViewCost) -> None:
        """Remember what a view took."""
        self._preparing_s[self._has_changed].append(cost.preparing_s)
        self._has_changed = False
        self._beside_s.append(cost.beside_s)
        alone_s = cost.sampling_s - cost.beside_s
        self._pixel_sample_s.append(alone_s / (cost.samples * cost.pixels))
        self._finished[cost.denoising].append(cost)

    def plan(self, pixels: int, seconds: float) -> ViewPlan:
        """Return how a view of so many pixels fits into the time: one sample if none was timed.

        All the time there is (``inf``) is no limit.
        """
        if seconds == inf:
            return ViewPlan(1.0, 0.0, "thorough")
        if not self._pixel_sample_s:
            return ViewPlan(1.0, AT_ONCE_S)
        # A world that stays takes next to nothing, also before one was seen to.
        beside_s = median(self._beside_s)
        left_s = seconds - median(self._preparing_s[self._has_changed] or (0.0,)) - beside_s
        sample_s = median(self._pixel_sample_s) * pixels
        finish_s = {denoising: self._finish_s(pixels, denoising) for denoising in DENOISING_COSTS}
        pay: list[DenoisingQuality] = [
            each
            for each, cost in DENOISING_COSTS.items()
            if left_s - finish_s[each] >= cost.least_samples * sample_s
        ]
        denoising: DenoisingQuality = pay[-1] if pay else "fast"
        area = (left_s - EARLY * seconds) / (sample_s + finish_s[denoising])
        if area < 1:
            return ViewPlan(sqrt(max(area, LEAST_AREA)), AT_ONCE_S)
        # A sample that begins in time may end one sample late, and what comes after it may be what
        # takes least or most of what `denoising` will choose from: both ends are to be equally far.
        least_s, most_s = finish_s[denoising], finish_s[denoising]
        if denoising != "thorough":
            least_s, most_s = finish_s["fast"], max(finish_s["fast"], finish_s["balanced"])
        begun_s = left_s - (sample_s + least_s + most_s) / 2
        latest_s = left_s - sample_s - least_s + OVER * seconds
        return ViewPlan(1.0, max(min(begun_s, latest_s) + beside_s, AT_ONCE_S), denoising)

    def denoising_quality(
        self, pixels: int, samples: int, left_s: float, seconds: float
    ) -> DenoisingQuality:
        """Return how a view of so many pixels is denoised, now that its light samples are taken.

        Of all that do good it is the one that takes nearest to the time left of its ``seconds``:
        what light samples, of which one may be a third of them, leave too early or too late.
        """
        if not self._pixel_sample_s:
            return "fast"
        late_s = {
            denoising: SLOW * self._finish_s(pixels, denoising) - left_s
            for denoising in DENOISING_COSTS
        }
        fit: list[DenoisingQuality] = [
            denoising
            for denoising, cost in DENOISING_COSTS.items()
            if samples >= cost.least_spare and late_s[denoising] <= OVER * seconds
        ]
        return min(fit, key=lambda denoising: abs(late_s[denoising]), default="fast")

    def _finish_s(self, pixels: int, denoising: DenoisingQuality) -> float:
        own = self._pixel_finish_s(pixels, denoising)
        of_others = [
            value * DENOISING_COSTS[denoising].times / DENOISING_COSTS[other].times
            for other in DENOISING_COSTS
            if other != denoising
            for value in self._pixel_finish_s(pixels, other)
        ]
        if not of_others:
            return median(own) * pixels
        # Not much more than the others let expect: it would not be tried again.
        most = median(of_others) * (MOST_TIMES if len(own) >= TRUSTED else 1.0)
        return min(median(own or (inf,)), most) * pixels

    def _pixel_finish_s(self, pixels: int, denoising: DenoisingQuality) -> list[float]:
        """Return what an denoising took per pixel of comparable pictures, or else of any."""
        costs = self._finished[denoising]
        comparable = [each for each in costs if each.pixels >= COMPARABLE * pixels]
        return [each.finishing_s / each.pixels for each in comparable or costs]


def denoising_quality_for(samples: int) -> DenoisingQuality:
    """Return how a picture of so many light samples is denoised where time has no limit."""
    return [each for each, cost in DENOISING_COSTS.items() if cost.least_samples <= samples][-1]


def lowest_quality(*efforts: DenoisingQuality) -> DenoisingQuality:
    """Return the least of some."""
    return min(efforts, key=list(DENOISING_COSTS).index)


def _history() -> deque[float]:
    return deque(maxlen=REMEMBERED)


def _costs() -> deque[ViewCost]:
    return deque(maxlen=REMEMBERED)
