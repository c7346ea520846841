"""How many samples per pixel, and which denoising, fit into a view's time budget."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf, sqrt
from statistics import median
from typing import Literal, NamedTuple

REMEMBERED = 8
"""Number of recent views whose cost is kept."""

TRUSTED = 3
"""Number of views after which a denoising quality's own times are trusted: the first is slower."""

MAX_TIMES = 2.0
"""Upper bound on the time of a denoising quality, as a multiple of what others let expect."""

COMPARABLE = 0.25
"""Only views with at least this share of the pixels are compared, because of the fixed costs."""

OVER = 0.12
"""Share of its budget by which a view may be late, rather than early by a whole sample."""

EARLY = 0.05
"""Share of its budget by which a view at reduced resolution aims to be early."""

SLOW = 1.1
"""Safety factor on the expected time of denoising, which comes last."""

DenoisingQuality = Literal["fast", "balanced", "thorough"]
"""See `Denoiser.denoise`."""


class DenoisingCost(NamedTuple):
    """When a denoising quality is worth its time.

    Attributes:
        least_samples: Samples per pixel from which on it is worth more than further samples.
        least_spare: Samples per pixel from which on it improves the image, if time is left.
        times: Its time as a multiple of ``fast``'s, until it was measured.
    """

    least_samples: int
    least_spare: int
    times: float


DENOISING_COSTS: dict[DenoisingQuality, DenoisingCost] = {
    "fast": DenoisingCost(0, 0, 1.0),
    "balanced": DenoisingCost(3, 1, 1.8),
    "thorough": DenoisingCost(8, 8, 3.7),
}
"""In ascending order."""

MIN_AREA = 1 / 16
"""Least share of an image's pixels that is rendered, however little time there is."""

ONE_SAMPLE_S = 1e-3
"""A time limit that ends sampling after one sample per pixel."""


@dataclass(frozen=True)
class ViewPlan:
    """How a view is rendered to fit into its time.

    Attributes:
        scale: Factor on the image's sides; below 1 if one sample per pixel takes too long.
        sampling_s: Time limit for beginning another sample per pixel; 0: none.
        denoising: Quality that time is reserved for.
    """

    scale: float
    sampling_s: float
    denoising: DenoisingQuality = "fast"


@dataclass(frozen=True)
class ViewCost:
    """What a view cost.

    Attributes:
        pixels: Number of pixels rendered.
        samples: Samples per pixel.
        preparing_s: Time before the first sample.
        sampling_s: Time of sampling.
        beside_s: Part of ``sampling_s`` due to work in other threads.
        finishing_s: Time after the last sample, mostly denoising.
        denoising: Quality of the denoising.
    """

    pixels: int
    samples: int
    preparing_s: float
    sampling_s: float
    finishing_s: float
    denoising: DenoisingQuality = "fast"
    beside_s: float = 0.0


class TimeBudget:
    """Plans views by the cost of recent ones.

    A view is prepared (longer if the world has changed), sampled, and denoised. Cycles samples
    until a time limit, so that the cost of a sample need not be known in advance. The time before
    and after is expected to be the median of recent views.
    """

    def __init__(self) -> None:
        self._preparing_s = {changed: _history() for changed in (False, True)}
        self._beside_s = _history()
        self._pixel_sample_s = _history()
        self._finished = {denoising: _costs() for denoising in DENOISING_COSTS}
        self._has_changed = True

    def world_changed(self) -> None:
        """Expect the next view to take longer to prepare."""
        self._has_changed = True

    def learn(self, cost: ViewCost) -> None:
        """Remember the cost of a view."""
        self._preparing_s[self._has_changed].append(cost.preparing_s)
        self._has_changed = False
        self._beside_s.append(cost.beside_s)
        alone_s = cost.sampling_s - cost.beside_s
        self._pixel_sample_s.append(alone_s / (cost.samples * cost.pixels))
        self._finished[cost.denoising].append(cost)

    def plan(self, pixels: int, seconds: float) -> ViewPlan:
        """Return how to render a view of so many pixels within a time, which may be ``inf``.

        Before the first view was timed, it is one sample per pixel.
        """
        if seconds == inf:
            return ViewPlan(1.0, 0.0, "thorough")
        if not self._pixel_sample_s:
            return ViewPlan(1.0, ONE_SAMPLE_S)
        # An unchanged world takes next to nothing, so 0 is a fair guess.
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
            return ViewPlan(sqrt(max(area, MIN_AREA)), ONE_SAMPLE_S)
        # The end varies by one sample and by the denoising that `denoising_quality` will choose:
        # aim at the middle of that range.
        least_s, most_s = finish_s[denoising], finish_s[denoising]
        if denoising != "thorough":
            least_s, most_s = finish_s["fast"], max(finish_s["fast"], finish_s["balanced"])
        begun_s = left_s - (sample_s + least_s + most_s) / 2
        latest_s = left_s - sample_s - least_s + OVER * seconds
        return ViewPlan(1.0, max(min(begun_s, latest_s) + beside_s, ONE_SAMPLE_S), denoising)

    def denoising_quality(
        self, pixels: int, samples: int, left_s: float, seconds: float
    ) -> DenoisingQuality:
        """Return how to denoise a view of so many pixels after it was sampled.

        Of the qualities that improve the image, it is the one whose time is nearest to the time
        left of ``seconds``.
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
        # Bounded, because a quality that once took too long would never be tried again.
        most = median(of_others) * (MAX_TIMES if len(own) >= TRUSTED else 1.0)
        return min(median(own or (inf,)), most) * pixels

    def _pixel_finish_s(self, pixels: int, denoising: DenoisingQuality) -> list[float]:
        """Return the times per pixel of a denoising quality, of comparable or else all images."""
        costs = self._finished[denoising]
        comparable = [each for each in costs if each.pixels >= COMPARABLE * pixels]
        return [each.finishing_s / each.pixels for each in comparable or costs]


def denoising_quality_for(samples: int) -> DenoisingQuality:
    """Return how to denoise an image of so many samples per pixel without a time limit."""
    return [each for each, cost in DENOISING_COSTS.items() if cost.least_samples <= samples][-1]


def lowest_quality(*efforts: DenoisingQuality) -> DenoisingQuality:
    """Return the lowest of some qualities."""
    return min(efforts, key=list(DENOISING_COSTS).index)


def _history() -> deque[float]:
    return deque(maxlen=REMEMBERED)


def _costs() -> deque[ViewCost]:
    return deque(maxlen=REMEMBERED)
