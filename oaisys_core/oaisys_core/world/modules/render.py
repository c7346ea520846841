"""The module that sets the quality of the colour images."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from oaisys_core.config.sections.render import EffectsConfig, RenderConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.sensing.effects import NO_EFFECTS, Bloom, Effects, SensorNoise
from oaisys_core.sensing.exposure import AutoExposure
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import DIGITAL
from oaisys_core.world.module import Metadata, SectionModule, World, override, require

LIGHT_SEED = 0
"""Seed of the sampling pattern, the same for all views: a pose rendered again looks the same."""


class QualityPreset(NamedTuple):
    """The settings of a quality preset; see `RenderSettings`."""

    samples: int
    max_bounces: int
    max_samples: int = 1
    small_samples: int = 0


PRESETS = {
    "geometry": QualityPreset(samples=1, max_bounces=0),
    "draft": QualityPreset(samples=1, max_bounces=0),
    "preview": QualityPreset(samples=1, max_bounces=2, small_samples=6),
    "standard": QualityPreset(samples=3, max_bounces=2, max_samples=6, small_samples=6),
    "high": QualityPreset(samples=8, max_bounces=3, small_samples=6),
    "final": QualityPreset(samples=128, max_bounces=4),
}


LOOKS = {
    "clean": NO_EFFECTS,
    "machine_vision": Effects(
        chromatic_aberration=0.0004, vignetting=0.6, noise=SensorNoise(10_500.0, 2.5)
    ),
    "mars_mastcam_like": Effects(
        bloom=Bloom(0.85, 6.0, 0.15), vignetting=0.3, noise=SensorNoise(26_000.0, 18.0)
    ),
}
"""Effects by the name of a camera's look."""


class RenderModule(SectionModule[RenderConfig]):
    """Converts a quality preset to render settings; metadata may override the configuration."""

    name = "render"
    metadata_part = "render"

    def __init__(self, config: RenderConfig, offered: frozenset[str]) -> None:
        """Take the section and the modalities of all sensors of the rig.

        Raises:
            ConfigError: An image that the section asks for would not be rendered.
        """
        super().__init__(config)
        self._offered = offered
        try:
            config.check_passes(offered, self.name)
        except InvalidInputError as error:
            raise ConfigError(str(error)) from error

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys, invalid values, and images that would not be rendered."""
        self._check(self._config, metadata)

    def check_sample(self, metadata: Metadata) -> None:
        """Raise as `check` does; the section may have been changed since the batch began."""
        self._check(self._now, metadata)

    def _check(self, before: RenderConfig, metadata: Metadata) -> None:
        changed = override(before, metadata, self.metadata_part)
        if changed is not before:
            changed.check_passes(self._offered, f"metadata.{self.metadata_part}")

    def apply(self, world: World, section: RenderConfig) -> None:
        """Set the render settings, except for the seed of the sensor noise."""
        settings = _settings(section, self._offered)
        if settings.exposure_ev is None and world.material is not None:
            meter = settings.auto_exposure.for_ground(world.material.mean_luminance)
            settings = replace(settings, auto_exposure=meter)
        world.render = settings
        has_numbers = any(map(section.renders, DIGITAL & self._offered))
        self.changes_by_itself = has_numbers or world.render.effects.noise is not None

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Apply the metadata, and draw the seed of this sample's sensor noise."""
        super().step_sample(world, metadata, rng)
        world.render = replace(require(world.render), noise_seed=int(rng.integers(2**63)))


def _settings(config: RenderConfig, offered: frozenset[str]) -> RenderSettings:
    preset = PRESETS[config.quality]
    passes = frozenset(filter(config.renders, offered))
    most = config.max_samples or (preset.max_samples if config.samples is None else 1)
    is_preset = config.samples is None and config.max_samples is None
    samples = config.samples or min(preset.samples, config.max_samples or preset.samples)
    return RenderSettings(
        quality=config.quality,
        samples=samples,
        max_samples=max(samples, most),
        small_samples=preset.small_samples if is_preset else 0,
        max_bounces=preset.max_bounces if config.max_bounces is None else config.max_bounces,
        denoise=config.denoise,
        exposure_ev=config.exposure_ev,
        auto_exposure=AutoExposure(**config.auto_exposure.model_dump()),
        seed=LIGHT_SEED,
        view_transform=config.view_transform,
        time_budget_s=config.time_budget_s,
        passes=None if passes == offered else passes,
        effects=_effects(config.effects, LOOKS[config.camera_look]),
        device=config.device,
        white_balance=config.white_balance,
    )


def _effects(config: EffectsConfig, look: Effects) -> Effects:
    """Return the effects of a configuration, and those of a look where it has none."""
    bloom, noise = config.bloom, config.sensor_noise
    return Effects(
        chromatic_aberration=config.chromatic_aberration or look.chromatic_aberration,
        bloom=Bloom(**bloom.model_dump()) if bloom is not None else look.bloom,
        vignetting=config.vignetting or look.vignetting,
        noise=SensorNoise(**noise.model_dump()) if noise is not None else look.noise,
    )
