"""Images worked on in bands of rows, so that what is computed on the way stays small."""

from __future__ import annotations

from collections.abc import Iterator

from oaisys_core.interruption import stop_if_unwanted

BAND_PIXELS = 40_000
"""Some hundred bytes of each pixel are worked with: more would not stay in a core's cache, and take
4 GB at 4096x3072. Two threads at two bands gain nothing on two logical cores."""


def bands(height_px: int, width_px: int) -> Iterator[slice]:
    """Yield slices that make up all rows; raise between them if nobody waits any more."""
    rows = max(1, BAND_PIXELS // width_px)
    for first in range(0, height_px, rows):
        stop_if_unwanted()
        yield slice(first, min(first + rows, height_px))
