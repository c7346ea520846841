"""Configuration of a layer of the ground: how it looks, its labels, and where it lies.

Lengths are in metres, angles in degrees. A range is ``[least, most]`` or a single number for both;
its value is drawn for each batch.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from oaisys_core.config.section import (
    Labelled,
    Positive,
    PositiveRange,
    Range,
    Section,
    TileRange,
    Weight,
)
from oaisys_core.config.sections.layer_conditions import ConditionConfig, Share
from oaisys_core.files.path_fields import ConfigFile, ConfigFolder

CurvePoints = tuple[tuple[Share, Share], ...]

LooseStones = Literal[
    "none",
    "gravel",
    "gravel_dark",
    "pebbles",
    "soil",
    "regolith",
    "red_sand",
    "lava",
    "basalt",
    "bedrock",
    "rock",
]

MASK_VALUE = re.compile(r"\d{1,5}|#[0-9a-f]{6}")


def _mask_value(value: str) -> str:
    if not MASK_VALUE.fullmatch(value.lower()):
        raise ValueError("expected a grey value such as 255, or a colour as '#rrggbb'")
    return value.lower()


MaskValue = Annotated[
    str,
    BeforeValidator(lambda value: str(value) if isinstance(value, int) else value),
    AfterValidator(_mask_value),
]
"""A grey value (0 to 65535) or a colour (``#rrggbb``) of a label image."""


class LabelImageConfig(Section):
    """A label image of a layer, which is laid on every tile like the colour map.

    Attributes:
        image: Grey image of 8 or 16 bits, or a colour image; the nearest pixel is used.
        mapping: Labels by pixel value. Other pixel values, and levels that an entry does not have,
            get the labels of the layer.
    """

    image: ConfigFile
    mapping: dict[MaskValue, Labelled] = Field(min_length=1)


class StoneLabelsConfig(Labelled):
    """Labels of the stones that a built-in texture shows, instead of those of its layer.

    Attributes:
        label: Name of the stones on level 0.
        semantic_id: Id of the stones on level 0.
        levels: Their labels on the levels from 1 on; further levels are those of the layer.
        min_size_m: Least size of such a stone: the diameter of a circle of the area that it shows.
            Smaller ones are ground.
    """

    min_size_m: Positive = 0.05


class CurvesConfig(Section):
    """Tone curves of a colour map, through (0, 0), the given points and (1, 1).

    Attributes:
        combined: (input, output) points for all channels, applied first.
        red, green, blue: Points for one channel.
    """

    combined: CurvePoints = ()
    red: CurvePoints = ()
    green: CurvePoints = ()
    blue: CurvePoints = ()


class ColorConfig(Section):
    """Change of a layer's colour, drawn for each batch.

    Attributes:
        hue_deg: Rotation of the hue.
        saturation: Factor on the saturation.
        value: Factor on the brightness.
        curves: Tone curves, applied before the other changes.
    """

    hue_deg: Range = (0.0, 0.0)
    saturation: PositiveRange = (1.0, 1.0)
    value: PositiveRange = (1.0, 1.0)
    curves: CurvesConfig = CurvesConfig()


class LookConfig(Section):
    """How a layer looks, and where it may lie.

    Attributes:
        texture: Name of a built-in texture set; ignored if ``folder`` is given.
        folder: Folder of PBR maps, named as by Poly Haven, ambientCG and others.
        tile_m: Edge length of a tile; None uses that of the texture set.
        color: Change of its colour.
        displacement_m: Height of the full range of the height map; None keeps the normal map.
        normal_strength: Factor on the slopes of the normal map.
        anti_tiling: How repetition is hidden: ``voronoi`` rotates and shifts the texture in each
            cell, ``stochastic`` blends shifted copies on a triangular lattice; None for
            ``voronoi`` where it would be seen (regolith, rock, bedrock, basalt, lava, ice, mud,
            clay_cracks, salt_crust, moss, leaf_litter), and for ``none`` with other built-in
            textures and folders.
        cell_tiles: Cell size of ``anti_tiling``, in tiles.
        rotation_deg: Largest rotation of a Voronoi cell to either side.
        share: Share of the ground relative to other layers; None counts as 1 if another layer has
            a share.
        exposure: Where it rather lies, see ``mask.relief``: from -1 for hollows and level ground to
            1 for ridges and scarps; None for what is usual for a built-in texture, such as -0.8 for
            sand and 1 for bedrock, and 0 for a folder.
        when: Where it may lie; None for anywhere.
        sward: Grass that stands on it: short ``turf``, ``grass``, or ``none``; None for that of the
            built-in textures of these names, and none on others. A layer on which a group of
            ``grass_tuft``, ``meadow`` or ``flower_meadow`` stands by its density has none.
        loose_stones: Stones of 1 to 14 cm that lie on it, by the name of the texture with whose
            sizes and shapes they are, or ``none``; None for those of a built-in texture if
            ``materials.loose_stones`` is true, and none on others.
        rock_faces: Whether its walls, steeper than about 45 degrees, are of broken rock, see
            ``materials.rock_faces``; None for those of a built-in texture of rock if that is true,
            and not on others.
    """

    texture: str = "gravel"
    folder: ConfigFolder | None = None
    tile_m: TileRange | None = None
    color: ColorConfig = ColorConfig()
    displacement_m: Range | None = None
    normal_strength: float = Field(default=1.0, ge=0, le=10)
    anti_tiling: Literal["none", "voronoi", "stochastic"] | None = None
    cell_tiles: float = Field(default=1.0, ge=0.1, le=100)
    rotation_deg: float = Field(default=180.0, ge=0, le=180)
    share: Weight | None = None
    exposure: float | None = Field(default=None, ge=-1, le=1)
    when: ConditionConfig | None = None
    sward: Literal["none", "turf", "grass"] | None = None
    loose_stones: LooseStones | None = None
    rock_faces: bool | None = None


class LayerConfig(Labelled, LookConfig):
    """One layer of the ground's material.

    Attributes:
        labels_from: Label image of a tile; None for the same labels everywhere. A layer with one
            is projected from above on steep slopes too.
        stones: Labels of the stones of a built-in texture (gravel, gravel_dark, pebbles, regolith,
            soil, sand, red_sand); None: they are ground. A layer with them is projected from above,
            too.
    """

    labels_from: LabelImageConfig | None = None
    stones: StoneLabelsConfig | None = None

    @model_validator(mode="after")
    def _has_one_source_of_labels(self) -> LayerConfig:
        if self.stones is not None and self.labels_from is not None:
            raise ValueError("received labels_from and stones, expected one of them")
        if self.stones is not None and self.folder is not None:
            raise ValueError(
                "received folder and stones, which built-in textures have; expected labels_from,"
                " the label image of a folder's texture"
            )
        return self
