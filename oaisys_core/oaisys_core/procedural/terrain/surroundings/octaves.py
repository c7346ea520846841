"""The octaves of the land's relief, each with the forms of what shaped the land.

Water cuts gullies down the slopes of all longer forms, impacts leave craters, and wind swells.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import gradient_noise
from oaisys_core.procedural.terrain.surroundings.form_noise import (
    CRATER_DEVIATION,
    LATTICE,
    craters,
    ridges,
)
from oaisys_core.procedural.terrain.surroundings.spectrum import Octave
from oaisys_core.types import FloatArray

Shaper = Literal["water", "impacts", "wind"]
"""What shaped a land."""

NOISE_DEVIATION = 0.305
"""Standard deviation of gradient noise."""

CELLS = 0.75
"""Edge of a cell of the noise in wavelengths of its strongest waves."""

TURN_RAD = 0.6
"""Rotation of an octave's lattice against that of the octave before."""

MIN_POINTS, ENOUGH_POINTS = 2.0, 4.0
"""Points per wavelength up to which an octave is left out, and from which it is complete."""

UNCUT = 3
"""Number of the longest octaves, of noise, down whose slopes gullies run."""

FORMED = 0.85
"""Share of the standard deviation of an octave that has forms; noise has the rest."""

STEEPEST = 1.3
"""Largest factor on the height of ridges where slopes are steeper than usual."""

MAX_STEEPNESS = 0.03
"""Largest standard deviation of an octave over its wavelength: the cliffs of a stage are no spikes
on its land."""

SHARPER = 1.6
"""Factor on the points per wavelength of octaves with forms, which have sharp crests."""

STEP = 0.05
"""Distance in cells over which slopes of noise are found."""


Places = slice | NDArray[np.intp]
"""Some of N points; a slice where they follow each other, which spares copies."""


class OctaveHeights(NamedTuple):
    """Heights of an octave at P of N points.

    Attributes:
        octave: The octave.
        here: The points that can have it.
        height_m: (P,) its heights, of a `share` of 1.
    """

    octave: Octave
    here: Places
    height_m: FloatArray


def octave_heights(
    xy_m: FloatArray,
    spacing_m: FloatArray,
    octaves: list[Octave],
    rngs: list[np.random.Generator],
    shaped_by: Shaper,
) -> Iterator[OctaveHeights]:
    """Yield the heights of each octave, from the longest on.

    Args:
        xy_m: (N, 2) points.
        spacing_m: (N,) distances between points there, by which short octaves are left out.
        octaves: The spectrum, the shortest first.
        rngs: Draw each octave.
        shaped_by: What made its forms.
    """
    x_m, y_m = (np.ascontiguousarray(axis) for axis in xy_m.T)
    slope = np.zeros((2, len(xy_m)))
    usual = 0.0
    for index in reversed(range(len(octaves))):
        octave = octaves[index]
        deviation_m = min(octave.deviation_m, MAX_STEEPNESS * octave.wavelength_m)
        octave = octave._replace(deviation_m=deviation_m)
        has_forms = shaped_by != "wind" and index < len(octaves) - UNCUT
        share = resolvable_share(octave, spacing_m * (SHARPER if has_forms else 1.0))
        here = _places(share > 0)
        if here is None or not octave.deviation_m:
            continue
        place = _Place(x_m[here], y_m[here], octave, index)
        if has_forms and shaped_by == "water":
            height_m = place.with_gullies(slope, here, usual, rngs[index])
        elif has_forms:
            height_m = place.with_craters(rngs[index])
        else:
            height_m = place.swells(slope, here, rngs[index])
        usual = np.sqrt(usual**2 + (2 * np.pi * octave.deviation_m / octave.wavelength_m) ** 2)
        yield OctaveHeights(octave, here, share[here] * height_m)


def resolvable_share(octave: Octave, spacing_m: FloatArray) -> FloatArray:
    """Return (N,) shares of an octave that points at some distances from each other can have."""
    points = octave.wavelength_m / spacing_m
    share = np.clip((points - MIN_POINTS) / (ENOUGH_POINTS - MIN_POINTS), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _places(chosen: NDArray[np.bool_]) -> Places | None:
    """Return the chosen ones of (N,) points; None for none."""
    here = np.flatnonzero(chosen)
    if not len(here):
        return None
    first, last = int(here[0]), int(here[-1])
    return slice(first, last + 1) if last + 1 - first == len(here) else here


class _Place:
    """Points on the lattice of an octave, turned against those of the others."""

    def __init__(self, x_m: FloatArray, y_m: FloatArray, octave: Octave, index: int) -> None:
        self._cosine, self._sine = np.cos(TURN_RAD * index), np.sin(TURN_RAD * index)
        self._cell_m = CELLS * octave.wavelength_m
        x, y = self._turned(x_m, y_m)
        self._x, self._y = x / self._cell_m, y / self._cell_m
        self._deviation_m = octave.deviation_m

    def swells(self, slope: FloatArray, here: Places, rng: np.random.Generator) -> FloatArray:
        """Return (P,) heights of noise, and add its slopes to those of the P points ``here``."""
        gradients = rng.bit_generator.state
        height_m = self._noise(0.0, 0.0, rng)
        rises = []
        for east, north in ((STEP, 0.0), (0.0, STEP)):
            rng.bit_generator.state = gradients
            rises.append((self._noise(east, north, rng) - height_m) / (STEP * self._cell_m))
        self._add_slope(slope, here, *rises)
        return height_m

    def with_gullies(
        self, slope: FloatArray, here: Places, usual: float, rng: np.random.Generator
    ) -> FloatArray:
        """Return (P,) heights of ridges down the slopes, and add theirs to them.

        Args:
            slope: (2, N) slopes of the longer octaves along x and y.
            here: Which of the N points these are.
            usual: Standard deviation of these slopes.
            rng: Draws the ridges.
        """
        down_x, down_y = slope[0, here], slope[1, here]
        steepness = np.sqrt(down_x * down_x + down_y * down_y)
        downhill = np.stack(self._turned(down_x, down_y)).T
        forms = ridges(np.stack((self._x, self._y)).T, downhill, rng)
        share = steepness * (FORMED / max(usual, 1e-12))
        np.minimum(share, FORMED * STEEPEST, out=share)
        share *= self._deviation_m
        rise = share / self._cell_m
        self._add_slope(slope, here, rise * forms.slope[:, 0], rise * forms.slope[:, 1])
        height_m = share * forms.height
        height_m += np.sqrt(1 - FORMED**2) * self._noise(0.0, 0.0, rng)
        return height_m

    def with_craters(self, rng: np.random.Generator) -> FloatArray:
        """Return (P,) heights of craters on noise; no crater is deeper than a fresh one."""
        noise_m = np.sqrt(1 - FORMED**2) * self._noise(0.0, 0.0, rng)
        deviation_m = min(FORMED * self._deviation_m, CRATER_DEVIATION * self._cell_m)
        heights = craters(np.stack((self._x, self._y)).T, rng)
        return np.asarray(deviation_m * heights + noise_m)

    def _turned(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return vectors of the land in the axes of the lattice."""
        return x * self._cosine + y * self._sine, y * self._cosine - x * self._sine

    def _add_slope(self, slope: FloatArray, here: Places, x: FloatArray, y: FloatArray) -> None:
        """Add slopes along the axes of the lattice to those of the land."""
        slope[0, here] += x * self._cosine - y * self._sine
        slope[1, here] += x * self._sine + y * self._cosine

    def _noise(self, east: float, north: float, rng: np.random.Generator) -> FloatArray:
        noise = gradient_noise(self._x + east, self._y + north, rng, LATTICE)
        return noise.astype(np.float64) * (self._deviation_m / NOISE_DEVIATION)
