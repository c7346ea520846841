"""The configuration of a TSDF volume."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    CELL_BLOCKS_PER_BLOCK,
    CELL_FIELDS,
    GEOMETRY_FIELDS,
    SEMANTIC_FIELDS,
    VoxelField,
    block_bytes,
)

WEIGHTINGS = ("constant", "inverse_square")
WHEN_FULL = ("refuse", "drop", "store")

APPEARANCE_VOXELS = 2.0
"""Distance in front of the surface, in voxels, within which voxels keep colours and classes."""


@dataclass(frozen=True)
class TsdfConfig:
    """How a volume integrates views and how much memory it may use.

    Attributes:
        voxel_size_m: Edge length of a voxel.
        truncation_voxels: Distance from the surface, in voxels, at which signed distances are
            truncated. A larger truncation closes holes and rounds edges.
        solid_voxels: How far beyond the truncation voxels behind a surface count as solid until a
            view shows otherwise. Without it, faces seen only at grazing angles are lost, because
            no voxel behind them is known.
        max_range_m: Depth beyond which nothing is integrated, and up to which a ray that hit
            nothing, or something further away, clears space. At most the camera's own range.
        max_blocks: Blocks of 8 x 8 x 8 voxels that may be in memory; 400,000 take 4.9 GB. See
            `bytes_per_block`.
        when_full: What to do with a view that needs more blocks: ``refuse`` it, or make room by
            removing the blocks farthest from the camera: ``drop`` discards them, ``store`` writes
            them to disk until the camera comes back.
        store_folder: Folder of the file of stored blocks; None: the system's temporary folder.
        weighting: Weight of a pixel: ``constant`` (1), or ``inverse_square`` (1 / depth^2), which
            suits the noise of depth cameras.
        weigh_incidence: Whether to multiply the weight by the cosine of the angle of incidence.
        max_weight: Upper limit of a voxel's weight, so that it still adapts to changes.
        clear_free_space: Whether rays clear the blocks that they pass through, including rays that
            hit nothing. Without it, objects that moved away stay in the map.
        record_free_space: Whether to remember which blocks without voxels are free, for distance
            queries in open space.
        semantic: Whether to keep classes, for voxels and for cells half as wide near the surface.
    """

    voxel_size_m: float = 0.10
    truncation_voxels: float = 3.0
    solid_voxels: float = 2.0
    max_range_m: float = 60.0
    max_blocks: int = 400_000
    when_full: str = "refuse"
    store_folder: Path | None = None
    weighting: str = "constant"
    weigh_incidence: bool = False
    max_weight: float = 100.0
    clear_free_space: bool = True
    record_free_space: bool = False
    semantic: bool = False

    def __post_init__(self) -> None:
        """Refuse sizes that are not above 0, and unknown choices."""
        for name in ("voxel_size_m", "truncation_voxels", "max_range_m", "max_blocks"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InvalidInputError(name, value, "a finite number above 0")
        if not (np.isfinite(self.solid_voxels) and self.solid_voxels >= 0):
            raise InvalidInputError(
                "solid_voxels", self.solid_voxels, "a finite number, at least 0"
            )
        if not self.max_weight > 0:
            raise InvalidInputError("max_weight", self.max_weight, "a number above 0")
        for name, choices in (("weighting", WEIGHTINGS), ("when_full", WHEN_FULL)):
            value = getattr(self, name)
            if value not in choices:
                raise InvalidInputError(name, value, one_of(choices, value))

    @property
    def truncation_m(self) -> float:
        """Distance at which signed distances are truncated."""
        return self.truncation_voxels * self.voxel_size_m

    @property
    def solid_m(self) -> float:
        """Distance behind the surface up to which voxels are updated."""
        return self.truncation_m + self.solid_voxels * self.voxel_size_m

    @property
    def appearance_m(self) -> float:
        """Distance in front of the surface within which voxels keep colours and classes."""
        return min(APPEARANCE_VOXELS * self.voxel_size_m, self.truncation_m)

    @property
    def fields(self) -> tuple[VoxelField, ...]:
        """Values stored for each voxel."""
        return (*GEOMETRY_FIELDS, *SEMANTIC_FIELDS) if self.semantic else GEOMETRY_FIELDS

    @property
    def block_size_m(self) -> float:
        """Edge length of a block."""
        return BLOCK_VOXELS * self.voxel_size_m

    @property
    def bytes_per_block(self) -> int:
        """Memory per block: 12 kB; with classes at most 49 kB, label cells included."""
        cells = CELL_BLOCKS_PER_BLOCK * block_bytes(CELL_FIELDS) if self.semantic else 0
        return block_bytes(self.fields) + cells
