"""Wet and frozen ground shines in Blender, dry ground does not."""

from dataclasses import replace

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from synthetic_worlds import SUNNY, camera, flat_world, texture

from oaisys_core.geometry import pixel_rays, pose_looking_at
from oaisys_core.scene import Scene
from oaisys_core.scene.sky import Hdri, SkyImage

pytestmark = pytest.mark.blender

VIEW = camera(pose_looking_at((0, 0, 1.5), (6, 0, 0.6)))
BRIGHT = Hdri(SkyImage("bright", np.full((8, 16, 3), 0.9, np.float32), ()))
SKY = replace(SUNNY, sun_strength_w_m2=0.0, hdri=BRIGHT)


def black_ground(roughness: int) -> Scene:
    """A level, black ground under a sky of one colour, nothing on it."""
    world = flat_world()
    layer = world.material.layers[0]
    maps = texture("black", (0, 0, 0), 2.0)
    maps = replace(
        maps,
        color_srgb=np.zeros_like(maps.color_srgb),
        roughness=np.full_like(maps.roughness, roughness),
    )
    layers = (replace(layer, maps=maps),)
    masks = np.ones((1, *world.material.masks.shape[1:]), np.float32)
    material = replace(world.material, layers=layers, masks=masks)
    return replace(world, material=material, primitives=())


def rays() -> NDArray[np.float64]:
    """(H, W, 3) directions of the view's rays, of unit length."""
    rays = pixel_rays(VIEW.intrinsics)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.asarray(rays @ VIEW.T_map_camera[:3, :3].T)


def reflectance(cos: NDArray[np.float64], ior: float) -> NDArray[np.float64]:
    """Fresnel's law for unpolarised light that comes from air."""
    refracted = np.sqrt(1 - (1 - cos**2) / ior**2)
    s = (cos - ior * refracted) / (cos + ior * refracted)
    p = (ior * cos - refracted) / (ior * cos + refracted)
    return (s**2 + p**2) / 2


def test_a_film_of_water_reflects_as_fresnel_says() -> None:
    (image,) = in_blender("environment.linear_views", black_ground(5), [VIEW], [SKY])
    up = rays()[..., 2]
    ground = up < -0.06
    sky = image[up > 0.05].mean()
    assert 0.3 < sky < 1
    # A flat normal map's 128 is upright, not a slope of 1 in 255 (which fails here).
    expected = reflectance(-rays()[ground][:, 2], 1.33) * sky
    assert np.ptp(expected) > 0.2
    wrong = np.abs(image[ground] - expected[:, None]).max(axis=-1)
    # Now and then a ray that starts on an edge between two triangles goes astray.
    assert np.quantile(wrong, 0.99) < 0.004


def test_dull_ground_has_no_gloss() -> None:
    (image,) = in_blender("environment.linear_views", black_ground(235), [VIEW], [SKY])
    up = rays()[..., 2]
    assert image[up < -0.06].max() == 0
