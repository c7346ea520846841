"""Water up to a level: what rays, labels, heights and the true mesh see of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.terrain.water.ponds import FIRST_WATER_ID, WaterLook, water_on
from oaisys_core.scene import HeightField
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

LOOK = WaterLook(0.5, (0.1, 0.2, 0.2), 0.3)
EXTENT_M = 20.0


def two_hollows() -> HeightField:
    """Ground with a wide hollow on the left and a narrow one on the right, 1 m deep."""
    axis = np.linspace(-EXTENT_M / 2, EXTENT_M / 2, 129)
    x, y = np.meshgrid(axis, axis)
    wide = np.exp(-((x + 4) ** 2 + y**2) / 8)
    narrow = np.exp(-((x - 5) ** 2 + y**2) / 2)
    return HeightField((-wide - narrow).astype(np.float32), (-10.0, -10.0), EXTENT_M / 128)


def test_each_pond_has_its_own_id_and_covers_what_lies_below_the_level() -> None:
    ground = two_hollows()
    water = water_on(ground, -0.4, (40,), LOOK, 0.1)

    assert [p.instance_ids.tolist() for p in water.parts.placements] == [
        [FIRST_WATER_ID], [FIRST_WATER_ID + 1],
    ]  # fmt: skip
    places = np.random.default_rng(0).uniform(-9.9, 9.9, (800, 2))
    below = ground.height_at(places) < -0.4
    covered = np.zeros(len(places), int)
    for prototype in water.parts.prototypes:
        corners = prototype.vertices_m[prototype.triangles][:, :, :2]
        low, high = corners.min(axis=1), corners.max(axis=1)
        hit = ((places[:, None] >= low) & (places[:, None] <= high)).all(axis=2).any(axis=1)
        covered += hit
        assert prototype.water is not None
        assert prototype.water.opacity.max() > prototype.water.opacity.min()
    assert (covered[below] == 1).all()
    assert (covered <= 1).all()
    assert (ground.height_at(places[covered > 0]) < 0).all(), "little more than the ponds"
    left = water.parts.prototypes[0].vertices_m
    assert left[:, 0].max() < 0, "the larger pond comes first"


def world(**water: Any) -> dict[str, Any]:
    return {
        "seed": 4,
        "backend": "analytic",
        "stage": {
            "preset": "mounds",
            "extent_m": 24,
            "resolution_px": 97,
            "water": {"level_share": 0.5, "semantic_id": 40, **water},
        },
        "materials": {"texture_size_px": 32, "layers": [{"texture": "soil", "label": "soil",
                                                         "semantic_id": 1}]},
        "assets": {"rocks": [], "groups": []},
        "sensors": {"cameras": [{"width_px": 64, "height_px": 48}]},
    }  # fmt: skip


def test_depth_labels_heights_and_the_true_mesh_agree_on_water() -> None:
    simulation = Simulation(config_from_mapping(world()))
    simulation.step_batch()
    pose = pose_looking_at((0.0, 0.0, 18.0), (0.1, 0.0, 0.0))
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
    image = {frame.modality: frame.data for frame in sample.frames}
    scene, mesh = simulation.scene, simulation.ground_truth_mesh()
    level_m = float(scene.placements[0].T_map_object[0, 2, 3])

    is_water = image["semantic_0"] == 40
    assert simulation.info().semantic_labels == {1: "soil", 40: "water"}
    assert 0.03 < is_water.mean() < 0.9
    assert ((image["instance"] >= FIRST_WATER_ID) == is_water).all()
    assert image["depth"][is_water] == pytest.approx(18.0 - level_m, rel=1e-2)
    assert mesh.semantic_ids is not None
    corners = mesh.triangles[mesh.semantic_ids == 40]
    assert mesh.vertices_m[corners][..., 2] == pytest.approx(level_m)
    places = np.random.default_rng(0).uniform(-11.9, 11.9, (500, 3))
    heights = simulation.query_height(places)
    under = heights.ground_height_m < level_m
    assert 0.1 < under.mean() < 0.9
    assert heights.surface_height_m[under] == pytest.approx(level_m)
    assert heights.surface_height_m[~under] == pytest.approx(heights.ground_height_m[~under])
    before = simulation.scene
    simulation.step_sample(ModuleMetadata(environment={"sun_elevation_deg": 12.0}))
    assert simulation.scene.placements is before.placements, "nothing is built again"


@pytest.mark.parametrize("water", [{"level_share": None}, {"level_m": 1.0}])
def test_water_needs_one_level(water: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"stage\.water.*either level_m or level_share"):
        config_from_mapping(world(**water))
