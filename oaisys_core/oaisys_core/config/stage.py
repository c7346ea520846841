"""The ground.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from pydantic import Field

from oaisys_core.config.section import Positive, Section


class StageConfig(Section):
    """The ground.

    Attributes:
        preset: Kind of terrain, see ``oaisys_core.terrain.presets``.
        extent_m: Edge length of the square stage, centred on the map's origin.
        resolution_px: Grid points along an edge.
        relief_m: Height difference between lowest and highest point; None: the preset's own.
        roughness: Factor on the fine unevenness, 0 smooth, 1 the preset's own.
    """

    preset: str = "mounds"
    extent_m: Positive = 64.0
    resolution_px: int = Field(default=1025, ge=2, le=8193)
    relief_m: float | None = Field(default=None, ge=0)
    roughness: float = Field(default=1.0, ge=0, le=10)
