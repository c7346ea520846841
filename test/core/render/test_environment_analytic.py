"""Sky and haze of the analytic backend against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import SUNNY, camera, flat_world, settings

from oaisys_core.color import linear
from oaisys_core.geometry import pixel_rays, pose_looking_at
from oaisys_core.procedural.environment.light import sky_irradiance_w_m2
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.render.shading.shading import sky_radiance
from oaisys_core.scene import PlacedCamera, Sky
from oaisys_core.scene.sky import Gradient, Haze, Hdri, SkyImage
from oaisys_core.types import DEPTH, RGB, SEMANTIC_0

VIEW = camera(pose_looking_at((-19, 0, 3), (0, 0, 0.25)), modalities=(RGB, DEPTH, SEMANTIC_0))


def frames(sky: Sky, view: PlacedCamera = VIEW) -> tuple[NDArray[np.float64], bytes]:
    """Linear colour, and the bytes of depth and labels."""
    backend = AnalyticBackend()
    backend.build(replace(flat_world(), primitives=(), sky=sky), lambda _: None)
    rgb, depth, labels = backend.render_all([view], settings(), lambda _: None)
    return linear(rgb.data / 255), depth.data.tobytes() + labels.data.tobytes()


def test_haze_follows_koschmieder_and_leaves_depth_and_labels() -> None:
    haze = Haze(extinction_per_m=(0.02, 0.05, 0.1), veil=(0.5, 0.4, 0.3))
    clear, labels = frames(SUNNY)
    hazy, labels_in_haze = frames(replace(SUNNY, haze=haze))
    rays = pixel_rays(VIEW.intrinsics) @ VIEW.T_map_camera[:3, :3].T
    distance_m = (0.25 - 3.0) / rays[..., 2] * np.linalg.norm(rays, axis=-1)
    on_ground = (rays[..., 2] < 0) & (distance_m < 35)
    share = np.exp(-distance_m[on_ground, None] * np.array(haze.extinction_per_m))
    expected = clear[on_ground] * share + np.array(haze.veil) * (1 - share)
    # Bytes of sRGB are up to 0.009 apart in linear light.
    np.testing.assert_allclose(hazy[on_ground], expected, atol=0.01)
    assert labels == labels_in_haze


def test_the_sky_is_veiled_at_the_horizon_most() -> None:
    sky = replace(SUNNY, haze=Haze((0.01,) * 3, thickness_m=50.0, veil=(0.2, 0.3, 0.4)))
    rays = np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 1.0)])
    without = sky_radiance(replace(sky, haze=None), rays)
    depth = 0.5 / np.array([1.0, 1e-4, np.sqrt(0.5)])
    share = np.exp(-depth)[:, None]
    expected = without * share + np.array((0.2, 0.3, 0.4)) * (1 - share)
    np.testing.assert_allclose(sky_radiance(sky, rays), expected)


def test_a_plain_sky_runs_from_the_horizon_to_the_zenith() -> None:
    gradient = Gradient((0.1, 0.2, 0.3), (0.7, 0.6, 0.5), (1.0, 0.5, 0.2), 0.1)
    sky = replace(SUNNY, model="plain", gradient=gradient, sun_elevation_rad=0.0, sky_strength=2.0)
    away = np.array([(0.0, 0.0, 3.0), -np.array(sky.to_sun), sky.to_sun])
    seen = sky_radiance(sky, away)
    np.testing.assert_allclose(seen[0], (0.2, 0.4, 0.6), atol=1e-5)
    np.testing.assert_allclose(seen[1], (1.4, 1.2, 1.0), atol=1e-5)
    np.testing.assert_allclose(seen[2] - seen[1], (2.0, 1.0, 0.4), atol=1e-5)


def test_without_a_sky_there_is_none() -> None:
    sky = replace(SUNNY, model="none")
    assert not sky_radiance(sky, np.array([(0.0, 0.0, 1.0)])).any()
    assert not sky_irradiance_w_m2(sky).any()


@pytest.mark.parametrize("strength", [1.0, 2.5])
def test_an_even_sky_image_gives_pi_times_its_radiance(strength: float) -> None:
    image = SkyImage("even", np.full((64, 128, 3), 0.3, np.float32))
    sky = replace(SUNNY, hdri=Hdri(image, strength=strength))
    assert sky_irradiance_w_m2(sky) == pytest.approx(np.pi * 0.3 * strength, rel=1e-3)
