"""The ground: which terrain a batch stands on."""

from __future__ import annotations

import hashlib

import numpy as np

from oaisys_core.config.stage import StageConfig
from oaisys_core.errors import ConfigError
from oaisys_core.module import Metadata, Module, World
from oaisys_core.scene import HeightField
from oaisys_core.terrain.presets import PRESETS, make_ground


class StageModule(Module):
    """Draws the ground of a batch from a terrain preset."""

    name = "stage"
    metadata_part = "stage"

    def __init__(self, config: StageConfig) -> None:
        if config.preset not in PRESETS:
            known = ", ".join(sorted(PRESETS))
            raise ConfigError(f"stage.preset: received {config.preset!r}, expected one of {known}")
        self._config = config

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Put a new ground into the world."""
        world.ground = make_ground(
            self._config.preset,
            self._config.extent_m,
            self._config.resolution_px,
            rng,
            roughness=self._config.roughness,
            relief_m=self._config.relief_m,
        )
        world.stage_hash = content_hash(world.ground)


def content_hash(ground: HeightField) -> str:
    """Return a hash that two grounds share only if they are the same surface."""
    digest = hashlib.sha256(np.ascontiguousarray(ground.elevation_m).tobytes())
    digest.update(repr((ground.elevation_m.shape, ground.origin_xy_m, ground.spacing_m)).encode())
    return digest.hexdigest()
