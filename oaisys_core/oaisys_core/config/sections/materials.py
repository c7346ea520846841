"""The ground's material: which layers there are, how they look and where each of them lies.

Lengths are metres, angles degrees (a person types them). A range is ``[least, most]``, or one
number for both; it is drawn anew for each batch.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from oaisys_core.config.paths import ConfigFile, ConfigFolder
from oaisys_core.config.section import (
    Labelled,
    Positive,
    PositiveRange,
    Range,
    Section,
    SemanticId,
)

Share = Annotated[float, Field(ge=0, le=1)]
SlopeDeg = Annotated[float, Field(ge=0, le=90)]
CurvePoints = tuple[tuple[Share, Share], ...]

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
    """Labels of a layer that an image tells; it lies on every tile just as the colour map does.

    Attributes:
        image: Grey image of 8 or 16 bits, or a colour image; its nearest pixel decides.
        mapping: Labels by pixel value. Levels that an entry does not have, and pixels of any
            other value, are labelled as the layer is.
    """

    image: ConfigFile
    mapping: dict[MaskValue, Labelled] = Field(min_length=1)


class ConditionConfig(Section):
    """Where a layer may lie; all that is given must hold.

    Attributes:
        slope_deg: Slopes from the first to the second angle.
        height_m: Heights in ``map``; None: any.
        height_share: Heights as shares of the ground's relief, 0 its lowest, 1 its highest point.
        soft_deg, soft_m: Widths over which the layer fades, half of it on each side of a bound.
    """

    slope_deg: tuple[SlopeDeg, SlopeDeg] = (0.0, 90.0)
    height_m: tuple[float, float] | None = None
    height_share: tuple[Share, Share] | None = None
    soft_deg: float = Field(default=6.0, ge=0, le=90)
    soft_m: float = Field(default=0.5, ge=0)

    @model_validator(mode="after")
    def _in_order(self) -> ConditionConfig:
        for name in ("slope_deg", "height_m", "height_share"):
            bounds = getattr(self, name)
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError(f"{name}: received {list(bounds)}, expected [least, most]")
        return self


class CurvesConfig(Section):
    """Tone curves of a colour map, through (0, 0), the given points and (1, 1).

    Attributes:
        combined: (from, to) points of all channels, applied first.
        red, green, blue: Points of one channel.
    """

    combined: CurvePoints = ()
    red: CurvePoints = ()
    green: CurvePoints = ()
    blue: CurvePoints = ()


class ColorConfig(Section):
    """Change of a layer's colour, drawn for each batch.

    Attributes:
        hue_deg: Turn of the hue.
        saturation: Factor on the saturation.
        value: Factor on the brightness.
        curves: Tone curves, applied before.
    """

    hue_deg: Range = (0.0, 0.0)
    saturation: PositiveRange = (1.0, 1.0)
    value: PositiveRange = (1.0, 1.0)
    curves: CurvesConfig = CurvesConfig()


class LookConfig(Section):
    """How a layer looks, and where it may lie.

    Attributes:
        texture: Name of a built-in texture set; ignored where ``folder`` is given.
        folder: A folder of PBR maps named as Poly Haven or the original name them.
        tile_m: Edge length of one tile; None: the texture set's own.
        color: Change of its colour.
        displacement_m: Height that the height map's full range stands for; None: the relief of
            the normal map as it is.
        normal_strength: Factor on the slopes of the normal map.
        anti_tiling: How repetition is hidden: ``voronoi`` turns and shifts the texture from cell
            to cell, ``stochastic`` blends shifted copies on a triangular lattice.
        cell_tiles: Size of a cell of it, in tiles.
        rotation_deg: Largest turn of a Voronoi cell to either side.
        share: Share of the ground, relative to those of the other layers; None: as it comes.
        when: Where it may lie; None: anywhere.
    """

    texture: str = "gravel"
    folder: ConfigFolder | None = None
    tile_m: PositiveRange | None = None
    color: ColorConfig = ColorConfig()
    displacement_m: Range | None = None
    normal_strength: float = Field(default=1.0, ge=0, le=10)
    anti_tiling: Literal["none", "voronoi", "stochastic"] = "none"
    cell_tiles: float = Field(default=1.0, ge=0.1, le=100)
    rotation_deg: float = Field(default=180.0, ge=0, le=180)
    share: Positive | None = None
    when: ConditionConfig | None = None


class LayerConfig(Labelled, LookConfig):
    """One layer of the ground's material.

    Attributes:
        labels_from: An image that tells labels within a tile; None: the layer's own everywhere.
            Such a layer is projected from above on steep slopes too.
    """

    labels_from: LabelImageConfig | None = None


class PoolConfig(Section):
    """Layers some of which are drawn for each batch.

    Attributes:
        layers: Those to draw from.
        folder: A folder of folders of PBR maps, each of which is one more layer to draw from,
            named and labelled as ``labels`` tells or after the folder.
        look: What the layers of ``folder`` have in common; its texture and folder are ignored.
        labels: Labels by the name of a folder in ``folder``.
        first_semantic_id: Id of the first folder, in the order of their names, without ``labels``;
            the others count on.
        count: Least and most layers to draw; more than there are draws all of them.
        replacement: Whether a layer may be drawn more than once.
    """

    layers: tuple[LayerConfig, ...] = ()
    folder: ConfigFolder | None = None
    look: LookConfig = LookConfig()
    labels: dict[str, Labelled] = Field(default_factory=dict)
    first_semantic_id: SemanticId = 1000
    count: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] = (1, 2)
    replacement: bool = False

    @model_validator(mode="after")
    def _can_be_drawn(self) -> PoolConfig:
        if self.count[0] > self.count[1]:
            raise ValueError(f"count: received {list(self.count)}, expected [least, most]")
        if not self.layers and self.folder is None:
            raise ValueError("received neither layers nor folder, expected one of them")
        return self


class NoiseConfig(Section):
    """Noise that lays each layer over those before it, as the original simulator does.

    Attributes:
        scale: Noise cells along the ground's longer edge.
        detail: Octaves beyond the first; a fraction counts in part.
        roughness: Height of each octave relative to the one before.
        distortion: How far the noise is warped by other noise, in cells.
        borders: Noise below the first value (noise runs from 0 to 1) shows what lies below, above
            the second one the layer; in between they are mixed.
    """

    scale: PositiveRange = (3.0, 7.0)
    detail: Range = (1.0, 3.0)
    roughness: Range = (0.2, 0.5)
    distortion: Range = (0.0, 0.6)
    borders: tuple[Share, Share] = (0.48, 0.52)


class MaskConfig(Section):
    """How layers are distributed over the ground.

    Attributes:
        method: ``patches``: all layers compete for every place; ``noise``: each is laid over
            those before it, see ``noise``.
        scale_m: Typical size of a patch.
        sharpness: 0 soft transitions of patches to 1 hard borders (of the colour).
        noise: Parameters of the method ``noise``.
        size_px: Edge length of the mask images.
    """

    method: Literal["patches", "noise"] = "patches"
    scale_m: Positive = 9.0
    sharpness: float = Field(default=0.75, ge=0, le=1)
    noise: NoiseConfig = NoiseConfig()
    size_px: int = Field(default=1024, ge=2, le=8192)


class VariationConfig(Section):
    """The slow change of the ground's colour from place to place.

    Attributes:
        brightness: Range of the brightness, around 1.
        tint: Range of the change between cooler and warmer, as a share of red and blue.
        scale_m: Size of its pattern; None: 7.3 tiles of the first layer.
    """

    brightness: float = Field(default=0.35, ge=0, le=1)
    tint: float = Field(default=0.0, ge=0, le=1)
    scale_m: Positive | None = None


class MaterialsConfig(Section):
    """The ground's material: layers blended by masks.

    Attributes:
        layers: Layers of every batch; by default gravel and sand, none where there are pools.
        pools: Further layers, drawn for each batch.
        mask: Where the layers lie.
        label_borders: ``hard``: the heaviest layer's label; ``soft``: labels are scattered where
            layers mix, each as often as its layer weighs.
        label_cell_m: Size of the grains of soft borders.
        displacement: What ``displacement_m`` moves: ``bump`` only shades, ``geometry`` moves the
            ground's vertices too, as far as their distance carries the relief.
        projection: Textures come from above; ``sides``: on steep slopes from the side; ``auto``:
            so where the ground has steep parts.
        variation: Slow change of colour.
        texture_size_px: Edge length of built-in texture maps.
        texture_seed: Seed of the built-in maps; not redrawn per batch, so that they are cached.
            ``OAISYS_CACHE_MB`` in the environment bounds that cache (1024); 0 turns it off.
    """

    layers: tuple[LayerConfig, ...] = (
        LayerConfig(texture="gravel", label="gravel", semantic_id=1),
        LayerConfig(texture="sand", label="sand", semantic_id=2),
    )
    pools: tuple[PoolConfig, ...] = ()
    mask: MaskConfig = MaskConfig()
    label_borders: Literal["hard", "soft"] = "hard"
    label_cell_m: float = Field(default=0.02, ge=0.001)
    displacement: Literal["bump", "geometry"] = "bump"
    projection: Literal["auto", "top", "sides"] = "auto"
    variation: VariationConfig = VariationConfig()
    texture_size_px: int = Field(default=1024, ge=16, le=8192)
    texture_seed: int = Field(default=0, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _pools_replace_default_layers(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("pools") and "layers" not in data:
            return {**data, "layers": ()}
        return data

    @model_validator(mode="after")
    def _has_a_layer(self) -> MaterialsConfig:
        if not self.layers and all(pool.count[0] == 0 for pool in self.pools):
            raise ValueError("materials.layers: received none, expected a layer or a pool of them")
        return self

    @property
    def labelled(self) -> list[Labelled]:
        """Everything in it that carries labels."""
        layers = [*self.layers, *(layer for pool in self.pools for layer in pool.layers)]
        images = [layer.labels_from for layer in layers if layer.labels_from is not None]
        return [
            *layers,
            *(entry for image in images for entry in image.mapping.values()),
            *(entry for pool in self.pools for entry in pool.labels.values()),
        ]
