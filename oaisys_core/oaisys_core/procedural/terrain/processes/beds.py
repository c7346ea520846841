"""Layered rock: beds of differing hardness, which stand out as ledges or wear back as slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import fractal
from oaisys_core.procedural.terrain.processes.exact import draw_direction, tangent
from oaisys_core.types import FloatArray

STEPS = 512
"""Samples of the column of rock."""


@dataclass(frozen=True)
class Beds:
    """A column of beds, laid with a dip and slight folds.

    Attributes:
        hardness: (STEPS,) from 0 (soft) to 1 (hard), from the lowest bed up.
        bottom_m, height_m: Height of the column's foot where ``lift_m`` is 0, and its extent; it
            repeats above and below.
        contrast: Factor between the erodibilities of the softest and the hardest rock.
        repose_deg: Steepest stable slopes of the softest and of the hardest rock.
    """

    hardness: NDArray[np.float64]
    bottom_m: float
    height_m: float
    contrast: float
    repose_deg: tuple[float, float]

    def hardness_at(self, elevation_m: FloatArray, lift_m: float | FloatArray) -> FloatArray:
        """Return the hardness of what lies at the surface.

        Args:
            elevation_m: Heights of the surface.
            lift_m: By how much the beds lie higher there than their column says.
        """
        phase = (elevation_m - lift_m - self.bottom_m) / self.height_m
        place = (phase - np.floor(phase)) * (STEPS - 1)
        low = place.astype(np.intp)
        share = place - low
        high = np.minimum(low + 1, STEPS - 1)
        return np.asarray(self.hardness[low] * (1 - share) + self.hardness[high] * share)

    def erodibility(self, hardness: FloatArray) -> FloatArray:
        """Return the factor on the erodibility, at most 1."""
        return np.asarray(1.0 / (1.0 + (self.contrast - 1.0) * hardness))

    def repose(self, hardness: FloatArray) -> FloatArray:
        """Return the tangents of the steepest stable slopes."""
        soft, hard = (tangent(angle) for angle in self.repose_deg)
        return np.asarray(soft + (hard - soft) * hardness)


def draw_beds(
    rng: np.random.Generator,
    bottom_m: float,
    height_m: float,
    *,
    count: int,
    contrast: float,
    repose_deg: tuple[float, float],
    hard_share: float = 0.35,
) -> Beds:
    """Return beds of drawn thickness and hardness.

    Args:
        rng: Draws them.
        bottom_m, height_m, contrast, repose_deg: As of `Beds`.
        count: Number of pairs of a soft bed and a hard one.
        hard_share: Share of the column that is hard.
    """
    thickness = rng.uniform(0.4, 1.6, 2 * count)
    thickness[1::2] *= hard_share / thickness[1::2].sum()
    thickness[::2] *= (1 - hard_share) / thickness[::2].sum()
    hardness = np.where(np.arange(2 * count) % 2, rng.uniform(0.45, 1.0, 2 * count), 0.0)
    hardness[::2] = rng.uniform(0.0, 0.15, count)
    top = np.cumsum(thickness)
    at = (np.arange(STEPS) + 0.5) / STEPS
    column = hardness[np.minimum(np.searchsorted(top, at), 2 * count - 1)]
    return Beds(column, bottom_m, height_m, contrast, repose_deg)


def draw_lift(
    size_px: int, extent_m: float, rng: np.random.Generator, dip: float, folds_m: float
) -> FloatArray:
    """Return (size_px, size_px) by how much beds lie higher: a dip, and folds.

    Args:
        size_px: Edge length.
        extent_m: Edge length of the ground.
        rng: Draws direction and folds.
        dip: Tangent of the angle at which the beds dip.
        folds_m: Height of the folds.
    """
    east, north = draw_direction(rng)
    axis = np.linspace(-0.5, 0.5, size_px)
    tilt = axis[None, :] * east + axis[:, None] * north
    x, y = (axis + 0.5) * 2.2, (axis[:, None] + 0.5) * 2.2
    folds = fractal(x[None, :], y, rng, octaves=3, gain=0.4)
    return np.asarray(dip * extent_m * tilt + folds_m * folds)
