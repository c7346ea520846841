"""What fills the space between things on a tile: swells, grit, grains; and its quick noises."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.sizes import SizeLaw, draw_diameters
from oaisys_core.procedural.textures.baking.stamps import MeshStamps

REPEATS = 4
"""How often grit, whose stones are a few texels wide, repeats along an edge of a tile."""


class Grit(NamedTuple):
    """Small stones all over a tile.

    Attributes:
        height: (N, N) in tile edges.
        tone: (N, N) random value of each stone, with standard deviation 1; 0 between them.
    """

    height: Field
    tone: Field


def grit(
    size_px: int,
    stamps: MeshStamps,
    law: SizeLaw,
    cover: float,
    limits: tuple[float, float],
    rng: np.random.Generator,
) -> Grit:
    """Return grit, see `draw_diameters`."""
    repeats = REPEATS if size_px % REPEATS == 0 else 1
    bed = Bed(np.zeros((size_px // repeats,) * 2, np.float32))
    low, high = limits
    sizes = draw_diameters(law, cover, (low * repeats, high * repeats), rng)
    bed.add(stamps, sizes, Laying(buried=(0.1, 0.5), makes_room=False), rng)
    tone = np.append(rng.standard_normal(bed.count), 0.0).astype(np.float32)[bed.ids]
    height = bed.height / np.float32(repeats)
    return Grit(np.tile(height, (repeats, repeats)), np.tile(tone, (repeats, repeats)))


def swell(size_px: int, cells: int, rng: np.random.Generator, rough: float = 1.85) -> Field:
    """Return `fields.tile_noise` without what is smaller than `COARSE` texels, in less time."""
    if size_px % COARSE or size_px // COARSE < MIN_COARSE_PX:
        return fields.tile_noise(size_px, cells, rng, rough)
    return enlarge(fields.tile_noise(size_px // COARSE, cells, rng, rough), COARSE)


COARSE, MIN_COARSE_PX = 4, 64


def fine_noises(size_px: int, rng: np.random.Generator) -> tuple[Field, Field]:
    """Return (N, N) tileable grain of a texel, and unevenness of centimetres, of deviation 1.

    They repeat twice along an edge, which nobody sees of what is so fine.
    """
    repeats = 2 if size_px % 2 == 0 else 1
    part_px = size_px // repeats
    fine = fields.grains(part_px, rng, 0.6), fields.tile_noise(part_px, 30, rng, 1.3)
    grain, uneven = (np.tile(each, (repeats, repeats)) for each in fine)
    return grain, uneven


def at_half(size_px: int, make: Callable[[int], Field]) -> Field:
    """Return a (N, N) field that is made at half of its resolution, if that is enough for it."""
    return all_at_half(size_px, lambda px: (make(px),))[0]


def all_at_half(size_px: int, make: Callable[[int], Sequence[Field]]) -> list[Field]:
    """Return (N, N) fields that are made together, as `at_half` does."""
    if size_px % 2 or size_px < 4 * MIN_COARSE_PX:
        return list(make(size_px))
    return [enlarge(each, 2) for each in make(size_px // 2)]


def enlarge(field: Field, factor: int) -> Field:
    """Return a tileable field at a multiple of its resolution."""
    pad = 2
    wrapped = np.pad(field, pad, mode="wrap")
    size = len(wrapped) * factor
    import cv2

    large = cv2.resize(wrapped, (size, size), interpolation=cv2.INTER_CUBIC)
    edge = pad * factor
    return np.ascontiguousarray(large[edge:-edge, edge:-edge])


def wide_blur(field: Field, sigma_px: float) -> Field:
    """Return `fields.blur`, at a resolution that is enough for it."""
    size_px = len(field)
    if sigma_px < 2 * COARSE or size_px % COARSE:
        return fields.blur(field, sigma_px)
    size = (size_px // COARSE,) * 2
    import cv2

    small = cv2.resize(field, size, interpolation=cv2.INTER_AREA)
    return enlarge(fields.blur(small, sigma_px / COARSE), COARSE)


def sky_share(height: Field, radii: tuple[float, ...]) -> Field:
    """Return the (N, N) share of the sky that texels below their surroundings see, 0.35 to 1.

    Only what a normal map cannot show: what stands around a place, by the mean height around it.

    Args:
        height: (N, N) in tile edges.
        radii: In tile edges.
    """
    share = np.ones_like(height)
    for radius in radii:
        hollow = wide_blur(height, radius * len(height)) - height
        depth = np.maximum(hollow, 0) / np.float32(fields.OCCLUDING_SLOPE * radius)
        share *= np.clip(1 - depth, 0.35, 1)
    return np.asarray(np.sqrt(share), np.float32)
