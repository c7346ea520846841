"""Radiance images in W/(m² sr), against closed forms of both backends' laws of reflection.

Lambert's, of the analytic backend and of textures without roughness; and that of Cycles' rough
ground: Fujii (2012), A tiny improvement of Oren-Nayar reflectance model, with the light that is
reflected several times after Portsmouth, Kutz and Hill (2024), EON: a practical energy-preserving
rough diffuse BRDF.
"""

from __future__ import annotations

from dataclasses import replace
from math import acos, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import SUNNY, camera, flat_world, settings, texture

from oaisys_core.color import linear
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.output.images import read_image, write_image
from oaisys_core.procedural.environment.radiometry import unit_w_m2
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.scene.terrain_material import Variation
from oaisys_core.simulation import Simulation
from oaisys_core.types import RADIANCE, RGB, Frame, ModuleMetadata

UNIT_W_M2 = (40.0, 46.0, 47.0)
GREY = 188
ALBEDO = float(linear(GREY / 255))
DOWN = camera(pose_looking_down(0.0, 0.0, 6.0), modalities=(RADIANCE,))


def grey_world(elevation_deg: float, sun_w_m2: float = 4.0, roughness: int = 0) -> Scene:
    """Level grey ground under a sun without a sky."""
    world = flat_world()
    maps = replace(
        texture("grey", (0, 0, 0), 2.0),
        color_srgb=np.full((16, 16, 3), GREY, np.uint8),
        roughness=np.full((16, 16), roughness, np.uint8),
    )
    layers = (replace(world.material.layers[0], maps=maps),)
    sky = replace(
        SUNNY,
        model="none",
        sun_elevation_rad=radians(elevation_deg),
        sun_strength_w_m2=sun_w_m2,
        has_plain=False,
        unit_w_m2=UNIT_W_M2,
    )
    material = replace(
        world.material,
        layers=layers,
        masks=np.ones_like(world.material.masks[:1]),
        variation=Variation(brightness=0.0),
        is_lambertian=not roughness,
    )
    return replace(world, material=material, primitives=(), sky=sky)


def lambert(elevation_deg: float, sun_w_m2: float = 4.0) -> np.ndarray[Any, Any]:
    irradiance = sun_w_m2 * sin(radians(elevation_deg)) * np.array(UNIT_W_M2)
    return np.asarray(ALBEDO / pi * irradiance)


def rough_over_lambert(elevation_deg: float, roughness: float) -> float:
    """Radiance of rough ground seen from above, relative to Lambert's law."""
    up = sin(radians(elevation_deg))
    a = 1 / (1 + (1 / 2 - 2 / (3 * pi)) * roughness)
    # Towards the zenith, the two directions' product and that of their cosines are the same.
    single = ALBEDO * a

    def share(mu: float) -> float:
        """Share of light from a direction that is reflected once."""
        sine, angle = sqrt(1 - mu * mu), acos(mu)
        g = sine * (angle - sine * mu) + 2 / 3 * ((sine / mu) * (1 - sine**3) - sine)
        return a * (1 + roughness * g / pi)

    mean = a * (1 + (2 / 3 - 28 / (15 * pi)) * roughness)
    # The publication has the square of the albedo; Cycles multiplies by the colour once more.
    several = ALBEDO**3 * mean / (1 - ALBEDO * (1 - mean)) / (1 - mean)
    several *= (1 - share(up)) * (1 - share(1.0 - 1e-12))
    return (single + several) / ALBEDO


def radiance(scene: Scene, view: PlacedCamera = DOWN) -> Frame:
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    (frame,) = backend.render_all([view], settings(), lambda _: None)
    return frame


@pytest.mark.parametrize("elevation_deg", [5.0, 30.0, 90.0])
def test_level_ground_follows_lamberts_law(elevation_deg: float) -> None:
    frame = radiance(grey_world(elevation_deg))
    assert frame.data.dtype == np.float32
    expected = np.broadcast_to(lambert(elevation_deg), frame.data.shape)
    np.testing.assert_allclose(frame.data, expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("elevation_deg", "rough"), [(90.0, 0), (30.0, 0), (25.0, 230), (60.0, 230)]
)
def test_drafts_follow_the_laws_too(elevation_deg: float, rough: int) -> None:
    backend = AnalyticBackend()
    backend.build(grey_world(elevation_deg, 4.0, rough), lambda _: None)
    draft = replace(settings(), quality="draft")
    (frame,) = backend.render_all([DOWN], draft, lambda _: None)
    factor = rough_over_lambert(elevation_deg, rough / 255) if rough else 1.0
    middle = frame.data[22:26, 30:34].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, factor * lambert(elevation_deg), rtol=0.01)


def test_nothing_is_clipped_and_exposure_changes_nothing() -> None:
    bright = radiance(grey_world(30.0, sun_w_m2=4e6))
    np.testing.assert_allclose(bright.data[0, 0], lambert(30.0, 4e6), rtol=1e-4)
    backend = AnalyticBackend()
    backend.build(grey_world(30.0), lambda _: None)
    view = replace(DOWN, modalities=(RADIANCE, RGB))
    dark, light = (
        backend.render_all([view], settings(exposure_ev=ev), lambda _: None) for ev in (-4.0, 2.0)
    )
    assert np.array_equal(dark[0].data, light[0].data)
    assert not np.array_equal(dark[1].data, light[1].data)


@pytest.mark.blender
def test_cycles_follows_the_laws_too() -> None:
    cases = [(90.0, 0), (30.0, 0), (25.0, 230), (60.0, 230)]
    scenes = [grey_world(elevation_deg, 4.0, rough) for elevation_deg, rough in cases]
    scenes.append(grey_world(30.0, 4e6))
    *images, bright = in_blender("environment.radiances", scenes, DOWN, 64)
    for (elevation_deg, rough), image in zip(cases, images, strict=True):
        middle = image[16:32, 24:40].mean(axis=(0, 1))
        # Straight down in the middle; the corners of this part look 13 degrees aside.
        factor = rough_over_lambert(elevation_deg, rough / 255) if rough else 1.0
        np.testing.assert_allclose(middle, factor * lambert(elevation_deg), rtol=0.01)
    np.testing.assert_allclose(bright[24, 32], lambert(30.0, 4e6), rtol=0.01)


@pytest.mark.blender
def test_all_lenses_show_the_same_radiance() -> None:
    aside = pose_looking_at((-3.0, 0.0, 5.0), (0.0, 0.0, 0.25))
    plain = camera(aside, modalities=(RADIANCE,))
    lens = replace(plain.intrinsics, distortion=(-0.2, 0.05, 0.001, 0.0, 0.0))
    views = [plain, replace(plain, intrinsics=lens)]
    for view in views:
        (image,) = in_blender("environment.radiances", [grey_world(30.0)], view, 4)
        expected = np.broadcast_to(lambert(30.0), image.shape)
        np.testing.assert_allclose(image, expected, rtol=0.01)


def test_a_standard_sun_is_as_bright_as_that_of_the_body() -> None:
    """The solar constants of the bodies are 1361 and 586 W/m² (NASA's planetary fact sheets)."""
    seen = {}
    for body in ("moon", "mars"):
        stage = {"preset": "plane", "extent_m": 10.0, "resolution_px": 9, "body": body}
        environment = {"sun_elevation_deg": 90.0, "sky": {"model": "none"}}
        sensors = {"cameras": [{"width_px": 8, "height_px": 6, "modalities": ["radiance"]}]}
        materials = {"layers": [{"texture": "sand", "label": "sand", "semantic_id": 1}]}
        sections = {"stage": stage, "environment": environment, "sensors": sensors}
        sections |= {"materials": materials, "assets": {"rocks": []}}
        config = config_from_mapping({"backend": "analytic", **sections})
        simulation = Simulation(config)
        simulation.step_batch()
        sensor: Any = {"pose": pose_looking_down(0.0, 0.0, 2.0)}
        sample = simulation.step_sample(ModuleMetadata(sensor=sensor))
        (frame,) = (each for each in sample.frames if each.modality == RADIANCE)
        seen[body] = frame.data.mean(axis=(0, 1))
    np.testing.assert_allclose(seen["moon"] / seen["mars"], 1361 / 586, rtol=0.002)


def test_radiance_of_an_unknown_body_needs_its_distance() -> None:
    data: dict[str, Any] = {
        "stage": {"preset": "plane", "body": 4.7e5},
        "sensors": {"cameras": [{"modalities": ["radiance"]}]},
    }
    with pytest.raises(ConfigError, match=r"environment\.sun_distance_au: expected a number"):
        config_from_mapping(data)
    # The sun's radius is 0.00465 au: nearer, it has no angular diameter.
    for distance_au in (0.004, 5e-324):
        with pytest.raises(ConfigError, match=r"environment\.sun_distance_au: received"):
            config_from_mapping({**data, "environment": {"sun_distance_au": distance_au}})
    ceres = config_from_mapping({**data, "environment": {"sun_distance_au": 2.77}})
    assert ceres.environment.sun_distance_au == 2.77
    assert unit_w_m2(2.77)[0] * 2.77**2 == pytest.approx(unit_w_m2(1.0)[0])


def test_it_survives_as_an_exr_file(tmp_path: Path) -> None:
    frame = radiance(grey_world(33.0, sun_w_m2=4e6))
    write_image(tmp_path / "radiance.exr", frame)
    assert np.array_equal(read_image(tmp_path / "radiance.exr", RADIANCE), frame.data)
