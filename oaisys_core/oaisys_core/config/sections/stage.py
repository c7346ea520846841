"""The ground.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from oaisys_core.config.paths import ConfigFile
from oaisys_core.config.section import MOST_M, Positive, Section, Vector3

StageName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")]
"""A plain name, never a path."""


class DemConfig(Section):
    """Real relief from a file: a GeoTIFF, a 16-bit PNG or an EXR image, its first row in the north.

    Attributes:
        file: The image.
        spacing_m: Distance of the file's pixels; None: what the GeoTIFF says of itself.
        scale: Factor on its heights, after what the file says itself.
        offset_m: Added to its heights; None: the median height comes to z = 0.
        ground_spacing_m: Distance of the ground's points; None: that of the pixels.
        band: Which band of a GeoTIFF.
    """

    file: ConfigFile
    spacing_m: Positive | None = None
    scale: float = 1.0
    offset_m: float | None = None
    ground_spacing_m: Positive | None = None
    band: int = Field(default=1, ge=1)


class StageMeshConfig(Section):
    """A ground of a user's own: .obj, .glb, .gltf, .ply, .stl or .blend; scripts never run.

    Attributes:
        file: The file.
        object: Name of the object in it; None: all of them.
        scale: Metres per unit of the file.
        up: Axis of the file that points up, after y-up formats were turned to z.
        position_m: Where its origin comes to lie.
    """

    file: ConfigFile
    object: str | None = None
    scale: Positive = 1.0
    up: Literal["x", "y", "z"] = "z"
    position_m: Vector3 = (0.0, 0.0, 0.0)


class DetailConfig(Section):
    """Finer ground around the cameras, for depth, labels, colour and queries alike.

    Attributes:
        radius_m: Half the edge of the square that is fine; it moves in steps of half of it.
        spacing_m: Distance of its points.
        amplitude_m: Height of the unevenness that the coarse ground is too coarse for.
        gain: Height of each finer octave relative to the one before.
        below_m: Height above the ground beyond which cameras have no use for it.
    """

    radius_m: Positive = 4.0
    spacing_m: Positive = 0.02
    amplitude_m: float = Field(default=0.012, ge=0)
    gain: float = Field(default=0.6, gt=0, le=1)
    below_m: Positive = 30.0


class ReuseConfig(Section):
    """A stage that was kept, instead of a new one.

    Attributes:
        name: Its hash, or what it was saved as, in the store; or the hash of the one that stands.
        file: A stage's file, in place of a name.
        objects: Whether what was scattered stays, is drawn anew, or is cleared away.
    """

    name: StageName | None = None
    file: ConfigFile | None = None
    objects: Literal["keep", "redraw", "clear"] = "redraw"

    @model_validator(mode="after")
    def _one_source(self) -> ReuseConfig:
        if (self.name is None) == (self.file is None):
            raise ValueError("expected either a name or a file")
        return self


class StageConfig(Section):
    """The ground.

    Attributes:
        preset: Kind of terrain, see ``oaisys_core.terrain.presets``.
        extent_m: Edge length of the square stage, centred on the map's origin.
        resolution_px: Grid points along an edge.
        relief_m: Height difference between lowest and highest point; None: the preset's own.
        roughness: Factor on the fine unevenness, 0 smooth, 1 the preset's own.
        dem: Real relief, in place of a preset.
        mesh: A mesh of a user's own, in place of a preset.
        detail: Finer ground around the cameras; None: the same everywhere.
        store: Folder that keeps each batch's stage by its hash, so that it can be reused in any
            later run; relative to where the command runs. None: nothing is kept.
        save_as: Name that a batch's stage is kept under as well.
        reuse: A stage that was kept; None: each batch has a new one.
    """

    preset: str = "mounds"
    extent_m: float = Field(default=64.0, ge=0.01, le=MOST_M)
    resolution_px: int = Field(default=1025, ge=2, le=8193)
    relief_m: float | None = Field(default=None, ge=0, le=MOST_M)
    roughness: float = Field(default=1.0, ge=0, le=10)
    dem: DemConfig | None = None
    mesh: StageMeshConfig | None = None
    detail: DetailConfig | None = None
    store: Path | None = None
    save_as: StageName | None = None
    reuse: ReuseConfig | None = None

    @model_validator(mode="after")
    def _consistent(self) -> StageConfig:
        if self.dem is not None and self.mesh is not None:
            raise ValueError("expected dem or mesh, not both")
        if self.mesh is not None and self.detail is not None:
            raise ValueError("expected no detail on a mesh: only grids can be refined")
        if self.save_as is not None and self.store is None:
            raise ValueError("expected a store, where save_as is given")
        return self
