"""Classes in cells finer than voxels, from the points that pixels show.

A voxel takes the label of the pixel it projects to. Near a step or a small object that pixel shows
what lies beside or below, so classes of voxels are right only to about a voxel. Here each pixel
votes for the one cell that contains its point, with the share of the cell's surface that the pixel
covers, so that the steep side of a rock, which few pixels show, is not outvoted by the ground.
Where cells have no votes, `TsdfVolume.classes_at` falls back to voxels.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_mapping.voxels.block_cache import BlockCache
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    CELL_BLOCKS_PER_BLOCK,
    CELL_FIELDS,
    NO_BLOCKS,
    VOXELS,
    BlockCoordinates,
    block_keys,
    unique_blocks,
)
from oaisys_mapping.voxels.blocks import INITIAL_BLOCKS
from oaisys_mapping.voxels.labelled_points import LabelledPoints, points_with_labels
from oaisys_mapping.voxels.padded_images import PaddedImages
from oaisys_mapping.voxels.semantic_fusion import fuse_classes

VOXEL_CELLS = 2
"""Cells along a voxel's edge; pixels miss too many of still smaller cells."""

CLASS_IDS = 1 << 16
"""Number of possible class ids."""

BLOCK_SHIFT = BLOCK_VOXELS.bit_length() - 1

_WITHIN_BLOCK = np.indices(3 * (VOXEL_CELLS,)).reshape(3, -1).T.astype(np.int32)


class LabelCells:
    """The label cells of a volume, kept wherever its blocks of voxels are kept.

    Args:
        voxel_size_m: Edge length of a voxel of the volume.
        max_blocks: Blocks of voxels that may be in memory.
        store_folder: Folder of the file of stored blocks; None: the system's temporary folder.

    Attributes:
        cache: The blocks of cells.
    """

    def __init__(self, voxel_size_m: float, max_blocks: int, store_folder: Path | None) -> None:
        self.cache = BlockCache(
            voxel_size_m / VOXEL_CELLS,
            CELL_FIELDS,
            max_blocks=CELL_BLOCKS_PER_BLOCK * max_blocks,
            when_full="refuse",
            store_folder=store_folder,
            initial_blocks=2 * INITIAL_BLOCKS,
        )

    def follow(self, evicted: BlockCoordinates, restored: BlockCoordinates, *, store: bool) -> None:
        """Evict the cells in (N, 3) blocks of voxels, and restore those in (M, 3) others.

        Raises:
            VolumeFullError: The disk is full.
        """
        if len(evicted):
            self.cache.evict(_cell_blocks(evicted), store=store)
        if len(restored):
            self.cache.restore(_cell_blocks(restored))

    def vote(self, images: PaddedImages, near: BlockCoordinates) -> BlockCoordinates:
        """Add the votes of a view's pixels; return the (N, 3) blocks of voxels that got some.

        Args:
            images: The view.
            near: (N, 3) blocks of voxels near its surface, all in memory.
        """
        points = points_with_labels(images, self.cache.voxel_size_m)
        if points is None:
            return NO_BLOCKS
        blocks, index = unique_blocks(points.cells >> BLOCK_SHIFT)
        blocks = blocks + points.base_block
        slots = np.full(len(blocks), -1, np.int32)
        kept = np.flatnonzero(np.isin(block_keys(blocks // VOXEL_CELLS), block_keys(near)))
        slots[kept] = self.cache.add(blocks[kept])
        x, y, z = points.cells & (BLOCK_VOXELS - 1)
        index <<= 3 * BLOCK_SHIFT
        index += x + (y << BLOCK_SHIFT) + (z << 2 * BLOCK_SHIFT)
        self._fuse(index, slots, points)
        voted, _ = unique_blocks((blocks[slots >= 0] // VOXEL_CELLS).T)
        return voted

    def _fuse(
        self, cell_index: NDArray[np.intp], slots: NDArray[np.int32], points: LabelledPoints
    ) -> None:
        """Sum the weights that each cell gets for each label, and fuse the sums.

        Args:
            cell_index: (N,) each point's cell: its block's number, then its number in the block.
            slots: (B,) slots of the blocks; -1: none.
            points: The points.
        """
        ids, weights = (
            self.cache.arrays[field.name].reshape(-1, field.channels) for field in CELL_FIELDS
        )
        is_used = np.zeros(len(slots) * VOXELS, bool)
        is_used[cell_index] = True
        cells = np.flatnonzero(is_used)
        compact = np.empty(len(is_used), np.int32)
        compact[cells] = np.arange(len(cells), dtype=np.int32)
        compact = compact[cell_index]
        slot = slots[cells >> 3 * BLOCK_SHIFT].astype(np.int64)
        memory_index = (slot << 3 * BLOCK_SHIFT) + (cells & (VOXELS - 1))
        has_label = np.zeros(CLASS_IDS, bool)
        has_label[points.labels] = True
        for label in np.flatnonzero(has_label).astype(np.uint16):
            same = np.flatnonzero(points.labels == label)
            weight = np.bincount(compact[same], points.weights[same], len(cells))
            voted = np.flatnonzero((weight > 0) & (slot >= 0))
            labels = np.full(len(voted), label)
            fuse_classes(
                ids, weights, memory_index[voted], labels, weight[voted].astype(np.float32)
            )


def _cell_blocks(blocks: BlockCoordinates) -> BlockCoordinates:
    """Return the (8 N, 3) blocks of cells in (N, 3) blocks of voxels."""
    return np.asarray((VOXEL_CELLS * blocks[:, None] + _WITHIN_BLOCK).reshape(-1, 3), np.int32)
