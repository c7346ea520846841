"""How much of the sun's disc each point of an image sees, by rays towards it."""

from __future__ import annotations

from math import pi, sin, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import Surface
from oaisys_core.render.draft.appearance import Floats, normalise
from oaisys_core.scene.sky import Sky
from oaisys_core.types import FloatArray

EDGE_RAYS = 8
"""Rays to the disc where its share is neither none nor all."""

BLOCK_PX = 2
"""Edge of the square of pixels whose rays go to different points of the disc, so that together they
see its share in finer steps."""

GROWTH = 12
"""How often the pixels along the edges of shadows are extended while they are half in shadow."""

GOLDEN_RAD = pi * (3 - sqrt(5))
"""Angle by which points are spread evenly over a disc, one after the other."""


class SunLight:
    """Casts rays at the sun from the points of an image."""

    def __init__(self, sky: Sky, surface: Surface) -> None:
        self._surface = surface
        self._to_sun = np.array(sky.to_sun)
        self._discs = _discs(self._to_sun, sky.sun_angular_diameter_rad / 2)

    def share(self, starts_m: FloatArray, may_see: NDArray[np.bool_]) -> Floats:
        """Return the (H, W) share of the disc that is seen.

        Where shadows end, rays go to all of the disc.

        Args:
            starts_m: (H, W, 3) just above the surface, in ``map``.
            may_see: (H, W) pixels to look at; the share of others is 0.
        """
        share = np.zeros(may_see.shape, np.float32)
        flat_m = starts_m.reshape(-1, 3)

        def cast(rows: slice) -> None:
            wanted = may_see[rows]
            share[rows][wanted] = ~self._surface.are_occluded_along(
                starts_m[rows][wanted], self._to_sun
            )

        self._surface.each_band((share.shape[0], share.shape[1]), cast)
        # Pixels that cannot see the sun are no shadow's edge.
        square = np.ones((3, 3), np.uint8)
        lit, dark = (np.where(may_see, share, np.float32(each)) for each in (1, 0))
        is_edge = cv2.dilate(dark, square) > cv2.erode(lit, square)
        self._refine(share, is_edge, flat_m, may_see.copy())
        return share

    def _refine(
        self,
        share: Floats,
        is_edge: NDArray[np.bool_],
        starts_m: FloatArray,
        is_left: NDArray[np.bool_],
    ) -> None:
        """Replace shares along edges, in place, by means of several rays.

        Pixels around those that are half in shadow follow. ``starts_m`` are (N, 3) of all pixels;
        ``is_left`` is changed.
        """
        flat, square = share.reshape(-1), np.ones((3, 3), np.uint8)
        for _ in range(GROWTH):
            rows = np.flatnonzero(is_edge & is_left)
            if not len(rows):
                break
            for disc, some in zip(self._discs, _by_place(rows, share.shape[1]), strict=True):
                flat[some] = self._mean_share(starts_m[some], disc)
            is_left.reshape(-1)[rows] = False
            is_partly = np.zeros(share.shape, np.uint8)
            is_partly.reshape(-1)[rows] = (flat[rows] > 0) & (flat[rows] < 1)
            is_edge = cv2.dilate(is_partly, square) > 0

    def _mean_share(self, starts_m: FloatArray, disc: FloatArray) -> Floats:
        """Return the (N,) shares of a disc's rays along which (N, 3) points see the sun."""
        seen = np.zeros(len(starts_m), np.float32)
        for ray in disc:
            seen += ~self._surface.are_occluded_along(starts_m, ray)
        return np.asarray(seen / np.float32(EDGE_RAYS))


def _by_place(pixels: NDArray[np.intp], width_px: int) -> list[NDArray[np.intp]]:
    """Return pixels, flat indices of an image, by their place in squares of `BLOCK_PX`."""
    row, column = np.divmod(pixels, width_px)
    place = row % BLOCK_PX * BLOCK_PX + column % BLOCK_PX
    return [pixels[place == each] for each in range(BLOCK_PX**2)]


def _discs(to_sun: FloatArray, radius_rad: float) -> FloatArray:
    """Return (BLOCK_PX**2, EDGE_RAYS, 3) unit vectors to points spread evenly over the disc."""
    aside = np.array((0.0, 0.0, 1.0)) if abs(to_sun[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    right = np.cross(aside, to_sun)
    right /= np.linalg.norm(right)
    up = np.cross(to_sun, right)
    places = BLOCK_PX**2
    place = np.arange(places)[:, None]
    index = np.arange(EDGE_RAYS)
    radius = sin(radius_rad) * np.sqrt((index + (place + 0.5) / places) / EDGE_RAYS)
    turn = index * GOLDEN_RAD + place * (2 * pi / places)
    offset = radius[..., None] * (np.cos(turn)[..., None] * right + np.sin(turn)[..., None] * up)
    rays = (to_sun + offset).reshape(-1, 3).astype(np.float32)
    return normalise(rays).astype(np.float64).reshape(places, EDGE_RAYS, 3)
