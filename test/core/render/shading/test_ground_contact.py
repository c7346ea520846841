"""Dust and darkness at the feet of things, where the ground under them is the stage or the land."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_worlds import EXTENT_M, SUNNY, camera, rocky_world

from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.terrain.surroundings.kinds import Surroundings
from oaisys_core.raycast.surface import Surface
from oaisys_core.render.draft.draft import DraftRenderer
from oaisys_core.render.shading.ground_contact import ContactGround
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import HeightField, Placement, Scene
from oaisys_core.types import FloatArray

PLACE_M = (EXTENT_M / 2 + 5.0, 1.0)
SIZE_M = 2.0


def dusty_rock_on_land(base_m: float) -> Scene:
    """A rock beyond the edge of a stage whose heights are around a base."""
    scene = rocky_world()
    assert isinstance(scene.ground, HeightField)
    ground = replace(scene.ground, elevation_m=scene.ground.elevation_m + np.float32(base_m))
    land = Surroundings("land", 5).around(ground, None)
    T_map_object = np.diag((SIZE_M, SIZE_M, SIZE_M, 1.0))[None]
    T_map_object[0, :2, 3] = PLACE_M
    T_map_object[0, 2, 3] = land.height_at([PLACE_M])[0] - 0.2
    rock = Placement(0, (20,), T_map_object, np.array([77], np.uint32), on_land=True)
    prototype = replace(scene.prototypes[0], dust_m=0.15)
    return replace(
        scene,
        ground=ground,
        far_ground=land,
        prototypes=(prototype,),
        placements=(rock,),
        sky=SUNNY,
    )


def radiance_of_rock(base_m: float) -> FloatArray:
    """Return the (N, 3) radiance of its pixels."""
    scene = dusty_rock_on_land(base_m)
    at_m = scene.placements[0].T_map_object[0, :3, 3]
    seen = camera(pose_looking_at(tuple(at_m + np.array((-5.0, 1.0, 4.0))), tuple(at_m)))
    surface = Surface(scene, None)
    view = surface.view(seen)
    shaded = DraftRenderer().shade(surface, view, seen)
    return np.asarray(shaded.radiance[view.instance_ids == 77], np.float64)


@pytest.mark.parametrize("base_m", [-30.0, 30.0])
def test_a_rock_on_the_land_looks_the_same_at_any_height(base_m: float) -> None:
    """Below the origin of ``map`` it was black, and above it there was no dust on it."""
    expected, found = radiance_of_rock(0.0), radiance_of_rock(base_m)
    assert len(expected) > 100
    assert len(found) == len(expected)
    np.testing.assert_allclose(found.mean(axis=0), expected.mean(axis=0), rtol=0.01)


def test_where_there_is_no_ground_nothing_is_dusty_or_dark() -> None:
    scene = replace(dusty_rock_on_land(-30.0), far_ground=None)
    contact = ContactGround(scene, LevelStore())(scene.placements[0].T_map_object)
    assert contact.bed[0, 2] < -10 * SIZE_M
