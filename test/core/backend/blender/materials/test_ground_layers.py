"""Grounds of many layers in Blender: Cycles draws what is too large for its stack black."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from blender_process import in_blender

pytestmark = [pytest.mark.blender, pytest.mark.long]

TEXTURES = ("ice", "snow", "sastrugi", "mud", "salt_crust", "gravel")
"""With layers below the surface and gloss, which need most."""

N, V, S = "none", "voronoi", "stochastic"
GROUNDS = (
    *([N] * 2, [N] * 6, [V] * 2, [V] * 3, [V, N, N], [N, N, N, V]),
    *([S] * 2, [N, N, N, S], [S, V]),
)


def world(tilings: list[str]) -> dict[str, Any]:
    """A canyon, whose walls are textured from the side, with all that changes its colour."""
    layers = [
        {"texture": texture, "label": texture, "semantic_id": index + 1, "anti_tiling": tiling}
        for index, (texture, tiling) in enumerate(zip(TEXTURES, tilings, strict=False))
    ]
    rover = {
        "name": "rover",
        "label": "rover",
        "semantic_id": 51,
        "shape": "rover",
        "trajectory": {"waypoints_m": [[-8, -8], [8, -8], [0, 8]], "closed": True},
    }
    water = {"level_share": 0.1, "semantic_id": 40}
    return {
        "seed": 3,
        "stage": {"preset": "canyon", "extent_m": 40, "resolution_px": 129, "water": water},
        "materials": {"layers": layers},
        "environment": {"haze": {}},
        "assets": {"movers": [rover]},
        "sensors": {
            "cameras": [
                {"name": "camera", "width_px": 48, "height_px": 36, "fx_px": 40, "fy_px": 40}
            ],
            "pose_policy": "clamp",
        },
    }


def test_no_ground_is_black(tmp_path: Path) -> None:
    paths = []
    for tilings in GROUNDS:
        paths.append(tmp_path / f"{'-'.join(tilings)}.yaml")
        paths[-1].write_text(yaml.safe_dump(world(tilings)), encoding="utf-8")

    found = in_blender("examples.rendered", [str(path) for path in paths], 1)

    for name, images in found.items():
        (rgb,) = (data for _, modality, data in images["samples"][0] if modality == "rgb")
        assert rgb.max(axis=-1).min() > 2, name
    assert len(found) == len(GROUNDS)
