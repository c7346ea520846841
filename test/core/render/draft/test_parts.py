"""The parts of draft against closed forms: sky, textures, film, visibility, water."""

from dataclasses import replace
from math import degrees, pi, radians

import numpy as np
import pytest
from synthetic_worlds import SUNNY, flat_world

from oaisys_core.color import LUMINANCE
from oaisys_core.procedural.environment.atmosphere import clear_sky, level_irradiance
from oaisys_core.procedural.environment.light import (
    SKY_IRRADIANCE_W_M2,
    daylight,
    sky_irradiance_w_m2,
)
from oaisys_core.raycast.surface import Surface
from oaisys_core.render.draft.ground.ground_details import darken_wet
from oaisys_core.render.draft.ground.texture_atlas import TextureAtlas
from oaisys_core.render.draft.ground.water import fresnel
from oaisys_core.render.draft.light.sky_light import SkyLight
from oaisys_core.render.draft.light.visibility import SkyVisibility
from oaisys_core.render.draft.objects.rock_texture import box_weights
from oaisys_core.render.shading.looks import WET_DARKENING
from oaisys_core.scene import HeightField
from oaisys_core.scene.sky import SkyModel
from oaisys_core.sensing.view_transforms import FILMS, show

UP = np.array([(0, 0, 1)], np.float32)


@pytest.mark.parametrize("elevation_deg", [5, 9, 20, 38, 60])
def test_the_sky_is_as_bright_as_daylight_says(elevation_deg: float) -> None:
    sky = clear_sky(radians(elevation_deg), 0.0, 1.0, 1.0, 1.0)
    found = level_irradiance(sky) @ LUMINANCE / SKY_IRRADIANCE_W_M2
    assert found == pytest.approx(daylight(radians(elevation_deg)), rel=0.06)


@pytest.mark.parametrize("model", ["atmosphere", "plain"])
def test_level_surfaces_get_the_irradiance_of_the_sky(model: SkyModel) -> None:
    sky = replace(SUNNY, model=model)
    found = SkyLight(sky).irradiance(UP)[0]
    np.testing.assert_allclose(found, sky_irradiance_w_m2(sky), rtol=0.06)


def test_a_wall_gets_half_of_an_even_sky() -> None:
    even = replace(SUNNY.gradient, zenith=(1.0, 1.0, 1.0), horizon=(1.0, 1.0, 1.0))
    light = SkyLight(replace(SUNNY, model="plain", gradient=even))
    wall = light.irradiance(np.array([(1, 0, 0)], np.float32))
    np.testing.assert_allclose(light.irradiance(UP), pi, rtol=0.05)
    np.testing.assert_allclose(wall, pi / 2, rtol=0.05)


def test_an_atlas_looks_each_level_up_and_wraps_around() -> None:
    rng = np.random.default_rng(1)
    levels = [rng.random((size, size)).astype(np.float32) for size in (16, 8)]
    atlas = TextureAtlas(levels)
    for level, image in enumerate(levels):
        size = len(image)
        row, column = np.indices(image.shape).reshape(2, -1)
        u, v = (column + 0.5) / size, (size - row - 0.5) / size
        places = atlas.places((u + 3, v - 2), np.full(len(u), level, np.uint8))
        np.testing.assert_allclose(atlas.look_up(places), image[row, column], atol=1e-5)
        # Between the last texel and the first.
        at_edge = np.array([1.0]), np.array([0.5 / size])
        edge = atlas.look_up(atlas.places(at_edge, np.array([level], np.uint8)))
        assert edge[0] == pytest.approx((image[-1, 0] + image[-1, -1]) / 2, abs=1e-5)


def test_a_rock_shows_one_side_or_mixes_those_beside() -> None:
    normals = np.array([(1, 0, 0), (0, -1, 0.05), (1, 1, 0), (1, 1, 1)], np.float32)
    weights = box_weights(normals)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
    np.testing.assert_allclose(weights[0], (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(weights[1], (0, 1, 0), atol=1e-6)
    np.testing.assert_allclose(weights[2], (0.5, 0.5, 0), atol=1e-6)
    np.testing.assert_allclose(weights[3], 1 / 3, atol=1e-6)


def test_water_mirrors_two_percent_from_above_and_all_at_the_horizon() -> None:
    found = fresnel(np.array((1.0, 0.5, 1e-4), np.float32))
    assert found[0] == pytest.approx(((1.33 - 1) / (1.33 + 1)) ** 2, rel=1e-3)
    assert 0.05 < found[1] < 0.07
    assert found[2] > 0.99


def test_ground_is_wet_on_the_stage_alone() -> None:
    places = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, 2.5), (0.0, 0.0, 4.0), (12.0, 0.0, 1.0)])
    color = np.ones((4, 3), np.float32)
    darken_wet((2.0, 3.0), (-10.0, -10.0, 10.0, 10.0), places, color)
    dark = 1 - WET_DARKENING
    np.testing.assert_allclose(color[:, 1], (dark, (1 + dark) / 2, 1, 1), atol=1e-6)


def test_the_bottom_of_a_trench_sees_the_sky_between_its_walls() -> None:
    scene = replace(flat_world(), primitives=())
    x_m = np.linspace(-20, 20, 257)
    depth_m = np.where(np.abs(x_m) < 4, 0.0, 8.0).astype(np.float32)
    ground = HeightField(np.repeat(depth_m[None], 257, axis=0), (-20.0, -20.0), 40 / 256)
    visibility = SkyVisibility(Surface(replace(scene, ground=ground), None))
    middle, above = visibility.at(np.array([(0.0, 0.0, 0.0), (12.0, 0.0, 8.0)]))
    # A long trench whose walls rise by 63 degrees; horizons are searched in steps.
    assert degrees(np.arctan2(8, 4)) == pytest.approx(63.4, abs=0.1)
    assert middle == pytest.approx(np.sin(np.arctan2(4, 8)), abs=0.13)
    assert above > 0.97
    # The land behind the stage is not in the trench that ends there.
    edge, near, far = visibility.at(np.array([(0.0, y_m, 0.0) for y_m in (20.0, 22.0, 90.0)]))
    assert edge < 0.6
    assert near == pytest.approx((1 + edge) / 2, abs=0.02)
    assert far == 1


def test_film_darkens_nothing_to_grey_and_keeps_grey_grey() -> None:
    stops = 2.0 ** np.arange(-10, 5)
    grey = np.repeat(stops[:, None, None], 3, axis=2).astype(np.float32)
    for name in FILMS:
        shown = show(grey, name, 0.0).astype(int)  # type: ignore[arg-type]
        assert np.ptp(shown, axis=2).max() <= 1
        assert (np.diff(shown[:, 0, 0]) >= 0).all()
        assert shown[0, 0, 0] < 12
        assert shown[-1, 0, 0] > 240
    raw = show(np.full((1, 1, 3), 0.25, np.float32), "raw", 1.0)
    assert (raw == 128).all()
