"""Quality of the colour images."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oaisys_core.backend.base import RenderSettings
from oaisys_core.config.model import RenderConfig
from oaisys_core.module import Metadata, Module, World
from oaisys_core.modules.overrides import overridden

LIGHT_SEED = 0
"""One pattern of light samples for all views: a pose rendered again gives the same picture."""


class Preset(NamedTuple):
    """What a quality name stands for."""

    samples: int
    max_bounces: int


PRESETS = {
    "preview": Preset(samples=1, max_bounces=2),
    "standard": Preset(samples=4, max_bounces=2),
    "high": Preset(samples=16, max_bounces=3),
    "final": Preset(samples=128, max_bounces=4),
}


class RenderModule(Module):
    """Turns a quality preset into settings; a step's metadata overrides its configuration."""

    name = "render"
    metadata_part = "render"

    def __init__(self, config: RenderConfig) -> None:
        self._config = config
        self._now = config

    def check(self, metadata: Metadata) -> None:
        """Refuse unknown keys and values out of range."""
        overridden(self._now, metadata, self.metadata_part)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Begin a batch with the configured quality and the metadata's changes."""
        self._now = overridden(self._config, metadata, self.metadata_part)
        world.render = _settings(self._now)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Change the quality for this and the following samples."""
        self._now = overridden(self._now, metadata, self.metadata_part)
        world.render = _settings(self._now)


def _settings(config: RenderConfig) -> RenderSettings:
    preset = PRESETS[config.quality]
    return RenderSettings(
        quality=config.quality,
        samples=preset.samples,
        max_bounces=preset.max_bounces,
        denoise=True,
        exposure_ev=config.exposure_ev,
        seed=LIGHT_SEED,
    )
