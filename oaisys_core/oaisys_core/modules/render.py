"""Quality of the colour images."""

from __future__ import annotations

from typing import NamedTuple

from oaisys_core.backend.base import RenderSettings
from oaisys_core.config.render import RenderConfig
from oaisys_core.module import World
from oaisys_core.modules.overrides import SectionModule

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


class RenderModule(SectionModule[RenderConfig]):
    """Turns a quality preset into settings; a step's metadata overrides its configuration."""

    name = "render"
    metadata_part = "render"

    def apply(self, world: World, section: RenderConfig) -> None:
        """Set samples, bounces and exposure."""
        world.render = _settings(section)


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
