"""What colour costs here, and how much of it fits into a sample's time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf, sqrt
from statistics import median

REMEMBERED = 8
"""Views whose cost is remembered."""

OVER = 0.12
"""Share of its time by which a view may be late, so as not to be early by a whole light sample."""

THOROUGH_SAMPLES = 8
"""Light samples from which on thorough denoising is worth more than the samples it costs."""

THOROUGH_TIMES = 5.0
"""What thorough denoising takes, in times of the fast one, as long as that is not known."""

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
        thorough: Whether there is time for thorough denoising.
    """

    scale: float
    sampling_s: float
    thorough: bool = False


@dataclass(frozen=True)
class Cost:
    """What a view took.

    Attributes:
        pixels: That were rendered.
        samples: Light samples of each.
        preparing_s: Until the first light sample began.
        sampling_s: Until the last one ended.
        finishing_s: What came after that: denoising, mostly.
        thorough: How it was denoised.
    """

    pixels: int
    samples: int
    preparing_s: float
    sampling_s: float
    finishing_s: float
    thorough: bool = False


class TimeBudget:
    """Knows what recent views took.

    A view is prepared (whatever its size; long where the world has changed), sampled, and finished.
    Cycles takes its light samples by the clock, so that how dear this view is need not be known;
    what comes before and after them is the median of recent views, which one slow view of them
    does not move.
    """

    def __init__(self) -> None:
        self._preparing_s = {changed: _history() for changed in (False, True)}
        self._pixel_sample_s = _history()
        self._pixel_finish_s = {thorough: _history() for thorough in (False, True)}
        self._has_changed = True

    def world_changed(self) -> None:
        """Expect that the next view takes longer to prepare."""
        self._has_changed = True

    def learn(self, cost: Cost) -> None:
        """Remember what a view took."""
        self._preparing_s[self._has_changed].append(cost.preparing_s)
        self._has_changed = False
        self._pixel_sample_s.append(cost.sampling_s / (cost.samples * cost.pixels))
        self._pixel_finish_s[cost.thorough].append(cost.finishing_s / cost.pixels)

    def plan(self, pixels: int, seconds: float) -> Plan:
        """Return how a view of so many pixels fits into the time: one sample if none was timed.

        All the time there is (``inf``) is no limit.
        """
        if seconds == inf:
            return Plan(1.0, 0.0, thorough=True)
        if not self._pixel_sample_s:
            return Plan(1.0, AT_ONCE_S)
        # A world never changed before: what it takes then is not known, and nothing can be saved.
        known = self._preparing_s[self._has_changed] or self._preparing_s[not self._has_changed]
        left_s = seconds - median(known)
        sample_s = median(self._pixel_sample_s) * pixels
        samples_s = left_s - self._finish_s(pixels, thorough=True)
        thorough = samples_s >= THOROUGH_SAMPLES * sample_s
        finish_s = self._finish_s(pixels, thorough=thorough)
        area = left_s / (sample_s + finish_s)
        if area < 1 - OVER:
            return Plan(sqrt(max(area, LEAST_AREA)), AT_ONCE_S)
        # A sample that begins in time may end one sample late: on average half of one.
        late_s = min(sample_s / 2, OVER * seconds)
        return Plan(1.0, max(left_s - finish_s - sample_s + late_s, AT_ONCE_S), thorough)

    def _finish_s(self, pixels: int, *, thorough: bool) -> float:
        if known := self._pixel_finish_s[thorough]:
            return median(known) * pixels
        other = median(self._pixel_finish_s[not thorough]) * pixels
        return other * THOROUGH_TIMES if thorough else other / THOROUGH_TIMES


def _history() -> deque[float]:
    return deque(maxlen=REMEMBERED)
