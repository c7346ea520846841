"""What a volume stores for every voxel and for every label cell, and what a block of them takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BLOCK_VOXELS = 8
"""Voxels along a block's edge; on terrain 8 takes half the time and memory of 16."""

VOXELS = BLOCK_VOXELS**3
"""Voxels in a block."""

CLASSES_KEPT = 4
"""Classes that a voxel keeps."""

CELL_CLASSES_KEPT = 2
"""Classes that a label cell keeps: one border may run through it."""

CELL_BLOCKS_PER_BLOCK = 4
"""Blocks of label cells allowed for each block of voxels; rocky terrain uses 2.5 of 8 possible."""


@dataclass(frozen=True)
class VoxelField:
    """A value stored for every voxel under one name.

    Attributes:
        dtype: ``float32`` or ``uint16``.
        channels: Numbers per voxel.
    """

    name: str
    dtype: str
    channels: int = 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one block's values: (`VOXELS`,) or (`VOXELS`, channels)."""
        return (VOXELS,) if self.channels == 1 else (VOXELS, self.channels)

    @property
    def block_bytes(self) -> int:
        """Memory of one block's values."""
        return VOXELS * self.channels * np.dtype(self.dtype).itemsize


GEOMETRY_FIELDS = (
    VoxelField("tsdf", "float32"),
    VoxelField("weight", "float32"),
    VoxelField("color", "float32", 4),
)
SEMANTIC_FIELDS = (
    VoxelField("class_id", "uint16", CLASSES_KEPT),
    VoxelField("class_weight", "float32", CLASSES_KEPT),
)
CELL_FIELDS = (
    VoxelField("cell_class_id", "uint16", CELL_CLASSES_KEPT),
    VoxelField("cell_class_weight", "float32", CELL_CLASSES_KEPT),
)


def block_bytes(fields: tuple[VoxelField, ...]) -> int:
    """Return the memory of one block with these fields."""
    return sum(field.block_bytes for field in fields)
