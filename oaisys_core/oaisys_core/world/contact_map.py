"""Where things meet the ground: fines banked against their feet, and darkness at the very contact.

It changes the ground's colour only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import Ground, MeshPrototype, Placement, Scene
from oaisys_core.terrain.detail import DetailedGround
from oaisys_core.terrain.noise import spectral
from oaisys_core.types import FloatArray

TEXEL_M, MOST_PX = 0.025, 2048
"""Wanted size of a texel, and largest edge of a map."""

LEAST_TEXELS = 2.5
"""Size of the smallest things on the map."""

RIMS = ((1.0, 40), (0.72, 85), (0.48, 130), (0.28, 175), (0.12, 220), (0.0, 255))
"""How far from a thing's outline, as shares of `reach`, the map has which value or more."""

REACH, REACH_M = 0.13, 0.02
"""Width of the rim: the first times a thing's size, plus the second."""

ONE_SIDED = 0.7
"""By how much a rim is wider on one side, and narrower on the other."""

UPHILL = 1.2
"""Shift of the rim uphill, where fines are stopped, by its width and the ground's slope."""

SECTORS, LEVELS = 20, 8
"""Corners of an outline, and heights of a mesh that have one."""

_SECTOR_RAD = (np.arange(SECTORS) + 0.5) * (2 * np.pi / SECTORS)
"""Direction of each corner."""

SLAB = 0.14
"""Half the height of the slab whose vertices make an outline, as a share of the mesh's height."""

NOISE_PX, NOISE_WAVES, NOISE = 256, 24.0, 0.85
"""Edge and waves along the edge of the tile of noise that frays the rims, and its strength."""

FIXED_POINT_BITS = 4
"""Of the polygons that are drawn."""


@dataclass(frozen=True)
class ContactMap:
    """How close the ground is to a thing that stands in it.

    Attributes:
        share: (M, M) uint8, 255 at and below things, 0 away from them; row 0 at min_y.
        extent_m: (min_x, min_y, max_x, max_y) that it covers.
    """

    share: NDArray[np.uint8]
    extent_m: tuple[float, float, float, float]

    def is_near(self, xy_m: FloatArray) -> NDArray[np.bool_]:
        """Return which of (H, W, 2) points are near a thing."""
        x0, y0, x1, y1 = self.extent_m
        rows, columns = self.share.shape
        x = (xy_m[..., 0] - x0) * (columns / (x1 - x0)) - 0.5
        y = (xy_m[..., 1] - y0) * (rows / (y1 - y0)) - 0.5
        places = x.astype(np.float32), y.astype(np.float32)
        return np.asarray(cv2.remap(self.share, *places, cv2.INTER_LINEAR) > 0)


def contact_map(scene: Scene) -> ContactMap | None:
    """Return the map of a scene; None if nothing that stays where it is has fines at its foot."""
    ground = stage_ground(scene)
    x0, y0, x1, y1 = ground.extent_m
    edge_m = max(x1 - x0, y1 - y0)
    size_px = int(np.clip(2 ** np.ceil(np.log2(edge_m / TEXEL_M)), NOISE_PX, MOST_PX))
    least_m = LEAST_TEXELS * edge_m / size_px
    placed = [(scene.prototypes[p.prototype], p) for p in scene.placements]
    outlines = [_outlines(*each, ground, least_m) for each in placed if has_rim(*each)]
    if not sum(len(each.centre_m) for each in outlines):
        return None
    share = np.zeros((size_px, size_px), np.uint8)
    scale = np.array((size_px / (x1 - x0), size_px / (y1 - y0)))
    for width, value in RIMS:
        for each in outlines:
            corners = (each.widened_m(width) - (x0, y0)) * scale - 0.5
            for polygon in np.round(corners * 2**FIXED_POINT_BITS).astype(np.int32):
                cv2.fillPoly(share, [polygon], value, cv2.LINE_8, FIXED_POINT_BITS)
    return ContactMap(_frayed(share), (x0, y0, x1, y1))


def stage_ground(scene: Scene) -> Ground:
    """Return the ground without the detail around the cameras, on which no colour may depend."""
    ground = scene.ground
    return ground.coarse if isinstance(ground, DetailedGround) else ground


def has_rim(prototype: MeshPrototype, placement: Placement) -> bool:
    """Return whether fines lie around the instances of a placement."""
    return bool(prototype.dust_m) and not placement.is_moving


class Outlines(NamedTuple):
    """Where N things meet the ground.

    Attributes:
        centre_m: (N, 2) positions in ``map``.
        corners_m: (N, SECTORS, 2) from there.
        reach_m: (N, SECTORS) widths of their rims.
        uphill_m: (N, 2) how far the outer edges of the rims are shifted.
    """

    centre_m: FloatArray
    corners_m: FloatArray
    reach_m: FloatArray
    uphill_m: FloatArray

    def widened_m(self, width: float) -> FloatArray:
        """Return the (N, SECTORS, 2) outlines in ``map``, farther out by a share of the reach."""
        length_m = np.linalg.norm(self.corners_m, axis=-1, keepdims=True)
        factor = 1 + width * self.reach_m[..., None] / np.maximum(length_m, 1e-9)
        middle_m = self.centre_m + width * self.uphill_m
        return np.asarray(middle_m[:, None] + factor * self.corners_m)


def _outlines(
    prototype: MeshPrototype, placement: Placement, ground: Ground, least_m: float
) -> Outlines:
    """Return the outlines of a placement's instances that are large enough."""
    T = placement.T_map_object
    size_m = np.linalg.norm(T[:, :3, 0], axis=1)
    is_large = size_m >= least_m
    T, size_m = T[is_large], size_m[is_large]
    centre_m = T[:, :2, 3]
    slope, height_m = ground_plane(ground, centre_m, size_m / 2)
    profile = _profile(prototype)
    top = float(prototype.vertices_m[:, 2].max())
    level = (height_m - T[:, 2, 3]) / size_m / max(top, 1e-6) * (LEVELS - 1)
    corners = profile[np.clip(np.round(level), 0, LEVELS - 1).astype(np.intp)]
    corners_m = np.einsum("nij,nkj->nki", T[:, :2, :3], corners)
    # More fines lie on one side, and around some things.
    phase, amount = np.modf(np.abs(centre_m @ ((127.1, 269.5), (311.7, 183.3))))[0].T
    one_sided = 1 + ONE_SIDED * np.cos(_SECTOR_RAD - 2 * np.pi * phase[:, None])
    reach_m = (REACH * size_m + REACH_M) * (0.5 + amount)
    uphill_m = UPHILL * slope * reach_m[:, None]
    return Outlines(centre_m, corners_m, one_sided * reach_m[:, None], uphill_m)


def ground_plane(
    ground: Ground, xy_m: FloatArray, radius_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (N, 2) slopes and (N,) heights of the ground at points; 0 where there is no ground."""
    radius_m = np.maximum(radius_m, ground.spacing_m / 2)
    ways = np.array(((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)), np.float64)
    points_m = xy_m + ways[:, None] * radius_m[:, None]
    middle_m, east_m, west_m, north_m, south_m = ground.height_at(points_m.reshape(-1, 2)).reshape(
        len(ways), -1
    )
    slope = np.column_stack((east_m - west_m, north_m - south_m)) / (2 * radius_m[:, None])
    return np.nan_to_num(slope), np.nan_to_num(middle_m)


def _profile(prototype: MeshPrototype) -> FloatArray:
    """Return the (LEVELS, SECTORS, 3) outline of a mesh at each of some heights."""
    vertices_m = prototype.vertices_m.astype(np.float64)
    top_m = vertices_m[:, 2].max()
    heights_m = np.linspace(0, top_m, LEVELS)
    radius_m = np.hypot(vertices_m[:, 0], vertices_m[:, 1])
    angle = np.arctan2(vertices_m[:, 1], vertices_m[:, 0])
    sector = np.floor(angle / (2 * np.pi) * SECTORS).astype(np.intp) % SECTORS
    result = np.zeros((LEVELS, SECTORS))
    for level, height_m in enumerate(heights_m):
        near = np.abs(vertices_m[:, 2] - height_m) <= SLAB * top_m
        np.maximum.at(result[level], sector[near], radius_m[near])
        # A coarse mesh has no vertex in some sectors.
        wide = np.maximum(np.roll(result[level], 1), np.roll(result[level], -1))
        result[level] = np.where(result[level] == 0, wide, result[level])
    corners = np.empty((LEVELS, SECTORS, 3))
    corners[..., 0], corners[..., 1] = result * np.cos(_SECTOR_RAD), result * np.sin(_SECTOR_RAD)
    corners[..., 2] = heights_m[:, None]
    return corners


def _frayed(share: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a map whose rims end raggedly, as fines do."""
    noise = spectral(NOISE_PX, NOISE_WAVES, np.random.default_rng(0), rough=3.0)
    tile = np.clip((noise * 0.6 + 0.5) * 255, 0, 255).astype(np.uint8)
    copies = -(-len(share) // NOISE_PX)
    smooth = cv2.GaussianBlur(share, (3, 3), 0)
    # None of it at things themselves.
    uneven = cv2.multiply(
        cv2.bitwise_not(smooth), np.tile(tile, (copies, copies)), scale=NOISE / 255
    )
    return np.asarray(cv2.subtract(smooth, uneven))
