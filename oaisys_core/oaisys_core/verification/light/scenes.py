"""Worlds of one grey plane under one light, and cameras to look at them."""

from __future__ import annotations

from dataclasses import dataclass
from math import tan

import numpy as np

from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_at, pose_looking_down, pose_to_matrix
from oaisys_core.scene import (
    HeightField,
    Lamp,
    PbrMaps,
    PlacedCamera,
    Primitive,
    Scene,
    Sky,
    TerrainLayer,
    TerrainMaterial,
)
from oaisys_core.scene.photometric_laws import PhotometricLaw
from oaisys_core.scene.sky import Gradient
from oaisys_core.scene.terrain_material import Variation
from oaisys_core.types import RADIANCE, FloatArray, PinholeIntrinsics

HALF_M = 20.0
POINTS = 9


@dataclass(frozen=True)
class GreyPlane:
    """A grey plane through the origin of ``map``.

    Attributes:
        grey: Of its texture, as a byte in sRGB.
        slope_rad: By which it rises towards +x.
        roughness: Of its texture, as a byte.
        is_lambertian: Whether it reflects by Lambert's law.
        law: By which it reflects relative to that; None for the same.
    """

    grey: int = 188
    slope_rad: float = 0.0
    roughness: int = 255
    is_lambertian: bool = True
    law: PhotometricLaw | None = None

    @property
    def albedo(self) -> float:
        """Linear albedo of its grey, by IEC 61966-2-1."""
        encoded = self.grey / 255
        return float(encoded / 12.92 if encoded <= 0.04045 else ((encoded + 0.055) / 1.055) ** 2.4)


def sunny(elevation_rad: float, diameter_rad: float = 0.0093, strength: float = 4.0) -> Sky:
    """Return a sun over +x in a black sky."""
    return _sky(elevation_rad, strength, diameter_rad, Gradient((0.0,) * 3, (0.0,) * 3), "none")


def grey_sky(zenith: float, horizon: float, power: float = 0.5) -> Sky:
    """Return a grey sky without a sun; for the power see `Gradient`."""
    gradient = Gradient((zenith,) * 3, (horizon,) * 3, power=power)
    return _sky(0.5, 0.0, 0.0093, gradient, "plain")


def dark() -> Sky:
    """Return a black sky without a sun."""
    return sunny(0.5, strength=0.0)


def world(
    ground: GreyPlane,
    sky: Sky,
    lamps: tuple[Lamp, ...] = (),
    primitives: tuple[Primitive, ...] = (),
) -> Scene:
    """Return the plane under a light."""
    spacing_m = 2 * HALF_M / (POINTS - 1)
    x_m = np.linspace(-HALF_M, HALF_M, POINTS)
    elevation_m = np.broadcast_to(x_m * tan(ground.slope_rad), (POINTS, POINTS))
    field = HeightField(elevation_m.astype(np.float32), (-HALF_M, -HALF_M), spacing_m)
    material = TerrainMaterial(
        layers=(TerrainLayer("grey", (1,), _texture(ground)),),
        masks=np.ones((1, 8, 8), np.float32),
        extent_m=field.extent_m,
        variation=Variation(brightness=0.0),
        is_lambertian=ground.is_lambertian,
        law=ground.law,
    )
    return Scene(
        ground=field,
        material=material,
        prototypes=(),
        placements=(),
        primitives=primitives,
        sky=sky,
        semantic_labels={1: "grey"},
        stage_hash=f"audit of light, slope {ground.slope_rad}",
        lamps=lamps,
    )


def camera(
    eye_m: tuple[float, float, float],
    target_m: tuple[float, float, float],
    size_px: tuple[int, int] = (32, 24),
    focal_px: float = 64.0,
) -> PlacedCamera:
    """Return a camera that looks from one point to another and renders radiance."""
    width_px, height_px = size_px
    centre = (width_px - 1) / 2, (height_px - 1) / 2
    intrinsics = PinholeIntrinsics(width_px, height_px, focal_px, focal_px, *centre)
    if eye_m[:2] == target_m[:2]:
        pose = pose_looking_down(*eye_m)
    else:
        pose = pose_looking_at(np.array(eye_m), np.array(target_m))
    return PlacedCamera("audit", intrinsics, pose_to_matrix(pose) @ T_LINK_OPTICAL, (RADIANCE,))


def points_seen_m(view: PlacedCamera, height_m: float = 0.0) -> FloatArray:
    """Return the (H, W, 3) points of the level plane at a height that the pixels look at."""
    rays = rays_of(view)
    eye_m = view.T_map_camera[:3, 3]
    return np.asarray(eye_m + rays * ((height_m - eye_m[2]) / rays[..., 2:]))


def rays_of(view: PlacedCamera) -> FloatArray:
    """Return the (H, W, 3) directions in ``map``, of any length, that the pixels look along."""
    k = view.intrinsics
    u, v = np.meshgrid(np.arange(k.width_px), np.arange(k.height_px))
    rays = np.stack(((u - k.cx_px) / k.fx_px, (v - k.cy_px) / k.fy_px, np.ones(u.shape)), -1)
    return np.asarray(rays @ view.T_map_camera[:3, :3].T)


def _texture(ground: GreyPlane) -> PbrMaps:
    shape = (16, 16)
    return PbrMaps(
        name=f"grey {ground.grey} {ground.roughness}",
        color_srgb=np.full((*shape, 3), ground.grey, np.uint8),
        height=np.full(shape, 0.5, np.float32),
        normal_gl=np.full((*shape, 3), (128, 128, 255), np.uint8),
        roughness=np.full(shape, ground.roughness, np.uint8),
        tile_m=2.0,
    )


def _sky(
    elevation_rad: float, strength: float, diameter_rad: float, gradient: Gradient, model: str
) -> Sky:
    return Sky(
        sun_elevation_rad=elevation_rad,
        sun_azimuth_rad=0.0,
        sun_strength_w_m2=strength,
        sun_angular_diameter_rad=diameter_rad,
        sky_strength=1.0,
        air=1.0,
        dust=1.0,
        ozone=1.0,
        model="plain" if model == "plain" else "none",
        gradient=gradient,
    )
