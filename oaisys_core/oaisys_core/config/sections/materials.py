"""Configuration of the ground's material: its layers, how they look and where they lie.

Lengths are in metres, angles in degrees. A range is ``[least, most]`` or a single number for both;
its value is drawn for each batch.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import (
    Labelled,
    PositiveRange,
    Range,
    Section,
    SemanticId,
    Size,
)
from oaisys_core.config.sections.layer_conditions import Share
from oaisys_core.config.sections.layers import LayerConfig, LookConfig
from oaisys_core.files.path_fields import ConfigFolder


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
        sharpness: Sharpness of the borders of patches, from 0 to 1. With 0, bare layers change over
            wide transitions, and plants thin out to single tufts; with 1, borders are hard.
        relief: How strongly patches follow the forms of the ground, from 0 to 1: each layer lies
            where its ``exposure`` says. Layers of the same exposure do not.
        noise: Parameters of the method ``noise``.
        size_px: Edge length of the mask images.
    """

    method: Literal["patches", "noise"] = "patches"
    scale_m: Size = 9.0
    sharpness: float = Field(default=0.15, ge=0, le=1)
    relief: Share = 0.7
    noise: NoiseConfig = NoiseConfig()
    size_px: int = Field(default=1024, ge=2, le=8192)


class VariationConfig(Section):
    """Change of the ground's colour over the stage.

    Attributes:
        brightness: Range of the brightness factor around 1.
        tint: Range of the change between cool and warm, as a share of red and blue.
        scale_m: Size of a pattern that repeats; with None, colour follows the ground's forms: damp
            hollows, pale crests, streaks of water, dry plants and clumps of plants.
    """

    brightness: float = Field(default=0.35, ge=0, le=1)
    tint: float = Field(default=0.0, ge=0, le=1)
    scale_m: Size | None = None


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
        layers: Layers of every batch; by default gravel and sand, or what a ``stage.preset`` on
            Earth, the Moon or Mars is made of, see docs/worlds.md; none if there are pools.
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
        variation: Change of colour over the stage.
        macro_variation: Change of colour from metres to kilometres, as by dust and dampness, on the
            stage and beyond: 0 is none; at 1 the brightness has a standard deviation of 13 %.
        loose_stones: Whether stones lie on layers of stony built-in textures, see docs/worlds.md.
        rock_faces: Whether walls of rock, basalt and bedrock are of broken rock: pieces of a metre
            and more with beds, joints and overhangs, which a height field cannot have. They are
            part of the ground in depth, labels and the ground truth mesh. None: true on grounds of
            the presets alpine, canyon, large_terrain, mesa, mountain_1 and mountain_2, false on
            others and on terrain of yours, whichever a batch has.
        snow_depth_m: Depth of snow, by which its layers raise the ground: less towards their
            borders, so that rock stands out of it. None: 0.5 on the grounds of ``rock_faces``, 0 on
            others and on terrain of yours. Other layers than of snow are not deep, and a ground of
            snow alone stays where it is.
        texture_size_px: Edge length of built-in texture maps; by default 2048 of those of stones,
            rock, clay, grass or moss, and 1024 of all others.
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
    loose_stones: bool = False
    rock_faces: bool | None = None
    snow_depth_m: Annotated[float, Field(ge=0, le=10)] | None = None
    texture_size_px: int | None = Field(default=None, ge=16, le=8192)
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
