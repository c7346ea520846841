"""Colour of a view from the rays that found its depth: textures, sun with shadows, sky, lamps."""

from __future__ import annotations

from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.contact_map import stage_ground
from oaisys_core.procedural.environment.light import veil_radiance
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.draft.appearance import (
    Appearance,
    Floats,
    by_component,
    dot,
    empty,
    places_m,
    put,
    rows_where,
    take,
    zeros,
)
from oaisys_core.render.draft.light.cloud_shade import shade_by_clouds
from oaisys_core.render.draft.light.far_lift import GRAZING_COS, FarLift
from oaisys_core.render.draft.light.ground_nearby import light_around
from oaisys_core.render.draft.light.reflection import Nearby, reflect, sun_w_m2
from oaisys_core.render.draft.light.sun_light import LiftedPoints, SunLight
from oaisys_core.render.draft.objects.parts import Parts
from oaisys_core.render.draft.pixel_filter import filter_pixels
from oaisys_core.render.shading.lamp_light import lamp_irradiance_w_m2
from oaisys_core.render.shading.looks import pixel_angle_rad
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import PlacedCamera, Scene, Sky

LIFT_M, LIFT_SHARE = 1e-4, 1.5e-5
"""Distance of shadow rays' beginnings from the surface, and its share of that from the eye."""

GRAZING_LIFT = 0.12
"""How much higher they begin at most where light grazes the ground (`GRAZING_COS`), as a share of
the distance between the ground's vertices."""

UP = np.array([(0, 0, 1)], np.float32)


class Shaded(NamedTuple):
    """The colours of a view.

    Attributes:
        radiance: (H, W, 3) scene-linear.
        albedo: (H, W, 3) linear, 0 where nothing was hit.
    """

    radiance: Floats
    albedo: Floats


class Pixels(NamedTuple):
    """What the pixels of a view show, before there is light; in float32 unless said otherwise.

    Attributes:
        look: How it looks, (H, W) or (H, W, 3) each.
        to_eye: (H, W, 3) unit vectors.
        distance_m: (H, W) from the eye, 0 where nothing was hit.
        facing: (H, W) cosines of the sun's angle to the surfaces themselves, from below negative.
        lift_m: (H, W) how far above surfaces rays to the sun begin; below, where negative.
        may_see: bool (H, W), whether the sun may shine there.
    """

    look: Appearance
    to_eye: Floats
    distance_m: Floats
    facing: Floats
    lift_m: Floats
    may_see: NDArray[np.bool_]

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Pixels:
        """Return pixels that show nothing."""
        look = Appearance(
            zeros(*shape, 3),
            zeros(*shape, 3),
            zeros(*shape, 3),
            np.ones(shape, np.float32),
            np.zeros(shape, np.float32),
        )
        distance_m, facing, lift_m = np.zeros((3, *shape), np.float32)
        return cls(look, zeros(*shape, 3), distance_m, facing, lift_m, np.zeros(shape, np.bool_))

    def rows(self, rows: slice) -> Pixels:
        """Return some rows as pixels of one column, which share their memory with these."""
        look = Appearance(*(_flat(each[rows]) for each in self.look))
        images: list[Any] = [_flat(each[rows]) for each in self[1:]]
        return Pixels(look, *images)


class DraftRenderer:
    """Shades views of a world; what a world needs for that is made at its first view."""

    def __init__(self, store: LevelStore | None = None) -> None:
        """Make nothing yet; ``store`` may share levels of textures with others."""
        self._parts = Parts(store or LevelStore())
        self._far_lift = FarLift()

    def shade(self, surface: Surface, view: View, camera: PlacedCamera) -> Shaded:
        """Return the colours of a camera's pixels, whose rays go through their centres.

        Args:
            surface: The surface of the world.
            view: What it shows to the camera.
            camera: The camera.
        """
        self._parts.take_over(surface)
        sky, far_ground = surface.scene.sky, surface.scene.far_ground
        if sky.lamp_w_m2 and far_ground is not None:
            self._far_lift.take_over(far_ground, sky.to_sun)
        height, width = view.depth_m.shape
        shape = (height, width)
        pixels = Pixels.empty(shape)
        pixel_rad = pixel_angle_rad(camera.intrinsics)

        def look_at(rows: slice) -> None:
            self._look(surface, view.rows(rows), pixel_rad, pixels.rows(rows))

        surface.each_band(shape, look_at)
        sun_share = np.zeros(shape, np.float32)
        if sky.lamp_w_m2:
            starts = LiftedPoints.of(view.points_m, pixels.look.smooth, pixels.lift_m)
            sun = SunLight(sky, surface, starts)
            sun_share = sun.share(pixels.may_see, view.instance_ids)
            shade_by_clouds(sky, view.points_m, sun_share)
        around = light_around(view, pixels.facing, sun_share)
        image = np.empty((*shape, 3), np.float32)

        def shade(rows: slice) -> None:
            light = sun_share[rows].reshape(-1), around[rows].reshape(-1)
            found = self._shade(surface.scene, view.rows(rows), pixels.rows(rows), *light)
            image[rows] = found.reshape(*image[rows].shape)

        surface.each_band(shape, shade)
        self._mirror(surface, view, pixels.distance_m, image)
        return Shaded(filter_pixels(image, surface, view), pixels.look.albedo)

    def _look(self, surface: Surface, view: View, pixel_rad: float, pixels: Pixels) -> None:
        """Write, into some rows of pixels, what a view shows."""
        rays = by_component(view.directions.reshape(-1, 3))
        depth_m = np.where(view.is_hit, view.depth_m, 0).reshape(-1)
        length = np.sqrt(dot(rays, rays))
        pixels.distance_m[:] = depth_m * length
        for into, component in zip(pixels.to_eye.T, rays.T, strict=True):
            np.multiply(component, -1 / length, out=into)
        footprint_m = pixels.distance_m * np.float32(pixel_rad)
        for is_shown, find in (
            (view.is_ground, self._ground_look),
            (view.instance_ids > 0, self._parts.objects.at),
        ):
            rows = rows_where(is_shown.reshape(-1))
            if isinstance(rows, slice) or len(rows):
                found = find(surface, view.pixels(rows), take(footprint_m, rows))
                for into, values in zip(pixels.look, found, strict=True):
                    put(into, rows, values)
        if surface.scene.sky.lamp_w_m2:
            self._prepare_shadows(surface, view, pixels)

    def _ground_look(self, surface: Surface, view: View, footprint_m: Floats) -> Appearance:
        points_m = places_m(view.points_m[:, 0])
        normals = self._parts.normals.at(surface, view, points_m)
        found = self._parts.ground.at(points_m, normals, footprint_m)
        if surface.scene.material.is_lambertian:
            found = found._replace(roughness=np.zeros_like(found.roughness))
        return found

    def _prepare_shadows(self, surface: Surface, view: View, pixels: Pixels) -> None:
        """Write, into some rows of pixels, whether to cast rays to the sun, and from how high."""
        scene = surface.scene
        to_sun, look = np.array(scene.sky.to_sun, np.float32), pixels.look
        is_leaf = look.through > 0
        facing = dot(look.smooth, to_sun)
        is_towards = np.minimum(facing, dot(look.normal, to_sun)) > 0
        pixels.may_see[:] = view.is_hit.reshape(-1) & (is_towards | is_leaf)
        pixels.facing[:] = facing
        lift_m = pixels.lift_m
        np.multiply(pixels.distance_m, np.float32(LIFT_SHARE), out=lift_m)
        lift_m += np.float32(LIFT_M)
        # Triangles are flat; where light grazes them, they must not shade each other.
        grazing = np.clip(1 - facing * np.float32(1 / GRAZING_COS), 0, 1)
        spacing_m = stage_ground(scene).spacing_m
        lift_m += view.is_ground.reshape(-1) * grazing * np.float32(GRAZING_LIFT * spacing_m)
        far = np.flatnonzero(surface.is_far_ground(view))
        if len(far):
            lift_m[far] += self._far_lift.of(view.elements.reshape(-1)[far])
        # The sun may shine on the other side of leaves.
        np.negative(lift_m, where=is_leaf & (facing < 0), out=lift_m)

    def _shade(
        self, scene: Scene, view: View, pixels: Pixels, sun_share: Floats, around: Floats
    ) -> Floats:
        """Return the (N, 3) radiance of some rows.

        ``around`` is the (N,) share of the sun's light that surfaces nearby get.
        """
        is_hit = view.is_hit.reshape(-1)
        image = empty(len(is_hit), 3)
        rows = rows_where(is_hit)
        if isinstance(rows, slice) or len(rows):
            look = Appearance(*(take(each, rows) for each in pixels.look))
            light = take(sun_share, rows), take(around, rows)
            to_eye = take(pixels.to_eye, rows)
            found = self._reflect(scene, view.pixels(rows), look, to_eye, *light)
            if scene.sky.haze is not None:
                _veil(scene.sky, take(pixels.distance_m, rows), found)
            put(image, rows, found)
        if not isinstance(rows, slice):
            missed = np.flatnonzero(~is_hit)
            rays = np.ascontiguousarray(view.directions.reshape(-1, 3)[missed])
            put(image, missed, self._parts.sky.radiance(rays, with_disc=True))
        return image

    def _reflect(
        self,
        scene: Scene,
        view: View,
        look: Appearance,
        to_eye: Floats,
        sun_share: Floats,
        around: Floats,
    ) -> Floats:
        """Return the (N, 3) radiance of the points of a view of one column, without haze."""
        points_m, light = view.points_m[:, 0], self._parts.sky
        level = light.irradiance(UP)[0]
        per_light = self._parts.ground.mean_albedo * np.float32(1 / pi)
        ground = empty(len(points_m), 3)
        for channel, sun, sky, share in zip(
            ground.T, sun_w_m2(scene.sky), level, per_light, strict=True
        ):
            np.multiply(around, sun * share, out=channel)
            channel[:] += sky * share
        nearby = Nearby(
            to_eye,
            sun_share,
            self._parts.visibility.at(points_m),
            ground,
            view.is_ground[:, 0],
        )
        image = reflect(light, scene.sky, scene.material.law, look, nearby)
        if scene.lamps:
            normals = look.normal.astype(np.float64)
            of_lamps = lamp_irradiance_w_m2(scene.lamps, points_m, normals) * (1 / pi)
            image += look.albedo * of_lamps.astype(np.float32)
        return image

    def _mirror(self, surface: Surface, view: View, distance_m: Floats, image: Floats) -> None:
        """Add, in place, what water mirrors; what is not sky is like the ground on average."""
        found = self._parts.water.of_view(surface, view, distance_m)
        if found is None:
            return
        sky = surface.scene.sky
        seen = self._parts.sky.radiance(found.rays.astype(np.float64))
        lit = sun_w_m2(sky) * max(sky.to_sun[2], 0.0)
        level = (lit + self._parts.sky.irradiance(UP)[0]) * (1 / pi)
        seen[~found.is_sky] = self._parts.ground.mean_albedo * level
        share = found.share[:, None]
        if sky.haze is not None:
            _veil(sky, distance_m.reshape(-1)[found.pixels], seen)
        flat = image.reshape(-1, 3)
        flat[found.pixels] += share * (seen - flat[found.pixels])


def _veil(sky: Sky, distance_m: Floats, radiance: Floats) -> None:
    """Veil (N, 3) radiance, in place, by haze at (N,) distances (Koschmieder's law)."""
    assert sky.haze is not None
    airlight = veil_radiance(sky, sky.haze)
    for channel, air, per_m in zip(radiance.T, airlight, sky.haze.extinction_per_m, strict=True):
        clear = np.exp(distance_m * np.float32(-per_m))
        channel[:] -= np.float32(air)
        channel[:] *= clear
        channel[:] += np.float32(air)


def _flat(image: NDArray[Any]) -> NDArray[Any]:
    """Return (H, W, ...) pixels as (N, ...), which share their memory."""
    return image.reshape(-1, *image.shape[2:])
