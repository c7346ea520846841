"""The configuration model, section by section as the modules are.

Lengths are metres, angles degrees (a person types them), pixels in OpenCV's convention.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from oaisys_core.config.section import Positive, Section, SemanticId, Vector3
from oaisys_core.config.sensors import SensorsConfig


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


class LayerConfig(Section):
    """One layer of the ground's material.

    Attributes:
        texture: Name of a built-in texture set; ignored where ``folder`` is given.
        folder: A folder of PBR maps named as Poly Haven does (diff/col, disp, nor, rough).
        tile_m: Edge length of one tile; None: the texture set's own.
        label, semantic_id: What its surface is called in the semantic image.
    """

    texture: str = "gravel"
    folder: Path | None = None
    tile_m: Positive | None = None
    label: str
    semantic_id: SemanticId


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


class RockGroupConfig(Section):
    """Rocks of one kind, scattered at random.

    Attributes:
        kind: Shape, see ``oaisys_core.scatter.rocks``.
        count: (least, most) number of rocks.
        size_m: (smallest, largest) longest axis.
        size_exponent: Power law of sizes: the number above size D goes as D**-exponent.
        variants: Different meshes of the kind.
        sink: (least, most) share of a rock's height that is in the ground.
        max_slope_deg: No rock stands on ground steeper than this.
    """

    kind: str = "angular"
    count: tuple[int, int] = (120, 120)
    size_m: tuple[float, float] = (0.15, 1.2)
    size_exponent: Positive = 1.8
    variants: int = Field(default=3, ge=1, le=64)
    sink: tuple[float, float] = (0.15, 0.4)
    max_slope_deg: float = Field(default=40.0, ge=0, le=90)
    label: str = "rock"
    semantic_id: SemanticId = 10

    @field_validator("count", "size_m", "sink")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < 0 or value[0] > value[1]:
            raise ValueError("the first number must not be negative nor above the second")
        return value

    @field_validator("size_m")
    @classmethod
    def _positive(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] <= 0:
            raise ValueError("sizes must be above 0")
        return value


class PrimitiveConfig(Section):
    """An exact sphere or box, for calibration.

    Attributes:
        size_m: Radius (thrice, or once) of a sphere, edge lengths of a box.
        position_m, quat_xyzw: Pose of its centre in ``map``.
    """

    shape: Literal["sphere", "box"]
    size_m: Vector3
    position_m: Vector3
    quat_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    label: str = "target"
    semantic_id: SemanticId = 20
    color_srgb: Vector3 = (0.6, 0.3, 0.2)

    @model_validator(mode="before")
    @classmethod
    def _radius_alone(cls, data: object) -> object:
        """Let a sphere be given by its radius."""
        if isinstance(data, dict) and "radius_m" in data and "size_m" not in data:
            radius_m = data["radius_m"]
            rest = {key: value for key, value in data.items() if key != "radius_m"}
            return {**rest, "size_m": (radius_m, radius_m, radius_m)}
        return data

    @model_validator(mode="after")
    def _solid(self) -> PrimitiveConfig:
        if min(self.size_m) <= 0:
            raise ValueError("size_m must be above 0")
        if self.shape == "sphere" and len(set(self.size_m)) != 1:
            raise ValueError("a sphere has one radius")
        return self

    @field_validator("quat_xyzw")
    @classmethod
    def _unit(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        if abs(sum(v * v for v in value) ** 0.5 - 1) > 1e-3:
            raise ValueError("must be a unit quaternion")
        return value


class AssetsConfig(Section):
    """Things that stand on the ground.

    Attributes:
        rock_texture: Built-in texture set of the rocks.
        rock_tile_m: Edge length of one tile of it on the rocks.
    """

    rocks: tuple[RockGroupConfig, ...] = (
        RockGroupConfig(kind="angular", count=(650, 650), size_m=(0.15, 1.2)),
        RockGroupConfig(kind="rounded", count=(400, 400), size_m=(0.15, 0.9)),
        RockGroupConfig(kind="slab", count=(160, 160), size_m=(0.3, 1.4)),
        RockGroupConfig(kind="boulder", count=(60, 60), size_m=(0.8, 2.4), variants=4),
    )
    primitives: tuple[PrimitiveConfig, ...] = ()
    rock_texture: str = "rock"
    rock_tile_m: Positive = 1.6


class EnvironmentConfig(Section):
    """Sun and sky.

    Attributes:
        sun_azimuth_deg: From +x (east) towards +y (north).
        sun_strength_w_m2: Irradiance on a surface facing the sun, in Blender's scene units.
        sky_strength: Factor on the sky's radiance.
        air, dust, ozone: Densities of the atmosphere, 1 is a clear day on Earth.
        sky_semantic_id: Label of pixels that hit nothing; 0 leaves them unlabelled.
    """

    sun_elevation_deg: float = Field(default=38.0, ge=-10, le=90)
    sun_azimuth_deg: float = 125.0
    sun_strength_w_m2: float = Field(default=4.0, ge=0)
    sun_angular_diameter_deg: float = Field(default=0.545, ge=0, le=90)
    sky_strength: float = Field(default=1.0, ge=0)
    air: float = Field(default=1.0, ge=0, le=10)
    dust: float = Field(default=1.0, ge=0, le=10)
    ozone: float = Field(default=1.0, ge=0, le=10)
    sky_semantic_id: SemanticId = 0


class RenderConfig(Section):
    """How colour is rendered; depth and labels are exact at every quality.

    Attributes:
        quality: Preset of samples per pixel and bounces.
        exposure_ev: Exposure in stops.
    """

    quality: Literal["preview", "standard", "high", "final"] = "standard"
    exposure_ev: float = Field(default=0.0, ge=-20, le=20)


class SimulationConfig(Section):
    """Everything that, with the metadata of its steps, determines a simulation.

    Attributes:
        seed: Root of all random draws.
        backend: What renders.
    """

    seed: int = Field(default=1, ge=0, lt=2**63)
    backend: Literal["blender", "analytic"] = "blender"
    stage: StageConfig = StageConfig()
    materials: MaterialsConfig = MaterialsConfig()
    assets: AssetsConfig = AssetsConfig()
    environment: EnvironmentConfig = EnvironmentConfig()
    sensors: SensorsConfig = SensorsConfig()
    render: RenderConfig = RenderConfig()

    @model_validator(mode="after")
    def _one_label_per_id(self) -> SimulationConfig:
        labels: dict[int, str] = {}
        things: list[LayerConfig | RockGroupConfig | PrimitiveConfig] = [
            *self.materials.layers,
            *self.assets.rocks,
            *self.assets.primitives,
        ]
        for thing in things:
            known = labels.setdefault(thing.semantic_id, thing.label)
            if known != thing.label:
                raise ValueError(
                    f"semantic_id {thing.semantic_id} is called both {known!r} and {thing.label!r}"
                )
        return self
