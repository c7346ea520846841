"""Keys of the configuration that change a picture, each with two values to compare."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from oaisys_core.types import merge
from tools.gallery.names.worlds import NamedPicture, PictureViewpoint, ThingViewpoint
from tools.gallery.scenes import StageViewpoint

PAIRS = "keys"
"""Folder of the pairs of pictures."""

BASE: Mapping[str, Any] = {
    "seed": 5,
    "stage": {"preset": "mounds", "extent_m": 40.0, "resolution_px": 257},
    "assets": {"rocks": [{"kind": "boulder", "count": [60, 60], "size_m": [0.3, 1.3]}]},
}
BOULDER = {
    "name": "boulder",
    "shape": "boulder",
    "label": "boulder",
    "semantic_id": 9,
    "position_m": [0.0, 0.0, 0.0],
}
LAKE = {"water": {"level_share": 0.3, "semantic_id": 40}}

ACROSS = StageViewpoint("across", (-0.5, -0.5), 2.2, (0.2, 0.2), 0.6)
SKYWARDS = StageViewpoint("skywards", (-0.5, -0.5), 1.7, (0.9, 0.75), 4.0)
NEAR = StageViewpoint("near", (-0.1, -0.1), 0.9, (-0.03, -0.03), 0.0)
DOWN = StageViewpoint("down", (-0.9, -0.9), 0.5, (0.05, 0.05), 0.0, is_relative=True)


@dataclass(frozen=True)
class KeyPair:
    """A key with two values.

    Attributes:
        key: Dotted path; ``[]`` stands for the first item of a list.
        values: What is compared, as YAML is written.
        note: What the pictures show.
        view: Where both are taken from.
        world: What differs from `BASE` in both.
    """

    key: str
    values: tuple[Any, Any]
    note: str
    view: PictureViewpoint = ACROSS
    world: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name of the pair's file."""
        return self.key.replace("[]", "").replace(".", "_")

    @property
    def section(self) -> str:
        """The section of the configuration that the key is in."""
        return self.key.rpartition(".")[0]

    def pictures(self) -> tuple[NamedPicture, NamedPicture]:
        """Return the pictures of both values."""
        first, second = (
            NamedPicture(
                PAIRS, self.name, merge(merge(BASE, self.world), self._part(value)), self.view
            )
            for value in self.values
        )
        return first, second

    def _part(self, value: Any) -> dict[str, Any]:
        """Return the part of a configuration that gives the key a value."""
        part = value
        for name in reversed(self.key.split(".")):
            part = {name[:-2]: [part]} if name.endswith("[]") else {name: part}
        return dict(part)


SUNSET = {"environment": {"sun_elevation_deg": 5.0}}

KEY_PAIRS = (
    KeyPair("environment.sun_elevation_deg", (6, 60), "A low sun has long shadows and is warm."),
    KeyPair("environment.sun_azimuth_deg", (45, 225), "The sun before and behind the camera."),
    KeyPair(
        "environment.sun_angular_diameter_deg",
        (0.53, 40),
        "A wide sun casts soft shadows.",
        ThingViewpoint(1.2, 0.0, is_flat=False),
        {
            "stage": {"preset": "plane"},
            "assets": {"rocks": [], "objects": [BOULDER]},
            "environment": {"sun_elevation_deg": 30.0, "sun_azimuth_deg": 250.0},
        },
    ),
    KeyPair("environment.haze.visibility_m", (2000, 60), "Contrast falls with the distance."),
    KeyPair("environment.clouds.cover", (0.15, 0.6), "How much of the sky is hidden.", SKYWARDS),
    KeyPair("environment.dust", (0, 8), "Dust makes the sky pale and the light warm.", SKYWARDS),
    KeyPair("environment.sky_strength", (0.2, 3), "How bright the shadows are beside the sun."),
    KeyPair("render.auto_exposure.compensation_ev", (-1.5, 1.5), "Stops on top of the metering."),
    KeyPair(
        "render.auto_exposure.albedo_share",
        (0, 1),
        "Whether dark ground is shown dark.",
        ACROSS,
        {"materials": {"layers": [{"texture": "basalt", "label": "basalt", "semantic_id": 1}]}},
    ),
    KeyPair("render.view_transform", ("standard", "agx_contrast"), "How radiance becomes colour."),
    KeyPair("render.white_balance", ("daylight", "illuminant"), "At a low sun.", ACROSS, SUNSET),
    KeyPair("render.effects.vignetting", (0, 1), "The corners darken with the angle of view."),
    KeyPair(
        "render.effects.sensor_noise.full_well_e", (10000, 150), "Fewer electrons are more noise."
    ),
    KeyPair("stage.relief_m", (1, 8), "The height difference of the large forms."),
    KeyPair("stage.roughness", (0, 2.5), "A factor on the fine relief."),
    KeyPair(
        "stage.detail.textures",
        (0, 1),
        "Stones near the camera stand up.",
        NEAR,
        {
            "stage": {"preset": "plane", "detail": {}},
            "materials": {"layers": [{"texture": "pebbles", "label": "bank", "semantic_id": 1}]},
            "assets": {"rocks": []},
            "environment": {"sun_elevation_deg": 16.0},
        },
    ),
    KeyPair(
        "stage.erosion.age",
        (0.02, 0.3),
        "Gullies at first, valleys later.",
        DOWN,
        {"stage": {"relief_m": 9.0}, "assets": {"rocks": []}},
    ),
    KeyPair(
        "stage.water.level_share", (0.15, 0.45), "Where the water stands.", DOWN, {"stage": LAKE}
    ),
    KeyPair(
        "stage.water.waves",
        (0, 1),
        "A mirror, and a fresh breeze.",
        ACROSS,
        {"stage": {"water": {"level_share": 0.6, "semantic_id": 40}}},
    ),
    KeyPair("stage.water.clarity_m", (0.1, 4), "How deep one looks.", DOWN, {"stage": LAKE}),
    KeyPair(
        "stage.water.wet_bank_m",
        (0, 0.8),
        "The bank is wet and dark so high up.",
        DOWN,
        {"stage": LAKE},
    ),
    KeyPair("stage.surroundings", ("plain", "land"), "What lies beyond the stage.", DOWN),
    KeyPair("assets.rocks[].count", ([20, 20], [500, 500]), "How many rocks lie there."),
    KeyPair("assets.rocks[].size_m", ([0.2, 0.4], [1.0, 2.5]), "How large they are."),
    KeyPair(
        "materials.variation.brightness", (0, 0.9), "Slow change of the ground's colour.", DOWN
    ),
    KeyPair("materials.variation.tint", (0, 0.8), "The same between cool and warm.", DOWN),
)
"""All pairs; the item of a list that a key is in has defaults beside it."""
