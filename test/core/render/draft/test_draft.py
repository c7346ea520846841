"""Draft's pictures against closed forms, against Cycles, and each other."""

from contextlib import nullcontext
from dataclasses import replace
from math import cos, pi, radians, sin, tan
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from synthetic_worlds import CENTRED, EXTENT_M, SUNNY, camera, flat_world, rocky_world, settings

from oaisys_core.color import linear
from oaisys_core.geometry import pose_looking_at, pose_looking_down, transform
from oaisys_core.procedural.environment.light import sky_irradiance_w_m2
from oaisys_core.raycast import surface as surface_module
from oaisys_core.raycast import view as view_module
from oaisys_core.raycast.surface import Surface
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.render.draft.draft import DraftRenderer, Shaded
from oaisys_core.scene import HeightField, PlacedCamera, Primitive, Scene, Sky
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import ALBEDO, DEPTH, RGB, FloatArray
from tools.bench.references import psnr_db, ssim

DRAFT = replace(settings(), quality="draft")
NO_SKY = replace(SUNNY, model="none")
GREY = 0.2


def grey(scene: Scene, albedo: float = GREY, roughness: int = 0) -> Scene:
    """The scene on ground of one colour."""
    layer = scene.material.layers[0]
    srgb = np.full((16, 16, 3), round(255 * _srgb(albedo)), np.uint8)
    maps = replace(
        layer.maps,
        color_srgb=srgb,
        height=np.full((16, 16), 0.5, np.float32),
        roughness=np.full((16, 16), roughness, np.uint8),
    )
    material = replace(
        scene.material,
        layers=(replace(layer, maps=maps),),
        masks=np.ones((1, 32, 32), np.float32),
    )
    return replace(scene, material=material)


def _srgb(value: float) -> float:
    return float(1.055 * value ** (1 / 2.4) - 0.055)


def albedo_of(scene: Scene) -> float:
    return float(linear(scene.material.layers[0].maps.color_srgb[0, 0, 0] / 255))


def slope_world(angle_deg: float, sky: Sky) -> Scene:
    """Ground that rises towards +x, and nothing on it."""
    scene = grey(flat_world())
    x_m = np.linspace(0, EXTENT_M, 9) * tan(radians(angle_deg))
    elevation_m = np.repeat(x_m[None], 9, axis=0).astype(np.float32)
    ground = HeightField(elevation_m, (-EXTENT_M / 2,) * 2, EXTENT_M / 8)
    return replace(scene, ground=ground, primitives=(), sky=sky)


def shade(scene: Scene, seen: PlacedCamera) -> tuple[Shaded, FloatArray]:
    """The colours of a view, and the points in ``map`` that its pixels see."""
    surface = Surface(scene, None)
    view = surface.view(seen)
    return DraftRenderer().shade(surface, view, seen), view.points_m


@pytest.mark.parametrize("angle_deg", [0, 15, 30])
@pytest.mark.parametrize("elevation_deg", [20, 50])
def test_a_slope_in_the_sun_follows_lambert(angle_deg: float, elevation_deg: float) -> None:
    sun = replace(NO_SKY, sun_elevation_rad=radians(elevation_deg), sun_azimuth_rad=pi)
    scene = slope_world(angle_deg, sun)
    middle_m = EXTENT_M / 2 * tan(radians(angle_deg))
    pose = pose_looking_at((0.0, 0.0, middle_m + 6.0), (0.01, 0.0, middle_m))
    found, _ = shade(scene, camera(pose))
    expected = albedo_of(scene) / pi * 4.0 * sin(radians(angle_deg + elevation_deg))
    # A slope's lower half sees lit ground, besides.
    bounce = albedo_of(scene) ** 2 / pi * 4.0 * (1 - cos(radians(angle_deg))) / 2
    middle = found.radiance[12:36, 16:48]
    np.testing.assert_allclose(middle, expected + bounce / 2, rtol=0.03)


def test_level_ground_under_the_sky_alone_gets_its_irradiance() -> None:
    night = replace(SUNNY, sun_strength_w_m2=0.0)
    scene = replace(grey(flat_world()), primitives=(), sky=night)
    found, _ = shade(scene, camera(pose_looking_down(0, 0, 8.0)))
    expected = albedo_of(scene) / pi * sky_irradiance_w_m2(night)
    np.testing.assert_allclose(found.radiance.mean(axis=(0, 1)), expected, rtol=0.06)


def wall_world(diameter_deg: float, height_m: float = 3.0) -> Scene:
    """A wall along y, whose shadow of a sun 45 degrees high falls towards +x."""
    wall = Primitive(
        "box",
        (0.2, 30.0, 2 * height_m),
        transform(np.eye(3), (-0.1, 0.0, 0.25)),
        901,
        (20,),
        (0.5, 0.5, 0.5),
    )
    sun = replace(
        NO_SKY,
        sun_elevation_rad=radians(45),
        sun_azimuth_rad=pi,
        sun_angular_diameter_rad=radians(diameter_deg),
    )
    return replace(grey(flat_world()), primitives=(wall,), sky=sun)


def profile(scene: Scene, x_m: float, above_m: float) -> tuple[FloatArray, FloatArray]:
    """Brightness along a row of an image from above, from 0 in shadow to 1, and x there."""
    pose = pose_looking_down(x_m, 0.0, above_m)
    found, points_m = shade(scene, camera(pose))
    image = found.radiance[..., 0]
    order = np.argsort(points_m[24, :, 0]) if np.ptp(points_m[24, :, 0]) > 0.1 else None
    if order is not None:
        x, light = points_m[24, order, 0], image[24, order]
    else:
        order = np.argsort(points_m[:, 32, 0])
        x, light = points_m[order, 32, 0], image[order, 32]
    return x, (light - light.min()) / (light.max() - light.min())


def test_the_edge_of_a_shadow_is_where_geometry_has_it() -> None:
    x_m, light = profile(wall_world(0.001), 3.0, 4.0)
    edge_m = np.interp(0.5, light, x_m)
    pixel_m = float(np.diff(x_m).mean())
    # The wall's top is 3 m above the ground, so its shadow is 3 m long.
    assert edge_m == pytest.approx(3.0, abs=pixel_m)


@pytest.mark.parametrize("diameter_deg", [2.0, 6.0])
def test_the_penumbra_is_as_wide_as_the_sun_is_large(diameter_deg: float) -> None:
    x_m, light = profile(wall_world(diameter_deg), 3.0, 2.5)
    quarter_m, rest_m = (float(np.interp(share, light, x_m)) for share in (0.2, 0.8))
    # Of a disc whose diameter is 1, the middle 0.49 have three fifths of the area.
    reach_m = 3.0 / tan(radians(45 - diameter_deg / 2)) - 3.0 / tan(radians(45 + diameter_deg / 2))
    assert rest_m - quarter_m == pytest.approx(0.49 * reach_m, rel=0.3)


def test_shadows_as_thin_as_a_pixel_are_whole() -> None:
    """Against the slab method, for poles whose shadows are 1.5 pixels wide."""
    x_m = np.linspace(-3, 3, 7)
    poles = tuple(
        Primitive(
            "box",
            (0.2, 0.2, 3.0),
            transform(np.eye(3), (each, 0.37 * each - 1, 0.25)),
            901 + index,
            (20,),
            (0.5, 0.5, 0.5),
        )
        for index, each in enumerate(x_m.tolist())
    )
    sun = wall_world(1e-4).sky
    scene = replace(wall_world(1e-4), primitives=poles)
    found, points_m = shade(scene, camera(pose_looking_down(0.5, -0.5, 7.0)))
    flat_m = points_m.reshape(-1, 3)
    is_ground = flat_m[:, 2] < 0.26
    middles_m = np.array([pole.T_map_object[:3, 3] for pole in poles])
    halves_m = np.array((0.1, 0.1, 1.5))
    to_sun = np.array(sun.to_sun) + 1e-12
    low, high = ((middles_m + sign * halves_m)[None] - flat_m[:, None] for sign in (-1, 1))
    enter, leave = (low / to_sun, high / to_sun)
    first, last = np.minimum(enter, leave).max(axis=-1), np.maximum(enter, leave).min(axis=-1)
    is_dark = ((first <= last) & (last > 0)).any(axis=1)
    # The filter leaves a dark pixel between lit ones two thirds of its shade.
    light = found.radiance[..., 0].reshape(-1)
    lit = float(np.median(light[is_ground & ~is_dark]))
    shown = light < 0.6 * lit
    assert is_dark[is_ground].sum() > 100
    assert shown[is_ground & is_dark].mean() > 0.9
    assert shown[is_ground & ~is_dark].mean() < 0.05


def frames(scene: Scene, seen: PlacedCamera, how: RenderSettings = DRAFT) -> list[NDArray[Any]]:
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    return [frame.data for frame in backend.render_all([seen], how)]


LOW = camera(pose_looking_at((-6, -5, 3), (2, 1, 0)), CENTRED, (RGB, DEPTH, ALBEDO))


def test_the_same_view_has_the_same_bytes_whatever_was_seen_before() -> None:
    scene = rocky_world()
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    first = [frame.data for frame in backend.render_all([LOW], DRAFT)]
    other = camera(pose_looking_down(3, 2, 9), CENTRED, (RGB,))
    backend.render_all([other], DRAFT)
    backend.update(replace(scene, sky=replace(SUNNY, sun_elevation_rad=0.3)))
    backend.render_all([LOW], DRAFT)
    backend.update(scene)
    again = [frame.data for frame in backend.render_all([LOW], DRAFT)]
    for one, two, fresh in zip(first, again, frames(scene, LOW), strict=True):
        assert one.tobytes() == two.tobytes() == fresh.tobytes()


def test_bytes_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_module, "BAND_PIXELS", 320)
    scene = rocky_world()
    images = []
    for threads in (0, 1, 5):
        monkeypatch.setattr(surface_module, "CORES", threads)
        surface = Surface(scene, None)
        with surface.in_parallel() if threads else nullcontext():
            view = surface.view(LOW)
            found = DraftRenderer().shade(surface, view, LOW)
        images.append([view.depth_m, *found])
    for several in images[1:]:
        for one, other in zip(images[0], several, strict=True):
            assert np.ascontiguousarray(one).tobytes() == np.ascontiguousarray(other).tobytes()


def test_draft_shows_textures_shadows_and_albedo() -> None:
    scene = rocky_world()
    rgb, _, albedo = frames(scene, LOW)
    dark = replace(scene, sky=replace(SUNNY, sun_elevation_rad=-0.2))
    night, _, night_albedo = frames(dark, LOW)
    assert rgb.mean() > 2 * night.mean()
    np.testing.assert_array_equal(albedo, night_albedo)
    assert len(np.unique(albedo.reshape(-1, 3), axis=0)) > 20


def test_a_camera_that_sees_nothing_but_sky_has_a_picture() -> None:
    up = camera(pose_looking_at((0, 0, 5), (30, 0, 35)), CENTRED, (RGB,))
    (rgb,) = frames(replace(rocky_world(), far_ground=None), up)
    assert rgb.std() < 60
    assert rgb.mean() > 5


@pytest.mark.blender
def test_draft_looks_like_cycles() -> None:
    scene = grey(rocky_world(), roughness=230)
    found = in_blender("drafts.both_ways", scene, LOW, 0.0)
    assert psnr_db(found["draft"], found["cycles"]) > 26
    assert ssim(found["draft"], found["cycles"]) > 0.8
    assert found["draft"].mean() == pytest.approx(found["cycles"].mean(), rel=0.05)
    np.testing.assert_array_equal(found["again"], found["draft"])
    # Nothing of it is Blender's but the view transform.
    agx = replace(DRAFT, view_transform="agx_contrast")
    own, _, albedo = frames(scene, LOW, agx)
    difference = np.abs(own.astype(int) - found["draft"])
    assert np.percentile(difference, 95) <= 3
    np.testing.assert_array_equal(albedo, found["albedo"])
