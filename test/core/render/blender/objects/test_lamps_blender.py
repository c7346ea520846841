"""Lamps as Cycles renders them, against closed forms and whatever was rendered before."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import SUNNY, camera, flat_world

from oaisys_core.color import linear
from oaisys_core.geometry import pixel_rays, pose_looking_at, pose_looking_down, transform
from oaisys_core.render.shading.lamp_light import lamp_irradiance_w_m2
from oaisys_core.scene import Primitive, Scene
from oaisys_core.scene.lamps import Lamp
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0

pytestmark = pytest.mark.blender

NIGHT = replace(SUNNY, model="none", sun_elevation_rad=-0.3)
TABLE = Primitive(
    "box", (30.0, 30.0, 1.0), transform(np.eye(3), (0.0, 0.0, 0.5)), 900, (20,), (0.8, 0.7, 0.6)
)
"""A level surface at z = 1 whose colour is known."""

POINT = Lamp(
    name="lamp",
    kind="point",
    frame="map",
    position_m=(1.0, 0.5, 3.0),
    forward=(0.0, 0.0, -1.0),
    right=(1.0, 0.0, 0.0),
    strength_w=80.0,
    color=(1.0, 0.9, 0.8),
    radius_m=0.02,
)
LAMPS = {
    "point": POINT,
    "farther": replace(POINT, position_m=(1.0, 0.5, 5.0), strength_w=400.0),
    "large": replace(POINT, radius_m=0.5),
    "spot": replace(POINT, kind="spot", cone_rad=radians(70), cone_softness=0.5),
    "sharp spot": replace(POINT, kind="spot", cone_rad=radians(50)),
    "area": replace(POINT, kind="area", strength_w=50.0, width_m=2.0, height_m=0.5),
    "tilted area": replace(
        POINT,
        kind="area",
        forward=(0.6, 0.0, -0.8),
        right=(0.0, -1.0, 0.0),
        strength_w=50.0,
        width_m=0.5,
        height_m=1.0,
    ),
}
VIEW = camera(pose_looking_down(0.0, 0.0, 7.0), modalities=(RGB,))


def night(*lamps: Lamp, lit: bool = False) -> Scene:
    sky = replace(NIGHT, sun_elevation_rad=0.7) if lit else NIGHT
    return replace(flat_world(), primitives=(TABLE,), sky=sky, lamps=lamps)


def test_cycles_lights_a_plane_as_the_closed_forms_say() -> None:
    """Inverse square, Lambert's cosine, the spot's cone and the area's side, in absolute terms."""
    scenes = [night(lamp) for lamp in LAMPS.values()]
    pictures = in_blender("lamps.lambertian_views", scenes, [VIEW] * len(scenes), 32)
    rays = pixel_rays(VIEW.intrinsics) @ VIEW.T_map_camera[:3, :3].T
    points = (np.array((0.0, 0.0, 7.0)) + rays * (6.0 / -rays[..., 2:])).reshape(-1, 3)
    normals = np.broadcast_to((0.0, 0.0, 1.0), points.shape)
    for (name, lamp), picture in zip(LAMPS.items(), pictures, strict=True):
        irradiance = lamp_irradiance_w_m2([lamp], points, normals).reshape(picture.shape)
        expected = linear(TABLE.color_srgb) * irradiance / pi
        assert 0.1 < expected.max() < 0.95, name
        off = np.abs(picture - expected)
        assert off.mean() < 0.004, name
        assert np.quantile(off, 0.99) < 0.03, name


@pytest.mark.long
def test_pictures_do_not_depend_on_the_lamps_before() -> None:
    """Cycles tells lamps at one place apart by nothing but their order."""
    colors = ((1.0, 0.1, 0.1), (0.1, 1.0, 0.1), (0.1, 0.1, 1.0))
    spot, *points = (replace(POINT, name=str(color), color=color) for color in colors)
    spot = replace(LAMPS["spot"], name=spot.name, color=spot.color)
    wanted = night(spot, *points, lit=True)
    histories = [
        [wanted],
        [night(), night(*points, lit=True), wanted],
        [night(*points[::-1]), night(lit=True), wanted],
        [night(points[1], points[0], spot, lit=True), wanted],
        [night(replace(spot, strength_w=3.0), *points), wanted],
    ]
    pictures = in_blender("lamps.after_others", histories, VIEW, 2)
    assert [pictures.index(picture) for picture in pictures] == [0] * len(histories)
    without = [[night(lit=True)], [wanted, night(lit=True)]]
    assert len(set(in_blender("lamps.after_others", without, VIEW, 2))) == 1


def test_a_lamp_in_view_is_not_to_be_seen() -> None:
    """Its light falls on things; the lamp itself is in no image."""
    eye, ahead = (-12.0, 0.0, 2.5), (0.0, 0.0, 2.5)
    view = camera(pose_looking_at(eye, ahead), modalities=(RGB, DEPTH, SEMANTIC_0, INSTANCE))
    towards = replace(
        POINT,
        kind="area",
        position_m=(-9.0, 0.0, 2.8),
        forward=(-1.0, 0.0, 0.0),
        right=(0.0, 1.0, 0.0),
        width_m=2.0,
        height_m=1.0,
        strength_w=500.0,
    )
    bulb = replace(POINT, position_m=(-8.0, 1.0, 3.2), radius_m=0.3)
    dark, lit = in_blender("lamps.frames_of", [night(), night(bulb, towards)], view)
    assert not dark[0].any()
    is_sky = ~np.isfinite(lit[1])
    assert lit[0][~is_sky].max() > 60
    assert lit[0][is_sky].max() <= 2
    for one, other in zip(dark[1:], lit[1:], strict=True):
        assert np.array_equal(one, other)
