"""Colour of a view from the rays that found its depth: textures, sun with shadows, sky, lamps."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.contact_map import stage_ground
from oaisys_core.procedural.environment.light import sun_color
from oaisys_core.raycast.surface import Surface, View
from oaisys_core.render.draft.appearance import Appearance, Floats, normalise
from oaisys_core.render.draft.light.diffuse import RoughDiffuse, bent_share
from oaisys_core.render.draft.light.ground_nearby import Flags, ground_share, light_around
from oaisys_core.render.draft.light.sun_light import SunLight
from oaisys_core.render.draft.objects.parts import Parts
from oaisys_core.render.shading.lamp_light import lamp_irradiance_w_m2
from oaisys_core.render.shading.looks import THROUGH_LEAF, pixel_angle_rad
from oaisys_core.render.shading.photometry import law_factors
from oaisys_core.render.shading.shading import in_haze
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import PlacedCamera, Scene, Sky
from oaisys_core.scene.photometric_laws import PhotometricLaw
from oaisys_core.types import FloatArray

LIFT_M, LIFT_SHARE = 1e-4, 1.5e-5
"""Distance of shadow rays' beginnings from the surface, and its share of that from the eye."""

GRAZING_COS, GRAZING_LIFT = 0.2, 0.12
"""Cosine of the sun's angle to the ground below which they begin higher, and how much at most, as a
share of the distance between the ground's vertices."""

HIDDEN_LIGHT = 0.5
"""Radiance of what hides the sky, relative to that of the ground nearby: its side is often dark."""

FREE_OF_LEAVES = 0.75
"""Share of the sky that leaves leave to each other."""

FILTER_SHARE = 0.1
"""Share of its light that a pixel gives to each neighbour, in both directions."""

THIN_FILTER = np.array((0.27, 0.46, 0.27), np.float32)
"""The same weights where a pixel shows another thing than most pixels around it."""

PIXEL_FILTER = np.array((FILTER_SHARE, 1 - 2 * FILTER_SHARE, FILTER_SHARE), np.float32)


UP = np.array([(0, 0, 1)], np.float32)


class Shaded(NamedTuple):
    """The colours of a view.

    Attributes:
        radiance: (H, W, 3) scene-linear.
        albedo: (H, W, 3) linear, 0 where nothing was hit.
    """

    radiance: Floats
    albedo: Floats


class Nearby(NamedTuple):
    """Where N points are, and the light there.

    Attributes:
        points_m: (N, 3) in ``map``.
        to_eye: (N, 3) unit vectors.
        sun_share: (N,) of the sun's disc that they see.
        ground: (N, 3) radiance of the ground nearby.
        is_ground: (N,) whether they are ground themselves.
        of_sun, of_sky: (N,) reflectance of both, relative to the law of rough surfaces; None for 1.
    """

    points_m: FloatArray
    to_eye: Floats
    sun_share: Floats
    ground: Floats
    is_ground: Flags
    of_sun: Floats | None = None
    of_sky: Floats | None = None


class DraftRenderer:
    """Shades views of a world; what a world needs for that is made at its first view."""

    def __init__(self, store: LevelStore | None = None) -> None:
        """Make nothing yet; ``store`` may share levels of textures with others."""
        self._parts = Parts(store or LevelStore())

    def shade(self, surface: Surface, view: View, camera: PlacedCamera) -> Shaded:
        """Return the colours of a camera's pixels, whose rays go through their centres.

        Args:
            surface: The surface of the world.
            view: What it shows to the camera.
            camera: The camera.
        """
        self._parts.take_over(surface)
        height, width = view.depth_m.shape
        shape = (height, width)
        look = Appearance(
            np.zeros((*shape, 3), np.float32),
            np.zeros((*shape, 3), np.float32),
            np.zeros((*shape, 3), np.float32),
            np.ones(shape, np.float32),
            np.zeros(shape, np.float32),
        )
        pixel_rad = pixel_angle_rad(camera.intrinsics)
        distance_m = _distances_m(view)
        scene = surface.scene

        def look_at(rows: slice) -> None:
            footprint_m = distance_m[rows] * pixel_rad
            self._look(surface, view.rows(rows), footprint_m, look, rows)

        surface.each_band(shape, look_at)
        sun_share = self._sun_shares(surface, view, look, distance_m)
        light = sun_share, light_around(view, look, sun_share, scene.sky)
        image = np.empty((*shape, 3), np.float32)

        def shade(rows: slice) -> None:
            part = Appearance(*(each[rows] for each in look))
            shares = (each[rows] for each in light)
            image[rows] = self._shade(scene, view.rows(rows), part, distance_m[rows], *shares)

        surface.each_band(shape, shade)
        self._mirror(surface, view, distance_m, image)
        return Shaded(_filter(image, view), look.albedo)

    def _look(
        self, surface: Surface, view: View, footprint_m: Floats, look: Appearance, rows: slice
    ) -> None:
        """Write, into some rows of ``look``, how the points of a view look."""
        for is_shown, find in (
            (view.is_ground, self._ground_look),
            (view.instance_ids > 0, self._parts.objects.at),
        ):
            some = np.flatnonzero(is_shown)
            if not len(some):
                continue
            # A slice is not copied.
            pixels: NDArray[np.intp] | slice = slice(None) if len(some) == is_shown.size else some
            found = find(surface, view.pixels(pixels), footprint_m.reshape(-1)[pixels])
            for into, values in zip(look, found, strict=True):
                part = into[rows]
                part.reshape(-1, *part.shape[2:])[pixels] = values

    def _ground_look(self, surface: Surface, view: View, footprint_m: Floats) -> Appearance:
        normals = self._parts.normals.at(surface, view)
        found = self._parts.ground.at(view.points_m[:, 0], normals, footprint_m)
        if surface.scene.material.is_lambertian:
            found = found._replace(roughness=np.zeros_like(found.roughness))
        return found

    def _sun_shares(
        self, surface: Surface, view: View, look: Appearance, distance_m: Floats
    ) -> Floats:
        """Return the (H, W) share of the sun's disc that each pixel sees."""
        sky = surface.scene.sky
        if not sky.lamp_w_m2:
            return np.zeros(distance_m.shape, np.float32)
        to_sun = np.array(sky.to_sun, np.float32)
        facing = look.smooth @ to_sun
        is_towards = np.minimum(facing, look.normal @ to_sun) > 0
        may_see = view.is_hit & (is_towards | (look.through > 0))
        lift_m = LIFT_M + LIFT_SHARE * distance_m
        # Triangles are flat; where light grazes them, they must not shade each other.
        grazing = np.clip(1 - facing * np.float32(1 / GRAZING_COS), 0, 1)
        spacing_m = stage_ground(surface.scene).spacing_m
        lift_m += view.is_ground * grazing * np.float32(GRAZING_LIFT * spacing_m)
        # The sun may shine on the other side of leaves.
        lift_m = np.where((look.through > 0) & (facing < 0), -lift_m, lift_m)
        starts_m = view.points_m + lift_m[..., None] * look.smooth
        return SunLight(sky, surface).share(starts_m, may_see)

    def _shade(
        self,
        scene: Scene,
        view: View,
        look: Appearance,
        distance_m: Floats,
        sun_share: Floats,
        around: Floats,
    ) -> Floats:
        """Return the (R, W, 3) radiance of some rows.

        ``around`` is the (R, W) share of the sun's light that surfaces nearby get.
        """
        shape, sky = view.depth_m.shape, scene.sky
        flat = Appearance(*(each.reshape(-1, *each.shape[2:]) for each in look))
        points_m, is_hit = view.points_m.reshape(-1, 3), view.is_hit.reshape(-1)
        if not is_hit.all():
            points_m = np.where(is_hit[:, None], points_m, 0.0)
        sun = (sky.lamp_w_m2 * np.array(sun_color(sky))).astype(np.float32)
        level = around.reshape(-1, 1) * sun + self._parts.sky.irradiance(UP)
        nearby = Nearby(
            points_m,
            normalise(-view.directions.reshape(-1, 3).astype(np.float32)),
            sun_share.reshape(-1),
            level * (self._parts.ground.mean_albedo * np.float32(1 / pi)),
            view.is_ground.reshape(-1),
        )
        if scene.material.law is not None:
            nearby = _with_law(scene.material.law, scene.sky, flat, nearby)
        image = self._reflect(scene, flat, nearby, sun)
        seen, missed = np.flatnonzero(is_hit), np.flatnonzero(~is_hit)
        if scene.lamps and len(seen):
            normals = flat.normal[seen].astype(np.float64)
            of_lamps = lamp_irradiance_w_m2(scene.lamps, points_m[seen], normals) * (1 / pi)
            image[seen] += flat.albedo[seen] * of_lamps.astype(np.float32)
        if sky.haze is not None and len(seen):
            away_m = distance_m.reshape(-1)[seen].astype(np.float64)
            image[seen] = in_haze(image[seen].astype(np.float64), away_m, sky.haze, sky)
        if len(missed):
            rays = view.directions.reshape(-1, 3)[missed]
            image[missed] = self._parts.sky.radiance(rays, with_disc=True)
        return np.asarray(image.reshape(*shape, 3), np.float32)

    def _reflect(self, scene: Scene, look: Appearance, nearby: Nearby, sun: Floats) -> Floats:
        """Return the (N, 3) radiance of points under sun, sky and the ground nearby."""
        normal, through = look.normal, look.through
        view_cos = np.einsum("ij,ij->i", normal, nearby.to_eye)
        law = RoughDiffuse(look.albedo, look.roughness, view_cos)
        to_sun = np.array(scene.sky.to_sun, np.float32)
        facing = normal @ to_sun
        bend_cos = np.einsum("ij,ij->i", normal, look.smooth)
        direct = nearby.sun_share * bent_share(facing, look.smooth @ to_sun, bend_cos)
        image = law.radiance(facing, nearby.to_eye @ to_sun) * (direct[:, None] * sun)
        if nearby.of_sun is not None:
            image *= nearby.of_sun[:, None]
        free = self._parts.visibility.at(nearby.points_m)
        free[through > 0] *= np.float32(FREE_OF_LEAVES)
        below = ground_share(normal, bend_cos, free, nearby.is_ground)
        ambient = law.ambient() * self._ambient(normal, free, below, nearby.ground)
        image += ambient if nearby.of_sky is None else ambient * nearby.of_sky[:, None]
        leaves = np.flatnonzero(through)
        if len(leaves):
            behind = np.maximum(-facing[leaves], 0) * nearby.sun_share[leaves]
            light = behind[:, None] * (sun * np.float32(1 / pi))
            back = -normal[leaves]
            below = (1 - back[:, 2]) * np.float32(0.5)
            light += self._ambient(back, free[leaves], below, nearby.ground[leaves])
            light *= look.albedo[leaves] * np.array(THROUGH_LEAF, np.float32)
            image[leaves] += through[leaves, None] * (light - image[leaves])
        return image

    def _mirror(self, surface: Surface, view: View, distance_m: Floats, image: Floats) -> None:
        """Add, in place, what water mirrors; what is not sky is like the ground on average."""
        found = self._parts.water.of_view(surface, view, distance_m)
        if found is None:
            return
        sky = surface.scene.sky
        seen = self._parts.sky.radiance(found.rays.astype(np.float64))
        lit = sky.lamp_w_m2 * max(sky.to_sun[2], 0.0) * np.array(sun_color(sky))
        level = (lit + self._parts.sky.irradiance(UP)[0]) * (1 / pi)
        seen[~found.is_sky] = self._parts.ground.mean_albedo * level
        share = found.share[:, None]
        if sky.haze is not None:
            away_m = distance_m.reshape(-1)[found.pixels].astype(np.float64)
            veiled = in_haze(seen.astype(np.float64), away_m, sky.haze, sky)
            seen = veiled.astype(np.float32)
        flat = image.reshape(-1, 3)
        flat[found.pixels] += share * (seen - flat[found.pixels])

    def _ambient(self, normal: Floats, free: Floats, below: Floats, ground: Floats) -> Floats:
        """Return the (N, 3) irradiance over pi of sky and ground together.

        Args:
            normal: (N, 3) of the surfaces.
            free: (N,) share of the sky that they see.
            below: (N,) share of their hemisphere in which they see ground below the horizon.
            ground: (N, 3) radiance of the ground nearby.
        """
        above = (1 + normal[:, 2]) * np.float32(0.5)
        found = self._parts.sky.irradiance(normal) * (free * np.float32(1 / pi))[:, None]
        found += (below + np.float32(HIDDEN_LIGHT) * above * (1 - free))[:, None] * ground
        return np.asarray(found)


def _with_law(law: PhotometricLaw, sky: Sky, look: Appearance, nearby: Nearby) -> Nearby:
    """Return points with the factors of the ground's law; elsewhere these are 1."""
    on_ground = np.flatnonzero(nearby.is_ground)
    rays = -nearby.to_eye[on_ground]
    found = law_factors(law, look.normal[on_ground], rays, sky.to_sun)
    of_sun, of_sky = (np.ones(len(nearby.sun_share), np.float32) for _ in found)
    of_sun[on_ground], of_sky[on_ground] = found
    return nearby._replace(of_sun=of_sun, of_sky=of_sky)


def _filter(image: Floats, view: View) -> Floats:
    """Return an image as a pixel's filter has it, wider where things are thinner than pixels."""
    border = cv2.BORDER_REFLECT
    filtered = cv2.sepFilter2D(image, -1, PIXEL_FILTER, PIXEL_FILTER, borderType=border)
    ids = np.pad(view.instance_ids, 1, mode="edge")
    height, width = view.instance_ids.shape
    others = np.zeros((height, width), np.uint8)
    for row in range(3):
        for column in range(3):
            others += ids[row : row + height, column : column + width] != view.instance_ids
    # Beside a straight edge there are three.
    is_thin = others > 3
    if is_thin.any():
        wide = cv2.sepFilter2D(image, -1, THIN_FILTER, THIN_FILTER, borderType=border)
        filtered[is_thin] = wide[is_thin]
    return np.asarray(filtered)


def _distances_m(view: View) -> Floats:
    """Return the (H, W) distances from the eye, 0 where nothing was hit."""
    length = np.sqrt(np.einsum("ijk,ijk->ij", view.directions, view.directions))
    return np.asarray(np.where(view.is_hit, view.depth_m, 0.0) * length, np.float32)
