"""How many light samples fit into a sample's time, judged by what recent views cost."""

from __future__ import annotations

from collections import deque

from oaisys_core.types import PinholeIntrinsics

REMEMBERED = 8
"""Views whose cost is remembered."""


class TimeBudget:
    """Knows what a light sample of a pixel costs.

    What a view costs whatever its samples (preparing, denoising) is counted as if each sample cost
    a share of it: too much for a view of more samples than before, which errs to the safe side.
    """

    def __init__(self) -> None:
        self._costs_s: deque[float] = deque(maxlen=REMEMBERED)

    def learn(self, intrinsics: PinholeIntrinsics, samples: int, seconds: float) -> None:
        """Remember what a view took."""
        self._costs_s.append(seconds / (samples * _pixels(intrinsics)))

    def samples(self, intrinsics: PinholeIntrinsics, seconds: float, most: int) -> int:
        """Return how many light samples a view may have: 1 where none was timed yet."""
        if not self._costs_s or seconds <= 0:
            return 1
        # The dearest of them: a budget is kept, not met on average.
        affordable = seconds / (max(self._costs_s) * _pixels(intrinsics))
        return max(1, min(most, int(affordable)))


def _pixels(intrinsics: PinholeIntrinsics) -> int:
    return intrinsics.width_px * intrinsics.height_px
