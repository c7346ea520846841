"""Finds ground that Cycles has rendered black though it reflects light.

A shader that failed in Cycles has no colour at all: its albedo and its radiance are exactly 0 in
every pixel, by day and by night. Other ground has an albedo, and mirrors have the radiance of what
they show, so neither night nor shade is taken for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.geometry import unproject
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.blender.camera import pinhole_to_render
from oaisys_core.render.blender.postprocessing import COMBINED, SEEN_ALBEDO
from oaisys_core.render.render_result import RenderResult, pass_of
from oaisys_core.render.shading.looks import pixel_angle_rad
from oaisys_core.render.shading.reflectance import Reflectance
from oaisys_core.render.shading.shading import mean_color
from oaisys_core.scene import PbrMaps, PlacedCamera, Scene
from oaisys_core.types import FloatArray

ROWS, COLUMNS = 18, 24
"""Places in the image that are looked at: their rays take less than a millisecond."""

FARTHEST_M = 1e5
"""Range beyond which rays end."""

MIN_ALBEDO = 0.01
"""Mean albedo, seen through haze, from which on ground is expected not to be black; soot has more.
"""

MAX_BLACK, MIN_PLACES = 0.5, 8
"""Share of the places of one shader that may be black though the ray caster's albedo is not, of at
least so many. All are where it has failed; with moving cameras, some may be where it has not."""


class GroundPlaces(NamedTuple):
    """Where an image shows ground that reflects light.

    Attributes:
        at: (N, 2) rows and columns as shares of the image's height and width.
        is_land: (N,) whether it is ground beyond the stage, which has a shader of its own.
        view: Of one column: what is there.
        width_m: (N,) widths of pixels there.
        scene: The world.
    """

    at: FloatArray
    is_land: NDArray[np.bool_]
    view: View
    width_m: FloatArray
    scene: Scene


class GroundCheck:
    """Says where ground reflects light, and checks that it does so in Cycles' image."""

    def __init__(self) -> None:
        self._means: dict[int, tuple[PbrMaps, FloatArray]] = {}

    def places(self, surface: Surface, camera: PlacedCamera) -> GroundPlaces:
        """Cast a few hundred rays, and return where they meet ground that reflects light."""
        pinhole = pinhole_to_render(camera.intrinsics)
        size = np.array([pinhole.height_px, pinhole.width_px])
        rows, columns = (np.arange(ROWS) + 0.5) / ROWS, (np.arange(COLUMNS) + 0.5) / COLUMNS
        at = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        pixels = np.ascontiguousarray(np.floor(at * size)[:, ::-1])
        rays = unproject(pixels, np.ones(len(pixels)), pinhole)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        directions = rays @ camera.T_map_camera[:3, :3].T
        view = surface.cast(camera.T_map_camera[:3, 3], directions, FARTHEST_M)
        seen = np.flatnonzero(view.is_ground[:, 0])
        xy_m, range_m = view.points_m[seen, 0, :2], view.depth_m[seen, 0]
        bright = self._albedo(surface.scene, xy_m, range_m) >= MIN_ALBEDO
        x0, y0, x1, y1 = surface.scene.ground.extent_m
        is_land = ((xy_m < (x0, y0)) | (xy_m > (x1, y1))).any(axis=1)
        kept, width_m = seen[bright], range_m * pixel_angle_rad(camera.intrinsics)
        is_land, width_m = is_land[bright], width_m[bright]
        return GroundPlaces(at[kept], is_land, view.rows(kept), width_m, surface.scene)

    @staticmethod
    def check(places: GroundPlaces, rendered: RenderResult, name: str) -> None:
        """Raise if an image is black where ground reflects light.

        Args:
            places: Where the image shows such ground.
            rendered: The passes of the image.
            name: Name of the camera.

        Raises:
            RenderError: It is.
        """
        albedo, radiance = pass_of(rendered, SEEN_ALBEDO), pass_of(rendered, COMBINED)
        rows, columns = np.floor(places.at * albedo.shape[:2]).astype(np.intp).T
        light = albedo[rows, columns].sum(axis=-1) + radiance[rows, columns, :3].sum(axis=-1)
        for what, own in (("stage", ~places.is_land), ("land", places.is_land)):
            black = light[own] == 0
            if len(black) < MIN_PLACES or black.mean() <= MAX_BLACK:
                continue
            # Textures may be black there; looking them up takes long in a new world.
            view, width_m = places.view.rows(np.flatnonzero(own)), places.width_m[own]
            black &= Reflectance(places.scene).at(view, width_m) >= MIN_ALBEDO
            if black.mean() > MAX_BLACK:
                text = f"{black.mean():.0%} of the ground of the {what} is black in Cycles' image"
                raise RenderError(f"{name}: {text}, though its textures are not")

    def _albedo(self, scene: Scene, xy_m: FloatArray, range_m: FloatArray) -> FloatArray:
        """Return the (N,) mean albedo of the ground at (N, 2) points, through haze."""
        material, haze = scene.material, scene.sky.haze
        layers = [layer.maps for layer in material.layers]
        known = self._means
        self._means = {id(m): known.get(id(m)) or (m, mean_color(m)) for m in layers}
        albedo = material.weights_at(xy_m) @ np.array([self._means[id(m)][1] for m in layers])
        if haze is not None:
            albedo = albedo * np.exp(-range_m[:, None] * np.array(haze.extinction_per_m))
        return np.asarray(albedo.max(axis=1))
