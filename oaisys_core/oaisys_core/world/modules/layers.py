"""The layers of the ground's material: which ones a batch has, and how each looks."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from oaisys_core import randomness
from oaisys_core.config.sections.layers import LayerConfig, LookConfig
from oaisys_core.config.sections.materials import MaterialsConfig, PoolConfig
from oaisys_core.errors import InvalidInputError, one_of, quote
from oaisys_core.procedural.scatter.loose_stones import LOOSE_STONES
from oaisys_core.procedural.scatter.plants.swards import SWARDS
from oaisys_core.procedural.textures import (
    TEXTURES,
    TEXTURES_WITH_STONES,
    default_cache_dir,
    load_texture_folder,
    stands_out,
    texture_exposure,
    texture_set,
    texture_stones,
)
from oaisys_core.procedural.textures.adjusting import ColorChange, recolor, with_relief
from oaisys_core.procedural.textures.folder import (
    COLOR_MAP_EXPECTED,
    has_color_map,
    texture_folders,
)
from oaisys_core.procedural.textures.label_image import label_stones, load_label_image
from oaisys_core.scene.terrain_material import LabelImage, PbrMaps, TerrainLayer
from oaisys_core.scene.tiling import PlainTiling, Tiling, stochastic_tiling, voronoi_tiling

BARE_ROCK = 0.9
"""Least exposure of a built-in texture whose walls may be of broken rock."""

FOLDER_TILE_M = 2.0
"""Edge length of a tile of a user's texture folder without ``tile_m``."""

KEPT_SETS = 12
"""Number of texture sets, original and changed, that are cached between batches."""


@dataclass(frozen=True)
class DrawnLayer:
    """A layer of a batch.

    Attributes:
        config: Its configuration.
        layer: The layer as backends see it.
        relief_m: Height of the full range of its height map; 0 if none was given.
    """

    config: LayerConfig
    layer: TerrainLayer
    relief_m: float


class LayerLibrary:
    """Loads texture sets on demand and caches the latest ones."""

    def __init__(self) -> None:
        self._sets: OrderedDict[str, PbrMaps] = OrderedDict()

    def load(self, look: LookConfig, materials: MaterialsConfig) -> PbrMaps:
        """Return the maps of a layer before any changes."""
        if look.folder is not None:
            folder = look.folder
            return self._remember(
                f"folder {folder}", lambda: load_texture_folder(folder, FOLDER_TILE_M)
            )
        key = (look.texture, materials.texture_size_px, materials.texture_seed)
        return self._remember(f"built in {key}", lambda: texture_set(*key, default_cache_dir()))

    def draw(
        self, config: LayerConfig, materials: MaterialsConfig, rng: np.random.Generator
    ) -> DrawnLayer:
        """Draw how a layer looks in one batch.

        Raises:
            InvalidInputError: A map or label image cannot be used.
        """
        tile_m = _draw(config.tile_m, rng)
        color = config.color
        color_change = ColorChange(
            hue_deg=float(rng.uniform(*color.hue_deg)),
            saturation=float(rng.uniform(*color.saturation)),
            value=float(rng.uniform(*color.value)),
            curves=color.curves.model_dump(),
        )
        relief_m = _draw(config.displacement_m, rng)
        strength = config.normal_strength

        def change() -> PbrMaps:
            maps = self.load(config, materials)
            sized = maps if tile_m is None else replace(maps, tile_m=tile_m)
            return with_relief(recolor(sized, color_change), relief_m, strength)

        source = config.folder or (
            config.texture,
            materials.texture_size_px,
            materials.texture_seed,
        )
        maps = self._remember(repr((source, tile_m, color_change, relief_m, strength)), change)
        labels = _label_image(config, maps.tile_m, materials)
        tiling, sward = _tiling(config, rng), sward_of(config)
        stones = loose_stones_of(config, materials)
        layer = TerrainLayer(
            config.label,
            config.semantic_ids,
            maps,
            tiling,
            labels,
            sward,
            stones,
            rock_faces=breaks(config, materials),
        )
        return DrawnLayer(config, layer, relief_m or 0.0)

    def _remember(self, key: str, make: Callable[[], PbrMaps]) -> PbrMaps:
        if key not in self._sets:
            self._sets[key] = make()
        self._sets.move_to_end(key)
        while len(self._sets) > KEPT_SETS:
            self._sets.popitem(last=False)
        return self._sets[key]


def check_layers(materials: MaterialsConfig, path: str) -> None:
    """Raise if a layer cannot be drawn.

    Args:
        materials: The section with the layers.
        path: Path of that section, for messages.

    Raises:
        InvalidInputError: A texture does not exist, a folder has no colour map, or an id has two
            names.
    """
    for fault in layer_faults(materials, path):
        raise fault


def layer_faults(materials: MaterialsConfig, path: str) -> Iterator[InvalidInputError]:
    """Yield the errors that `check_layers` raises."""
    names: dict[int, str] = {}
    for place, layer in _all_layers(materials):
        if layer.folder is None and layer.texture not in TEXTURES:
            expected = one_of(TEXTURES, layer.texture)
            yield InvalidInputError(f"{path}.{place}.texture", layer.texture, expected)
        if layer.stones is not None and layer.texture not in TEXTURES_WITH_STONES:
            expected = f"with stones: {one_of(TEXTURES_WITH_STONES, layer.texture)}"
            yield InvalidInputError(f"{path}.{place}.texture", layer.texture, expected)
        if layer.folder is not None and not has_color_map(layer.folder):
            expected = COLOR_MAP_EXPECTED
            yield InvalidInputError(f"{path}.{place}.folder", str(layer.folder), expected)
        for semantic_id, label in _labels(layer):
            known = names.setdefault(semantic_id, label)
            if known != label:
                yield InvalidInputError(
                    f"{path}.{place}.semantic_id",
                    semantic_id,
                    f"an id that does not have the name {quote(known)} already",
                )


def choose_layers(materials: MaterialsConfig, rng: np.random.Generator) -> list[LayerConfig]:
    """Return the layers of a batch: the fixed ones, and those drawn from each pool."""
    chosen = list(materials.layers)
    for index, pool in enumerate(materials.pools):
        layers = pool_layers(pool)
        draw = randomness.child(rng, f"pool/{index}")
        count = int(draw.integers(*pool.count, endpoint=True))
        if not pool.replacement:
            count = min(count, len(layers))
        picks = draw.choice(len(layers), count, replace=pool.replacement)
        chosen.extend(layers[pick] for pick in picks)
    # Even if no layer is drawn, the ground needs one.
    return chosen or [pool_layers(materials.pools[0])[0]]


def pool_layers(pool: PoolConfig) -> list[LayerConfig]:
    """Return all layers of a pool: the given ones, then those of its folder by name.

    Raises:
        InvalidInputError: The folder contains no texture folder, or labels name a missing one.
    """
    layers = list(pool.layers)
    look = pool.look.model_dump(exclude={"folder"})
    folders = texture_folders(pool.folder) if pool.folder else []
    unknown = sorted(pool.labels.keys() - {folder.name for folder in folders})
    if unknown:
        known = one_of((folder.name for folder in folders), unknown[0])
        raise InvalidInputError("labels", unknown[0], f"a folder of the pool: {known}")
    for index, folder in enumerate(folders):
        label = pool.labels.get(folder.name)
        labels = (
            {"label": folder.name, "semantic_id": pool.first_semantic_id + index}
            if label is None
            else label.model_dump()
        )
        layers.append(LayerConfig.model_validate({**look, **labels, "folder": folder}))
    return layers


def labels_of(layer: LayerConfig) -> dict[int, str]:
    """Return the names of all ids that a layer may have."""
    return dict(_labels(layer))


def _labels(layer: LayerConfig) -> Iterator[tuple[int, str]]:
    yield from layer.labels.items()
    for entry in layer.labels_from.mapping.values() if layer.labels_from else ():
        yield from entry.labels.items()
    if layer.stones is not None:
        yield from layer.stones.labels.items()


def exposure_of(look: LookConfig) -> float:
    """Return where a layer lies, from -1 (hollows, level ground) to 1 (ridges, scarps)."""
    if look.exposure is not None:
        return look.exposure
    return 0.0 if look.folder is not None else texture_exposure(look.texture)


def sward_of(look: LookConfig) -> str | None:
    """Return the name of the grass that stands on a layer; None for none."""
    usual = look.texture if look.folder is None and look.texture in SWARDS else None
    name = look.sward or usual
    return None if name == "none" else name


def loose_stones_of(look: LookConfig, materials: MaterialsConfig) -> str | None:
    """Return the name of the stones that lie on a layer; None for none."""
    has_own = look.folder is None and look.texture in LOOSE_STONES
    usual = look.texture if has_own and materials.loose_stones else None
    name = look.loose_stones or usual
    return None if name == "none" else name


def breaks(look: LookConfig, materials: MaterialsConfig) -> bool:
    """Return whether walls of a layer are of broken rock."""
    if look.rock_faces is not None:
        return look.rock_faces
    is_rock = look.folder is None and texture_exposure(look.texture) >= BARE_ROCK
    return bool(materials.rock_faces) and is_rock


def _all_layers(materials: MaterialsConfig) -> Iterator[tuple[str, LayerConfig]]:
    for index, layer in enumerate(materials.layers):
        yield f"layers.{index}", layer
    for number, pool in enumerate(materials.pools):
        for index, layer in enumerate(pool_layers(pool)):
            yield f"pools.{number}.layers.{index}", layer


def _draw(bounds: tuple[float, float] | None, rng: np.random.Generator) -> float | None:
    return None if bounds is None else float(rng.uniform(*bounds))


def _tiling(look: LookConfig, rng: np.random.Generator) -> Tiling:
    draw = randomness.child(rng, "tiling")
    kind = look.anti_tiling
    if kind is None and look.folder is None and stands_out(look.texture):
        kind = "voronoi"
    if kind == "voronoi":
        return voronoi_tiling(look.cell_tiles, radians(look.rotation_deg), draw)
    if kind == "stochastic":
        return stochastic_tiling(look.cell_tiles, draw)
    return PlainTiling()


def _label_image(
    config: LayerConfig, tile_m: float, materials: MaterialsConfig
) -> LabelImage | None:
    """Return the labels that vary within a tile of a layer; None if none do."""
    if config.stones is not None:
        stones = texture_stones(config.texture, materials.texture_size_px, materials.texture_seed)
        wanted = config.stones
        ids = wanted.semantic_ids
        return label_stones(stones, tile_m, wanted.min_size_m, ids, config.semantic_ids)
    source = config.labels_from
    if source is None:
        return None
    mapping = {value: entry.semantic_ids for value, entry in source.mapping.items()}
    return load_label_image(source.image, mapping, config.semantic_ids)
