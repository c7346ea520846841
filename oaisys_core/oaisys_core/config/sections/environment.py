"""Configuration of sun, sky, air and lamps.

Lengths are in metres, angles in degrees. A range is ``[least, most]`` or a single number for both;
its value is drawn for each batch, or every few samples.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from oaisys_core.config.section import (
    MAX_LEVELS,
    Brightness,
    LabelConfig,
    Labelled,
    LabelText,
    NotNegative,
    Positive,
    Range,
    Section,
    SemanticId,
    Within,
)
from oaisys_core.config.sections.lamps import MAX_LAMPS, LampConfig, LampName
from oaisys_core.config.sections.layers import LabelImageConfig
from oaisys_core.config.sections.sun import SunFromTimeConfig
from oaisys_core.files.path_fields import ConfigFile, ConfigFolder
from oaisys_core.scene.sky import CloudKind, SkyModel

Density = Annotated[Range, Within(0.0, 10.0)]
Turn = Annotated[Range, Within(-720.0, 720.0)]
Channel = Annotated[float, Field(ge=0, le=1)]
ColorSrgb = tuple[Channel, Channel, Channel]


class SkyConfig(Section):
    """The sky, if no HDRI replaces it.

    Attributes:
        model: ``atmosphere`` computes the sunlight scattered by Earth's atmosphere, ``overcast`` is
            a sky of thick clouds without a sun, ``plain`` uses the colours below, ``none`` is
            black.
        zenith_srgb, horizon_srgb: Colours of a plain sky at the zenith and at the horizon.
        glow_srgb: Colour that a plain sky has in addition around the sun.
        glow_deg: Angle from the sun at which this glow has fallen to 1 / e.
    """

    model: SkyModel | Literal["overcast"] = "atmosphere"
    zenith_srgb: ColorSrgb = (0.41, 0.57, 0.8)
    horizon_srgb: ColorSrgb = (0.77, 0.83, 0.88)
    glow_srgb: ColorSrgb = (0.0, 0.0, 0.0)
    glow_deg: float = Field(default=12.0, gt=0, le=180)


class SkyLabelsConfig(LabelImageConfig):
    """An image with the layout of an HDRI whose pixel values stand for labels.

    Attributes:
        level: Semantic level of the ``semantic_id`` in ``mapping``; its ``levels`` follow.
    """

    image: ConfigFile
    level: int = Field(default=0, ge=0, le=9)


class HdriImageConfig(Labelled):
    """An equirectangular image of all directions.

    Attributes:
        file: Linear ``.hdr`` or ``.exr`` image, or a photograph (``.png``, ``.jpg``) in sRGB.
        strength, rotation_deg: Values for this image; None uses those of ``hdri``.
        labels_from: Label images by direction.
        label, semantic_id, levels: Labels of all other directions; 0 uses those of the sky.
    """

    file: ConfigFile
    strength: Brightness | None = None
    rotation_deg: Turn | None = None
    labels_from: tuple[SkyLabelsConfig, ...] = ()
    label: LabelText = "sky"
    semantic_id: SemanticId = 0


class HdriConfig(Section):
    """Images that replace the sky.

    Attributes:
        images: The images to choose from.
        folder: Folder whose ``.hdr`` and ``.exr`` files are appended to ``images``, by name.
        choose: ``random`` picks any image, ``shuffle`` a random one that was not used before all
            others, ``cycle`` the next one. The last two count the redraws in a batch.
        use: File name (without suffix) of the image to use; None uses ``choose``.
        strength: Factor on the radiance of the image.
        rotation_deg: Azimuth of the middle of the image, counter-clockwise from +x.
        keep_sun: Whether the sun lamp is on in addition.
    """

    images: tuple[HdriImageConfig, ...] = ()
    folder: ConfigFolder | None = None
    choose: Literal["random", "shuffle", "cycle"] = "random"
    use: str | None = None
    strength: Brightness = (1.0, 1.0)
    rotation_deg: Turn = (0.0, 0.0)
    keep_sun: bool = False

    @model_validator(mode="after")
    def _something(self) -> HdriConfig:
        if not self.images and self.folder is None:
            raise ValueError("expected images or a folder of them")
        return self


class HazeConfig(Section):
    """Dust or haze between the camera and the scene; it changes colour only.

    Attributes:
        visibility_m: Distance at which contrast falls to 2 % (Koschmieder's visual range). The
            default is a clear day in the country; a city's haze is at 5 km.
        angstrom_exponent: Dependence of the extinction on the wavelength: 0 for coarse dust, 1.3
            for smoke and haze, 4 for clean air.
        thickness_m: Thickness of the layer through which the sky is seen; None for a tenth of the
            visibility, up to 60 m: the sky is pale near the horizon only.
        color_srgb: Colour of the haze; it is as bright as the sky at the horizon.
    """

    visibility_m: Annotated[Range, Within(1.0, 1e6)] = (23_000.0, 23_000.0)
    angstrom_exponent: Annotated[Range, Within(0.0, 4.0)] = (0.0, 0.0)
    thickness_m: NotNegative | None = None
    color_srgb: ColorSrgb = (1.0, 1.0, 1.0)


class CloudsConfig(Section):
    """Clouds with volume, and their shadows; below a closed layer, the ground has light of clouds.

    Attributes:
        kind: ``cumulus`` are heaps with flat undersides, ``stratocumulus`` is a low layer of rolls.
        cover: Share of the sky straight above that they hide: 0.1 to 0.5 are fair weather. Nearer
            to the horizon one sees their sides and less sky between them.
        base_m: Height of their undersides above the ground.
        size_m: Distance from one to the next, about.
        thickness_m: Height of the highest tops above the undersides. None: 0.25 times the size of
            cumulus, 0.2 times that of stratocumulus.
        shadows: Whether they cast shadows: the ground below thick ones gets a fifth of the sun's
            light. ``false``: sun and sky shine as without clouds.
    """

    kind: CloudKind = "cumulus"
    cover: Annotated[Range, Within(0.0, 1.0)] = (0.25, 0.25)
    base_m: Annotated[Range, Within(100.0, 12_000.0)] = (1400.0, 1400.0)
    size_m: Annotated[Range, Within(50.0, 20_000.0)] = (1800.0, 1800.0)
    thickness_m: Annotated[Range, Within(10.0, 12_000.0)] | None = None
    shadows: bool = True


class EffectConfig(BaseModel):
    """An environment effect of another package, which checks its own options.

    Attributes:
        effect: Name in the entry point group ``oaisys.environment_effects``.
    """

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)

    effect: str

    @property
    def options(self) -> dict[str, Any]:
        """All other keys."""
        return dict(self.model_extra or {})


class EnvironmentConfig(Section):
    """Sun, sky, air and lamps.

    Attributes:
        sun_elevation_deg: Elevation of the sun's centre above the horizon.
        sun_azimuth_deg: Azimuth from +x (east) towards +y (north).
        sun_strength_w_m2: Irradiance on a surface that faces the sun, in Blender's scene units, at
            the body's mean distance from the sun. With ``sun_from_time``, it and the sky's light
            grow and fall with the distance at that time.
        sun_angular_diameter_deg: Angular diameter; a larger sun casts softer shadows. None: that
            of the sun at its distance, 0.533 at 1 au.
        sun_disc: Brightness of the visible disc relative to the sun's strength; 0 hides it.
        sun_from_time: Position of the sun by date, time and place, instead of the angles above.
        sun_distance_au: Mean distance of the body from the sun. None: that of Earth, the Moon or
            Mars. Another body needs it, or ``unit_w_m2``, for images of radiance.
        sky: The sky, if no HDRI replaces it.
        sky_strength: Factor on the sky's radiance.
        air, dust, ozone: Densities of the atmosphere; 1 is a clear day on Earth.
        altitude_m: Height above sea level from which the atmosphere is seen.
        optical_depth: Optical depth of dust under a plain sky, as on Mars, towards the zenith.
            ``sun_strength_w_m2`` is then the irradiance above the dust, which lets a part of it
            through and scatters the rest: the sky is as bright as a two-stream model says. 0.3 to
            0.6 are clear days on Mars, 2 is a dust storm. None leaves sun and sky as they are.
        hdri: Images that replace the sky.
        haze: Dust or haze in the air.
        clouds: Clouds in the sky. None: it is clear; skies from images have their own.
        lamps: Lamps in the world and on the rig, by name.
        sky_semantic_id: Id of pixels that hit nothing; 0 leaves them unlabelled.
        sky_label: Name of this label.
        sky_levels: Labels of the sky on the levels from 1 on.
        ground_beyond: Whether the ground continues beyond the stage to the horizon, in colour,
            depth, labels and, if it is land, heights; not with an HDRI. Meshes end at the stage,
            and cameras must stay on it. See ``stage.surroundings``.
        ground_beyond_label: Label of the ground beyond the stage and, where that is not land, of
            pixels below the horizon that hit nothing. None uses that of the ground's material,
            mirrored at the edges of the stage, and that of the sky.
        unit_w_m2: Irradiance in red, green and blue of one scene unit, by which ``radiance`` images
            are scaled. None: such that a sun of 4 is as bright as it is above the body's air.
        effects: Effects of other packages, applied in this order.
        redraw: Whether values are drawn once per batch, or again for samples.
        step_interval: Samples between draws, with ``redraw: sample``.
    """

    sun_elevation_deg: Annotated[Range, Within(-90.0, 90.0)] = (38.0, 38.0)
    sun_azimuth_deg: Turn = (125.0, 125.0)
    sun_strength_w_m2: Brightness = (4.0, 4.0)
    sun_angular_diameter_deg: Annotated[Range, Within(0.0, 90.0)] | None = None
    sun_disc: Brightness = (0.0, 0.0)
    sun_from_time: SunFromTimeConfig | None = None
    sun_distance_au: Annotated[float, Field(ge=0.01, le=1000)] | None = None
    sky: SkyConfig = SkyConfig()
    sky_strength: Brightness = (1.0, 1.0)
    air: Density = (1.0, 1.0)
    dust: Density = (1.0, 1.0)
    ozone: Density = (1.0, 1.0)
    altitude_m: Annotated[Range, Within(0.0, 60000.0)] = (0.0, 0.0)
    optical_depth: Density | None = None
    hdri: HdriConfig | None = None
    haze: HazeConfig | None = None
    clouds: CloudsConfig | None = None
    lamps: dict[LampName, LampConfig] = Field(default_factory=dict, max_length=MAX_LAMPS)
    sky_semantic_id: SemanticId = 0
    sky_label: LabelText = Field(default="sky", min_length=1)
    sky_levels: tuple[LabelConfig, ...] = Field(default=(), max_length=MAX_LEVELS - 1)
    ground_beyond: bool = True
    ground_beyond_label: Labelled | None = None
    unit_w_m2: tuple[Positive, Positive, Positive] | None = None
    effects: tuple[EffectConfig, ...] = ()
    redraw: Literal["batch", "sample"] = "batch"
    step_interval: int = Field(default=1, ge=1)

    @model_validator(mode="after")
    def _dust_has_a_plain_sky(self) -> EnvironmentConfig:
        if self.optical_depth is not None and self.sky.model != "plain":
            raise ValueError(
                f"optical_depth: expected sky.model plain with it, received {self.sky.model}"
            )
        return self

    @model_validator(mode="after")
    def _clouds_have_air(self) -> EnvironmentConfig:
        if self.clouds is not None and self.sky.model in ("none", "overcast"):
            raise ValueError(
                "clouds: expected sky.model atmosphere or plain with them, "
                f"received {self.sky.model}"
            )
        return self

    @property
    def sky_labels(self) -> Labelled:
        """Labels of the sky."""
        return Labelled(
            label=self.sky_label, semantic_id=self.sky_semantic_id, levels=self.sky_levels
        )

    @property
    def items_with_labels(self) -> tuple[Labelled, ...]:
        """Everything in the section that has labels; an id of 0 means no label."""
        images = self.hdri.images if self.hdri else ()
        mapped = [
            m for image in images for labels in image.labels_from for m in labels.mapping.values()
        ]
        things = (self.sky_labels, self.ground_beyond_label, *images, *mapped)
        return tuple(thing for thing in things if thing is not None and any(thing.semantic_ids))
