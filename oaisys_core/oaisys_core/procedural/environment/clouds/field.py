"""Where clouds are dense: a slab of air in which lobes of noise rise from a flat base.

A cloud is where a map of the land below, minus a threshold, exceeds what rises with the height; 3-D
lobes move that border in and out, so that bases are flat and tops like cauliflower. The form is
that of Schneider (SIGGRAPH 2015): coverage, a profile of heights, erosion by finer lobes. Bases are
flat because air condenses at one height; water, and so extinction, grows above it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np

from oaisys_core import randomness
from oaisys_core.procedural.environment.clouds.billows import (
    LEVELS,
    PERIOD,
    billows,
    lobes_in_plane,
    standardise,
)
from oaisys_core.procedural.environment.clouds.tile import Tile
from oaisys_core.procedural.terrain.noise import Field, spectral
from oaisys_core.scene.sky import CloudKind, Clouds

GRID = 6 * PERIOD
"""Texels along a side of the tile of sky that repeats."""

TILE_SIZES = 7.5
"""Side of that tile, in sizes of a cloud."""

SLABS = 40
"""Thin layers between base and tops."""

FINE_UP = 3
"""By how much the finer lobes are lower: neighbouring slabs share them, or would show as lines."""

BASE_SHARE = 0.4
"""Extinction at the base, relative to that of the tops."""

BASE_RELIEF, RELIEF_GAIN = 0.35, 2.5
"""Strength of the lobes at the base, and how fast it grows with the height, up to 1."""

MAX_LOBE = 3.4
"""Largest lobe, in standard deviations: beyond it there are none in a thousandth of the air."""

OUTSIDE = 6.0
"""How much steeper the map is where there are no clouds: else lobes stand alone as puffs."""

EVERY = 4
"""Spacing of the texels that tell the cover of a threshold; of the slabs it is 2."""

HALVINGS = 16
"""Steps of the search for that threshold."""


@dataclass(frozen=True)
class Form:
    """What kind of clouds they are.

    Attributes:
        cells: Weight of separate clouds, of smaller ones beside them, of groups, of uneven edges.
        spread: Of the map, over which a cloud reaches from the base to the tops.
        power: Of the height, by which less of the map is cloud: 1 are cones, 4 are slabs.
        lobes, fine_lobes: How far lobes move the border, in heights.
        edge: Of the border, over which it becomes dense: dry air is drawn in there.
        extinction_per_m: Of the tops. 0.6 g/m³ of droplets of 8 µm have 0.11, 0.4 g/m³ have 0.075
            (3 / 2 of the water over radius and density, Stephens 1978).
    """

    cells: tuple[float, float, float, float]
    spread: float
    power: float
    lobes: float
    fine_lobes: float
    edge: float
    extinction_per_m: float


FORMS: dict[CloudKind, Form] = {
    "cumulus": Form((0.7, 0.45, 0.7, 0.35), 1.6, 1.5, 0.28, 0.10, 0.6, 0.11),
    "stratocumulus": Form((0.8, 0.3, 0.45, 0.25), 1.3, 3.0, 0.26, 0.12, 0.5, 0.075),
}


class Slab:
    """A thin layer of clouds, whose extinction is as at its middle.

    Attributes:
        least: Excess of the map from which on there may be clouds.
        growth: By how much that excess grows from the bottom of the layer to its top.
    """

    def __init__(self, form: Form, index: int, lobes: Field, fine_lobes: Field) -> None:
        """Take over (PERIOD, PERIOD) lobes at this height."""
        rise = (index + 0.5) / SLABS
        relief = min(1.0, BASE_RELIEF + RELIEF_GAIN * rise)
        self._begins = rise**form.power
        self.growth = form.power * rise ** (form.power - 1) / SLABS
        self.least = self._begins - MAX_LOBE * relief * (form.lobes + form.fine_lobes)
        self._most_per_m = form.extinction_per_m * (BASE_SHARE + (1 - BASE_SHARE) * rise)
        self._edge = form.edge
        self._lobes = lobes * np.float32(form.lobes * relief)
        self._tile = Tile(self._lobes)
        self._fine_tile = Tile(fine_lobes * np.float32(form.fine_lobes * relief))

    def at(self, excess: Field, x: Field, y: Field) -> Field:
        """Return the (N,) extinction per metre at points.

        Args:
            excess: (N,) of the map there.
            x, y: (N,) where they are, in texels of the tile, any number of tiles away.
        """
        found = excess + self._tile.at(x, y)
        # A fifth as large, and turned: 3² + 4² = 5², so that they tile.
        found += self._fine_tile.at(3 * x + 4 * y, 3 * y - 4 * x)
        return self._extinction(found)

    def on_grid(self, excess: Field, step: int = 1) -> Field:
        """Return the (N, N) extinction per metre on a grid of texels, without the finer lobes.

        Args:
            excess: (N, N) excess of the map at these texels.
            step: Spacing of the grid, in texels.
        """
        sides = GRID // PERIOD
        return self._extinction(excess + np.tile(self._lobes[::step, ::step], (sides, sides)))

    def _extinction(self, excess: Field) -> Field:
        """Return the extinction per metre where the excess, with its lobes, is this; reuse it."""
        excess -= np.float32(self._begins)
        excess *= np.float32(1 / self._edge)
        np.clip(excess, 0, 1, out=excess)
        excess *= np.float32(self._most_per_m)
        return excess


class CloudField:
    """The extinction of clouds, in slabs from the base (0) to the tops (`SLABS` - 1).

    Attributes:
        texel_m: Edge of a texel of the tile of sky.
        slab_m: Thickness of a slab.
        excess: (GRID, GRID) the map by which slabs begin and end.
    """

    def __init__(self, clouds: Clouds) -> None:
        self._form = FORMS[clouds.kind]
        self.texel_m = clouds.size_m * TILE_SIZES / GRID
        self.slab_m = clouds.thickness_m / SLABS
        potential = _potential(clouds.seed, self._form)
        self.excess = self._excess(potential, self._threshold(potential, clouds.cover))

    def slab(self, index: int) -> Slab:
        """Return a slab."""
        return Slab(self._form, index, self._lobes(index, 1), self._lobes(index, FINE_UP))

    def _lobes(self, index: int, finer: int) -> Field:
        """Return the (PERIOD, PERIOD) lobes at the middle of a slab."""
        level = (index + 0.5) * self.slab_m / self.texel_m * finer
        below, volume = floor(level), billows()
        share = np.float32(level - below)
        lower, upper = volume[below % LEVELS], volume[(below + 1) % LEVELS]
        return np.asarray(lower * (1 - share) + upper * share)

    def _excess(self, potential: Field, threshold: float) -> Field:
        excess = (potential - np.float32(threshold)) * np.float32(1 / self._form.spread)
        # Steeper outside of clouds, where lobes would be shreds.
        return np.minimum(excess, np.float32(OUTSIDE) * excess)

    def _threshold(self, potential: Field, cover: float) -> float:
        """Return the threshold at which clouds hide a share of what is straight above."""
        some, slabs = potential[::EVERY, ::EVERY], [self.slab(i) for i in range(0, SLABS, 2)]
        low, high = -9.0, 9.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            excess, depth = self._excess(some, middle), np.zeros_like(some)
            for slab in slabs:
                depth += slab.on_grid(excess, EVERY) * np.float32(2 * self.slab_m)
            is_less = 1 - float(np.exp(-depth).mean(dtype=np.float64)) < cover
            low, high = (low, middle) if is_less else (middle, high)
        return (low + high) / 2


def _potential(seed: int, form: Form) -> Field:
    """Return the (GRID, GRID) map of where clouds rather are, with a standard deviation of 1."""
    rng = randomness.stream(seed, "clouds")
    parts = (
        lobes_in_plane(8, GRID, rng),
        lobes_in_plane(12, GRID, rng),
        spectral(GRID, 2.5, rng, 2.6),
        spectral(GRID, 8.0, rng, 3.0),
    )
    total = np.zeros((GRID, GRID), np.float32)
    for part, weight in zip(parts, form.cells, strict=True):
        total += part * np.float32(weight)
    return standardise(total)
