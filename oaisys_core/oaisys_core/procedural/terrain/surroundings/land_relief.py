"""How steep and how high the land is, by which the ground's layers lie where they would in nature.

On the stage, conditions bind layers to slopes and heights. How strongly they do is measured there,
and the land's patches follow its relief as strongly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.masks.relief import RELIEF_PX, Relief, relief_of
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.procedural.terrain.surroundings.land import endless_relief
from oaisys_core.procedural.terrain.surroundings.octaves import ENOUGH_POINTS
from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray

COLUMNS = 320
"""Directions in which the land's heights are sampled."""

FORMS = (0.8, 3.2, 12.8)
"""Wavelengths of the forms by which ridges, hollows and slopes count, in units of the distance
between the stage's centre and its nearest edge."""

MIN_FORM = 6.0
"""Least wavelength of a form in cells. Cells grow with the distance."""

MIN_WAVE = 1 / 2
"""Wavelengths below count nowhere: they repeat within a kilometre. In the units of `FORMS`."""

SLOPES = 1 / 4
"""Shortest waves by which slopes count, in units of a form's."""

ROWS_ALIKE = 12
"""Standard deviation, in rows, of the rings over which slopes and heights are normalised."""

STRENGTH = 2.0
"""Change of a patch's score, in standard deviations of the stage's patches, where steepness differs
by one standard deviation and the layer's mean steepness on the stage does, too."""

MIN_PREFERENCE = 0.3
"""Preference for ridges, and for hollows, of layers that have none on the stage."""

MAX_DEVIATION = 3.0
"""Largest deviation from the mean that counts."""


class LandScores(Protocol):
    """By how much a relief favours layers on the land."""

    def scores(self, layer: int, shape: tuple[int, ...]) -> Field:
        """Return by how much it favours a layer, on a grid of (rows, directions)."""


@dataclass(frozen=True, eq=False)
class LandRelief:
    """What the patches of layers on the land follow.

    Attributes:
        steepness: (R, `COLUMNS`) slopes over distance and direction, with mean 0 and standard
            deviation 1 at each distance.
        prominence: The same of heights above the ground around.
        preferences: (L, 2) mean steepness and prominence of each layer.
    """

    steepness: Field
    prominence: Field
    preferences: FloatArray

    def scores(self, layer: int, shape: tuple[int, ...]) -> Field:
        """Return by how much the relief favours a layer, on a grid of (rows, directions)."""
        import cv2

        steep, high = (STRENGTH * self.preferences[layer]).astype(np.float32).tolist()
        total = np.asarray(steep * self.steepness + high * self.prominence, np.float64)
        # Around the circle, the first column follows the last one.
        times = shape[1] // COLUMNS
        size = (shape[1] + 2 * times, shape[0])
        wide = cv2.resize(_around_circle(total), size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide[:, times:-times], np.float32)


@dataclass(frozen=True, eq=False)
class ReliefAround:
    """The relief of the land around a stage, worked out once a view shows layers on it.

    It holds data alone, by whose digest views of equal worlds are found again.

    Attributes:
        land: The land.
        stage: The ground in its middle.
        masks: (L, M, M) float32 masks of the layers on the stage.
        farthest_m: Distance from the stage's centre up to which the relief is known.
    """

    land: FarGroundMesh
    stage: Ground
    masks: NDArray[np.float32]
    farthest_m: float

    def scores(self, layer: int, shape: tuple[int, ...]) -> Field:
        """See `LandScores`."""
        return self._relief.scores(layer, shape)

    @cached_property
    def _relief(self) -> LandRelief:
        x0, y0, x1, y1 = self.stage.extent_m
        return land_relief(
            self.land,
            ((x0 + x1) / 2, (y0 + y1) / 2),
            min(x1 - x0, y1 - y0) / 2,
            self.farthest_m,
            preferences_of(relief_of(self.stage, RELIEF_PX), self.masks),
        )


def land_relief(
    land: FarGroundMesh,
    centre_m: tuple[float, float],
    nearest_m: float,
    farthest_m: float,
    preferences: FloatArray,
) -> LandRelief:
    """Return the relief of land between two distances from a stage's centre.

    Its forms have the same sizes at all distances where cells are fine enough. Those of the land's
    triangles grow with the distance: from above, patches that follow them burst from the stage.
    """
    angle = (np.arange(COLUMNS) + 0.5) * (2 * np.pi / COLUMNS)
    per_e_fold = COLUMNS / (2 * np.pi)
    rows = int(np.ceil(np.log(farthest_m / nearest_m) * per_e_fold)) + 1
    distance_m = np.geomspace(nearest_m, farthest_m, rows)[:, None]
    x, y = centre_m[0] + distance_m * np.cos(angle), centre_m[1] + distance_m * np.sin(angle)
    xy_m = np.stack((x, y), axis=-1)
    cell_m = distance_m / per_e_fold
    spacing_m = np.maximum(cell_m[:, 0], MIN_WAVE * nearest_m / ENOUGH_POINTS)
    forms_m = [np.maximum(form * nearest_m, MIN_FORM * cell_m) for form in FORMS]
    raised_m, ground_m = np.zeros((2, len(FORMS), rows, COLUMNS))
    for wave_m, octave_m in endless_relief(land, xy_m, spacing_m):
        for index, form_m in enumerate(forms_m):
            raised_m[index] += octave_m * (1 - _share_above(form_m, wave_m))
            ground_m[index] += octave_m * _share_above(SLOPES * form_m, wave_m)
    steepness = np.sum([_normalise(_slope(each / cell_m)) for each in ground_m], axis=0)
    prominence = np.sum([_normalise(each / cell_m) for each in raised_m], axis=0)
    return LandRelief(_normalise(steepness), _normalise(prominence), preferences)


def _share_above(limit_m: FloatArray, wave_m: float) -> FloatArray:
    """Return the shares of an octave in the waves that are longer than some limits."""
    return np.asarray(np.clip(np.log2(wave_m / limit_m) + 0.5, 0.0, 1.0))


def _slope(height: FloatArray) -> FloatArray:
    """Return slopes of (R, C) heights in units of the cells of each row."""
    along = np.gradient(_around_circle(height), axis=1)[:, 1:-1]
    return np.asarray(np.hypot(along, np.gradient(height, axis=0)))


def preferences_of(relief: Relief, masks: NDArray[np.float32]) -> FloatArray:
    """Return (L, 2) the mean steepness and prominence of the layers of a stage."""
    import cv2

    size = len(relief.height_m)
    slope = relief.slope_rad - relief.slope_rad.mean()
    raised = relief.height_m - _blur(relief.height_m, size / 16)
    found = []
    for index, mask in enumerate(masks):
        weight = cv2.resize(mask, (size, size), interpolation=cv2.INTER_AREA)
        total = max(float(weight.sum()), 1e-6)
        steep, high = (
            float((weight * values).sum()) / total / max(float(values.std()), 1e-9)
            for values in (slope, raised)
        )
        if np.hypot(steep, high) < MIN_PREFERENCE:
            high = MIN_PREFERENCE * (1 if index % 2 == 0 else -1)
        found.append((steep, high))
    return np.array(found)


def _around_circle(values: FloatArray) -> FloatArray:
    """Return (R, C + 2) values that go on around the circle at both ends."""
    return np.concatenate((values[:, -1:], values, values[:, :1]), axis=1)


def _normalise(values: FloatArray) -> Field:
    """Return (R, C) values relative to those at similar distances."""
    mean = _over_rings(values.mean(axis=1))
    deviation = np.sqrt(_over_rings(((values - mean[:, None]) ** 2).mean(axis=1)))
    unit = (values - mean[:, None]) / np.maximum(deviation, 1e-9)[:, None]
    return np.asarray(np.clip(unit, -MAX_DEVIATION, MAX_DEVIATION), np.float32)


def _over_rings(values: FloatArray) -> FloatArray:
    return _blur(values[:, None], ROWS_ALIKE)[:, 0]


def _blur(values: FloatArray | Field, sigma: float) -> FloatArray:
    import cv2

    blurred = cv2.GaussianBlur(
        np.asarray(values, np.float64), (0, 0), sigma, borderType=cv2.BORDER_REFLECT
    )
    return np.asarray(blurred).reshape(values.shape)
