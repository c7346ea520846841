"""The light of lamps against closed forms and against integrals over many small sources."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, radians

import numpy as np
import pytest
from synthetic_worlds import SUNNY, camera, flat_world, settings

from oaisys_core.color import linear
from oaisys_core.geometry import pixel_rays, pose_looking_down
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.render.shading.lamp_light import cone_share, lamp_irradiance_w_m2
from oaisys_core.scene.lamps import Lamp
from oaisys_core.types import RGB, FloatArray

POINT = Lamp(
    name="lamp",
    kind="point",
    frame="map",
    position_m=(0.0, 0.0, 4.0),
    forward=(0.0, 0.0, -1.0),
    right=(1.0, 0.0, 0.0),
    strength_w=100.0,
    color=(1.0, 0.5, 0.25),
)
SPOT = replace(POINT, kind="spot", cone_rad=radians(60), cone_softness=0.5)
AREA = replace(POINT, kind="area", width_m=2.0, height_m=0.5)
UP = np.array((0.0, 0.0, 1.0))


def light(lamp: Lamp, points_m: FloatArray, normal: FloatArray = UP) -> FloatArray:
    """(N,) irradiance in red."""
    normals = np.broadcast_to(normal / np.linalg.norm(normal), points_m.shape)
    return lamp_irradiance_w_m2([lamp], points_m, normals)[:, 0]


def along_x(*x_m: float) -> FloatArray:
    return np.array([(x, 0.0, 0.0) for x in x_m])


def test_a_point_lamp_follows_inverse_square_and_lamberts_cosine() -> None:
    x_m = np.linspace(-10, 10, 21)
    distance_m = np.hypot(x_m, 4.0)
    expected = 100.0 / (4 * pi) * (4.0 / distance_m) / distance_m**2
    np.testing.assert_allclose(light(POINT, along_x(*x_m)), expected)
    assert not light(POINT, along_x(*x_m), -UP).any()
    higher = replace(POINT, position_m=(0.0, 0.0, 8.0))
    np.testing.assert_allclose(light(higher, along_x(0.0)), light(POINT, along_x(0.0)) / 4)


def test_colours_and_lamps_add_up() -> None:
    points = along_x(0.0, 3.0)
    normals = np.broadcast_to(UP, points.shape)
    both = lamp_irradiance_w_m2([POINT, AREA], points, normals)
    np.testing.assert_allclose(both[:, 0], light(POINT, points) + light(AREA, points))
    np.testing.assert_allclose(both[:, 1:], both[:, :1] * np.array((0.5, 0.25)))


def test_a_spot_is_a_point_lamp_within_its_cone() -> None:
    inner, outer = radians(10), radians(31)
    points = along_x(0.0, 4 * np.tan(inner), 4 * np.tan(outer))
    middle, inside, outside = light(SPOT, points) / light(POINT, points)
    assert middle == pytest.approx(1.0)
    edge = cos(radians(30))
    share = (cos(inner) - edge) / ((1 - edge) * 0.5)
    assert inside == pytest.approx(min(share, 1.0) ** 2 * (3 - 2 * min(share, 1.0)))
    assert outside == 0.0
    sharp = replace(SPOT, cone_softness=0.0)
    np.testing.assert_allclose(cone_share(sharp, np.cos(np.radians([0, 29.9, 30.1]))), (1, 1, 0))


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.5, 0.3, 1), (-1, 0, 1.5)])
def test_an_area_lamp_is_the_sum_of_its_parts(normal: tuple[float, float, float]) -> None:
    points = np.array([(0.0, 0.0, 0.0), (2.0, -1.0, 0.5), (-3.0, 4.0, 1.0), (0.4, 0.1, 3.0)])
    direction = np.array(normal, dtype=float)
    direction /= np.linalg.norm(direction)
    u = (np.arange(400) + 0.5) / 400 - 0.5
    sources = np.stack(np.meshgrid(u * 2.0, u * 0.5, [4.0]), axis=-1).reshape(-1, 3)
    radiance = 100.0 / (pi * 2.0 * 0.5)
    expected = []
    for point in points:
        rays = sources - point
        distance_m = np.linalg.norm(rays, axis=1)
        received = np.maximum(rays @ direction, 0) / distance_m
        emitted = np.maximum(rays[:, 2], 0) / distance_m
        expected.append((radiance * received * emitted / distance_m**2).mean() * 2.0 * 0.5)
    np.testing.assert_allclose(light(AREA, points, direction), expected, rtol=2e-4)


def test_an_area_lamp_shines_to_one_side_and_from_afar_by_lamberts_law() -> None:
    above = np.array([(0.0, 0.0, 5.0), (3.0, 1.0, 4.5)])
    assert not light(AREA, above, -UP).any()
    far = replace(AREA, position_m=(0.0, 0.0, 400.0))
    tilted = replace(far, forward=(-0.6, 0.0, -0.8), right=(0.8, 0.0, -0.6))
    at_axis = 100.0 / (pi * 400.0**2)
    assert light(far, along_x(0.0))[0] == pytest.approx(at_axis, rel=1e-4)
    assert light(tilted, along_x(0.0))[0] == pytest.approx(0.8 * at_axis, rel=1e-3)


def test_pictures_at_night_show_the_lamps_alone() -> None:
    """Radiance is albedo / pi times irradiance, pixel by pixel; nothing else shines."""
    sky = replace(SUNNY, model="none", sun_elevation_rad=-0.2)
    lamp = replace(POINT, position_m=(1.0, 0.5, 2.25), color=(1.0, 1.0, 1.0))
    view = camera(pose_looking_down(0.0, 0.0, 6.25), modalities=(RGB, "albedo"))
    backend = AnalyticBackend()
    backend.build(replace(flat_world(), primitives=(), sky=sky, lamps=(lamp,)), lambda _: None)
    rgb, albedo = backend.render_all([view], settings())
    rays = pixel_rays(view.intrinsics) @ view.T_map_camera[:3, :3].T
    points = np.array((0.0, 0.0, 6.25)) + rays * (6.0 / -rays[..., 2:])
    irradiance = light(lamp, points.reshape(-1, 3)).reshape(rgb.data.shape[:2])
    expected = linear(albedo.data / 255) * irradiance[..., None] / pi
    assert expected.max() > 0.1
    np.testing.assert_allclose(linear(rgb.data / 255), expected, atol=0.01)
    backend.update(replace(flat_world(), primitives=(), sky=sky))
    assert not backend.render_all([view], settings())[0].data.any()
