"""Blades on a tile as one mesh, and what rays from above see of them: grass, leaves, needles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.raycast.open3d_bvh import Open3DBvh
from oaisys_core.types import FloatArray

Outline = Callable[[FloatArray], FloatArray]
"""Function of the share of a blade's length: half of its width there, 0 to 1."""

LEAST_PX, MOST_AS_ONE = 0.5, 8.0
"""Texels that a blade is wide at least, as far as one stands for no more than so many."""

ABOVE = 0.001
"""Distance, in tile edges, from the highest point to where rays start."""


class Blades(NamedTuple):
    """Thin strips that rise from their feet and bend over: one value for each.

    Lengths are in tile edges, and angles in radians.

    Attributes:
        foot: (B, 3) row, column and height.
        heading: (B,) direction in which they lean, from columns towards rows.
        length: (B,) along the blade.
        width: (B,) at the widest.
        lean: (B,) angle from the vertical at the foot.
        droop: (B,) how much larger it is at the tip.
        sway: (B,) how much further the heading turns from foot to tip.
        outline: Of all of them.
        segments: Flat parts of each.
    """

    foot: FloatArray
    heading: FloatArray
    length: FloatArray
    width: FloatArray
    lean: FloatArray
    droop: FloatArray
    sway: FloatArray
    outline: Outline
    segments: int = 4


class BladeView(NamedTuple):
    """What is seen of blades from above; blades count through all groups.

    Attributes:
        height: (N, N) float32 in tile edges; `-inf` where there is no blade.
        ids: (N, N) int32 index of the blade, -1 where there is none.
        along: (N, N) float32 share of its length, from 0 at its foot to 1.
        across: (N, N) float32 place between its edges, -1 to 1.
        facing: (N, N) float32 cosine between the vertical and the blade's normal.
    """

    height: Field
    ids: NDArray[np.int32]
    along: Field
    across: Field
    facing: Field


def grass_outline(along: FloatArray) -> FloatArray:
    """Return the outline of a blade of grass: nearly even, then a point."""
    return np.asarray(np.sqrt(1 - along**3))


def taper_outline(along: FloatArray) -> FloatArray:
    """Return the outline of a leaf that narrows evenly from its foot to its tip."""
    return 1 - along


def leaflet_outline(along: FloatArray) -> FloatArray:
    """Return the outline of a leaflet of clover: widest beyond its middle, and blunt."""
    return np.asarray(np.sqrt(np.sin(np.pi * np.clip(along, 0, 1) ** 1.25)))


def leaf_outline(along: FloatArray) -> FloatArray:
    """Return the outline of a lanceolate leaf: a stalk, a belly, a point."""
    belly = np.sin(np.pi * np.clip((along - 0.12) / 0.88, 0, 1) ** 0.9)
    return np.asarray(np.maximum(belly, 0.1 * (along < 0.97)))


def blades_as_one(width: float, size_px: int) -> float:
    """Return how many blades one of their joint width stands for, 1 where a texel shows them.

    Args:
        width: Mean width of a blade in tile edges.
        size_px: Edge length of the tile.
    """
    return float(np.clip(LEAST_PX / (width * size_px), 1, MOST_AS_ONE))


def texels_at(places: FloatArray, size_px: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of texels at (..., 2) places in tile edges, beyond 0 to 1 too."""
    texel = np.floor(places * size_px).astype(np.intp) % size_px
    return texel[..., 0], texel[..., 1]


def cast_blades(groups: Sequence[Blades], size_px: int) -> BladeView:
    """Cast a ray on each texel of a tile from above; blades go on across its edges.

    Args:
        groups: The blades.
        size_px: Edge length of the result.
    """
    mesh = _joined([_mesh(group) for group in groups], [len(each.length) for each in groups])
    top = np.float32(mesh.vertices[:, 2].max() + ABOVE)
    bvh = Open3DBvh(mesh.vertices, mesh.triangles)
    distance, element, place = bvh.first_places(*_rays_down(size_px, top))
    is_hit = np.isfinite(distance)
    element = np.where(is_hit, element, 0)
    second, third = place.T
    # The second triangle of a part has two corners at its end, and the first one has one.
    is_second = (element & 1).astype(np.bool_)
    end = np.where(is_second, second + third, third)
    side = np.where(is_second, second, second + third)
    along = mesh.begin[element] + end * mesh.share[element]
    parts = (
        np.where(is_hit, top - distance, np.float32(-np.inf)),
        np.where(is_hit, mesh.blade[element], -1),
        along * is_hit,
        (2 * side - 1) * is_hit,
        np.where(is_hit, mesh.facing[element], np.float32(1)),
    )
    return BladeView(*(part.reshape(size_px, size_px) for part in parts))


def _rays_down(size_px: int, top: np.float32) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (N * N, 3) origins above the texels' centres, and directions."""
    axis = ((np.arange(size_px) + 0.5) / size_px).astype(np.float32)
    origins = np.empty((size_px, size_px, 3), np.float32)
    origins[..., 0], origins[..., 1], origins[..., 2] = axis[:, None], axis[None, :], top
    return origins.reshape(-1, 3), np.broadcast_to(
        np.array((0, 0, -1), np.float32), (size_px**2, 3)
    )


class _Mesh(NamedTuple):
    """Triangles of blades; the two of each part follow each other.

    Attributes:
        vertices: (V, 3) row, column, height in tile edges.
        triangles: (T, 3).
        blade: (T,) index of the blade.
        begin, share: (T,) share of the blade's length before its part, and of the part.
        facing: (T,) see `BladeView`.
    """

    vertices: FloatArray
    triangles: NDArray[np.int32]
    blade: NDArray[np.int32]
    begin: NDArray[np.float32]
    share: NDArray[np.float32]
    facing: NDArray[np.float32]


def _joined(meshes: Sequence[_Mesh], counts: Sequence[int]) -> _Mesh:
    """Return the meshes of groups, of so many blades each, as one."""
    corners = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    blades = np.cumsum([0, *counts])
    return _Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [m.triangles + np.int32(k) for m, k in zip(meshes, corners[:-1], strict=True)]
        ),
        np.concatenate([m.blade + np.int32(k) for m, k in zip(meshes, blades[:-1], strict=True)]),
        *(np.concatenate([mesh[k] for mesh in meshes]) for k in (3, 4, 5)),
    )


def _mesh(blades: Blades) -> _Mesh:
    """Return the mesh of a group; those that cross the tile's edges come in on the other side."""
    edges, facing = _edges(blades)
    low, high = edges[..., :2].min(axis=(1, 2)), edges[..., :2].max(axis=(1, 2))
    copies, which = [], []
    for shift in np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2):
        number = np.flatnonzero(((high + shift > 0) & (low + shift < 1)).all(axis=1))
        copies.append(edges[number] + np.array((*shift, 0)))
        which.append(number)
    blade = np.concatenate(which).astype(np.int32)
    segments = blades.segments
    left = 2 * np.arange(segments, dtype=np.int32)
    corners = np.stack((left, left + 1, left + 3, left, left + 3, left + 2), axis=1).reshape(-1, 3)
    first = np.arange(len(blade), dtype=np.int32) * (2 * (segments + 1))
    begin = np.repeat(np.arange(segments, dtype=np.float32) / segments, 2)
    return _Mesh(
        np.concatenate(copies).reshape(-1, 3),
        (first[:, None, None] + corners).reshape(-1, 3),
        np.repeat(blade, 2 * segments),
        np.tile(begin, len(blade)),
        np.full(2 * segments * len(blade), 1 / segments, np.float32),
        np.repeat(facing[blade], 2, axis=1).reshape(-1),
    )


def _edges(blades: Blades) -> tuple[FloatArray, NDArray[np.float32]]:
    """Return the (B, S + 1, 2, 3) places of both edges, and (B, S) of `BladeView.facing`."""
    share = np.linspace(0, 1, blades.segments + 1)
    middle = (share[1:] + share[:-1]) / 2
    angle = blades.lean[:, None] + blades.droop[:, None] * middle
    way = blades.heading[:, None] + blades.sway[:, None] * middle
    step = blades.length[:, None] / blades.segments
    level = step * np.sin(angle)
    steps = np.stack((level * np.sin(way), level * np.cos(way), step * np.cos(angle)), axis=-1)
    line = np.concatenate((np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)), axis=1)
    line += blades.foot[:, None]
    way = np.concatenate((way[:, :1], way), axis=1)
    half = blades.width[:, None] / 2 * blades.outline(share)
    side = np.stack((half * np.cos(way), -half * np.sin(way), np.zeros_like(half)), axis=-1)
    facing = np.abs(np.sin(angle)).astype(np.float32)
    return np.stack((line - side, line + side), axis=2), facing
