"""The worlds of the small pictures: one for each terrain, texture, rock, plant and vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import yaml

from oaisys_core.cli.names import SKY_MODELS
from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.scatter.rocks import STYLES
from oaisys_core.procedural.scatter.shapes import MATS, PLANTS
from oaisys_core.procedural.scatter.vehicles import VEHICLES
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.procedural.textures.library import RECIPES
from oaisys_core.simulation import Simulation
from oaisys_core.types import Pose, merge
from tools.gallery.scenes import ABOVE, CLOSE, StageViewpoint
from tools.programs import ROOT

EXAMPLES = ROOT / "config" / "examples"

SIZE_PX = (240, 160)

CAMERA = {"name": "camera", "width_px": SIZE_PX[0], "height_px": SIZE_PX[1]}
LENS = {"fx_px": 200.0, "fy_px": 200.0}

UNDER_SKY = StageViewpoint("under the sky", (-0.5, -0.5), 2.0, (0.3, 0.3), 4.0)

SPACING_M = 40.0
"""Distance of things that stand in a row along y; views are along x."""

VEHICLE_M = 3.0
SMALL_M = {"rocks": 1.0, "plants": 0.6}
"""Sizes of things that have none of their own here."""

PLANT_M = {
    "birch": 9.0,
    "bracken": 1.0,
    "dwarf_pine": 1.8,
    "hawthorn": 3.5,
    "juniper": 1.8,
    "meadow": 1.5,
    "flower_meadow": 1.5,
    "moss_cushion": 0.3,
    "oak": 10.0,
    "pine": 9.0,
    "reed": 1.8,
    "spruce": 10.0,
    "willow": 3.0,
}
"""Sizes that plants are shown in, along their longest axis."""

GROUND = {"texture": "soil", "label": "soil", "semantic_id": 1}


class PictureViewpoint(Protocol):
    """Where a picture is taken from."""

    def pose(self, simulation: Simulation) -> Pose:
        """Return the pose of the rig in the current world."""


@dataclass(frozen=True)
class ThingViewpoint:
    """The viewpoint of a thing on the plane z = 0.

    Attributes:
        size_m: Length of its longest axis.
        y_m: Where it stands, at x = 0.
        is_flat: Whether it is looked down at.
    """

    size_m: float
    y_m: float
    is_flat: bool

    def pose(self, simulation: Simulation) -> Pose:
        """See `PictureViewpoint`."""
        up, target_up = (1.1, 0.0) if self.is_flat else (0.75, 0.42)
        offset_m = self.size_m * np.array(((-1.3, -0.6, up), (0.0, 0.0, target_up)))
        eye_m, target_m = np.array((0.0, self.y_m, 0.0)) + offset_m
        return pose_looking_at(eye_m, target_m)


@dataclass(frozen=True)
class NamedPicture:
    """A picture to be made.

    Attributes:
        group, name: Folder and name of its file.
        config: The world, without camera and renderer.
        view: Where the picture is taken from.
    """

    group: str
    name: str
    config: Mapping[str, Any]
    view: PictureViewpoint

    def full_config(self, backend: str, quality: str) -> SimulationConfig:
        """Return the configuration with the camera of all pictures and a renderer."""
        rest = {
            "backend": backend,
            "render": {"quality": quality},
            "sensors": {"cameras": [CAMERA | LENS]},
        }
        return config_from_mapping(merge(rest, self.config))


def all_pictures() -> Iterator[NamedPicture]:
    """Yield the pictures of all names that docs/names.md lists."""
    for name in sorted(PRESETS):
        yield NamedPicture("terrains", name, _terrain(name), ABOVE)
    for name in sorted(RECIPES):
        yield NamedPicture("textures", name, _texture(name), CLOSE)
    yield from _things()
    for name, (_, example) in sorted(SKY_MODELS.items()):
        yield NamedPicture("skies", name, _sky(example), UNDER_SKY)


def _things() -> Iterator[NamedPicture]:
    """Yield the pictures of rocks, plants and vehicles, which stand in a row in one world."""
    names = [*_named("rocks", STYLES), *_named("plants", PLANTS), *_named("vehicles", VEHICLES)]
    places_m = [SPACING_M * (index - len(names) // 2) for index in range(len(names))]
    objects = [_object(name, y_m) for (_, name), y_m in zip(names, places_m, strict=True)]
    for (group, name), y_m in zip(names, places_m, strict=True):
        size_m = VEHICLE_M if group == "vehicles" else PLANT_M.get(name, SMALL_M[group])
        view = ThingViewpoint(size_m, y_m, is_flat=name in MATS)
        yield NamedPicture(group, name, _row(objects), view)


def _named(group: str, names: Iterable[str]) -> list[tuple[str, str]]:
    return [(group, name) for name in sorted(names)]


def _terrain(name: str) -> dict[str, Any]:
    return {
        "seed": 3,
        "stage": {"preset": name, "extent_m": 60.0, "resolution_px": 513},
        "assets": {"rocks": []},
        "environment": {"sun_elevation_deg": 24.0},
    }


def _sky(example: str) -> dict[str, Any]:
    """Return the world of an example; where it draws its sky, with one for all pictures."""
    if example == "sky":
        return {"seed": 4, "environment": {"sun_elevation_deg": 30.0}}
    file = EXAMPLES / f"environment_{example}.yaml"
    return dict(yaml.safe_load(file.read_text(encoding="utf-8")))


def _texture(name: str) -> dict[str, Any]:
    return {
        "stage": {"preset": "plane", "extent_m": 16.0, "resolution_px": 65},
        "materials": {"layers": [{"texture": name, "label": name, "semantic_id": 1}]},
        "assets": {"rocks": []},
        "environment": {"sun_elevation_deg": 32.0},
    }


def _object(shape: str, y_m: float) -> dict[str, Any]:
    scale = PLANT_M.get(shape, SMALL_M["plants"]) if shape in PLANTS else 1.0
    thing = {"name": shape, "shape": shape, "label": "thing", "semantic_id": 9}
    return thing | {"position_m": [0.0, y_m, 0.0], "scale": scale}


def _row(objects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {
        "stage": {
            "preset": "plane",
            "extent_m": 1.2 * SPACING_M * len(objects),
            "resolution_px": 65,
        },
        "materials": {"layers": [GROUND], "mask": {"relief": 0}},
        "assets": {"rocks": [], "objects": list(objects)},
        "environment": {"sun_elevation_deg": 35.0, "sun_azimuth_deg": 200.0},
    }
