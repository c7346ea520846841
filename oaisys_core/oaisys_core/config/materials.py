"""The ground's material.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from oaisys_core.config.section import Labelled, Positive, Section


class LayerConfig(Labelled):
    """One layer of the ground's material.

    Attributes:
        texture: Name of a built-in texture set; ignored where ``folder`` is given.
        folder: A folder of PBR maps named as Poly Haven does (diff/col, disp, nor, rough).
        tile_m: Edge length of one tile; None: the texture set's own.
    """

    texture: str = "gravel"
    folder: Path | None = None
    tile_m: Positive | None = None


class MaskConfig(Section):
    """How layers are distributed over the ground.

    Attributes:
        scale_m: Typical size of a patch.
        sharpness: 0 soft transitions to 1 hard borders (of the colour; labels are always hard).
        size_px: Edge length of the mask images.
    """

    scale_m: Positive = 9.0
    sharpness: float = Field(default=0.75, ge=0, le=1)
    size_px: int = Field(default=1024, ge=2, le=8192)


class MaterialsConfig(Section):
    """The ground's material: layers blended by noise masks.

    Attributes:
        texture_size_px: Edge length of built-in texture maps.
        texture_seed: Seed of the built-in maps; not redrawn per batch, so that they are cached.
    """

    layers: tuple[LayerConfig, ...] = Field(
        default=(
            LayerConfig(texture="gravel", label="gravel", semantic_id=1),
            LayerConfig(texture="sand", label="sand", semantic_id=2),
        ),
        min_length=1,
    )
    mask: MaskConfig = MaskConfig()
    texture_size_px: int = Field(default=1024, ge=16, le=8192)
    texture_seed: int = Field(default=0, ge=0)
