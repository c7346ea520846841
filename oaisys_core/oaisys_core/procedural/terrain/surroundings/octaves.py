"""The octaves of the land's relief, each with the forms of what shaped the land.

Water cuts gullies down the slopes of all longer forms, impacts leave craters, and wind swells.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

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


def octave_heights(
    xy_m: FloatArray,
    spacing_m: FloatArray,
    octaves: list[Octave],
    rngs: list[np.random.Generator],
    shaped_by: Shaper,
) -> Iterator[tuple[Octave, NDArray[np.intp], FloatArray]]:
    """Yield each octave from the longest on, the points that can have it, and its heights there.

    Args:
        xy_m: (N, 2) points.
        spacing_m: (N,) distances between points there, by which short octaves are left out.
        octaves: The spectrum, the shortest first.
        rngs: Draw each octave.
        shaped_by: What made its forms.
    """
    slope = np.zeros((len(xy_m), 2))
    usual = 0.0
    for index in reversed(range(len(octaves))):
        octave = octaves[index]
        deviation_m = min(octave.deviation_m, MAX_STEEPNESS * octave.wavelength_m)
        octave = octave._replace(deviation_m=deviation_m)
        has_forms = shaped_by != "wind" and index < len(octaves) - UNCUT
        share = resolvable_share(octave, spacing_m * (SHARPER if has_forms else 1.0))
        here = np.flatnonzero(share > 0)
        if not len(here) or not octave.deviation_m:
            continue
        place = _Place(xy_m[here], octave, index)
        if has_forms and shaped_by == "water":
            height_m = place.with_gullies(slope, here, usual, rngs[index])
        elif has_forms:
            height_m = place.with_craters(rngs[index])
        else:
            height_m = place.swells(slope, here, rngs[index])
        usual = np.sqrt(usual**2 + (2 * np.pi * octave.deviation_m / octave.wavelength_m) ** 2)
        yield octave, here, octave.share * share[here] * height_m


def resolvable_share(octave: Octave, spacing_m: FloatArray) -> FloatArray:
    """Return (N,) shares of an octave that points at some distances from each other can have."""
    points = octave.wavelength_m / spacing_m
    share = np.clip((points - MIN_POINTS) / (ENOUGH_POINTS - MIN_POINTS), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


class _Place:
    """Points on the lattice of an octave, turned against those of the others."""

    def __init__(self, xy_m: FloatArray, octave: Octave, index: int) -> None:
        turn = TURN_RAD * index
        self._axes = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))
        self._cell_m = CELLS * octave.wavelength_m
        self._xy = xy_m @ self._axes / self._cell_m
        self._deviation_m = octave.deviation_m

    def swells(
        self, slope: FloatArray, here: NDArray[np.intp], rng: np.random.Generator
    ) -> FloatArray:
        """Return (P,) heights of noise, and add its slopes to those of the P points ``here``."""
        gradients = rng.bit_generator.state
        height_m = self._noise(np.zeros(2), rng)
        rises = []
        for axis in np.eye(2):
            rng.bit_generator.state = gradients
            rises.append((self._noise(STEP * axis, rng) - height_m) / (STEP * self._cell_m))
        slope[here] += np.stack(rises, axis=1) @ self._axes.T
        return height_m

    def with_gullies(
        self, slope: FloatArray, here: NDArray[np.intp], usual: float, rng: np.random.Generator
    ) -> FloatArray:
        """Return (P,) heights of ridges down the slopes, and add theirs to them.

        Args:
            slope: (N, 2) slopes of the longer octaves.
            here: Which of the N points these are.
            usual: Standard deviation of these slopes.
            rng: Draws the ridges.
        """
        down = slope[here]
        steepness = np.sqrt((down * down).sum(axis=1))
        forms = ridges(self._xy, down @ self._axes, rng)
        share = FORMED * np.minimum(steepness / max(usual, 1e-12), STEEPEST) * self._deviation_m
        slope[here] += (share / self._cell_m)[:, None] * (forms.slope @ self._axes.T)
        noise_m = np.sqrt(1 - FORMED**2) * self._noise(np.zeros(2), rng)
        return np.asarray(share * forms.height + noise_m)

    def with_craters(self, rng: np.random.Generator) -> FloatArray:
        """Return (P,) heights of craters on noise; no crater is deeper than a fresh one."""
        noise_m = np.sqrt(1 - FORMED**2) * self._noise(np.zeros(2), rng)
        deviation_m = min(FORMED * self._deviation_m, CRATER_DEVIATION * self._cell_m)
        return np.asarray(deviation_m * craters(self._xy, rng) + noise_m)

    def _noise(self, shift: FloatArray, rng: np.random.Generator) -> FloatArray:
        x, y = (self._xy + shift).T
        noise = gradient_noise(x, y, rng, LATTICE).astype(np.float64)
        return noise * (self._deviation_m / NOISE_DEVIATION)
