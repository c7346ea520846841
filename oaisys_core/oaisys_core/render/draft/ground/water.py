"""Water: it mirrors sky and banks by Fresnel's law, and hides the bottom with its depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.environment.light import level_irradiance_w_m2, sky_irradiance_w_m2
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.draft.appearance import Floats, normalise
from oaisys_core.render.draft.ground.texture_atlas import TextureAtlas
from oaisys_core.render.shading.looks import IOR
from oaisys_core.render.shading.ripples import (
    MAX_SLOPE,
    RIPPLE_TILES_M,
    ripple_slopes,
    share_shown,
    slope_towards_eye,
    variance_not_shown,
)
from oaisys_core.scene import Scene, Sky
from oaisys_core.types import FloatArray

DIFFUSE_THROUGH = 0.934
"""Share of diffuse light from above that a level surface of water lets through (Judd 1942)."""

LIFT_M = 1e-3
"""Height above the water at which mirrored rays begin."""


class Mirror(NamedTuple):
    """What N points of water mirror.

    Attributes:
        pixels: (N,) indices of the pixels that show them, row by row.
        share: (N,) of the light that is mirrored.
        rays: (N, 3) directions of what is mirrored.
        is_sky: (N,) whether that is the sky.
    """

    pixels: NDArray[np.intp]
    share: Floats
    rays: Floats
    is_sky: NDArray[np.bool_]


class WaterMirror:
    """Finds what water mirrors."""

    def __init__(self, scene: Scene) -> None:
        """Take over the water of a scene."""
        waves = {
            instance_id: prototype.water.waves
            for placement in scene.placements
            if (prototype := scene.prototypes[placement.prototype]).water is not None
            for instance_id in placement.instance_ids.tolist()
        }
        self._ids = np.array(sorted(waves), np.uint32)
        self._waves = np.array([waves[each] for each in self._ids.tolist()], np.float32)
        self._ripples = TextureAtlas([ripple_slopes()]) if waves else None

    def of_view(self, surface: Surface, view: View, distance_m: Floats) -> Mirror | None:
        """Return what the water in a view mirrors; None if there is no water in it."""
        if self._ripples is None:
            return None
        ids = view.instance_ids.reshape(-1)
        pixels = np.flatnonzero(np.isin(ids, self._ids))
        if not len(pixels):
            return None
        points_m = view.points_m.reshape(-1, 3)[pixels]
        rays = normalise(view.directions.reshape(-1, 3)[pixels].astype(np.float32))
        waves = self._waves[np.searchsorted(self._ids, ids[pixels])]
        normal = self._normals(points_m, distance_m.reshape(-1)[pixels], waves, rays)
        cos = np.clip(-np.einsum("ij,ij->i", rays, normal), 1e-3, 1)
        mirrored = rays + 2 * cos[:, None] * normal
        # Ripples must not mirror what is below the water.
        mirrored[:, 2] = np.abs(mirrored[:, 2])
        is_sky = ~surface.are_occluded(
            points_m + np.array((0.0, 0.0, LIFT_M)), mirrored.astype(np.float64)
        )
        return Mirror(pixels, fresnel(cos), mirrored, is_sky)

    def _normals(
        self, points_m: FloatArray, distance_m: Floats, waves: Floats, rays: Floats
    ) -> Floats:
        """Return the (N, 3) mean normals of the rippled surface that (N, 3) rays see."""
        assert self._ripples is not None
        level = np.zeros(len(points_m), np.uint8)
        slopes = np.zeros((len(points_m), 2), np.float32)
        for tile_m in RIPPLE_TILES_M:
            # Blender's images begin at the bottom.
            places = self._ripples.places((points_m[:, 0] / tile_m, points_m[:, 1] / tile_m), level)
            slopes += self._ripples.look_up(places)
        slopes *= (share_shown(distance_m) * waves * np.float32(MAX_SLOPE / 2**0.5))[:, None]
        upward = np.maximum(-rays[:, 2], 1e-3)
        level_m = np.maximum(np.linalg.norm(rays[:, :2], axis=1), 1e-6)
        variance = variance_not_shown(distance_m, waves * np.float32(MAX_SLOPE))
        leaning = slope_towards_eye(variance, level_m / upward)
        slopes -= rays[:, :2] * (leaning / level_m)[:, None]
        normal = np.ones((len(points_m), 3), np.float32)
        normal[:, :2] = slopes
        return normalise(normal)


def light_below_water(sky: Sky) -> np.float32:
    """Return the share of the light on level ground that reaches the bottom of clear water."""
    of_all_w_m2 = float(level_irradiance_w_m2(sky).sum())
    of_sky_w_m2 = float(sky_irradiance_w_m2(sky).sum())
    mirrored = float(fresnel(np.array([max(sky.to_sun[2], 1e-3)], np.float32))[0])
    sky_share = of_sky_w_m2 / of_all_w_m2 if of_all_w_m2 else 1.0
    return np.float32(sky_share * DIFFUSE_THROUGH + (1 - sky_share) * (1 - mirrored))


def fresnel(cos: Floats) -> Floats:
    """Return the (N,) share of light that water mirrors, by the cosine of its angle to the normal.

    Fresnel's law for light that is not polarised.
    """
    inside = np.sqrt(1 - (1 - cos * cos) / np.float32(IOR**2))
    across = (cos - IOR * inside) / (cos + IOR * inside)
    along = (IOR * cos - inside) / (IOR * cos + inside)
    return np.asarray((across * across + along * along) / 2, np.float32)
