"""The configuration model, with one section per module.

Lengths are in metres, angles in degrees; pixel coordinates follow OpenCV's convention.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from oaisys_core.config.section import Labelled, Section
from oaisys_core.config.sections.assets import AssetsConfig
from oaisys_core.config.sections.density import LayerDensity
from oaisys_core.config.sections.drive import DriveConfig
from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.config.sections.render import RenderConfig
from oaisys_core.config.sections.sensors import SensorsConfig
from oaisys_core.config.sections.stage import StageConfig
from oaisys_core.errors import one_of, quote

GENERATOR_VERSION = 11
"""Version of the generators of worlds, raised when the same seed draws another world; 1 had no land
beyond the stage, and a brighter sky beside the sun."""


class OutputConfig(Section):
    """What ``oaisys render`` renders and writes; options of the command line take precedence.

    Attributes:
        folder: Output folder, relative to the working directory; None requires ``--out``.
        batches: Number of worlds.
        samples: Number of views of each world.
        batch_offset: Number that is added to the numbers of batch folders; it does not change the
            worlds.
        save_blend: Whether to save the world of each batch as a .blend file.
    """

    folder: Path | None = None
    batches: int = Field(default=1, ge=1)
    samples: int = Field(default=1, ge=1)
    batch_offset: int = Field(default=0, ge=0)
    save_blend: bool = False


class SimulationConfig(Section):
    """The configuration of a simulation; with the metadata of its steps it determines the result.

    Attributes:
        seed: Root seed of all random draws.
        generator_version: Version of the generators that draw worlds from seeds. It is part of the
            configuration's hash; a record of another version is refused.
        backend: The renderer.
        drive: A timed drive; null for none.
        extensions: Modules of other packages by name, each with its options.
    """

    seed: int = Field(default=1, ge=0, lt=2**63)
    generator_version: int = GENERATOR_VERSION
    backend: Literal["blender", "analytic"] = "blender"
    stage: StageConfig = StageConfig()
    materials: MaterialsConfig = MaterialsConfig()
    assets: AssetsConfig = AssetsConfig()
    environment: EnvironmentConfig = EnvironmentConfig()
    sensors: SensorsConfig = SensorsConfig()
    render: RenderConfig = RenderConfig()
    output: OutputConfig = OutputConfig()
    drive: DriveConfig | None = None
    extensions: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @field_validator("generator_version")
    @classmethod
    def _of_this_version(cls, value: int) -> int:
        if value != GENERATOR_VERSION:
            raise ValueError(
                f"expected {GENERATOR_VERSION}, because this program's generators draw other worlds"
            )
        return value

    @model_validator(mode="after")
    def _one_label_per_id(self) -> SimulationConfig:
        labels: dict[int, str] = {}
        things: list[Labelled] = [
            *self.materials.items_with_labels,
            *self.assets.items_with_labels,
            *self.environment.items_with_labels,
        ]
        for thing in things:
            for semantic_id, label in thing.labels.items():
                known = labels.setdefault(semantic_id, label)
                if known != label:
                    raise ValueError(
                        f"semantic_id {semantic_id} is called both {quote(known)}"
                        f" and {quote(label)}"
                    )
        return self

    @model_validator(mode="after")
    def _sky_of_earth(self) -> SimulationConfig:
        if self.environment.sun_from_time is not None and not self.stage.is_on_earth:
            raise ValueError(
                "environment.sun_from_time: expected null, because it is the sun in Earth's sky,"
                f" and stage.body is {self.stage.body}; give sun_elevation_deg and sun_azimuth_deg"
            )
        return self

    @model_validator(mode="after")
    def _layers_of_densities(self) -> SimulationConfig:
        known = self.materials.layer_labels
        for group in self.assets.groups:
            for index, density in enumerate(group.density):
                labels = density.labels if isinstance(density, LayerDensity) else ()
                for label in labels:
                    if label not in known:
                        raise ValueError(
                            f"assets.groups.{group.name}.density.{index}.label: received"
                            f" {quote(label)}, expected {one_of(known, label)}"
                        )
        return self
