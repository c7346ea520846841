"""Grounds of many layers in Blender: Cycles draws what is too large for its stack black."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from blender_process import in_blender
from synthetic_worlds import SUNNY, GivenTone

from oaisys_core.procedural.terrain.macro_variation import MacroPattern
from oaisys_core.scene.photometric_laws import Hapke
from oaisys_core.scene.sky import Haze
from oaisys_core.scene.terrain_material import PbrMaps, TerrainLayer, TerrainMaterial, Variation
from oaisys_core.scene.tiling import PlainTiling, Tiling, stochastic_tiling, voronoi_tiling

STACK = 255
"""Numbers that Cycles' stack holds."""

pytestmark = pytest.mark.blender

TEXTURES = ("ice", "snow", "sastrugi", "mud", "salt_crust", "gravel")
"""With layers below the surface and gloss, which need most."""

N, V, S = "none", "voronoi", "stochastic"
GROUNDS = ([N] * 6, [S, V])
MORE_GROUNDS = ([V] * 3, [N, N, N, V], [N, N, N, S])
"""Between those, whose use of the stack is bounded by another test."""


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
    return {
        "seed": 3,
        "stage": {
            "preset": "canyon",
            "extent_m": 40,
            "resolution_px": 65,
            "surroundings": "plain",
            "water": {"level_share": 0.1, "semantic_id": 40},
        },
        "materials": {"layers": layers},
        "environment": {"haze": {}},
        "assets": {"rocks": [], "movers": [rover]},
        "sensors": {
            "cameras": [
                {"name": "camera", "width_px": 48, "height_px": 36, "fx_px": 40, "fy_px": 40}
            ],
            "pose_policy": "clamp",
        },
    }


@pytest.mark.parametrize(
    "grounds",
    [
        pytest.param(GROUNDS, marks=pytest.mark.long, id="most"),
        pytest.param(MORE_GROUNDS, marks=pytest.mark.soak, id="between"),
    ],
)
def test_no_ground_is_black(grounds: tuple[list[str], ...], tmp_path: Path) -> None:
    paths = []
    for tilings in grounds:
        paths.append(tmp_path / f"{'-'.join(tilings)}.yaml")
        paths[-1].write_text(yaml.safe_dump(world(tilings)), encoding="utf-8")

    found = in_blender("examples.rendered", [str(path) for path in paths], 1)

    for name, images in found.items():
        (rgb,) = (data for _, modality, data in images["samples"][0] if modality == "rgb")
        assert rgb.max(axis=-1).min() > 2, name
    assert len(found) == len(grounds)


def material(layers: int, tiling: Tiling) -> TerrainMaterial:
    """Layers of different tiles with all that ground can have, projected from the side."""
    rng = np.random.default_rng(layers)
    masks = rng.dirichlet(np.ones(layers), (8, 8)).astype(np.float32)

    def maps(index: int) -> PbrMaps:
        color, normal = rng.integers(0, 256, (2, 16, 16, 3), np.uint8)
        height, roughness = rng.random((16, 16), np.float32), np.full((16, 16), 60, np.uint8)
        return PbrMaps(f"{index}", color, height, normal, roughness, 1 + index / 3, subsurface=0.3)

    return TerrainMaterial(
        tuple(TerrainLayer(f"{i}", (i + 1,), maps(i), tiling) for i in range(layers)),
        np.moveaxis(masks, -1, 0),
        (-5.0, -5.0, 5.0, 5.0),
        projects_sides=True,
        tone=GivenTone(rng.integers(0, 256, (8, 8, 3), np.uint8)),
        macro=MacroPattern(0.5, 1),
        variation=Variation(0.3, 0.1),
        wet_bank_m=(-9.0, -8.5),
    )


@pytest.mark.long
def test_cycles_stack_has_room_for_any_number_of_layers() -> None:
    # Twice as many layers double one switch more, which takes a few numbers.
    rng = np.random.default_rng(0)
    turned, shifted = voronoi_tiling(1.0, 0.3, rng), stochastic_tiling(1.0, rng)
    few = [material(2, each) for each in (PlainTiling(), turned, shifted)]
    many = [material(4, turned), material(4, shifted), material(16, PlainTiling())]
    law = Hapke(0.32, 0.24, 0.3, 1.8, 0.071, 0.4)
    many.append(replace(few[0], is_lambertian=True, law=law))
    hazy = replace(SUNNY, haze=Haze((0.01, 0.02, 0.03)))

    of_plain, of_turned, of_shifted = used = in_blender("stack.stack_use", few, hazy)
    assert 20 < min(used) <= max(used) < STACK // 2, used
    bounds = [min(least + 20, STACK // 2 - 1) for least in (of_turned, of_shifted, of_plain)]
    bounds.append(bounds[-1])
    assert in_blender("stack.keeps_at_most", many, bounds, hazy) == [True] * 4, used
