"""The look book's list of pictures: all presets and the written worlds, by light and height."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.config import SimulationConfig, config_from_mapping, load_config
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import Pose

NOON_DEG, LOW_DEG = 60.0, 10.0
"""Elevations of the sun."""

SUN_AZIMUTH_DEG = 155.0
"""Azimuth of the sun over the presets; views look at 45°, so that light comes from the side."""

STAGE_M, STAGE_PX = 256.0, 1025


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture is taken from, by height and direction.

    Attributes:
        name: How the picture is called.
        eye_xy_m: Position in ``map``.
        height_m: Above the ground.
        heading_deg: From +x towards +y.
        pitch_deg: Above the horizon.
    """

    name: str
    eye_xy_m: tuple[float, float]
    height_m: float
    heading_deg: float
    pitch_deg: float

    def pose(self, simulation: Simulation) -> Pose:
        """Return the pose of the rig in the current world."""
        x_m, y_m = self.eye_xy_m
        surface_m = simulation.query_height([(x_m, y_m, 0.0)]).surface_height_m[0]
        eye_m = np.array((x_m, y_m, surface_m + self.height_m))
        heading, pitch = np.radians((self.heading_deg, self.pitch_deg))
        level = np.cos(pitch)
        ahead = (level * np.cos(heading), level * np.sin(heading), np.sin(pitch))
        return pose_looking_at(eye_m, eye_m + ahead)


@dataclass(frozen=True)
class LookWorld:
    """A world of the look book.

    Attributes:
        name: Of the preset or of the file.
        source: Its configuration: a mapping, or a file.
        views: The pictures, each with the elevation of the sun; None leaves that of the world.
    """

    name: str
    source: Path | Mapping[str, Any]
    views: tuple[tuple[Viewpoint, float | None], ...]

    def config(self) -> SimulationConfig:
        """Return the configuration; raises InvalidInputError where a key is unknown."""
        if isinstance(self.source, Path):
            return load_config(self.source)
        return config_from_mapping(self.source)


STANDING = Viewpoint("standing", (-50.0, -45.0), 1.7, 45.0, -4.0)
AT_30_M = Viewpoint("30 m up", (-75.0, -70.0), 30.0, 45.0, -14.0)
AT_200_M = Viewpoint("200 m up", (-115.0, -115.0), 200.0, 45.0, -20.0)

GROUNDS: dict[str, tuple[tuple[str, str], str, str]] = {
    "another_noise": (("soil", "grass"), "rock", "earth"),
    "canyon": (("bedrock", "red_sand"), "rock", "earth"),
    "craters": (("regolith", "gravel_dark"), "basalt", "moon"),
    "dunes": (("rippled_sand", "sand"), "rock", "earth"),
    "large_terrain": (("grass", "gravel"), "rock", "earth"),
    "mesa": (("red_sand", "bedrock"), "rock", "earth"),
    "mounds": (("gravel", "sand"), "rock", "earth"),
    "mountain_1": (("gravel", "bedrock"), "rock", "earth"),
    "mountain_2": (("moss", "bedrock"), "rock", "earth"),
    "plane": (("clay_cracks", "pebbles"), "rock", "earth"),
}
"""Textures of the ground, texture of the rocks, and sky of each preset."""

WORLD_VIEWS: dict[str, tuple[Viewpoint, Viewpoint]] = {
    "world_dem": (
        Viewpoint("standing", (-20.0, -16.0), 1.7, 40.0, 6.0),
        Viewpoint("30 m up", (-40.0, -40.0), 30.0, 45.0, -12.0),
    ),
    "world_mars": (
        Viewpoint("at the rover", (-1.5, -7.0), 1.6, 92.0, -9.0),
        Viewpoint("15 m up", (-18.0, -18.0), 15.0, 45.0, -18.0),
    ),
    "world_vegetation": (
        Viewpoint("standing", (-8.0, -8.0), 1.5, 45.0, -10.0),
        Viewpoint("12 m up", (-22.0, -22.0), 12.0, 45.0, -20.0),
    ),
    "world_snow": (
        Viewpoint("standing", (-26.0, -30.0), 1.7, 50.0, 12.0),
        Viewpoint("40 m up", (-55.0, -55.0), 40.0, 45.0, -15.0),
    ),
    "world_moon": (
        Viewpoint("at the lander", (-6.0, -6.5), 1.7, 47.0, -4.0),
        Viewpoint("30 m up", (-40.0, -40.0), 30.0, 45.0, -15.0),
    ),
}


def look_worlds(examples: Path, only: str = "") -> Iterator[LookWorld]:
    """Yield the worlds whose names contain ``only``: ten presets, then the written worlds."""
    for index, preset in enumerate(sorted(GROUNDS)):
        first, other = (NOON_DEG, LOW_DEG) if index % 2 else (LOW_DEG, NOON_DEG)
        views = ((STANDING, first), (AT_30_M, other), (AT_200_M, first))
        if only in preset:
            yield LookWorld(preset, preset_mapping(preset), views)
    for name, views_of_world in WORLD_VIEWS.items():
        if only in name:
            file = examples / f"{name}.yaml"
            yield LookWorld(name, file, tuple((view, None) for view in views_of_world))


def preset_mapping(preset: str) -> dict[str, Any]:
    """Return the configuration of a preset as somebody writes it who wants to see it."""
    layers, rocks, sky = GROUNDS[preset]
    environment: dict[str, Any] = {"sun_azimuth_deg": SUN_AZIMUTH_DEG}
    if sky == "moon":
        environment["sky"] = {"model": "none"}
    else:
        environment["clouds"] = {}
    return {
        "seed": 5,
        "stage": {"preset": preset, "extent_m": STAGE_M, "resolution_px": STAGE_PX},
        "materials": {
            "layers": [
                {"texture": texture, "label": texture, "semantic_id": index}
                for index, texture in enumerate(layers, start=1)
            ]
        },
        "assets": {
            "rock_texture": rocks,
            "rocks": [
                {"kind": "angular", "count": [4000, 4000], "size_m": [0.15, 1.2]},
                {"kind": "boulder", "count": [120, 120], "size_m": [0.8, 2.6]},
            ],
        },
        "environment": environment,
    }
