"""The worlds of the gallery: all example configurations, and one world per texture set."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oaisys_core.config import SimulationConfig, adjust, config_from_mapping, load_config
from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.textures.library import TEXTURES
from oaisys_core.simulation import Simulation
from oaisys_core.types import Pose

EYE_HEIGHT_M = 1.7

TARGET_GROUP = "textures by themselves"


@dataclass(frozen=True)
class StageViewpoint:
    """A viewpoint relative to the stage.

    Attributes:
        eye: (x, y) from the centre, in half extents of the stage.
        height_m: Height above the surface; in half extents if ``is_relative``.
        target: (x, y) of the point to look at, in half extents.
        rise_m: Height of that point above the surface.
    """

    name: str
    eye: tuple[float, float]
    height_m: float
    target: tuple[float, float]
    rise_m: float = 0.0
    is_relative: bool = False

    def pose(self, simulation: Simulation) -> Pose:
        """Return the pose of the rig in the current world."""
        x0, y0, x1, y1 = simulation.scene.ground.extent_m
        middle, half = np.array((x0 + x1, y0 + y1)) / 2, np.array((x1 - x0, y1 - y0)) / 2
        eye, target = middle + half * self.eye, middle + half * self.target
        surface_m = simulation.query_height([(*eye, 0.0), (*target, 0.0)]).surface_height_m
        while not np.isfinite(surface_m).all():
            # The ground of a mesh may not fill its extent.
            eye = middle + 0.9 * (eye - middle)
            surface_m = simulation.query_height([(*eye, 0.0), (*target, 0.0)]).surface_height_m
        height_m = self.height_m * float(half.min()) if self.is_relative else self.height_m
        return pose_looking_at(
            (*eye, surface_m[0] + height_m), (*target, surface_m[1] + self.rise_m)
        )


EYE = StageViewpoint("eye height", (-0.3, -0.35), EYE_HEIGHT_M, (0.25, 0.2), 0.8)
ABOVE = StageViewpoint("from above", (-0.85, -0.85), 0.62, (0.05, 0.05), 0.0, is_relative=True)
CLOSE = StageViewpoint("close", (0.0, -0.25), 1.5, (0.0, 0.05))
TOWARDS_SKY = StageViewpoint("towards the sky", (-0.3, -0.35), EYE_HEIGHT_M, (0.9, 0.75), 5.0)


@dataclass(frozen=True)
class Picture:
    """A world and its viewpoints; without viewpoints the rig's own motion is used."""

    group: str
    name: str
    caption: str
    config: SimulationConfig
    views: tuple[StageViewpoint, ...]


def picture_names(examples: Path) -> list[str]:
    """Return the names of all worlds of the gallery."""
    return [*sorted(file.stem for file in examples.glob("*.yaml")), *map(_texture_name, TEXTURES)]


def _texture_name(texture: str) -> str:
    return f"texture_{texture}"


def pictures(examples: Path, only: str, backend: str, quality: str) -> Iterator[Picture]:
    """Yield the worlds of the gallery whose names contain ``only``."""
    for file in sorted(file for file in examples.glob("*.yaml") if only in file.stem):
        config = adjust(load_config(file), backend=backend, quality=quality)
        group, _, name = file.stem.partition("_")
        yield Picture(group, name or group, _caption(file), config, _views(group, config))
    for texture in sorted(name for name in TEXTURES if only in _texture_name(name)):
        yield Picture(
            TARGET_GROUP, texture, "", _texture_config(texture, backend, quality), (CLOSE,)
        )


def _views(group: str, config: SimulationConfig) -> tuple[StageViewpoint, ...]:
    if config.sensors.motion.kind != "given":
        return ()
    if group == "stage":
        return (EYE, ABOVE)
    if group == "environment":
        return (TOWARDS_SKY, EYE)
    return (EYE,)


def _caption(file: Path) -> str:
    """Return the comment on top of an example."""
    first = file.read_text(encoding="utf-8").splitlines()[0]
    return first.removeprefix("#").strip()


def _texture_config(texture: str, backend: str, quality: str) -> SimulationConfig:
    return config_from_mapping(
        {
            "backend": backend,
            "stage": {"preset": "plane", "extent_m": 16.0, "resolution_px": 129},
            "materials": {"layers": [{"texture": texture, "label": texture, "semantic_id": 1}]},
            "assets": {"rocks": []},
            "environment": {"sun_elevation_deg": 32.0},
            "render": {"quality": quality},
        }
    )
