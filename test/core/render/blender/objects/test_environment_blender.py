"""Sky images, haze and the sun as Blender shows them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from coarse_clouds import coarse_clouds
from numpy.typing import NDArray
from synthetic_worlds import SUNNY, camera, flat_world

from oaisys_core.geometry import pixel_rays, pose_looking_at
from oaisys_core.procedural.environment.clouds.daylight import daylight_factors
from oaisys_core.procedural.environment.clouds.shadows import cloud_shadows
from oaisys_core.procedural.terrain.surroundings.plain import plain_around
from oaisys_core.render.shading.shading import sky_radiance
from oaisys_core.scene import PlacedCamera
from oaisys_core.scene.sky import Clouds, Haze, Hdri, SkyImage
from oaisys_core.types import FloatArray

pytestmark = pytest.mark.blender

COLORS = np.array(
    [
        (0.9, 0.1, 0.1),
        (0.1, 0.9, 0.1),
        (0.1, 0.1, 0.9),
        (0.9, 0.9, 0.1),
        (0.1, 0.9, 0.9),
        (0.9,) * 3,
    ]
)
"""By label: those of sky images whose pixels are coloured as they are labelled."""

ROWS = 16


@pytest.fixture
def small_dome() -> Iterator[None]:
    """Clouds in a sixteenth of the directions, as `linear_views` has them."""
    with coarse_clouds():
        yield


def labelled_image() -> SkyImage:
    """An image in which every direction's colour tells its label: another one in each texel."""
    ids = np.random.default_rng(3).integers(len(COLORS), size=(ROWS, 2 * ROWS)).astype(np.uint16)
    labels = ((0, ids), (2, np.uint16(5) - ids))
    return SkyImage("labelled", COLORS[ids].astype(np.float32), labels)


def rays_of(view: PlacedCamera) -> FloatArray:
    """(H, W, 3) directions in ``map``."""
    return pixel_rays(view.intrinsics) @ view.T_map_camera[:3, :3].T


def from_texel_borders(rays: FloatArray, rotation_rad: float) -> NDArray[Any]:
    """Distance of rays from the nearest border of a texel, in texels."""
    x, y, z = np.moveaxis(rays, -1, 0)
    across = (np.arctan2(y, x) - rotation_rad) / (2 * np.pi) * 2 * ROWS
    down = np.arctan2(z, np.hypot(x, y)) / np.pi * ROWS
    return np.minimum(np.abs(across - np.rint(across)), np.abs(down - np.rint(down)))


def test_a_sky_that_failed_is_set_again() -> None:
    """The image before it was taken for the present one, though it had been removed."""
    image, other = labelled_image(), SkyImage("other", np.ones((8, 16, 3), np.float32))
    skies = [replace(SUNNY, hdri=Hdri(each)) for each in (image, other)]
    assert in_blender("environment.has_sky_after_a_failure", *skies)


@pytest.mark.long
def test_labels_lie_where_a_sky_image_shows_them() -> None:
    """In all directions, poles and seam among them, for any rotation."""
    above = (0.0, 0.0, 50.0)
    targets = [(1, 0, 50), (-1, 0.02, 50), (0, 1, 50), (0.1, -1, 50.4), (0.01, 0, 51), (0.5, 1, 52)]
    cameras = [camera(pose_looking_at(above, target)) for target in targets]
    rotations = (0.0, 0.7, -2.9)
    hdris = [Hdri(labelled_image(), rotation_rad=rotation) for rotation in rotations]
    skies = [replace(SUNNY, hdri=hdri) for hdri in hdris]
    images = in_blender("environment.linear_views", flat_world(), cameras, skies)
    seen = iter(images)
    for sky, rotation in zip(skies, rotations, strict=True):
        for view in cameras:
            image, rays = next(seen), rays_of(view)
            labels = sky.semantic_ids_at(rays.reshape(-1, 3), 0).reshape(rays.shape[:2])
            shown = np.abs(image[..., None, :] - COLORS).sum(axis=-1).argmin(axis=-1)
            # Colours are blended between the centres of texels, labels are not.
            sky_only = rays[..., 2] > 0
            certain = sky_only & (from_texel_borders(rays, rotation) > 0.45)
            assert certain.sum() > 5
            assert (shown[certain] == labels[certain]).all()


def test_haze_dims_and_veils_by_distance() -> None:
    """Koschmieder's law, in linear light, against the closed form on a level plane."""
    haze = Haze(extinction_per_m=(0.02, 0.05, 0.1), veil=(0.5, 0.4, 0.3))
    clear = replace(SUNNY, model="none", sun_strength_w_m2=2.0)
    view = camera(pose_looking_at((-19, 0, 3), (0, 0, 0.25)))
    scene = replace(flat_world(), primitives=())
    without, with_haze = in_blender(
        "environment.linear_views", scene, [view], [clear, replace(clear, haze=haze)]
    )
    rays = rays_of(view)
    distance_m = (0.25 - 3.0) / rays[..., 2] * np.linalg.norm(rays, axis=-1)
    xy = (-19, 0) + (distance_m / np.linalg.norm(rays, axis=-1))[..., None] * rays[..., :2]
    on_ground = (rays[..., 2] < 0) & (np.abs(xy) < 19.5).all(axis=-1)
    assert on_ground.mean() > 0.4
    share = np.exp(-distance_m[on_ground, None] * np.array(haze.extinction_per_m))
    assert share.min() < 0.1
    expected = without[on_ground] * share + np.array(haze.veil) * (1 - share)
    assert np.abs(with_haze[on_ground] - expected).max() < 1.5 / 255


@pytest.mark.long
@pytest.mark.usefixtures("small_dome")
def test_clouds_are_those_of_the_dome_and_leave_the_light() -> None:
    clear = replace(SUNNY, has_plain=True, model="plain")
    fair = Clouds(0.4, 1000.0, 1500.0, 600.0, seed=4, shadows=False)
    cloudy = replace(clear, clouds=fair)
    up = camera(pose_looking_at((0, 0, 2), (-12, 0, 10)))
    level = camera(pose_looking_at((-19, 0, 3), (0, 0, 0.25)))
    skies = [clear, cloudy]
    images = in_blender("environment.linear_views", flat_world(), [up, level], skies)
    rays, below = rays_of(up).reshape(-1, 3), rays_of(level)[..., 2] < -0.02
    blue, clear_ground, shown, cloudy_ground = images
    expected = np.clip(sky_radiance(cloudy, rays), 0, 1).reshape(shown.shape)
    assert 0.2 < (np.abs(shown - blue).max(axis=-1) > 0.02).mean() < 0.9
    assert np.quantile(np.abs(shown - expected), 0.99) < 3 / 255
    assert (cloudy_ground[below] == clear_ground[below]).all()


@pytest.mark.long
@pytest.mark.usefixtures("small_dome")
def test_below_a_closed_layer_the_ground_has_its_light_alone() -> None:
    closed = Clouds(1.0, 1000.0, 1500.0, 900.0, seed=4)
    cloudy = replace(SUNNY, model="plain", clouds=closed)
    no_sun = replace(cloudy, clouds=None, sun_strength_w_m2=0.0)
    level = camera(pose_looking_at((-19, 0, 3), (0, 0, 0.25)))
    scene = replace(flat_world(), primitives=())
    dark, lit = in_blender("environment.linear_views", scene, [level], [no_sun, cloudy], 16)
    on_ground = rays_of(level)[..., 2] < -0.1
    factors = np.array(daylight_factors(cloudy))
    assert np.abs(factors - 1).max() > 0.2
    found = lit[on_ground].mean(axis=0) / dark[on_ground].mean(axis=0)
    np.testing.assert_allclose(found, factors, rtol=0.03)


@pytest.mark.long
@pytest.mark.usefixtures("small_dome")
def test_clouds_cast_the_shadows_that_drafts_have() -> None:
    """Of a sun as by day, and of one so low that its shadows would begin far away."""
    low = Clouds(0.4, 60.0, 30.0, 1500.0, seed=4)
    view = camera(pose_looking_at((-19, 0, 12), (0, 0, 0.25)))
    scene = replace(flat_world(), primitives=())
    skies = [
        replace(
            SUNNY,
            model="none",
            sun_strength_w_m2=1.5 / np.sin(up_rad),
            sun_elevation_rad=up_rad,
            sun_azimuth_rad=azimuth_rad,
        )
        for up_rad, azimuth_rad in ((0.9, 0.5), (0.035, -2.0))
    ]
    skies += [replace(sky, clouds=low) for sky in skies]
    images = in_blender("environment.linear_views", scene, [view], skies, 16)
    rays = rays_of(view)
    points_m = np.array((-19, 0, 12)) + rays * ((0.25 - 12) / rays[..., 2])[..., None]
    on_ground = (rays[..., 2] < 0) & (np.abs(points_m[..., :2]) < 19.5).all(axis=-1)
    for clear, shaded, sky in zip(images[:2], images[2:], skies[2:], strict=True):
        shadows = cloud_shadows(sky)
        assert shadows is not None
        share = shadows.at(points_m[on_ground])
        assert np.ptp(share) > 0.3
        difference = shaded[on_ground] - clear[on_ground] * share[:, None]
        assert np.quantile(np.abs(difference), 0.99) < 0.03 * clear[on_ground].max()


@pytest.mark.long
@pytest.mark.parametrize("model", ["atmosphere", "plain", "none"])
def test_the_disc_stands_where_the_sun_is(model: Any) -> None:
    sky = replace(SUNNY, model=model, sun_disc=1.0, sun_angular_diameter_rad=0.1)
    above = np.array((0.0, 0.0, 50.0))
    view = camera(pose_looking_at(tuple(above), tuple(above + sky.to_sun)))
    dark = replace(sky, sun_disc=0.0)
    disc, sky_alone = in_blender("environment.linear_views", flat_world(), [view], [sky, dark])
    rays = rays_of(view)
    angle = np.arccos(rays @ np.array(sky.to_sun) / np.linalg.norm(rays, axis=-1))
    assert (disc[angle < 0.049] > 0.9).all()
    assert np.abs(disc - sky_alone)[angle > 0.051].max() < 0.02


def test_the_ground_goes_on_to_the_horizon_but_not_above_it() -> None:
    """Beyond the stage it is as bright as on it, where without it one would see sky."""
    sky = replace(SUNNY, has_plain=True)
    scene = replace(flat_world(), primitives=())
    scene = replace(scene, far_ground=plain_around(scene.ground))
    view = camera(pose_looking_at((15, 0, 2), (40, 0, 2)))
    with_plain, without = in_blender("environment.linear_views", scene, [view], [sky, SUNNY], 16)
    rays = rays_of(view)
    # The stage ends 5 m ahead, 1.75 m below the eye.
    beyond = (rays[..., 2] < -0.02) & (rays[..., 2] > -0.25)
    on_stage = rays[..., 2] < -0.38
    assert beyond.sum() > 300
    mean = with_plain[on_stage].mean(axis=0)
    np.testing.assert_allclose(with_plain[beyond].mean(axis=0), mean, rtol=0.3)
    above = rays[..., 2] > 0.02
    np.testing.assert_allclose(with_plain[above], without[above], atol=1.5 / 255)
    np.testing.assert_allclose(with_plain[on_stage], without[on_stage], atol=0.1)
