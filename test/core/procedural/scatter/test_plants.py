"""Plants that grow by rules, and the moisture that decides where they stand."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.config.sections.density import MoistureDensity
from oaisys_core.procedural.scatter.placement.density import make_density
from oaisys_core.procedural.scatter.plants.growth import StemRule, branches, stems
from oaisys_core.procedural.scatter.plants.species import SPECIES
from oaisys_core.procedural.terrain.water.moisture import moisture
from oaisys_core.scene import HeightField

MAX_TRIANGLES = 40_000


@pytest.mark.parametrize("name", SPECIES)
def test_a_species_grows_to_1_m_from_its_seed(name: str) -> None:
    plant, same, other = (SPECIES[name](np.random.default_rng(seed), 1.0) for seed in (1, 1, 2))

    assert np.ptp(plant.vertices_m, axis=0).max() == pytest.approx(1.0, abs=1e-5)
    assert -0.1 < plant.vertices_m[:, 2].min() < 0.01, "its foot is at the origin"
    assert np.abs(plant.vertices_m[:, :2].mean(axis=0)).max() < 0.35, "it stands above its foot"
    assert plant.triangles.max() < len(plant.vertices_m)
    assert len(plant.triangles) <= MAX_TRIANGLES
    assert plant.translucency is not None
    assert 0 < plant.translucency.max() < 128, "leaves let less light through than they reflect"
    assert np.array_equal(plant.vertices_m, same.vertices_m)
    assert plant.vertices_m.shape != other.vertices_m.shape or not np.allclose(
        plant.vertices_m, other.vertices_m
    ), "another seed grows another plant"


def test_branches_leave_their_parents_at_the_angle_and_length_of_the_rule() -> None:
    rng = np.random.default_rng(3)
    upright = StemRule(1, wander=0.0, points=5, taper=0.5)
    trunk = stems(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.ones(1), np.full(1, 0.1),
                  upright, rng)  # fmt: skip
    rule = StemRule(7, (0.2, 0.8), 0.5, angle_deg=(60.0, 60.0), wander=0.0, jitter=0.0)

    grown = branches(trunk, rule, rng)

    feet, ways = grown.points_m[:, 0], grown.points_m[:, -1] - grown.points_m[:, 0]
    assert trunk.lengths_m == pytest.approx(1.0)
    assert (np.abs(feet[:, :2]) < 1e-9).all()
    assert ((feet[:, 2] > 0.2) & (feet[:, 2] < 0.8)).all()
    assert np.linalg.norm(ways, axis=1) == pytest.approx(0.5)
    assert ways[:, 2] / 0.5 == pytest.approx(np.cos(np.radians(60.0)))
    assert grown.radii_m[:, 0] == pytest.approx(0.6 * 0.1 * (1 - 0.5 * feet[:, 2]))


def test_water_gathers_in_valleys_and_plants_that_like_it_stand_there() -> None:
    axis = np.linspace(-20, 20, 129)
    valley = 0.2 * np.abs(axis)[None, :] + 0.05 * axis[:, None]
    ground = HeightField(valley.astype(np.float32), (-20.0, -20.0), 40 / 128)
    wet = MoistureDensity(kind="moisture", range_share=(0.8, 1.0), fade_share=0.0)

    found = moisture(ground)
    density = make_density((wet,), ground, np.random.default_rng(0))

    columns = found[20:-20].mean(axis=0)
    assert abs(int(columns.argmax()) - len(columns) / 2) < 5
    assert columns[len(columns) // 2] > columns[len(columns) // 5] + 0.3
    assert density(np.array([[0.0, -10.0], [12.0, -10.0]])).tolist() == [1.0, 0.0]
    places = np.random.default_rng(1).uniform(-19, 19, (4000, 2))
    assert density(places).mean() == pytest.approx(0.2, abs=0.04), "a share of the ground"


def test_level_ground_is_equally_moist_everywhere() -> None:
    level = HeightField(np.zeros((9, 9), np.float32), (0.0, 0.0), 1.0)
    assert (moisture(level) == 0.5).all()
