"""How a volume of voxels is made."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.voxels.blocks import BLOCK_VOXELS, GEOMETRY_FIELDS, VoxelField, block_bytes
from oaisys_mapping.voxels.label_cells import BYTES_PER_BLOCK
from oaisys_mapping.voxels.semantic_fusion import SEMANTIC_FIELDS

WEIGHTINGS = ("constant", "inverse_square")
WHEN_FULL = ("refuse", "drop", "store")


@dataclass(frozen=True)
class TsdfConfig:
    """How a volume is made.

    Attributes:
        voxel_size_m: Edge length of a voxel.
        truncation_voxels: Distance from the surface, in voxels, up to which distances are kept. On
            rocky ground seen from 10 m at 0.1 m, 2 / 3 / 4 / 6 gave an RMSE of 4.5 / 5.6 / 7.2 /
            10.3 mm and holes of 1.0 / 0.5 / 0.4 / 0.3 %.
        solid_voxels: How much further behind the surface voxels are taken for solid until a view
            tells otherwise: without, a face that rays graze has none behind it, and no surface.
        max_range_m: Depth beyond which nothing is integrated, and up to which a ray that hit
            nothing, or something further away, clears. No more than the camera's own range.
        max_blocks: Blocks of 8 x 8 x 8 voxels that may be in memory: 400,000 take 4.9 GB; see
            `bytes_per_block`.
        when_full: What becomes of a view that needs more: ``refuse`` it, or make room for it with
            the blocks that are farthest from the camera: ``drop`` them, or ``store`` them on disk
            until the camera comes back.
        store_folder: Where stored blocks go; None: where temporary files do.
        weighting: What a pixel counts: ``constant``: 1, or ``inverse_square``: 1 / depth^2, as the
            noise of depth cameras asks for.
        weigh_incidence: Whether it counts less the flatter the ray meets the surface (cosine).
        max_weight: Weight beyond which a voxel's does not grow, so that it can change its mind.
        clear_free_space: Whether rays clear blocks that they pass through, also those that hit
            nothing; without it, a thing that moved away stays.
        record_free_space: Whether to remember which blocks without voxels are free; for distance
            queries in the open.
        semantic: Whether classes are kept: of voxels, and of cells half as wide beside the surface.
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
        """Refuse sizes that are not above 0, and choices that there are not."""
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
            if getattr(self, name) not in choices:
                raise InvalidInputError(name, getattr(self, name), f"one of {', '.join(choices)}")

    @property
    def truncation_m(self) -> float:
        """Distance up to which distances are kept."""
        return self.truncation_voxels * self.voxel_size_m

    @property
    def fields(self) -> tuple[VoxelField, ...]:
        """What is kept of a voxel."""
        return (*GEOMETRY_FIELDS, *SEMANTIC_FIELDS) if self.semantic else GEOMETRY_FIELDS

    @property
    def block_size_m(self) -> float:
        """Edge length of a block."""
        return BLOCK_VOXELS * self.voxel_size_m

    @property
    def bytes_per_block(self) -> int:
        """Memory that a block takes: 12 kB; with classes 49 kB at most, cells included."""
        return block_bytes(self.fields) + (BYTES_PER_BLOCK if self.semantic else 0)
