"""Shapes that wind makes: what it leaves of sheets of snow, tails behind edges, ripples of sand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields

SOFT_M = 0.008
"""How far the flanks of tails have slumped, as the standard deviation of a blur."""


class Sheet(NamedTuple):
    """A sheet of packed snow of which the wind has left a part.

    Attributes:
        above: Hardness, in standard deviations, from which on there is some.
        thickness_m: At its edge.
        rise_m: How much thicker it is for each standard deviation of hardness above that.
    """

    above: float
    thickness_m: float
    rise_m: float


def carve(hardness: Field, sheets: Sequence[Sheet], fall: float, tile_m: float) -> Field:
    """Return (N, N) heights, in tile edges, of what wind has left of sheets on each other.

    Args:
        hardness: (N, N) tileable, with standard deviation 1.
        sheets: From the lowest to the highest.
        fall: See `tails`.
        tile_m: Edge length of the tile.
    """
    height = np.zeros_like(hardness)
    for sheet in sheets:
        over = hardness - np.float32(sheet.above)
        left_m = np.where(over > 0, sheet.thickness_m + sheet.rise_m * over, 0)
        left = (left_m / tile_m).astype(np.float32)
        behind = fields.blur(tails(left, fall), SOFT_M / tile_m * len(left))
        height += np.maximum(left, behind)
    return height


def tails(height: Field, fall: float) -> Field:
    """Return (N, N) heights with a tail behind all that stands; the wind blows along the rows.

    Snow and sand that drift fill the lee of an edge; its side towards the wind stays as steep as it
    was cut. The result is the lowest surface above the given one that nowhere falls more steeply
    with the wind.

    Args:
        height: (N, N) tileable, in tile edges.
        fall: Slope of the tails, above 0.
    """
    size_px = len(height)
    filled, step, most = height, 1, float(height.max() - height.min())
    while step < size_px and fall * step / size_px < most:
        lower = np.roll(filled, step, axis=1) - np.float32(fall * step / size_px)
        filled = np.maximum(filled, lower)
        step *= 2
    return filled


def swerve(field: Field, cells: int, reach: float, rng: np.random.Generator) -> Field:
    """Return a tileable field whose rows swerve, as the wind does.

    Args:
        field: (N, N).
        cells: Bends along an edge of the tile.
        reach: Standard deviation of how far a row leaves its line, in tile edges.
        rng: Draws the bends.
    """
    away = np.float32(reach) * fields.tile_noise(len(field), cells, rng, 3.0)
    return _displaced(field, away, np.zeros_like(away))


def ripples(size_px: int, waves: int, rng: np.random.Generator) -> Field:
    """Return (N, N) tileable wind ripples from about -1 in a trough to 1 on a crest.

    Waves of many lengths near one compete until one length and one amplitude are left; where they
    disagree, a crest ends or forks. This is the equation of J. Swift and P. Hohenberg
    ("Hydrodynamic fluctuations at the convective instability", Phys. Rev. A 15, 1977) for waves
    that one direction is given. Crests then lean with the wind, along the rows, because the sand
    slides down their lee side.

    Args:
        size_px: Edge length of the tile.
        waves: Waves along a row.
        rng: Draws the waves at the beginning.
    """
    along = scipy.fft.rfftfreq(size_px, 1 / size_px)[None, :] / waves
    across = scipy.fft.fftfreq(size_px, 1 / size_px)[:, None] / waves
    damping = ((np.hypot(along, across) - 1) / BAND) ** 2 + (across / SINUOUS) ** 2
    phase, amplitude = fields.narrow_band(size_px, waves, rng, (0.2, 0.4))
    # In twice the precision, so that rounding, which grows from step to step, stays invisible.
    wave = (amplitude * np.cos(phase)).astype(np.float64)
    for _ in range(STEPS):
        wave = np.clip(wave, -MOST, MOST)
        grown = scipy.fft.rfft2(wave * (1 + STEP * (1 - wave**2)))
        wave = scipy.fft.irfft2(grown / (1 + STEP * damping), s=wave.shape)
    crest = wave.astype(np.float32)
    crest += np.float32(PEAKED) * (np.square(crest) - np.float32(0.5))
    return _displaced(crest, np.zeros_like(crest), np.float32(LEE / waves) * crest)


BAND, SINUOUS = 0.25, 0.8
"""How strongly waves are damped that are longer or shorter than most, and that run askew."""

STEPS, STEP = 30, 0.4
"""How often and how fast the waves compete."""

MOST = 1.5
"""Bound of a wave: beyond the amplitude 2 / sqrt(3) that all reach, below where steps diverge."""

PEAKED, LEE = 0.22, 0.085
"""How much narrower a crest is than a trough, and how far it leans, in wavelengths."""


def _displaced(field: Field, down: Field, right: Field) -> Field:
    """Return a tileable field, moved by (N, N) parts of a tile edge."""
    size_px = np.float32(len(field))
    axis = np.arange(len(field), dtype=np.float32)
    places = (axis[:, None] - size_px * down, axis[None, :] - size_px * right)
    moved = scipy.ndimage.map_coordinates(field, places, order=1, mode="grid-wrap")
    return np.asarray(moved, np.float32)
