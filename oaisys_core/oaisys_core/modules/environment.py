"""Sun and sky."""

from __future__ import annotations

from math import radians

from oaisys_core.config.environment import EnvironmentConfig
from oaisys_core.module import World
from oaisys_core.modules.overrides import SectionModule
from oaisys_core.scene import Sky


class EnvironmentModule(SectionModule[EnvironmentConfig]):
    """Holds the light of a batch; a step's metadata overrides any field of its configuration."""

    name = "environment"
    metadata_part = "environment"

    def apply(self, world: World, section: EnvironmentConfig) -> None:
        """Set sun and sky."""
        world.sky = _sky(section)
        if section.sky_semantic_id:
            world.semantic_labels[section.sky_semantic_id] = "sky"


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
        semantic_ids=(config.sky_semantic_id,),
    )
