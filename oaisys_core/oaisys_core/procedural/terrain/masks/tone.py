"""The tone of a stage's ground: how water, slope and plants change its colour from place to place.

Damp hollows and the ways of water are dark, crests and washed slopes pale; plants are yellow where
it is dry, and stand in dark clumps where it is moist. Beyond the stage's edge the tone is even.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.masks.relief import Relief, exposure, relief_of
from oaisys_core.procedural.terrain.noise import Field, band
from oaisys_core.procedural.terrain.water.moisture import moisture
from oaisys_core.scene import Ground
from oaisys_core.scene.terrain_material import MAX_TONE, MIN_TONE, Variation

Image = NDArray[np.float32]

MAX_PX, RELIEF_PX, COARSE_PX = 512, 384, 192
"""Largest size of the image, beyond which Cycles samples it more slowly, and grid sizes of the
slopes that water runs down and of the forms that stand out."""

DAMP, PALE, WASHED, MOTTLED = -0.9, 0.3, 0.5, 0.3
"""Changes of the brightness, in units of half its range: from the driest place to the wettest, for
a standard deviation of exposure, and for one of the streaks of water and of mottles."""

OF_PLANTS, OF_SNOW = 0.6, 0.15
"""The same changes on plants and on snow, relative to those on bare ground: snow is clean."""

FORMS_M = 9.0
"""Size of the forms that are paler where they stand out."""

MOTTLES_M = 0.5, 12.0
"""Shortest and longest waves of mottles, whose octaves are equally strong."""

STREAK_STEPS = 14
"""Steps of a texel that noise is smeared down the slope each way, which makes streaks."""

STREAKED_RAD = 0.06, 0.35
"""Slopes from which on, and at which in full, water leaves streaks."""

CLUMPS_M = 0.6, 5.0
"""Shortest and longest waves of clumps of taller plants: they are half as wide."""

CLUMP_DARKNESS, MAX_DARKNESS = 1.3, 0.7
"""Share of light that a clump of plants reflects less, with its own shade, in units of the range of
brightness, and its bound."""

CLUMPED = 0.9, 2.2
"""Standard deviations from which on a clump begins, at the wettest place and at the driest."""

DRY_TINT = (0.9, 0.23, 0.0)
"""Change of the colour of plants from the mean place to the driest, in units of the range of
brightness: red, green, blue."""

LUSH, DRY_MOTTLES = -0.35, 0.4
"""Of this change, the share at the wettest place, and that for a standard deviation of mottles."""

FADED = 0.08
"""Share of the stage's edge over which the tone fades out."""


@dataclass(frozen=True)
class StageTone:
    """The tone of a stage's ground.

    Attributes:
        ground: The stage's.
        masks: (L, M, M) weights of the layers.
        green, snowy: Whether each layer is of plants, and of snow.
        strength: How strong the tone is; its size does not matter.
        seed: Of mottles, streaks and clumps.
    """

    ground: Ground
    masks: NDArray[np.float32]
    green: tuple[bool, ...]
    snowy: tuple[bool, ...]
    strength: Variation
    seed: int

    @cached_property
    def pixels(self) -> NDArray[np.uint8]:
        """(T, T, 3) bytes: factors on the linear colour, from `MIN_TONE` to `MAX_TONE`.

        T is at most M and `MAX_PX`.
        """
        ground, strength = self.ground, self.strength
        rng = randomness.stream(self.seed, "tone")
        size = min(self.masks.shape[1], MAX_PX)
        extent_m = ground.extent_m[2] - ground.extent_m[0]
        wet = _resize(moisture(ground).astype(np.float32), size)
        shortest_m, longest_m = MOTTLES_M
        mottles = band(size, extent_m / longest_m, extent_m / shortest_m, rng)
        change = np.float32(DAMP) * (wet - np.float32(0.5)) + np.float32(MOTTLED) * mottles
        change += _of_forms(relief_of(ground, RELIEF_PX), size, extent_m, rng)
        plants, snow = (self._weight(of, size) for of in (self.green, self.snowy))
        change *= 1 - np.float32(1 - OF_PLANTS) * plants - np.float32(1 - OF_SNOW) * snow
        ranges = strength.brightness + strength.tint * np.array((1, 0, -1))
        factor = np.asarray(1 + change[..., None] * (ranges / 2), np.float32)
        if any(self.green):
            dry = np.clip(1 - 2 * wet + np.float32(DRY_MOTTLES) * mottles, LUSH, 1)
            clumps = _clumps(wet, extent_m, rng)
            factor *= 1 + plants[..., None] * _change_of_plants(dry, clumps, strength.brightness)
        factor = 1 + (factor / factor.mean() - 1) * _inside(size)[..., None]
        share = (np.clip(factor, MIN_TONE, MAX_TONE) - MIN_TONE) * (255 / (MAX_TONE - MIN_TONE))
        return np.asarray(np.rint(share), np.uint8)

    def _weight(self, of: tuple[bool, ...], size: int) -> Field:
        """Return the (size, size) weight of some layers."""
        return _resize(np.asarray(self.masks[np.array(of)].sum(axis=0), np.float32), size)


def _of_forms(relief: Relief, size: int, extent_m: float, rng: np.random.Generator) -> Field:
    """Return the (size, size) change of brightness by crests, and by streaks on slopes."""
    coarse = Relief(*(_resize(each, COARSE_PX) for each in relief))
    exposed = _resize(exposure(coarse, extent_m / COARSE_PX, FORMS_M), size)
    streaks = _resize(_streaks(relief, extent_m, rng), size)
    return np.float32(PALE) * exposed + np.float32(WASHED) * streaks


def _change_of_plants(dry: Field, clumps: Field, brightness: float) -> Image:
    """Return the (T, T, 3) change of the colour of plants, 0 for none."""
    tint = np.array(DRY_TINT, np.float32) * np.float32(brightness)
    darkness = np.float32(min(CLUMP_DARKNESS * brightness, MAX_DARKNESS))
    factor = (1 + dry[..., None] * tint) * (1 - darkness * clumps[..., None])
    return np.asarray(factor - 1, np.float32)


def _streaks(relief: Relief, extent_m: float, rng: np.random.Generator) -> Field:
    """Return noise that water has smeared down the slopes, with deviation 1 where it is steep.

    It is a line integral convolution (Cabral and Leedom, SIGGRAPH 1993) along the steepest way.
    """
    import cv2

    size = len(relief.height_m)
    texel_m = extent_m / size
    smooth_m = cv2.GaussianBlur(relief.height_m, (0, 0), 2.0)
    up_y, up_x = (np.asarray(each, np.float32) for each in np.gradient(smooth_m, texel_m))
    length = np.maximum(np.hypot(up_x, up_y), np.float32(1e-6))
    up_x, up_y = up_x / length, up_y / length
    noise = rng.standard_normal((size, size), dtype=np.float32)
    total = noise.copy()
    rows, columns = np.mgrid[:size, :size].astype(np.float32)
    for sign in (np.float32(-1), np.float32(1)):
        x, y = columns, rows
        for _ in range(STREAK_STEPS):
            step_x, step_y = (_at(each, x, y) for each in (up_x, up_y))
            x, y = x + sign * step_x, y + sign * step_y
            total += _at(noise, x, y)
    least, most = (np.float32(np.tan(each)) for each in STREAKED_RAD)
    steep = np.clip((length - least) / (most - least), 0, 1)
    return np.asarray(total / total.std() * steep, np.float32)


def _clumps(wet: Field, extent_m: float, rng: np.random.Generator) -> Field:
    """Return (T, T) from 0 beside clumps of plants to 1 in them."""
    shortest_m, longest_m = CLUMPS_M
    noise = band(len(wet), extent_m / longest_m, extent_m / shortest_m, rng)
    wettest, driest = (np.float32(each) for each in CLUMPED)
    return np.clip((noise - (driest + (wettest - driest) * wet)) / np.float32(0.5), 0, 1)


def _inside(size: int) -> Field:
    """Return (size, size) weights of the tone, which fade to 0 at the stage's edge."""
    at = (np.arange(size, dtype=np.float32) + 0.5) / np.float32(size)
    ramp = np.clip(np.minimum(at, 1 - at) / np.float32(FADED), 0, 1)
    return np.minimum.outer(ramp, ramp)


def _at(image: Field, x: Field, y: Field) -> Field:
    import cv2

    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))


def _resize(values: Field, size: int) -> Field:
    import cv2

    way = cv2.INTER_AREA if size < len(values) else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(values, (size, size), interpolation=way))
