"""Rays to the sun begin above the land's triangles that lean away from it."""

from dataclasses import replace
from math import cos, radians, sin, sqrt

import numpy as np

from oaisys_core.procedural.terrain.surroundings.kinds import EARTH_RADIUS_M
from oaisys_core.procedural.terrain.surroundings.land import land_around
from oaisys_core.render.draft.light.far_lift import GRAZING_COS, FarLift
from oaisys_core.scene import HeightField


def test_triangles_that_lean_away_are_left_by_as_much_as_they_are_wide() -> None:
    ground = HeightField(np.zeros((9, 9), np.float32), (-4.0, -4.0), 1.0)
    lean_rad = radians(20.0)
    vertices_m = np.array(
        ((0, 0, 0), (3, 0, 0), (0, 3, 0), (0, 0, 0), (0, 3, 0), (-3, 0, -3 * sin(lean_rad))),
        np.float32,
    )
    land = replace(
        land_around(ground, 5, EARTH_RADIUS_M),
        vertices_m=vertices_m,
        triangles=np.array(((0, 1, 2), (3, 4, 5)), np.int32),
        cast_triangles=2,
    )
    up_rad = radians(10.0)
    lift = FarLift()
    lift.take_over(land, (cos(up_rad), 0.0, sin(up_rad)))
    level_m, leaning_m, beyond_m = lift.of(np.array((0, 1, 2)))
    np.testing.assert_allclose(level_m, 3 * (GRAZING_COS - sin(up_rad)), rtol=1e-5)
    # The second one rises towards the sun.
    slope = np.array((-sin(lean_rad), 0.0, 1.0)) / sqrt(1 + sin(lean_rad) ** 2)
    facing = slope @ (cos(up_rad), 0.0, sin(up_rad))
    edge_m = sqrt(3 * 3 * sqrt(1 + sin(lean_rad) ** 2))
    np.testing.assert_allclose(leaning_m, edge_m * (GRAZING_COS - facing), rtol=1e-5)
    assert beyond_m == 0
