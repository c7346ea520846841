"""Where things meet the ground: fines banked against their feet, and darkness at the very contact.

It changes the ground's colour only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.geometry import distances_along_m
from oaisys_core.procedural.terrain.detail import DetailedGround
from oaisys_core.procedural.terrain.noise import spectral
from oaisys_core.scene import Ground, MeshPrototype, Placement, Scene, WheelTracks
from oaisys_core.types import FloatArray

TEXEL_M, MAX_PX = 0.025, 2048
"""Wanted size of a texel, and largest edge of a map."""

MIN_TEXELS = 2.5
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

MAX_TRACKS, TRACK_STEP_M, MAX_STEPS = 3, 0.1, 20_000
"""Rovers whose tracks are shown, and distance and number of the steps in which they are drawn."""

_SECTOR_RAD = (np.arange(SECTORS) + 0.5) * (2 * np.pi / SECTORS)
"""Direction of each corner."""

FOOT, FOOT_GAP_M, FOOT_STEP_M = 0.035, 0.35, 0.02
"""Share of a vehicle's height that belongs to its feet, least distance between two of them, and
resolution of their shapes."""

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
        passed: (M, M, 3) uint8 of up to three rovers: 0 where there is no track, else 1 at the
            start of its way to 255 at the end; None without rovers.
        extent_m: (min_x, min_y, max_x, max_y) that it covers.
    """

    share: NDArray[np.uint8]
    extent_m: tuple[float, float, float, float]
    passed: NDArray[np.uint8] | None = None

    def is_near(self, xy_m: FloatArray) -> NDArray[np.bool_]:
        """Return which of (H, W, 2) points are near a thing."""
        x0, y0, x1, y1 = self.extent_m
        rows, columns = self.share.shape
        x = (xy_m[..., 0] - x0) * (columns / (x1 - x0)) - 0.5
        y = (xy_m[..., 1] - y0) * (rows / (y1 - y0)) - 0.5
        places = x.astype(np.float32), y.astype(np.float32)
        near = cv2.remap(self.share, *places, cv2.INTER_LINEAR) > 0
        if self.passed is not None:
            near |= (cv2.remap(self.passed, *places, cv2.INTER_LINEAR) > 0).any(axis=-1)
        return np.asarray(near)


def contact_map(scene: Scene) -> ContactMap | None:
    """Return the map of a scene; None if nothing that stays where it is has fines at its foot."""
    ground = stage_ground(scene)
    x0, y0, x1, y1 = ground.extent_m
    edge_m = max(x1 - x0, y1 - y0)
    size_px = int(np.clip(2 ** np.ceil(np.log2(edge_m / TEXEL_M)), NOISE_PX, MAX_PX))
    least_m = MIN_TEXELS * edge_m / size_px
    placed = [(scene.prototypes[p.prototype], p) for p in scene.placements]
    outlines = [
        _outlines(part, placement.T_map_object, ground, least_m)
        for prototype, placement in placed
        if has_rim(prototype, placement)
        for part in _contact_parts(prototype)
    ]
    if not (sum(len(each.centre_m) for each in outlines) or scene.tracks):
        return None
    scale = np.array((size_px / (x1 - x0), size_px / (y1 - y0)))

    def pixels(points_m: FloatArray) -> NDArray[np.int32]:
        """Return (..., 2) points on the map in fixed point, as OpenCV draws them."""
        at_px = (points_m - (x0, y0)) * scale - 0.5
        return np.asarray(np.round(at_px * 2**FIXED_POINT_BITS), np.int32)

    share = np.zeros((size_px, size_px), np.uint8)
    for width, value in RIMS:
        for each in outlines:
            for polygon in pixels(each.wider_outlines_m(width)):
                cv2.fillPoly(share, [polygon], value, cv2.LINE_8, FIXED_POINT_BITS)
    drawn = [np.zeros_like(share) for _ in range(MAX_TRACKS if scene.tracks else 0)]
    for canvas, track in zip(drawn, scene.tracks, strict=False):
        quads_m, values = _track_quads(track)
        for polygon, value in zip(pixels(quads_m), values, strict=True):
            cv2.fillConvexPoly(canvas, polygon, int(value), cv2.LINE_8, FIXED_POINT_BITS)
    passed = np.stack(drawn, axis=-1) if drawn else None
    return ContactMap(_fray(share), (x0, y0, x1, y1), passed)


def _track_quads(track: WheelTracks) -> tuple[FloatArray, FloatArray]:
    """Return (Q, 4, 2) quads in ``map`` of which tracks consist, and their values, last first."""
    ends_m = distances_along_m(track.way_m)
    count = int(np.clip(ends_m[-1] / TRACK_STEP_M, 2, MAX_STEPS))
    at_m = np.linspace(0, ends_m[-1], count)
    way_m = np.column_stack([np.interp(at_m, ends_m, axis) for axis in track.way_m.T])
    ahead = np.gradient(way_m, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    left = ahead[:, ::-1] * (-1, 1)
    quads = []
    for side in (-1, 1):
        inner_m, outer_m = (
            way_m + side * (track.wheel_y_m + half * track.width_m) * left for half in (-0.5, 0.5)
        )
        quads.append(np.stack((inner_m[:-1], inner_m[1:], outer_m[1:], outer_m[:-1]), axis=1))
    values = np.repeat(1 + 254 * (at_m[1:] / max(ends_m[-1], 1e-9)), 2)
    # Where it passes again, the first tracks count.
    return np.stack(quads, axis=1).reshape(-1, 4, 2)[::-1], values[::-1]


def stage_ground(scene: Scene) -> Ground:
    """Return the ground without the detail near cameras; colours must not depend on cameras."""
    ground = scene.ground
    return ground.coarse if isinstance(ground, DetailedGround) else ground


def has_rim(prototype: MeshPrototype, placement: Placement) -> bool:
    """Return whether fines lie around the instances of a placement, which is on the stage."""
    return bool(prototype.dust_m) and not (placement.is_moving or placement.on_land)


class Outlines(NamedTuple):
    """Where N things meet the ground.

    Attributes:
        centre_m: (N, 2) positions in ``map``.
        corners_m: (N, SECTORS, 2) corners of their outlines, relative to ``centre_m``.
        reach_m: (N, SECTORS) widths of their rims.
        uphill_m: (N, 2) how far the outer edges of the rims are shifted.
    """

    centre_m: FloatArray
    corners_m: FloatArray
    reach_m: FloatArray
    uphill_m: FloatArray

    def wider_outlines_m(self, width: float) -> FloatArray:
        """Return the (N, SECTORS, 2) outlines in ``map``, farther out by a share of the reach."""
        length_m = np.linalg.norm(self.corners_m, axis=-1, keepdims=True)
        factor = 1 + width * self.reach_m[..., None] / np.maximum(length_m, 1e-9)
        middle_m = self.centre_m + width * self.uphill_m
        return np.asarray(middle_m[:, None] + factor * self.corners_m)


class ContactPart(NamedTuple):
    """A part of a mesh that stands in the ground.

    Attributes:
        centre_m: (3,) origin of its outlines, in the mesh's frame.
        size_m: Its width.
        top_m: Height of the highest outline.
        outlines_m: (LEVELS, SECTORS, 3) outlines at equal steps of height, from the origin.
    """

    centre_m: FloatArray
    size_m: float
    top_m: float
    outlines_m: FloatArray


def _outlines(
    part: ContactPart, T_map_object: FloatArray, ground: Ground, least_m: float
) -> Outlines:
    """Return the outlines of a part of (N, 4, 4) instances, where it is large enough."""
    scale = np.linalg.norm(T_map_object[:, :3, 0], axis=1)
    is_large = scale * part.size_m >= least_m
    T, scale = T_map_object[is_large], scale[is_large]
    size_m = scale * part.size_m
    origin_m = T[:, :3, :3] @ part.centre_m + T[:, :3, 3]
    centre_m = origin_m[:, :2]
    slope, height_m = ground_plane(ground, centre_m, size_m / 2)
    height_m = np.nan_to_num(height_m)  # off the stage, where the map does not show it
    level = (height_m - origin_m[:, 2]) / scale / max(part.top_m, 1e-6) * (LEVELS - 1)
    corners = part.outlines_m[np.clip(np.round(level), 0, LEVELS - 1).astype(np.intp)]
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
    """Return (N, 2) slopes and (N,) heights of the ground at points; 0 and NaN where it is not."""
    radius_m = np.maximum(radius_m, ground.spacing_m / 2)
    ways = np.array(((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)), np.float64)
    points_m = xy_m + ways[:, None] * radius_m[:, None]
    middle_m, east_m, west_m, north_m, south_m = ground.height_at(points_m.reshape(-1, 2)).reshape(
        len(ways), -1
    )
    slope = np.column_stack((east_m - west_m, north_m - south_m)) / (2 * radius_m[:, None])
    return np.nan_to_num(slope), middle_m


def _contact_parts(prototype: MeshPrototype) -> list[ContactPart]:
    """Return where a mesh may meet the ground: a rock all around, a vehicle with its wheels."""
    vertices_m = prototype.vertices_m.astype(np.float64)
    if prototype.vertex_colors_srgb is None:
        return [_contact_part(vertices_m, np.zeros(3))]
    low = vertices_m[vertices_m[:, 2] <= FOOT * vertices_m[:, 2].max()]
    low = np.unique(np.round(low / FOOT_STEP_M), axis=0) * FOOT_STEP_M
    tree = scipy.spatial.cKDTree(low[:, :2])
    near = tree.sparse_distance_matrix(tree, FOOT_GAP_M)
    count, foot_of = scipy.sparse.csgraph.connected_components(near, directed=False)
    feet = []
    for index in range(count):
        part = low[foot_of == index]
        centre_m = np.append((part[:, :2].min(axis=0) + part[:, :2].max(axis=0)) / 2, 0.0)
        feet.append(_contact_part(part - centre_m, centre_m))
    return feet


def _contact_part(vertices_m: FloatArray, centre_m: FloatArray) -> ContactPart:
    """Return the contact part of (V, 3) vertices relative to its centre."""
    top_m = vertices_m[:, 2].max()
    size_m = float(np.ptp(vertices_m, axis=0).max())
    return ContactPart(centre_m, size_m, float(top_m), _profile(vertices_m))


def _profile(vertices_m: FloatArray) -> FloatArray:
    """Return the (LEVELS, SECTORS, 3) outlines of (V, 3) vertices at some heights."""
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


def _fray(share: NDArray[np.uint8]) -> NDArray[np.uint8]:
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
