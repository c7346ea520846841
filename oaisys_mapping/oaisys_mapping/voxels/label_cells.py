"""Classes in cells finer than voxels, told by the places that pixels show.

A voxel asks the pixel that it projects to, and near a step or a small thing that pixel shows what
lies beside or below: classes of voxels are right to about a voxel. Here each pixel tells the one
cell in which the point lies that it shows, and counts as much as it covers of the cell's surface,
so that the steep side of a rock, which few pixels show, is not outvoted by the ground. Cells are a
refinement: where no pixel fell, there was no room, or pixels are as far apart as cells (beyond 19 m
at 10 cm voxels and 640 pixels), voxels tell.

On the demo's worlds, rocks seen from 10 m above, the IoU of rock grows from 0.90 to 0.94.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_cache import BlockCache
from oaisys_mapping.voxels.blocks import (
    BLOCK_VOXELS,
    INITIAL_BLOCKS,
    VOXELS,
    Coordinates,
    VoxelField,
    block_bytes,
    distinct_blocks,
    packed,
)
from oaisys_mapping.voxels.padded_images import PaddedImages
from oaisys_mapping.voxels.semantic_fusion import UNLABELLED, fuse_classes

VOXEL_CELLS = 2
"""Cells along a voxel's edge. On the demo's worlds 1 / 2 / 3 give an IoU of rock of 0.89 / 0.935 /
0.927: still finer ones are too often missed by all pixels."""

CELL_FIELDS = (
    VoxelField("cell_class_id", "uint16", 2),
    VoxelField("cell_class_weight", "float32", 2),
)
"""A cell keeps two classes: one border may run through it."""

BLOCK_SHARE = 4
"""Blocks of cells that there may be for each block of voxels. Rocky terrain has
2.5; 8 would cover all."""

BYTES_PER_BLOCK = BLOCK_SHARE * block_bytes(CELL_FIELDS)
"""Most memory that cells take for each block of voxels."""

ASKED = ((0, 0), (1, 1))
"""First row and column of the pixels that are asked, every second one in every second row each: the
fields of one colour of a chessboard. All four would cost twice the time for an IoU of 0.002."""

STEEPEST = 5.0
"""Most times that a pixel's area on the surface counts more than one seen face on."""

CLASSES = 1 << 16
"""Numbers of classes that there may be."""

BLOCK_SHIFT = BLOCK_VOXELS.bit_length() - 1

_IN_BLOCK = np.indices(3 * (VOXEL_CELLS,)).reshape(3, -1).T.astype(np.int32)


@dataclass(frozen=True)
class _Shown:
    """What labelled pixels of a view show.

    Attributes:
        cell: (3, N) int32 cells, counted from the first of block ``base``.
        base: (3,) block of cells.
        labels: (N,) uint16.
        weights: (N,) float32, at most 1.
    """

    cell: NDArray[np.int32]
    base: NDArray[np.int32]
    labels: NDArray[np.uint16]
    weights: NDArray[np.float32]


class LabelCells:
    """The cells of a volume; they come and go with its blocks of voxels.

    Args:
        voxel_size_m: Edge length of a voxel of the volume.
        most_blocks: Of voxels that may be in memory.
        store_folder: Where those go that the camera has left.
    """

    def __init__(self, voxel_size_m: float, most_blocks: int, store_folder: Path | None) -> None:
        self.cell_m = voxel_size_m / VOXEL_CELLS
        self._working = BlockCache(
            self.cell_m,
            CELL_FIELDS,
            most_blocks=BLOCK_SHARE * most_blocks,
            when_full="refuse",
            store_folder=store_folder,
            initial_blocks=2 * INITIAL_BLOCKS,
        )
        self.values = self._working.values
        self.rows = self._working.rows
        self.fill = self._working.fill

    @property
    def blocks_in_memory(self) -> int:
        """How many blocks of cells are in memory."""
        return self._working.in_memory

    @property
    def all_blocks(self) -> Coordinates:
        """The (N, 3) blocks of cells in memory and on disk, in `block_order`."""
        return self._working.all_blocks

    def follow(self, gone: Coordinates, restored: Coordinates, *, stores: bool) -> None:
        """Let cells go with (N, 3) blocks of voxels, and come back with (M, 3) others.

        Raises:
            VolumeFullError: The disk is full.
        """
        if len(gone):
            self._working.put_away(_blocks_within(gone), stores=stores)
        if len(restored):
            self._working.bring_back(_blocks_within(restored))

    def vote(self, seen: PaddedImages, near: Coordinates) -> Coordinates:
        """Count what a view's pixels show; return the (N, 3) blocks of voxels where they did.

        Args:
            seen: The view.
            near: (N, 3) blocks of voxels that have cells, all in memory.
        """
        shown = _shown(seen, self.cell_m)
        if shown is None:
            return _NO_BLOCKS
        blocks, place = distinct_blocks(shown.cell >> BLOCK_SHIFT)
        blocks += shown.base
        slots = np.full(len(blocks), -1, np.int32)
        kept = np.flatnonzero(np.isin(packed(blocks // VOXEL_CELLS), packed(near)))
        slots[kept] = self._working.add(blocks[kept])
        x, y, z = shown.cell & (BLOCK_VOXELS - 1)
        place <<= 3 * BLOCK_SHIFT
        place += x + (y << BLOCK_SHIFT) + (z << 2 * BLOCK_SHIFT)
        self._count(place, slots, shown)
        voted, _ = distinct_blocks((blocks[slots >= 0] // VOXEL_CELLS).T)
        return voted

    def _count(self, place: NDArray[np.intp], slots: NDArray[np.int32], shown: _Shown) -> None:
        """Add up the weights that each cell gets for each label, and fuse them.

        Args:
            place: (N,) each pixel's cell, by the number of its block and its own in that.
            slots: (B,) of the blocks; -1: none.
            shown: What the pixels say.
        """
        ids, weights = (
            self._working.arrays[field.name].reshape(-1, field.channels) for field in CELL_FIELDS
        )
        is_shown = np.zeros(len(slots) * VOXELS, bool)
        is_shown[place] = True
        cells = np.flatnonzero(is_shown)
        number = np.empty(len(is_shown), np.int32)
        number[cells] = np.arange(len(cells), dtype=np.int32)
        number = number[place]
        slot = slots[cells >> 3 * BLOCK_SHIFT].astype(np.int64)
        at = (slot << 3 * BLOCK_SHIFT) + (cells & (VOXELS - 1))
        is_told = np.zeros(CLASSES, bool)
        is_told[shown.labels] = True
        for label in np.flatnonzero(is_told).astype(np.uint16):
            is_so = np.flatnonzero(shown.labels == label)
            weight = np.bincount(number[is_so], shown.weights[is_so], len(cells))
            told = np.flatnonzero((weight > 0) & (slot >= 0))
            labels = np.full(len(told), label)
            fuse_classes(ids, weights, at[told], labels, weight[told].astype(np.float32))


def _shown(seen: PaddedImages, cell_m: float) -> _Shown | None:
    """Return what a view's pixels show; None if none of them has both a label and a depth."""
    matrix, camera_m = seen.to_map
    # Counted from near the camera: float32 is exact enough for what its range covers.
    base = np.floor(camera_m / (cell_m * BLOCK_VOXELS)).astype(np.int32)
    offset = camera_m / cell_m - BLOCK_VOXELS * base.astype(np.float64)
    far_m = _farthest_m(matrix, cell_m)
    parts = [_shown_by(_Lattice(seen, *first), matrix, offset, cell_m, far_m) for first in ASKED]
    cell, labels, weights = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    return _Shown(cell, base, labels, weights) if len(labels) else None


@dataclass(frozen=True)
class _Lattice:
    """Every second pixel of every second row of a view, and their neighbours.

    Attributes:
        row, column: The first pixel: 0 or 1.
    """

    seen: PaddedImages
    row: int
    column: int

    def of(self, image: NDArray[Any], below: int = 0, right: int = 0) -> NDArray[Any]:
        """Return a bordered image's values at the pixels, or so far from them."""
        row, column = self.row + 1 + below, self.column + 1 + right
        rows, stride = self.seen.rows - 2, self.seen.stride - 2
        bordered = image.reshape(self.seen.rows, self.seen.stride)
        return bordered[row : rows + 1 + below : 2, column : stride + 1 + right : 2]


def _shown_by(
    pixels: _Lattice, matrix: FloatArray, offset: FloatArray, cell_m: float, far_m: float
) -> tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.float32]]:
    """Return the (3, N) cells of those pixels that tell some, their labels and weights.

    Args:
        pixels: Some of a view's.
        matrix: (3, 3) that gives a point of z times (column, row, 1).
        offset: (3,) the camera, in cells.
        cell_m: Edge length of a cell.
        far_m: Depth beyond which no pixel tells anything.
    """
    seen = pixels.seen
    assert seen.labels is not None
    depth_m, labels = pixels.of(seen.depth_m), pixels.of(seen.labels)
    is_told = (depth_m > 0) & (depth_m < far_m) & (labels != UNLABELLED)
    told = np.flatnonzero(is_told)
    cell = np.empty((3, len(told)), np.int32)
    if not len(told):
        return cell, labels[is_told], depth_m[is_told]
    depth_m = np.where(is_told, depth_m, np.float32(0))
    along_u, along_v, ahead = (matrix / cell_m).T[:, :, None]
    rows = along_v * (pixels.row + 2 * np.arange(depth_m.shape[0])) + ahead
    columns = along_u * (pixels.column + 2 * np.arange(depth_m.shape[1]))
    rows, columns = rows.astype(np.float32), columns.astype(np.float32)
    for axis in range(3):
        place = rows[axis, :, None] + columns[axis]
        place *= depth_m
        place += np.float32(offset[axis])
        np.rint(place, out=place)
        cell[axis] = _at(place, told)
    share = _areas_m2(pixels, matrix) * np.float32(4 / len(ASKED) / cell_m**2)
    weight = np.minimum(share, np.float32(1), out=share)
    if seen.weight is not None:
        weight *= pixels.of(seen.weight)
    return cell, _at(labels, told), _at(weight, told)


def _farthest_m(matrix: FloatArray, cell_m: float) -> float:
    """Return the depth at which pixels that are asked are as far apart as cells."""
    size_u, size_v = (float(np.linalg.norm(matrix[:, axis])) for axis in (0, 1))
    return float(cell_m * np.sqrt(len(ASKED) / 4 / (size_u * size_v)))


def _at(image: NDArray[Any], pixels: NDArray[np.intp]) -> NDArray[Any]:
    """Return an image's values at some of its pixels, which often are all."""
    return image.ravel() if len(pixels) == image.size else image.ravel()[pixels]


def _areas_m2(pixels: _Lattice, matrix: FloatArray) -> NDArray[np.float32]:
    """Return the (H, W) area of surface that each pixel shows.

    It is that of the parallelogram between the derivatives of its point by column and row.
    """
    depth_m = pixels.of(pixels.seen.depth_m)
    size_u, size_v = (float(np.linalg.norm(matrix[:, axis])) for axis in (0, 1))
    first_x, first_y = matrix[:, 0] @ matrix[:, 2] / size_u, matrix[:, 1] @ matrix[:, 2] / size_v
    columns = pixels.column + 2 * np.arange(depth_m.shape[1])
    rows = pixels.row + 2 * np.arange(depth_m.shape[0])
    x, y = (first_x + size_u * columns).astype(np.float32), (first_y + size_v * rows)[:, None]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        along_u = _gentlest_slope(pixels, 0, 1) / (depth_m * np.float32(size_u))
        along_v = _gentlest_slope(pixels, 1, 0) / (depth_m * np.float32(size_v))
        ahead = 1 + along_u * x + along_v * y.astype(np.float32)
        times = np.sqrt(along_u**2 + along_v**2 + ahead**2)
        times = np.fmin(times, np.float32(STEEPEST))
        return np.asarray(times * np.square(depth_m) * np.float32(size_u * size_v))


def _gentlest_slope(pixels: _Lattice, below: int, right: int) -> NDArray[np.float32]:
    """Return the lesser step of depth to the neighbours on both sides: that on its own surface."""
    depth_m = pixels.seen.depth_m
    here = pixels.of(depth_m)
    before, after = here - pixels.of(depth_m, -below, -right), pixels.of(depth_m, below, right)
    after = after - here
    return np.where(np.abs(before) < np.abs(after), before, after)


def _blocks_within(blocks: Coordinates) -> Coordinates:
    """Return the (8 N, 3) blocks of cells in (N, 3) blocks of voxels."""
    return np.asarray((VOXEL_CELLS * blocks[:, None] + _IN_BLOCK).reshape(-1, 3), np.int32)


_NO_BLOCKS = np.zeros((0, 3), np.int32)
