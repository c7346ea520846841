"""The configuration model, with one section per module.

Lengths are in metres, angles in degrees; pixel coordinates follow OpenCV's convention.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from pydantic import (
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    SerializationInfo,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import to_jsonable_python

from oaisys_core.config.draw_checks import (
    check_labels,
    check_options,
    error_at,
    error_of,
    errors_below,
)
from oaisys_core.config.draws import Draws, put_back, separate
from oaisys_core.config.section import Labelled, Section
from oaisys_core.config.sections.assets import AssetsConfig
from oaisys_core.config.sections.density import LayerDensity
from oaisys_core.config.sections.drive import DriveConfig
from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.config.sections.render import RenderConfig
from oaisys_core.config.sections.sensing.sensors import SensorsConfig
from oaisys_core.config.sections.stage import StageConfig, body_name
from oaisys_core.config.stage_defaults import with_defaults_of_stage
from oaisys_core.config.variants import VariantConfig
from oaisys_core.errors import ConfigError, InvalidInputError, one_of, quote
from oaisys_core.files.path_fields import NamedPath
from oaisys_core.types import DIGITAL, RADIANCE

GENERATOR_VERSION = 28
"""Version of the generators of worlds, raised when the same seed draws another world; 1 had no land
beyond the stage, and a brighter sky beside the sun."""

MAX_VARIANTS = 100


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

    folder: NamedPath | None = None
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
        variants: Kinds of worlds, of which each world has one; empty: all are as the file says.
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
    variants: tuple[VariantConfig, ...] = Field(default=(), max_length=MAX_VARIANTS)
    _draws: Draws = PrivateAttr(default_factory=dict)

    @property
    def draws(self) -> Draws:
        """What each world draws, by location; the fields hold the first possible values."""
        return self._draws

    def with_first_values(self) -> SimulationConfig:
        """Return the configuration without draws and variants: the first possible values stay."""
        config = self.model_copy(update={"variants": ()})
        object.__setattr__(config, "_draws", {})
        return config

    @property
    def label_names(self) -> dict[int, str]:
        """Labels by id, of the first possible values."""
        items = (
            *self.materials.items_with_labels,
            *self.assets.items_with_labels,
            *self.environment.items_with_labels,
        )
        return {i: label for thing in items for i, label in thing.labels.items() if i}

    @model_validator(mode="wrap")
    @classmethod
    def _separate_draws(
        cls,
        data: Any,
        handler: ModelWrapValidatorHandler[SimulationConfig],
        info: ValidationInfo,
    ) -> SimulationConfig:
        """Check the configuration with each value that a world may draw."""
        if not isinstance(data, dict):
            return handler(data)
        try:
            plain, draws = separate(data, cls)
        except InvalidInputError as error:
            raise error_of(error) from error
        config = handler(with_defaults_of_stage(plain))

        def check(each: dict[str, Any]) -> SimulationConfig:
            return cls.model_validate(each, context=info.context)

        plain.pop("variants", None)
        if draws:
            object.__setattr__(config, "_draws", check_options(plain, draws, data, cls, check))
        return config.complete_variants(check) if config.variants else config

    def complete_variants(
        self, check: Callable[[dict[str, Any]], SimulationConfig]
    ) -> SimulationConfig:
        """Return the configuration with the complete sections of each variant, checked."""
        base = self.model_dump()
        del base["variants"]
        complete: list[VariantConfig] = []
        labels: dict[int, str] = {}
        for index, variant in enumerate(self.variants):
            place = ("variants", index)
            try:
                data = variant.apply_to(base)
            except ConfigError as error:
                where = (*place, "file")
                raise error_at(where, str(variant.file), f"a valid file: {error}") from error
            try:
                checked = check(data)
            except ValidationError as error:
                raise errors_below(error, data, type(self), place) from error
            check_labels(labels, checked.label_names, place, variant.name)
            complete.append(variant.with_all_sections(checked.model_dump()))
        return self.model_copy(update={"variants": tuple(complete)})

    @model_serializer(mode="wrap")
    def _with_draws(
        self, handler: SerializerFunctionWrapHandler, info: SerializationInfo
    ) -> dict[str, Any]:
        """Return the data with the draws at their places, and without variants if there are none.

        So the configuration of worlds that draw nothing has the hash that it always had.
        """
        data: dict[str, Any] = handler(self)
        if not self.variants:
            data.pop("variants", None)
        draws = put_back(data, self._draws)
        return to_jsonable_python(draws) if info.mode == "json" else draws

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
    def _sun_of_the_body(self) -> SimulationConfig:
        environment, stage = self.environment, self.stage
        body, sun = body_name(stage.body), environment.sun_from_time
        if sun is not None and body is None:
            raise ValueError(
                "environment.sun_from_time: expected null, because ephemerides are for earth, moon"
                f" and mars, and stage.body is {stage.body}; give sun_elevation_deg and"
                " sun_azimuth_deg"
            )
        if sun is not None and sun.latitude_deg is None and stage.dem is None:
            raise ValueError(
                "environment.sun_from_time.latitude_deg: expected a number, because there is no"
                " stage.dem that says where the stage lies"
            )
        has_unit = environment.unit_w_m2 or environment.sun_distance_au
        measures_light = (DIGITAL | {RADIANCE}) & self.sensors.modalities
        if body is None and not has_unit and measures_light:
            raise ValueError(
                "environment.sun_distance_au: expected a number for images of radiance and digital"
                f" numbers, because stage.body is {stage.body}, whose distance from the sun is"
                " not known"
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
