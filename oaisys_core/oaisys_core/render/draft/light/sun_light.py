"""How much of the sun's disc each point of an image sees, by rays towards it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import repeat
from math import pi, sin, sqrt
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.targets.ray_target import RayCone
from oaisys_core.render.draft.appearance import Floats, normalise
from oaisys_core.scene.sky import Sky
from oaisys_core.types import FloatArray

EDGE_RAYS, CLUTTERED_RAYS = 8, 4
"""Rays to the disc where its share is neither none nor all: along edges of shadows, and where edges
are everywhere, as among leaves."""

CLUTTER_PX, CLUTTER = 9, 0.5
"""Edge length of the square around a pixel, and share of it beside others in another light from
which on edges are everywhere. One straight edge has a third of a square."""

COARSE_PX = 2
"""Edge of the squares of pixels of which one is looked at first."""

RAY_PIXELS, DISC_RAY_PIXELS = 8, 2
"""Pixels of an image that are as much work as a ray to the middle of the sun, and as one of several
to its disc: how rays are divided into bands."""

BLOCK_PX = 2
"""Edge of the square of pixels whose rays go to different points of the disc, so that together they
see its share in finer steps."""

TILE_PX = (8, 4)
"""Rows and columns of the tiles in whose order rays are cast: rays that Embree casts together, and
one after the other, then meet much of the same."""

GROWTH = 12
"""How often the pixels along the edges of shadows are extended: while their neighbours are in
another light, and while they are half in shadow."""

FEW = 1 / 4096
"""Share of the pixels below which edges are not extended further: a round takes a millisecond."""

GOLDEN_RAD = pi * (3 - sqrt(5))
"""Angle by which points are spread evenly over a disc, one after the other."""

T = TypeVar("T", bound=np.generic)


class LiftedPoints(NamedTuple):
    """Points a little above the surfaces that N pixels show, computed when they are asked for.

    Attributes:
        points_m: float64 (N, 3) on the surfaces, in ``map``.
        normal: float32 (N, 3) unit normals of the surfaces.
        lift_m: float32 (N,) heights above them.
    """

    points_m: FloatArray
    normal: Floats
    lift_m: Floats

    @classmethod
    def of(cls, points_m: FloatArray, normal: Floats, lift_m: Floats) -> LiftedPoints:
        """Return those of (H, W, 3) points and normals and (H, W) heights, row by row."""
        return cls(points_m.reshape(-1, 3), normal.reshape(-1, 3), lift_m.reshape(-1))

    def at(self, pixels: NDArray[np.intp]) -> FloatArray:
        """Return the (P, 3) lifted points of some pixels."""
        lifted_m = np.empty((len(pixels), 3), order="F")
        lift_m = self.lift_m.take(pixels)
        for into, place_m, normal in zip(lifted_m.T, self.points_m.T, self.normal.T, strict=True):
            np.add(place_m.take(pixels), normal.take(pixels) * lift_m, out=into)
        return lifted_m


class SunLight:
    """Casts rays at the sun from the points of an image."""

    def __init__(self, sky: Sky, surface: Surface, starts: LiftedPoints) -> None:
        """Take over where the rays of all pixels begin, row by row."""
        self._surface, self._starts = surface, starts
        self._to_sun = np.array(sky.to_sun)
        radius_rad = sky.sun_angular_diameter_rad / 2
        self._cone = RayCone(sky.to_sun, radius_rad)
        self._disc = _disc(self._to_sun, radius_rad, EDGE_RAYS)
        self._coarse_disc = _disc(self._to_sun, radius_rad, CLUTTERED_RAYS)

    def share(self, may_see: NDArray[np.bool_], instance_ids: NDArray[np.uint32]) -> Floats:
        """Return the (H, W) share of the disc that is seen.

        One ray of each square of pixels comes first, then those of pixels beside others in another
        light. Where shadows end, rays go to all of the disc.

        Args:
            may_see: (H, W) pixels to look at; the share of others is 0.
            instance_ids: (H, W) what they show: other things may be in another light.
        """
        first = np.zeros(may_see.shape, np.bool_)
        first[::COARSE_PX, ::COARSE_PX] = True
        is_known = first & may_see
        is_lit = np.zeros(may_see.shape, np.uint8)
        self._cast(is_known, is_lit)
        is_like_first = _spread(is_known) & (_spread(instance_ids) == instance_ids)
        is_lit = _spread(is_lit)
        wanted = may_see & ~is_like_first
        for few in _few_by_round(wanted.size):
            wanted &= ~is_known
            if np.count_nonzero(wanted) <= few:
                break
            self._cast(wanted, is_lit)
            is_known |= wanted
            wanted = may_see & _is_edge(is_lit, may_see)
        share = (is_lit * may_see).astype(np.float32)
        self._refine(share, _is_edge(is_lit, may_see), may_see.copy())
        return share

    def _cast(self, wanted: NDArray[np.bool_], is_lit: NDArray[np.uint8]) -> None:
        """Write, in place, whether wanted pixels see the middle of the sun."""
        pixels = _pixels_by_tile(wanted)
        flat = is_lit.reshape(-1)

        def cast(rows: slice) -> None:
            some = pixels[rows]
            starts_m = self._starts.at(some)
            flat[some] = ~self._surface.are_occluded_along(starts_m, self._to_sun)

        self._surface.each_band((len(pixels), RAY_PIXELS), cast)

    def _refine(
        self, share: Floats, is_edge: NDArray[np.bool_], is_left: NDArray[np.bool_]
    ) -> None:
        """Replace shares along edges, in place, by means of several rays.

        Pixels around those that are half in shadow follow, but for cluttered ones. ``is_left`` is
        changed.
        """
        flat, square = share.reshape(-1), np.ones((3, 3), np.uint8)
        edges = cv2.blur(is_edge.astype(np.float32), (CLUTTER_PX, CLUTTER_PX))
        is_cluttered = edges > CLUTTER
        is_left &= is_edge | ~is_cluttered
        for few in _few_by_round(share.size):
            rows = _pixels_by_tile(is_edge & is_left)
            if len(rows) <= few:
                break
            is_coarse = is_cluttered.reshape(-1)[rows]
            for disc, some in (
                (self._disc, rows[~is_coarse]),
                (self._coarse_disc, rows[is_coarse]),
            ):
                if len(some):
                    flat[some] = self._mean_shares(disc, some, _places(some, share.shape[1]))
            is_left.reshape(-1)[rows] = False
            is_partly = np.zeros(share.shape, np.uint8)
            is_partly.reshape(-1)[rows] = (flat[rows] > 0) & (flat[rows] < 1)
            is_edge = cv2.dilate(is_partly, square) > 0

    def _mean_shares(
        self, disc: FloatArray, pixels: NDArray[np.intp], places: NDArray[np.intp]
    ) -> Floats:
        """Return the (N,) shares of a disc's rays along which (N,) pixels see the sun.

        ``places`` are those of the pixels in squares of `BLOCK_PX`.
        """
        shares = np.empty(len(pixels), np.float32)
        count = disc.shape[2]

        def cast(rows: slice) -> None:
            # By component, as the starts are.
            rays = disc[:, places[rows]].reshape(3, -1).T
            origins_m = np.repeat(self._starts.at(pixels[rows]).T, count, axis=1).T
            is_hidden = self._surface.are_occluded(origins_m, rays, self._cone)
            shares[rows] = 1 - is_hidden.reshape(-1, count).mean(axis=1, dtype=np.float32)

        self._surface.each_band((len(pixels), count * DISC_RAY_PIXELS), cast)
        return shares


def _spread(image: NDArray[T]) -> NDArray[T]:
    """Return an image whose squares show what their first pixel does."""
    first = image[::COARSE_PX, ::COARSE_PX]
    height, width = image.shape
    return first.repeat(COARSE_PX, axis=0)[:height].repeat(COARSE_PX, axis=1)[:, :width]


def _few_by_round(pixels: int) -> Iterator[float]:
    """Yield, for each round of growth, how many pixels end it; the first one takes any."""
    yield 0
    yield from repeat(FEW * pixels, GROWTH - 1)


def _is_edge(is_lit: NDArray[np.uint8], may_see: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (H, W) pixels beside others in another light.

    Pixels that cannot see the sun are no shadow's edge.
    """
    square = np.ones((3, 3), np.uint8)
    lit, dark = np.where(may_see, is_lit, np.uint8(1)), is_lit * may_see
    return np.asarray(cv2.dilate(dark, square) > cv2.erode(lit, square))


def _pixels_by_tile(wanted: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the flat indices of the wanted pixels of an (H, W) image, tile by tile."""
    order = _tile_order(*wanted.shape)
    return np.asarray(order[wanted.reshape(-1).take(order)])


@lru_cache(maxsize=2)
def _tile_order(height_px: int, width_px: int) -> NDArray[np.intp]:
    """Return the flat indices of an image's pixels, tile by tile."""
    row, column = (each.reshape(-1) for each in np.indices((height_px, width_px)))
    return np.asarray(np.lexsort((column, row, column // TILE_PX[1], row // TILE_PX[0])))


def _places(pixels: NDArray[np.intp], width_px: int) -> NDArray[np.intp]:
    """Return the places of pixels, flat indices of an image, in squares of `BLOCK_PX`."""
    row, column = np.divmod(pixels, width_px)
    return row % BLOCK_PX * BLOCK_PX + column % BLOCK_PX


def _disc(to_sun: FloatArray, radius_rad: float, rays: int) -> FloatArray:
    """Return (3, BLOCK_PX**2, R) unit vectors to points spread evenly over the disc."""
    aside = np.array((0.0, 0.0, 1.0)) if abs(to_sun[2]) < 0.9 else np.array((1.0, 0.0, 0.0))
    right = np.cross(aside, to_sun)
    right /= np.linalg.norm(right)
    up = np.cross(to_sun, right)
    places = BLOCK_PX**2
    place = np.arange(places)[:, None]
    index = np.arange(rays)
    radius = sin(radius_rad) * np.sqrt((index + (place + 0.5) / places) / rays)
    turn = index * GOLDEN_RAD + place * (2 * pi / places)
    offset = radius[..., None] * (np.cos(turn)[..., None] * right + np.sin(turn)[..., None] * up)
    to_disc = normalise((to_sun + offset).reshape(-1, 3).astype(np.float32))
    return np.ascontiguousarray(
        to_disc.astype(np.float64).reshape(places, rays, 3).transpose(2, 0, 1)
    )
