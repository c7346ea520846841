"""Where a ground may hide the sun, against all rays cast by Open3D, and shadows of closed form."""

from __future__ import annotations

from math import cos, radians, sin, tan

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray

from oaisys_core.raycast.targets.ground_shade import BLOCK, GroundShade
from oaisys_core.raycast.targets.ray_target import RayCone
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

SPACING_M = 0.5
LIFT_M = 2e-3


def sun(elevation_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    level, turn = cos(radians(elevation_deg)), radians(azimuth_deg)
    return level * cos(turn), level * sin(turn), sin(radians(elevation_deg))


def rough(rows: int, columns: int, seed: int, height_m: float) -> HeightField:
    rng = np.random.default_rng(seed)
    elevation_m = np.zeros((rows, columns))
    y, x = np.indices((rows, columns)) * SPACING_M
    for _ in range(12):
        wave = rng.normal(0, 0.4, 2)
        elevation_m += height_m / 12 * np.sin(x * wave[0] + y * wave[1] + rng.uniform(0, 6))
    cliff = rng.integers(3, columns - 3)
    elevation_m[:, cliff:] += height_m * rng.uniform(-1, 1)
    return HeightField(elevation_m.astype(np.float32), (-7.0, 3.0), SPACING_M)


def are_hidden(ground: HeightField, origins_m: FloatArray, rays: FloatArray) -> NDArray[np.bool_]:
    """Cast all rays by Open3D at the ground's triangles."""
    scene = o3d.t.geometry.RaycastingScene()
    triangles = ground.triangles().astype(np.uint32)
    scene.add_triangles(o3d.core.Tensor(ground.vertices_m()), o3d.core.Tensor(triangles))
    both = np.hstack((origins_m, rays)).astype(np.float32)
    return np.asarray(scene.test_occlusions(o3d.core.Tensor(both)).numpy(), np.bool_)


def places(ground: HeightField, count: int, seed: int) -> FloatArray:
    """Draw points on, above and beside a ground."""
    rng = np.random.default_rng(seed)
    x0, y0, x1, y1 = ground.extent_m
    xy_m = rng.uniform((x0 - 2, y0 - 2), (x1 + 2, y1 + 2), (count, 2))
    height_m = ground.height_at(xy_m)
    lift_m = np.where(rng.random(count) < 0.5, LIFT_M, rng.uniform(0, 3, count))
    outside_m = rng.uniform(-3, 3, count)
    return np.column_stack((xy_m, np.where(np.isnan(height_m), outside_m, height_m + lift_m)))


@pytest.mark.parametrize("shape", [(60, 97), (130, 33), (9, 9)])
@pytest.mark.parametrize("half_angle_rad", [0.0, 0.0047, 0.12])
@pytest.mark.parametrize("height_m", [0.3, 2.0, 12.0])
def test_no_ray_that_the_ground_hides_is_left_out(
    shape: tuple[int, int], half_angle_rad: float, height_m: float
) -> None:
    ground = rough(*shape, seed=shape[0], height_m=height_m)
    shade = GroundShade(ground)
    origins_m = places(ground, 3000, seed=1)
    rng = np.random.default_rng(2)
    hidden = 0
    for azimuth_deg in range(0, 360, 29):
        for elevation_deg in (3.0, 12.0, 30.0, 55.0, 80.0):
            axis = np.array(sun(elevation_deg, azimuth_deg))
            aside = rng.normal(size=(len(origins_m), 3))
            aside -= (aside @ axis)[:, None] * axis
            aside /= np.linalg.norm(aside, axis=1, keepdims=True)
            off_rad = half_angle_rad * rng.random((len(origins_m), 1)) ** 0.2
            rays = np.cos(off_rad) * axis + np.sin(off_rad) * aside
            is_hidden = are_hidden(ground, origins_m, rays)
            may_hide = shade.may_hide(origins_m, RayCone(tuple(axis.tolist()), half_angle_rad))
            assert not (is_hidden & ~may_hide).any(), (azimuth_deg, elevation_deg)
            hidden += int(is_hidden.sum())
    assert hidden > 100, "nothing was hidden, so nothing was tried"


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0, 270.0, 37.0, 141.0, 200.0, 333.0])
def test_a_wall_is_looked_at_from_its_shadow_alone(azimuth_deg: float) -> None:
    """A wall of 4 m across a plain, the sun at 20 degrees: its shadow is 4 m / tan(20) long."""
    elevation_m = np.zeros((401, 401), np.float32)
    towards = np.array(sun(0.0, azimuth_deg)[:2])
    y, x = np.indices(elevation_m.shape) * SPACING_M
    ahead_m = (x - 100.0) * towards[0] + (y - 100.0) * towards[1]
    elevation_m[np.abs(ahead_m - 30.0) < 1.0] = 4.0
    shade = GroundShade(HeightField(elevation_m, (0.0, 0.0), SPACING_M))
    long_m = 4.0 / tan(radians(20.0))
    behind_m = np.linspace(0.5, 60.0, 120)
    xy_m = 100.0 + (30.0 - 1.0 - behind_m)[:, None] * towards
    origins_m = np.column_stack((xy_m, np.full(len(xy_m), LIFT_M)))
    may_hide = shade.may_hide(origins_m, RayCone(sun(20.0, azimuth_deg)))
    assert may_hide[behind_m < long_m - 0.1].all()
    # A block, its diagonal and the next one are how precise the bound is.
    assert not may_hide[behind_m > long_m + 4 * BLOCK * SPACING_M].any()


def test_rays_of_a_wide_cone_are_cast_however_far_a_tower_is() -> None:
    elevation_m = np.zeros((161, 401), np.float32)
    elevation_m[80:82, 380:382] = 30.0
    ground = HeightField(elevation_m, (0.0, 0.0), SPACING_M)
    shade = GroundShade(ground)
    axis, half_angle_rad = sun(10.0, 0.0), 0.12
    y_m, x_m = (each.ravel() for each in np.meshgrid(np.arange(1, 79, 0.5), np.arange(5, 180, 2)))
    origins_m = np.column_stack((x_m, y_m, np.full(len(x_m), LIFT_M)))
    rays = np.array((190.2, 40.2, 28.0)) - origins_m
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    within = np.arccos(rays @ axis) < half_angle_rad
    is_hidden = are_hidden(ground, origins_m, rays) & within
    assert is_hidden.sum() > 100
    may_hide = shade.may_hide(origins_m, RayCone(axis, half_angle_rad))
    assert not (is_hidden & ~may_hide).any()


def test_gentle_ground_hides_nothing_from_a_high_sun() -> None:
    y, x = np.indices((201, 201)) * SPACING_M
    elevation_m = (0.2 * x + np.sin(0.3 * y)).astype(np.float32)
    ground = HeightField(elevation_m, (0.0, 0.0), SPACING_M)
    origins_m = places(ground, 500, seed=3)
    x0, y0, x1, y1 = ground.extent_m
    inside = ((origins_m[:, :2] > (x0, y0)) & (origins_m[:, :2] < (x1, y1))).all(axis=1)
    shade = GroundShade(ground)
    assert not shade.may_hide(origins_m[inside], RayCone(sun(40.0, 10.0), 0.005)).any()
    # From beside it, a ray may come from below.
    assert shade.may_hide(origins_m[~inside], RayCone(sun(40.0, 10.0), 0.005)).all()


@pytest.mark.parametrize("elevation_deg", [-5.0, 0.5, 89.5])
def test_rays_that_are_level_or_upright_are_all_cast(elevation_deg: float) -> None:
    shade = GroundShade(HeightField(np.zeros((20, 20), np.float32), (0.0, 0.0), SPACING_M))
    origins_m = np.array(((4.0, 4.0, 1.0),))
    assert shade.may_hide(origins_m, RayCone(sun(elevation_deg, 0.0), 0.005)).all()
