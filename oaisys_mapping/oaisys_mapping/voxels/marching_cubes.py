"""Marching cubes over voxel blocks, vectorised over blocks.

Lorensen and Cline, SIGGRAPH 1987, with a computed table: on every face of a cube the crossings
around each run of inside corners are joined, which depends on the face alone, so that neighbouring
cubes agree and the surface has no holes (Bloomenthal, "Polygonization of implicit surfaces", 1988).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_layout import BLOCK_VOXELS, VOXELS, BlockCoordinates

PADDED = BLOCK_VOXELS + 1
"""Samples along an edge of a block's cubes: its own, and the first of its neighbour."""

REGION_BLOCKS = 4
"""Blocks along an edge of a region, the unit in which the surface is meshed."""

REGION_SAMPLES = REGION_BLOCKS * BLOCK_VOXELS + 1

NEIGHBOURS = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)])
"""Offsets to a block and its neighbours ahead along x, y and z; also the corners of a cube."""

EDGES = tuple((corner, axis) for corner in range(8) for axis in range(3) if not corner >> axis & 1)
"""A cube's edges: the corner where each starts, and its axis."""

NO_COLOR = 128 / 255
"""Colour of vertices without one, 0 to 1."""

ClassesAt = Callable[[FloatArray], tuple[NDArray[np.uint16], NDArray[np.float32]]]
"""Returns the (N,) classes at (N, 3) points, and their shares of the votes."""

_SAMPLES = PADDED**3
_STEPS = np.array((1, PADDED, PADDED**2))
_REGION_STEPS = np.array((1, REGION_SAMPLES, REGION_SAMPLES**2))


@dataclass(frozen=True)
class RegionSurfaces:
    """The surfaces of some regions, one after the other.

    Attributes:
        vertices_m: (V, 3) float64.
        key: (V,) the vertex's edge, by the sample of the region at its start and its axis:
            ``3 * (x + 33 (y + 33 z)) + axis``. Vertices are sorted by region, then by key.
        triangles: (T, 3) int32 vertex indices, by region.
        colors_rgb: (V, 3) uint8.
        class_ids, class_probabilities: (V,), or None.
        vertex_ends, triangle_ends: (R + 1,) bounds of each region's vertices and triangles.
    """

    vertices_m: FloatArray
    key: NDArray[np.int32]
    triangles: NDArray[np.int32]
    colors_rgb: NDArray[np.uint8]
    class_ids: NDArray[np.uint16] | None
    class_probabilities: NDArray[np.float32] | None
    vertex_ends: NDArray[np.intp]
    triangle_ends: NDArray[np.intp]


@cache
def triangle_table() -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return the triangles of all 256 cubes, and where those of each cube start and end.

    Bit i of a cube's number is set if corner i (`NEIGHBOURS`) is inside. Triangles are (T, 3)
    indices into `EDGES`, counter-clockwise as seen from outside.
    """
    triangles: list[tuple[int, int, int]] = []
    ends = [0]
    for cube in range(256):
        for loop in _loops(cube):
            triangles += [(loop[0], loop[i + 1], loop[i]) for i in range(1, len(loop) - 1)]
        ends.append(len(triangles))
    limits = np.array(ends, np.int32)
    return np.array(triangles, np.int32), limits[:-1], limits[1:]


def _loops(cube: int) -> list[list[int]]:
    """Return the closed loops of crossed edges of a cube."""
    following: dict[int, int] = {}
    for axis in range(3):
        for side in (0, 1):
            following |= _crossings(cube, axis, side)
    loops = []
    while following:
        loop = [next(iter(following))]
        while (edge := following.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        loops.append(loop)
    return loops


def _crossings(cube: int, axis: int, side: int) -> dict[int, int]:
    """Map, for each run of inside corners of a face, the edge after it to the edge before it."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    ring = [(0, 0), (1, 0), (1, 1), (0, 1)]
    corners = [side << axis | i << a | j << b for i, j in (ring if side else ring[::-1])]
    is_inside = [bool(cube >> corner & 1) for corner in corners]
    found = {}
    for start in range(4):
        if is_inside[start] and not is_inside[start - 1]:
            end = start
            while is_inside[(end + 1) % 4]:
                end += 1
            after = _edge(corners[end % 4], corners[(end + 1) % 4])
            found[after] = _edge(corners[start - 1], corners[start])
    return found


def _edge(one: int, other: int) -> int:
    return EDGES.index((min(one, other), (one ^ other).bit_length() - 1))


def region_surfaces(
    arrays: Mapping[str, NDArray[Any]],
    blocks: BlockCoordinates,
    slots: NDArray[np.int32],
    region: NDArray[np.intp],
    regions: int,
    voxel_size_m: float,
    classes_at: ClassesAt | None,
) -> RegionSurfaces:
    """Return the zero level set in regions, in cubes whose corners have all been observed.

    Args:
        arrays: Fields of voxels, indexed by slot.
        blocks: (N, 3) blocks, grouped by region.
        slots: (N, 8) slots of each block and its `NEIGHBOURS`; -1 for those that do not exist.
        region: (N,) index of each block's region.
        regions: Number of regions.
        voxel_size_m: Edge length of a voxel.
        classes_at: Gives the vertices' classes; None: they have none.
    """
    samples = _pad_samples(arrays, slots)
    cells, cubes = _find_cubes(samples)
    edges, count = _edges_of_cubes(cubes)
    corner = _corner_in_region(blocks, cells)
    place = 3 * (region[cells // _SAMPLES] * REGION_SAMPLES**3 + corner @ _REGION_STEPS)
    keys = np.repeat(place, count)[:, None] + _edge_keys(REGION_SAMPLES)[edges]
    # A vertex is found from up to four blocks, all with the same result.
    found = np.full(3 * regions * REGION_SAMPLES**3, -1, np.int32)
    found[keys] = np.repeat(3 * cells, count)[:, None] + _edge_keys(PADDED)[edges]
    vertices = np.flatnonzero(found >= 0)
    number = np.empty(len(found), np.int32)
    number[vertices] = np.arange(len(vertices), dtype=np.int32)
    own = found[vertices].astype(np.int64)
    along, offsets = _places(samples, own)
    block = own // (3 * _SAMPLES)
    vertices_m = (blocks[block].astype(np.float64) * BLOCK_VOXELS + offsets) * voxel_size_m
    ids, probabilities = classes_at(vertices_m) if classes_at is not None else (None, None)
    starts = 3 * REGION_SAMPLES**3 * np.arange(regions + 1)
    return RegionSurfaces(
        vertices_m=vertices_m,
        key=(vertices % (3 * REGION_SAMPLES**3)).astype(np.int32),
        triangles=number[keys],
        colors_rgb=_colors(arrays, slots, own, along),
        class_ids=ids,
        class_probabilities=probabilities,
        vertex_ends=np.searchsorted(vertices, starts),
        triangle_ends=np.searchsorted(keys[:, 0], starts),
    )


def _edges_of_cubes(cubes: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the (T, 3) edges of all cubes' triangles, and each cube's number of triangles."""
    triangles, first, end = triangle_table()
    count = (end - first)[cubes]
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return triangles[np.repeat(first[cubes], count) + within], count


def _corner_in_region(blocks: BlockCoordinates, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N, 3) samples at which cubes start, counted within their regions."""
    corner = blocks % REGION_BLOCKS * BLOCK_VOXELS
    return np.asarray(corner[cells // _SAMPLES] + _sample_places(cells))


def _pad_samples(
    arrays: Mapping[str, NDArray[Any]], slots: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return (N, 9, 9, 9) distances by z, y, x; NaN where nothing was observed."""
    cubes = (-1, BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    distance, weight = arrays["tsdf"].reshape(cubes), arrays["weight"].reshape(cubes)
    samples = np.empty((len(slots), PADDED, PADDED, PADDED), np.float32)
    for neighbour, ahead in enumerate(NEIGHBOURS):
        z, y, x = (0 if is_ahead else slice(None) for is_ahead in ahead[::-1])
        to_z, to_y, to_x = (
            BLOCK_VOXELS if is_ahead else slice(BLOCK_VOXELS) for is_ahead in ahead[::-1]
        )
        slot = slots[:, neighbour]
        found = distance[slot, z, y, x]
        found[weight[slot, z, y, x] <= 0] = np.nan
        found[slot < 0] = np.nan
        samples[:, to_z, to_y, to_x] = found
    return samples


def _find_cubes(samples: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return the flat samples at which crossed cubes start, and the cubes' numbers."""
    is_inside = samples < 0
    each = is_inside.reshape(len(samples), _SAMPLES)
    mixed = np.flatnonzero(each.any(axis=1) & ~each.all(axis=1))
    is_inside, is_whole = is_inside[mixed].view(np.uint8), ~np.isnan(samples[mixed])
    cubes = np.zeros((len(mixed), *(3 * (BLOCK_VOXELS,))), np.uint8)
    for corner, (x, y, z) in enumerate(NEIGHBOURS):
        cubes |= is_inside[:, z : z + 8, y : y + 8, x : x + 8] << np.uint8(corner)
    is_whole = is_whole[:, :-1] & is_whole[:, 1:]
    is_whole = is_whole[:, :, :-1] & is_whole[:, :, 1:]
    is_whole = is_whole[..., :-1] & is_whole[..., 1:]
    cells = np.flatnonzero(is_whole & (cubes != 0) & (cubes != 255))
    block, z, y, x = np.unravel_index(cells, cubes.shape)
    starts_at = mixed[block] * _SAMPLES + z * _STEPS[2] + y * _STEPS[1] + x
    return starts_at, cubes.ravel()[cells]


@cache
def _edge_keys(samples: int) -> NDArray[np.int64]:
    """Return the offset of each edge's key from three times the number of the cube's sample.

    Args:
        samples: Samples along an edge of the grid in which the sample is counted.
    """
    steps = (1, samples, samples**2)
    return np.array([3 * int(NEIGHBOURS[corner] @ steps) + axis for corner, axis in EDGES])


def _places(
    samples: NDArray[np.float32], vertices: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return each vertex's position along its edge, 0 to 1, and (V, 3) offset from its block."""
    sample, axis = vertices // 3, vertices % 3
    flat = samples.ravel()
    begin, end = flat[sample], flat[sample + _STEPS[axis]]
    along = begin / (begin - end)
    offsets = _sample_places(sample).astype(np.float32)
    offsets[np.arange(len(axis)), axis] += along
    return along, offsets


def _sample_places(sample: NDArray[np.int64]) -> NDArray[np.int64]:
    within = sample % _SAMPLES
    return np.column_stack((within % PADDED, within // PADDED % PADDED, within // PADDED**2))


def _colors(
    arrays: Mapping[str, NDArray[Any]],
    slots: NDArray[np.int32],
    vertices: NDArray[np.int64],
    along: NDArray[np.float32],
) -> NDArray[np.uint8]:
    """Return the (V, 3) colours, interpolated between the ends of each vertex's edge."""
    sample, axis = vertices // 3, vertices % 3
    ends = [_voxels(slots, one) for one in (sample, sample + _STEPS[axis])]
    shares = (1 - along, along)
    color, total = np.zeros((len(along), 3), np.float32), np.zeros(len(along), np.float32)
    for voxel, share in zip(ends, shares, strict=True):
        end_color = arrays["color"].reshape(-1, 4)[voxel]
        is_colored = share * (end_color[:, 3] > 0)
        color += end_color[:, :3] * is_colored[:, None]
        total += is_colored
    color[total <= 0], total[total <= 0] = NO_COLOR, 1
    share = np.clip(color / total[:, None], 0, 1)
    return np.asarray(np.rint(share * 255).astype(np.uint8))


def _voxels(slots: NDArray[np.int32], sample: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the flat voxels of flat samples, which may lie in neighbouring blocks."""
    x, y, z = _sample_places(sample).T
    ahead = (x // BLOCK_VOXELS) + 2 * (y // BLOCK_VOXELS) + 4 * (z // BLOCK_VOXELS)
    within = x % BLOCK_VOXELS + BLOCK_VOXELS * (
        y % BLOCK_VOXELS + BLOCK_VOXELS * (z % BLOCK_VOXELS)
    )
    return np.asarray(slots[sample // _SAMPLES, ahead].astype(np.int64) * VOXELS + within)
