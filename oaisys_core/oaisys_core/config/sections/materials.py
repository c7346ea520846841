"""Configuration of the ground's material: its layers, how they look and where they lie.

Lengths are in metres, angles in degrees. A range is ``[least, most]`` or a single number for both;
its value is drawn for each batch.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from oaisys_core.config.section import (
    Labelled,
    Positive,
    PositiveRange,
    Range,
    Section,
    SemanticId,
)
from oaisys_core.config.sections.layer_conditions import ConditionConfig, Share
from oaisys_core.files.path_fields import ConfigFile, ConfigFolder

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
            cell, ``stochastic`` blends shifted copies on a triangular lattice.
        cell_tiles: Cell size of ``anti_tiling``, in tiles.
        rotation_deg: Largest rotation of a Voronoi cell to either side.
        share: Share of the ground relative to other layers; None counts as 1 if another layer has
            a share.
        exposure: Where it rather lies, see ``mask.relief``: from -1 for hollows and level ground to
            1 for ridges and scarps; None for what is usual for a built-in texture, such as -0.8 for
            sand and 1 for bedrock, and 0 for a folder.
        when: Where it may lie; None for anywhere.
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
    exposure: float | None = Field(default=None, ge=-1, le=1)
    when: ConditionConfig | None = None


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


class PoolConfig(Section):
    """Layers of which some are drawn for each batch.

    Attributes:
        layers: The layers to draw from.
        folder: Folder of folders of PBR maps. Each is a further layer to draw from, labelled as in
            ``labels`` or named after its folder.
        look: Settings of the layers in ``folder``; ``texture`` and ``folder`` in it are ignored.
        labels: Labels by name of the folders in ``folder``.
        first_semantic_id: Id of the first folder by name; the following folders count up. It
            applies to folders without ``labels``.
        count: Least and most layers to draw; if there are fewer, all are drawn.
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
    """Noise with which each layer covers earlier ones, as in the original simulator.

    Attributes:
        scale: Noise cells along the ground's longer edge.
        detail: Number of octaves after the first; a fraction scales the last octave.
        roughness: Amplitude of each octave relative to the one before.
        distortion: Strength of the domain warp, in cells.
        borders: Noise values (0 to 1) between which the layer fades in: below the first it is
            invisible, above the second it covers everything.
    """

    scale: PositiveRange = (3.0, 7.0)
    detail: Range = (1.0, 3.0)
    roughness: Range = (0.2, 0.5)
    distortion: Range = (0.0, 0.6)
    borders: tuple[Share, Share] = (0.48, 0.52)


class MaskConfig(Section):
    """The distribution of layers over the ground.

    Attributes:
        method: With ``patches`` all layers compete for every point; with ``noise`` each layer
            covers earlier ones, see ``noise``.
        scale_m: Typical size of a patch. Patches lie closer in some regions, up to eight times as
            large.
        sharpness: Sharpness of the colour borders of patches, from 0 (soft) to 1 (hard).
        relief: How strongly patches follow the forms of the ground, from 0 to 1: each layer lies
            where its ``exposure`` says. Layers of the same exposure do not.
        noise: Parameters of the method ``noise``.
        size_px: Edge length of the mask images.
    """

    method: Literal["patches", "noise"] = "patches"
    scale_m: Positive = 9.0
    sharpness: float = Field(default=0.5, ge=0, le=1)
    relief: Share = 0.7
    noise: NoiseConfig = NoiseConfig()
    size_px: int = Field(default=1024, ge=2, le=8192)


class VariationConfig(Section):
    """Slow change of the ground's colour over the stage.

    Attributes:
        brightness: Range of the brightness factor around 1.
        tint: Range of the change between cool and warm, as a share of red and blue.
        scale_m: Size of the pattern; None for 7.3 tiles of the first layer.
    """

    brightness: float = Field(default=0.35, ge=0, le=1)
    tint: float = Field(default=0.0, ge=0, le=1)
    scale_m: Positive | None = None


class HapkeConfig(Section):
    """Hapke's law; the defaults are typical of the Moon in red light (Sato et al. 2014).

    Attributes:
        w: Albedo of single scattering; it forms the law, while the brightness is the textures'.
        b: Width of both lobes of the phase function: 0 scatters alike in all directions.
        c: Between the lobes: 1 scatters back to the sun, -1 forwards.
        b0: Amplitude of the opposition surge; 0 for none.
        h: Width of the surge, as the tangent of half the angle between sun and eye.
        theta_bar_deg: Mean angle of slopes that are smaller than a pixel.
    """

    w: float = Field(default=0.32, gt=0, le=1)
    b: float = Field(default=0.24, ge=0, lt=1)
    c: float = Field(default=0.30, ge=-1, le=1)
    b0: float = Field(default=1.8, ge=0, le=10)
    h: float = Field(default=0.071, gt=0, le=10)
    theta_bar_deg: float = Field(default=23.4, ge=0, le=60)


class MaterialsConfig(Section):
    """The material of the ground: layers blended by masks.

    Attributes:
        layers: Layers of every batch; by default gravel and sand, or none if there are pools.
        pools: Sets of further layers, of which some are drawn for each batch.
        mask: Where the layers lie.
        label_borders: With ``hard`` a point has the label of the layer with the largest weight;
            with ``soft`` labels are mixed at random where layers blend, by their weights.
        label_cell_m: Cell size of soft borders.
        displacement: With ``bump`` the height maps only change the shading; with ``geometry`` they
            also displace the vertices of the ground, as far as its resolution allows.
        projection: ``top`` projects textures from above, ``sides`` from the side on steep slopes,
            ``auto`` like ``sides`` if the ground has steep parts.
        reflectance: With ``rough`` the blender backend's ground reflects as a surface of the
            textures' roughness (Oren-Nayar), which is brighter towards the light than by Lambert's
            law, and has a film of water or ice where it is smooth; with ``lambert`` by that law.
            ``lommel_seeliger``, ``lunar_lambert`` (McEwen) and ``hapke`` are laws of powdery ground
            without air, see docs/light.md.
        hapke: Parameters of the law ``hapke``.
        variation: Slow change of colour.
        macro_variation: Change of colour from metres to kilometres, as by dust and dampness, on the
            stage and beyond: 0 is none; at 1 the brightness has a standard deviation of 13 %.
        texture_size_px: Edge length of built-in texture maps.
        texture_seed: Seed of the built-in maps, the same for all batches, so that maps are cached.
            The environment variable ``OAISYS_CACHE_MB`` limits the cache (default 1024); 0 disables
            it.
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
    reflectance: Literal["rough", "lambert", "lommel_seeliger", "lunar_lambert", "hapke"] = "rough"
    hapke: HapkeConfig = HapkeConfig()
    variation: VariationConfig = VariationConfig()
    macro_variation: Share = 0.5
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
    def layer_labels(self) -> set[str]:
        """The names on level 0 of all layers that a batch may have."""
        names = {layer.label for layer in self._all_layers}
        for pool in self.pools:
            folders = pool.folder.iterdir() if pool.folder and pool.folder.is_dir() else ()
            names |= {folder.name for folder in folders} - pool.labels.keys()
            names |= {entry.label for entry in pool.labels.values()}
        return names

    @property
    def _all_layers(self) -> list[LayerConfig]:
        return [*self.layers, *(layer for pool in self.pools for layer in pool.layers)]

    @property
    def items_with_labels(self) -> list[Labelled]:
        """Everything in the section that has labels."""
        layers = self._all_layers
        images = [layer.labels_from for layer in layers if layer.labels_from is not None]
        return [
            *layers,
            *(layer.stones for layer in layers if layer.stones is not None),
            *(entry for image in images for entry in image.mapping.values()),
            *(entry for pool in self.pools for entry in pool.labels.values()),
        ]
