"""Sun and sky."""

from __future__ import annotations

from math import radians

import numpy as np

from oaisys_core.config.model import EnvironmentConfig
from oaisys_core.module import Metadata, Module, World
from oaisys_core.modules.overrides import overridden
from oaisys_core.scene import Sky


class EnvironmentModule(Module):
    """Holds the light of a batch; a step's metadata overrides any field of its configuration."""

    name = "environment"
    metadata_part = "environment"

    def __init__(self, config: EnvironmentConfig) -> None:
        self._config = config
        self._now = config

    def check(self, metadata: Metadata) -> None:
        """Refuse unknown keys and values out of range."""
        overridden(self._now, metadata, self.metadata_part)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Begin a batch with the configured light and the metadata's changes."""
        self._now = overridden(self._config, metadata, self.metadata_part)
        world.sky = _sky(self._now)
        if self._now.sky_semantic_id:
            world.semantic_labels[self._now.sky_semantic_id] = "sky"

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Change the light for this and the following samples."""
        self._now = overridden(self._now, metadata, self.metadata_part)
        world.sky = _sky(self._now)


def _sky(config: EnvironmentConfig) -> Sky:
    return Sky(
        sun_elevation_rad=radians(config.sun_elevation_deg),
        sun_azimuth_rad=radians(config.sun_azimuth_deg),
        sun_strength_w_m2=config.sun_strength_w_m2,
        sun_angular_diameter_rad=radians(config.sun_angular_diameter_deg),
        sky_strength=config.sky_strength,
        air=config.air,
        dust=config.dust,
        ozone=config.ozone,
        semantic_id=config.sky_semantic_id,
    )
