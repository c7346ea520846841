"""A mesh kept by region, so that only regions that a view changed are meshed again."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    BlockCoordinates,
    BlockReader,
    block_keys,
    blocks_of_keys,
)
from oaisys_mapping.voxels.integration import POOL
from oaisys_mapping.voxels.marching_cubes import (
    NEIGHBOURS,
    REGION_BLOCKS,
    REGION_SAMPLES,
    ClassesAt,
    RegionSurfaces,
    region_surfaces,
)

BATCH_REGIONS = 8
"""Regions that are meshed at a time."""

_REGION_VOXELS = REGION_BLOCKS * BLOCK_VOXELS
_IN_REGION = np.indices(3 * (REGION_BLOCKS,)).reshape(3, -1).T


@dataclass(frozen=True)
class _RegionMesh:
    """The surface in one region; see `RegionSurfaces`.

    Attributes:
        shared: (S,) vertices on the region's border, which neighbouring regions have, too.
        shared_key: (S,) key of each such vertex, the same in all regions.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    colors_rgb: NDArray[np.uint8]
    class_ids: NDArray[np.uint16]
    class_probabilities: NDArray[np.float32]
    shared: NDArray[np.intp]
    shared_key: NDArray[np.int64]


class IncrementalMesh:
    """The surfaces of regions of blocks, and which of them are out of date.

    Args:
        voxel_size_m: Edge length of a voxel.
        classes_at: Gives the vertices' classes; None: they have none.
    """

    def __init__(self, voxel_size_m: float, classes_at: ClassesAt | None) -> None:
        self._voxel_size_m = voxel_size_m
        self._classes_at = classes_at
        self._meshes: dict[int, _RegionMesh] = {}
        self._stale: list[NDArray[np.int64]] = []

    def mark_changed(self, blocks: BlockCoordinates) -> None:
        """Mark the regions as stale whose surface depends on voxels of (N, 3) blocks."""
        if len(blocks):
            behind = (blocks[:, None] - NEIGHBOURS).reshape(-1, 3) // REGION_BLOCKS
            self._stale.append(np.unique(block_keys(behind)))

    def keep_only(self, blocks: BlockCoordinates) -> None:
        """Forget all regions that contain none of (N, 3) blocks."""
        kept = np.unique(block_keys(blocks // REGION_BLOCKS))
        known = set(kept.tolist())
        self._meshes = {number: mesh for number, mesh in self._meshes.items() if number in known}
        self._stale = [np.intersect1d(stale, kept) for stale in self._stale]

    def update(self, read: BlockReader) -> None:
        """Mesh the stale regions."""
        stale = np.unique(np.concatenate([_NO_KEYS, *self._stale]))
        self._stale.clear()
        for number in stale.tolist():
            self._meshes.pop(number, None)
        self._meshes.update(self._surfaces(stale, read))

    def mesh(self, others: BlockCoordinates, read: BlockReader) -> ColoredMesh:
        """Return the mesh of all regions kept here, and of the regions of (N, 3) other blocks.

        Vertices are ordered by region, so equal surfaces have equal bytes.
        """
        meshes = dict(self._meshes)
        regions = np.unique(block_keys(others // REGION_BLOCKS))
        missing = np.setdiff1d(regions, np.fromiter(meshes, np.int64, len(meshes)))
        meshes.update(self._surfaces(missing, read))
        return self._join([meshes[number] for number in sorted(meshes)])

    def _surfaces(
        self, regions: NDArray[np.int64], read: BlockReader
    ) -> Iterable[tuple[int, _RegionMesh]]:
        parts = [regions[i : i + BATCH_REGIONS] for i in range(0, len(regions), BATCH_REGIONS)]

        def work(part: NDArray[np.int64]) -> list[tuple[int, _RegionMesh]]:
            corners = blocks_of_keys(part)
            blocks = (corners[:, None] * REGION_BLOCKS + _IN_REGION).reshape(-1, 3)
            exists = np.flatnonzero(read(blocks)[1] >= 0)
            blocks, region = blocks[exists], exists // len(_IN_REGION)
            arrays, slots = read((blocks[:, None] + NEIGHBOURS).reshape(-1, 3))
            slots = slots.reshape(-1, len(NEIGHBOURS))
            size_m, classes_at = self._voxel_size_m, self._classes_at
            found = region_surfaces(arrays, blocks, slots, region, len(part), size_m, classes_at)
            return _split(part, corners, found)

        for done in POOL.map(work, parts):
            yield from done

    def _join(self, meshes: list[_RegionMesh]) -> ColoredMesh:
        if not meshes:
            return _no_mesh(has_classes=self._classes_at is not None)
        counts = np.array([len(mesh.vertices_m) for mesh in meshes])
        faces = np.array([len(mesh.triangles) for mesh in meshes])
        first = np.cumsum(counts) - counts
        kept, number = _weld(meshes, first, int(counts.sum()))
        local = np.concatenate([mesh.triangles for mesh in meshes])
        local += np.repeat(first, faces).astype(np.int32)[:, None]
        ids, probabilities = None, None
        if self._classes_at is not None:
            ids = np.concatenate([mesh.class_ids for mesh in meshes])[kept]
            probabilities = np.concatenate([mesh.class_probabilities for mesh in meshes])[kept]
        return ColoredMesh(
            np.concatenate([mesh.vertices_m for mesh in meshes]).take(kept, axis=0),
            number[local],
            np.concatenate([mesh.colors_rgb for mesh in meshes]).take(kept, axis=0),
            ids,
            probabilities,
        )


def _split(
    regions: NDArray[np.int64], corners: BlockCoordinates, found: RegionSurfaces
) -> list[tuple[int, _RegionMesh]]:
    """Return the surfaces of those regions that have one, by region key."""
    samples = np.column_stack(np.unravel_index(found.key // 3, 3 * (REGION_SAMPLES,)))[:, ::-1]
    is_shared = ((samples == 0) | (samples == _REGION_VOXELS)).any(axis=1)
    meshes = []
    for index, number in enumerate(regions.tolist()):
        part = slice(*found.vertex_ends[index : index + 2].tolist())
        if part.start == part.stop:
            continue
        faces = slice(*found.triangle_ends[index : index + 2].tolist())
        shared = np.flatnonzero(is_shared[part])
        sample = samples[part][shared] + _REGION_VOXELS * corners[index].astype(np.int64)
        mesh = _RegionMesh(
            found.vertices_m[part].copy(),
            found.triangles[faces] - np.int32(part.start),
            found.colors_rgb[part].copy(),
            _NO_IDS if found.class_ids is None else found.class_ids[part].copy(),
            _NO_SHARES
            if found.class_probabilities is None
            else found.class_probabilities[part].copy(),
            shared,
            _edge_numbers(sample, found.key[part][shared] % 3),
        )
        meshes.append((number, mesh))
    return meshes


def _edge_numbers(sample: NDArray[np.int64], axis: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return one number for each edge of the grid, from its start and its axis."""
    x, y, z = sample.T + (1 << 19)
    return np.asarray(((x << 40) | (y << 20) | z) * 3 + axis)


def _weld(
    meshes: list[_RegionMesh], first: NDArray[np.int64], count: int
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the vertices kept, the first on each edge, and every vertex's new number."""
    sizes = [len(mesh.shared) for mesh in meshes]
    shared = np.concatenate([mesh.shared for mesh in meshes]) + np.repeat(first, sizes)
    key = np.concatenate([mesh.shared_key for mesh in meshes])
    order = np.argsort(key, kind="stable")
    is_first = np.ones(len(order), bool)
    is_first[1:] = key[order[1:]] != key[order[:-1]]
    leader = order[is_first][np.cumsum(is_first) - 1]
    is_kept = np.ones(count, bool)
    is_kept[shared[order[~is_first]]] = False
    kept = np.flatnonzero(is_kept)
    number = np.cumsum(is_kept, dtype=np.int32) - np.int32(1)
    number[shared[order]] = number[shared[leader]]
    return kept, number


def _no_mesh(*, has_classes: bool) -> ColoredMesh:
    classes = (_NO_IDS, _NO_SHARES) if has_classes else (None, None)
    return ColoredMesh(
        np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8), *classes
    )


_NO_KEYS = np.zeros(0, np.int64)
_NO_IDS = np.zeros(0, np.uint16)
_NO_SHARES = np.zeros(0, np.float32)
