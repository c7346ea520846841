"""Things that stand on the ground: scattered rocks and calibration solids."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from oaisys_core import geometry
from oaisys_core.config.assets import AssetsConfig, PrimitiveConfig, RockGroupConfig
from oaisys_core.config.section import Section
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.module import Metadata, Module, World, drawn
from oaisys_core.modules.overrides import overridden
from oaisys_core.scatter.placement import scatter_on
from oaisys_core.scatter.rocks import ROCK_KINDS, make_rock
from oaisys_core.scene import Ground, MeshPrototype, PbrMaps, Placement, Primitive
from oaisys_core.textures import default_cache_dir, texture_set
from oaisys_core.types import FloatArray, Pose

LARGE_ROCK_M = 1.3
"""Rocks that may become larger than this have four times as many triangles."""


class AssetMetadata(Section):
    """What a caller can set for a batch.

    Attributes:
        count_factor: Factor on the number of rocks of every group.
    """

    count_factor: Annotated[float, Field(ge=0, le=100)] = 1.0


class AssetsModule(Module):
    """Scatters rocks over the ground, anew for each batch."""

    name = "assets"
    metadata_part = "asset"

    def __init__(self, config: AssetsConfig, texture_size_px: int, texture_seed: int) -> None:
        for index, group in enumerate(config.rocks):
            if group.kind not in ROCK_KINDS:
                known = ", ".join(sorted(ROCK_KINDS))
                raise ConfigError(
                    f"assets.rocks.{index}.kind: received {group.kind!r}, expected one of {known}"
                )
        self._config = config
        self._texture = (texture_size_px, texture_seed)
        self._rock_maps: PbrMaps | None = None

    def setup(self) -> None:
        """Load or make the rocks' texture set."""
        if self._config.rocks:
            maps = texture_set(self._config.rock_texture, *self._texture, default_cache_dir())
            self._rock_maps = replace(maps, tile_m=self._config.rock_tile_m)

    def check(self, metadata: Metadata) -> None:
        """Refuse unknown keys and values out of range."""
        overridden(AssetMetadata(), metadata, self.metadata_part)

    def check_sample(self, metadata: Metadata) -> None:
        """Refuse everything: what stands on the ground is drawn once a batch."""
        if metadata:
            raise InvalidInputError("metadata.asset", dict(metadata), "none at a sample step")

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Replace all objects of the world."""
        ground = drawn(world.ground)
        factor = overridden(AssetMetadata(), metadata, self.metadata_part).count_factor
        prototypes: list[MeshPrototype] = []
        placements: list[Placement] = []
        next_id = 1
        for group in self._config.rocks:
            shapes = self._draw_shapes(group, rng)
            T_map_object = _draw_poses(group, factor, ground, shapes, rng)
            shape_of = rng.integers(len(shapes), size=len(T_map_object))
            ids = np.arange(next_id, next_id + len(T_map_object), dtype=np.uint32)
            next_id += len(T_map_object)
            for variant in range(len(shapes)):
                chosen = shape_of == variant
                placements.append(
                    Placement(
                        len(prototypes) + variant,
                        group.semantic_ids,
                        T_map_object[chosen],
                        ids[chosen],
                    )
                )
            prototypes.extend(shapes)
            world.semantic_labels.update(group.labels)
        world.prototypes = tuple(prototypes)
        world.placements = tuple(placements)
        world.primitives = tuple(
            _primitive(primitive, next_id + index)
            for index, primitive in enumerate(self._config.primitives)
        )
        for primitive in self._config.primitives:
            world.semantic_labels.update(primitive.labels)

    def _draw_shapes(self, group: RockGroupConfig, rng: np.random.Generator) -> list[MeshPrototype]:
        subdivisions = 4 if group.size_m[1] > LARGE_ROCK_M else 3
        return [
            replace(make_rock(group.kind, rng, subdivisions), maps=self._rock_maps)
            for _ in range(group.variants)
        ]


def _draw_poses(
    group: RockGroupConfig,
    factor: float,
    ground: Ground,
    shapes: list[MeshPrototype],
    rng: np.random.Generator,
) -> FloatArray:
    least, most = group.count
    count = round(factor * int(rng.integers(least, most, endpoint=True)))
    T_map_object, _ = scatter_on(
        ground,
        count,
        group.size_m,
        rng,
        size_exponent=group.size_exponent,
        sink=group.sink,
        max_slope_deg=group.max_slope_deg,
        height_share=float(np.mean([shape.vertices_m[:, 2].max() for shape in shapes])),
    )
    return T_map_object


def _primitive(config: PrimitiveConfig, instance_id: int) -> Primitive:
    pose = Pose(config.position_m, config.quat_xyzw)
    return Primitive(
        shape=config.shape,
        size_m=config.size_m,
        T_map_object=geometry.pose_to_matrix(pose),
        instance_id=instance_id,
        semantic_ids=config.semantic_ids,
        color_srgb=config.color_srgb,
    )
