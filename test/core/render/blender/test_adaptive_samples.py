"""Samples per pixel by what a view is full of: known worlds, and what a picture then has."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import camera, flat_world, settings

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.raycast.surface import Surface
from oaisys_core.render.blender.adaptive_samples import (
    ViewNeed,
    adapt,
    samples_for,
    view_need,
)
from oaisys_core.scene import Lamp, Primitive, Scene
from oaisys_core.types import PinholeIntrinsics

DOWN = camera(pose_looking_down(10.0, 10.0, 8.0))
GROUND_M = 0.25


@cache
def reeds(pitch_m: float) -> Scene:
    """Thin upright boxes on level ground, under the camera that looks down."""
    steps_m = np.arange(7.0, 13.0, pitch_m)
    boxes = [
        Primitive(
            "box",
            (0.12, 0.12, 0.4),
            np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, GROUND_M + 0.2], [0, 0, 0, 1.0]]),
            1 + len(steps_m) * row + column,
            (20,),
            (0.2, 0.5, 0.1),
        )
        for row, y in enumerate(steps_m)
        for column, x in enumerate(steps_m)
    ]
    return replace(flat_world(), primitives=tuple(boxes))


@cache
def surface_of_reeds(pitch_m: float) -> Surface:
    return Surface(reeds(pitch_m), None)


def needed(scene: Scene) -> ViewNeed:
    return view_need(Surface(scene, None), DOWN)


def test_open_ground_in_the_sun_needs_nothing() -> None:
    assert needed(flat_world()) == (0.0, 0.0)


def test_thin_things_are_clutter_and_many_more_so() -> None:
    few, many = (view_need(surface_of_reeds(pitch_m), DOWN) for pitch_m in (1.6, 0.5))
    assert few.clutter < 0.5 < many.clutter


def test_without_the_sun_all_is_shade() -> None:
    scene = flat_world()
    assert needed(replace(scene, sky=replace(scene.sky, sun_elevation_rad=-0.1))) == (0.0, 1.0)


def test_a_view_of_the_sky_alone_is_shade_and_nothing_fails() -> None:
    up = camera(pose_looking_at((10, 10, 3), (10.1, 10, 30)))
    assert view_need(Surface(flat_world(), None), up).clutter == 0


def test_an_image_of_one_pixel_has_a_need() -> None:
    one = replace(DOWN, intrinsics=PinholeIntrinsics(1, 1, 50.0, 50.0, 0.0, 0.0))
    assert view_need(Surface(flat_world(), None), one) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("clutter", "shade", "samples"), [(0, 0, 3), (0.3, 0, 4), (1, 0, 6), (0, 1, 5), (1, 1, 6)]
)
def test_samples_lie_between_their_bounds(clutter: float, shade: float, samples: int) -> None:
    assert samples_for(ViewNeed(clutter, shade), 3, 6) == samples


def test_settings_of_one_number_keep_it() -> None:
    surface = surface_of_reeds(0.5)
    assert adapt(surface, DOWN, settings(1)) == settings(1)
    fixed = adapt(surface, DOWN, replace(settings(5), denoise=True, max_samples=5))
    assert fixed.samples == 5
    assert fixed.clutter == view_need(surface, DOWN).clutter


def test_small_images_have_more_samples_within_the_bounds() -> None:
    surface = Surface(flat_world(), None)
    wanted = replace(settings(3), denoise=True, max_samples=6)
    found = []
    for width_px, height_px in ((64, 48), (72, 54), (80, 60), (96, 72), (320, 240)):
        intrinsics = replace(DOWN.intrinsics, width_px=width_px, height_px=height_px)
        found.append(adapt(surface, replace(DOWN, intrinsics=intrinsics), wanted).samples)
    assert found == [6, 5, 4, 3, 3]


def test_small_images_of_one_sample_have_several_where_they_cost_little() -> None:
    surface, found = Surface(flat_world(), None), []
    for width_px, height_px in ((32, 24), (64, 48), (65, 52), (640, 480)):
        intrinsics = replace(DOWN.intrinsics, width_px=width_px, height_px=height_px)
        wanted = replace(settings(1), small_samples=6)
        chosen = adapt(surface, replace(DOWN, intrinsics=intrinsics), wanted)
        found.append((chosen.samples, chosen.max_samples))
    assert [samples for samples, _ in found] == [6, 6, 1, 1]
    assert found[0][1] == 6


@pytest.mark.parametrize(("samples", "most"), [(1, 1), (3, 6), (8, 8)])
def test_small_images_have_more_samples_where_there_are_lamps_or_gloss(
    samples: int, most: int
) -> None:
    white, down, right = (1.0, 1.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)
    lamp = Lamp("lamp", "point", "map", (10.0, 10.0, 3.0), down, right, 100.0, white)
    lit = Surface(replace(flat_world(), lamps=(lamp,)), None)
    wanted = replace(settings(samples), denoise=True, max_samples=most, small_samples=6)
    assert adapt(lit, DOWN, wanted).samples == 24
    glossy = Surface(flat_world(), None)
    assert adapt(glossy, DOWN, wanted, has_gloss=True).samples == 24
    large = replace(DOWN, intrinsics=replace(DOWN.intrinsics, width_px=640, height_px=480))
    assert adapt(lit, large, wanted).samples == samples
    assert adapt(glossy, large, wanted, has_gloss=True).samples == samples


def test_a_picture_has_the_samples_that_its_view_needs() -> None:
    view = replace(DOWN, intrinsics=PinholeIntrinsics(160, 120, 135.0, 135.0, 79.5, 59.5))
    few, many, fixed = in_blender("adaptive.pictures", [flat_world(), reeds(0.3)], view)
    assert (few["samples"], many["samples"]) == (2, 4)
    np.testing.assert_array_equal(many["picture"], fixed["picture"])


def test_albedo_has_the_samples_of_colour_whether_or_not_that_is_rendered() -> None:
    beside, alone = in_blender("adaptive.albedos", reeds(0.5), DOWN)
    np.testing.assert_array_equal(alone, beside)
