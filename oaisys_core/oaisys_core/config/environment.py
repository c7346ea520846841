"""Sun and sky.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from pydantic import Field

from oaisys_core.config.section import Section, SemanticId


class EnvironmentConfig(Section):
    """Sun and sky.

    Attributes:
        sun_azimuth_deg: From +x (east) towards +y (north).
        sun_strength_w_m2: Irradiance on a surface facing the sun, in Blender's scene units.
        sky_strength: Factor on the sky's radiance.
        air, dust, ozone: Densities of the atmosphere, 1 is a clear day on Earth.
        sky_semantic_id: Label of pixels that hit nothing; 0 leaves them unlabelled.
    """

    sun_elevation_deg: float = Field(default=38.0, ge=-10, le=90)
    sun_azimuth_deg: float = 125.0
    sun_strength_w_m2: float = Field(default=4.0, ge=0)
    sun_angular_diameter_deg: float = Field(default=0.545, ge=0, le=90)
    sky_strength: float = Field(default=1.0, ge=0)
    air: float = Field(default=1.0, ge=0, le=10)
    dust: float = Field(default=1.0, ge=0, le=10)
    ozone: float = Field(default=1.0, ge=0, le=10)
    sky_semantic_id: SemanticId = 0
