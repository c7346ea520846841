"""A mesh under a light, as `tools.bench.referees.mitsuba_light` is given it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

GROUND, OBJECTS = "ground.ply", "objects.ply"


@dataclass(frozen=True)
class Lighting:
    """What Mitsuba is to render, as JSON-able data in scene units.

    Attributes:
        albedo: Of the ground and the objects.
        hapke: Parameters of the ground's law of Hapke; None: Lambert's law.
        to_sun: Unit vector towards the sun.
        sun_w_m2: Irradiance across its beam.
        sun_radius_rad: Half the sun's angular diameter, for ``sun_share`` only.
        zenith, horizon: Radiance of a grey sky; between, the root of the elevation's sine.
        max_bounces: Light that is reflected more often is left out.
        samples: Per pixel.
        K: (3, 3) of the camera, with OpenCV's pixel centres and a centred principal point.
        size_px: Width and height.
        T_map_camera: (4, 4), optical frame.
    """

    albedo: float
    hapke: Mapping[str, float] | None
    to_sun: tuple[float, float, float]
    sun_w_m2: float
    sun_radius_rad: float
    zenith: float
    horizon: float
    max_bounces: int
    samples: int
    K: list[list[float]]
    size_px: tuple[int, int]
    T_map_camera: list[list[float]]
