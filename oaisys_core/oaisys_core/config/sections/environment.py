"""Sun, sky and air.

Lengths are metres, angles degrees (a person types them). A range is ``[least, most]``, or one
number for both; it is drawn anew for each batch, or every few samples.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from oaisys_core.config.paths import ConfigFile, ConfigFolder
from oaisys_core.config.section import (
    MAX_LEVELS,
    LabelConfig,
    Labelled,
    NotNegative,
    Range,
    Section,
    SemanticId,
    Within,
)
from oaisys_core.config.sections.materials import LabelImageConfig
from oaisys_core.sky import SkyModel

Density = Annotated[Range, Within(0.0, 10.0)]
Turn = Annotated[Range, Within(-720.0, 720.0)]
Channel = Annotated[float, Field(ge=0, le=1)]
ColorSrgb = tuple[Channel, Channel, Channel]


class SkyConfig(Section):
    """How the sky looks where no HDRI takes its place.

    Attributes:
        model: ``atmosphere`` computes the sunlight that Earth's air scatters, ``plain`` takes the
            colours below, ``none`` is black.
        zenith_srgb, horizon_srgb: Colours that a plain sky runs between.
        glow_srgb: What it has in addition around the sun.
        glow_deg: Angle from the sun at which this glow has fallen to 1 / e.
    """

    model: SkyModel = "atmosphere"
    zenith_srgb: ColorSrgb = (0.41, 0.57, 0.8)
    horizon_srgb: ColorSrgb = (0.77, 0.83, 0.88)
    glow_srgb: ColorSrgb = (0.0, 0.0, 0.0)
    glow_deg: float = Field(default=12.0, gt=0, le=180)


class SunFromTimeConfig(Section):
    """Where the sun stands over a place on Earth; it overrides elevation and azimuth.

    Attributes:
        date_time: With its offset from UTC, such as ``2026-06-21T12:00:00+02:00``.
        latitude_deg, longitude_deg: North and east are positive.
        north_offset_deg: Direction of true north in ``map``, counter-clockwise from +y.
        later_h: Hours that are added, for a time of day drawn at random.
        s_per_sample: Seconds by which the clock runs on from one sample to the next.
    """

    date_time: AwareDatetime
    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    north_offset_deg: float = Field(default=0.0, ge=-360, le=360)
    later_h: Annotated[Range, Within(-8784.0, 8784.0)] = (0.0, 0.0)
    s_per_sample: float = Field(default=0.0, ge=-86400, le=86400)


class SkyLabelsConfig(LabelImageConfig):
    """An image of the same layout as an HDRI, whose pixel values stand for labels.

    Attributes:
        level: Semantic level that a mapping's ``semantic_id`` is of; its ``levels`` follow.
    """

    image: ConfigFile
    level: int = Field(default=0, ge=0, le=9)


class HdriImageConfig(Labelled):
    """One equirectangular image of all directions.

    Attributes:
        file: ``.hdr`` or ``.exr``, linear.
        strength, rotation_deg: Of this image; none: those of the list.
        labels_from: Images that tell labels by direction.
        label, semantic_id, levels: Where those say nothing; 0: the sky's.
    """

    file: ConfigFile
    strength: NotNegative | None = None
    rotation_deg: Turn | None = None
    labels_from: tuple[SkyLabelsConfig, ...] = ()
    label: str = "sky"
    semantic_id: SemanticId = 0


class HdriConfig(Section):
    """Images that take the sky's place.

    Attributes:
        images: To choose from.
        folder: All ``.hdr`` and ``.exr`` files in it, by name, come after those.
        choose: ``random``: any of them; ``shuffle``: at random, but none again before all were
            shown; ``cycle``: one after the other. The latter two count redraws in a batch.
        use: File name (without its ending) of the one to show; none: as ``choose`` says.
        strength: Factor on the image's radiance.
        rotation_deg: Direction of the image's middle, counter-clockwise from +x.
        keep_sun: Whether the sun lamp shines as well.
    """

    images: tuple[HdriImageConfig, ...] = ()
    folder: ConfigFolder | None = None
    choose: Literal["random", "shuffle", "cycle"] = "random"
    use: str | None = None
    strength: NotNegative = (1.0, 1.0)
    rotation_deg: Turn = (0.0, 0.0)
    keep_sun: bool = False

    @model_validator(mode="after")
    def _something(self) -> HdriConfig:
        if not self.images and self.folder is None:
            raise ValueError("expected images or a folder of them")
        return self


class HazeConfig(Section):
    """Dust or haze between the camera and what it sees, in colour only.

    Attributes:
        visibility_m: Distance at which contrast falls to 2 % (Koschmieder's visual range).
        angstrom_exponent: How much more blue light is dimmed than red: 0 for coarse dust, 1.3 for
            smoke and haze, 4 for clean air.
        thickness_m: Of the hazy layer in front of the sky overhead; none: a tenth of the
            visibility.
        color_srgb: Of the veil before what is far; it is as bright as the sky at the horizon.
    """

    visibility_m: Annotated[Range, Within(1.0, 1e6)]
    angstrom_exponent: Annotated[Range, Within(0.0, 4.0)] = (0.0, 0.0)
    thickness_m: NotNegative | None = None
    color_srgb: ColorSrgb = (1.0, 1.0, 1.0)


class EffectConfig(BaseModel):
    """An environment effect of a package that registered one; it checks its own options.

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
    """Sun, sky and air.

    Attributes:
        sun_elevation_deg: Of the sun's centre above the horizon.
        sun_azimuth_deg: From +x (east) towards +y (north).
        sun_strength_w_m2: Irradiance on a surface facing it, in Blender's scene units.
        sun_angular_diameter_deg: Of the sun; the larger, the softer are the shadows' edges.
        sun_disc: Brightness of the sun's disc in the picture, 1 is true to its strength; 0: none.
        sun_from_time: Places the sun by date, time and place instead.
        sky: How the sky looks.
        sky_strength: Factor on the sky's radiance.
        air, dust, ozone: Densities of the atmosphere, 1 is a clear day on Earth.
        altitude_m: Height above the sea from which the atmosphere is seen.
        hdri: Images that take the sky's place.
        haze: Dust or haze in the air.
        sky_semantic_id: Label of pixels that hit nothing; 0 leaves them unlabelled.
        sky_label: What that label is called.
        sky_levels: Their labels of the levels from 1 on.
        ground_beyond: Whether the ground goes on beyond the stage up to the horizon, in colour,
            depth and labels; not where there is an HDRI. Meshes and heights end with the stage.
        ground_beyond_label: Of the ground beyond the stage, and of pixels that hit nothing below
            the horizon; none: that of the ground's material, mirrored at the stage's edges, and
            the sky's.
        effects: Effects from other packages, applied in this order.
        redraw: Whether ranges are drawn when a batch begins or for its samples too.
        step_interval: With ``redraw: sample``, samples until the next draw.
    """

    sun_elevation_deg: Annotated[Range, Within(-90.0, 90.0)] = (38.0, 38.0)
    sun_azimuth_deg: Turn = (125.0, 125.0)
    sun_strength_w_m2: NotNegative = (4.0, 4.0)
    sun_angular_diameter_deg: Annotated[Range, Within(0.0, 90.0)] = (0.545, 0.545)
    sun_disc: NotNegative = (0.0, 0.0)
    sun_from_time: SunFromTimeConfig | None = None
    sky: SkyConfig = SkyConfig()
    sky_strength: NotNegative = (1.0, 1.0)
    air: Density = (1.0, 1.0)
    dust: Density = (1.0, 1.0)
    ozone: Density = (1.0, 1.0)
    altitude_m: Annotated[Range, Within(0.0, 60000.0)] = (0.0, 0.0)
    hdri: HdriConfig | None = None
    haze: HazeConfig | None = None
    sky_semantic_id: SemanticId = 0
    sky_label: str = Field(default="sky", min_length=1)
    sky_levels: tuple[LabelConfig, ...] = Field(default=(), max_length=MAX_LEVELS - 1)
    ground_beyond: bool = True
    ground_beyond_label: Labelled | None = None
    effects: tuple[EffectConfig, ...] = ()
    redraw: Literal["batch", "sample"] = "batch"
    step_interval: int = Field(default=1, ge=1)

    @property
    def sky_labels(self) -> Labelled:
        """Labels of the sky."""
        return Labelled(
            label=self.sky_label, semantic_id=self.sky_semantic_id, levels=self.sky_levels
        )

    @property
    def labelled(self) -> tuple[Labelled, ...]:
        """All that carries labels; an id of 0 means none here."""
        images = self.hdri.images if self.hdri else ()
        mapped = [
            m for image in images for labels in image.labels_from for m in labels.mapping.values()
        ]
        things = (self.sky_labels, self.ground_beyond_label, *images, *mapped)
        return tuple(thing for thing in things if thing is not None and any(thing.semantic_ids))
