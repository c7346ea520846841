"""How much of the sky each place on the stage sees, over the ground and the objects around it."""

from __future__ import annotations

from math import pi

import cv2
import numpy as np

from oaisys_core.procedural.contact_map import stage_ground
from oaisys_core.raycast.surface import Surface
from oaisys_core.render.draft.appearance import Floats
from oaisys_core.render.draft.ground.texture_atlas import sample
from oaisys_core.types import FloatArray

MAX_PX, LEAST_M = 1024, 0.02
"""Largest edge of the map, and smallest texel."""

AZIMUTHS = 12
"""Directions along which horizons are searched."""

STEPS_PX = (1, 2, 3, 5, 8, 12, 18, 28, 44, 70, 110, 180)
"""Distances at which they are searched, in texels."""

MIN_RISE_M = 0.02
"""Height of objects from which on their points see more of the sky than the ground does."""

UNDER = 1e-3
"""Distance below something that moves at which a ray goes on."""

FADE = 0.1
"""Distance beyond the stage, as a share of its edge, within which the land comes to see all of the
sky: what shades the last places of the stage does not shade the land behind them."""

LAYERS = 20
"""Things that move above one another, at most."""


class SkyVisibility:
    """The share of its hemisphere that the ground sees free, by light that comes from everywhere.

    It depends on the ground and on what stays where it is, not on what moves.
    """

    def __init__(self, surface: Surface) -> None:
        """Search the horizons around places on the stage."""
        # Not the detail near cameras, so that light does not depend on where these are.
        ground = stage_ground(surface.scene)
        self._extent_m = x0, y0, x1, y1 = ground.extent_m
        edge_m = max(x1 - x0, y1 - y0)
        self._size = int(np.clip(edge_m / max(ground.spacing_m, LEAST_M), 8, MAX_PX))
        xy_m = self._places_m()
        low_m = np.nan_to_num(ground.height_at(xy_m), nan=0.0)
        top_m = np.fmax(low_m, _object_height_m(surface, xy_m))
        shape = (self._size, self._size)
        low, top = (each.reshape(shape).astype(np.float32) for each in (low_m, top_m))
        self._map = np.stack((self._search(low, top), low, top - low), axis=-1)

    def at(self, points_m: FloatArray) -> Floats:
        """Return the (N,) shares at (N, 3) points: more, the higher above the ground they are."""
        x0, y0, x1, y1 = self._extent_m
        x = (points_m[:, 0] - x0) * (self._size / (x1 - x0)) - 0.5
        y = (points_m[:, 1] - y0) * (self._size / (y1 - y0)) - 0.5
        found = sample(self._map, x.astype(np.float32), y.astype(np.float32))
        share, low_m, rise_m = found.T
        risen = points_m[:, 2].astype(np.float32) - low_m
        height = np.clip(risen / np.maximum(rise_m, np.float32(MIN_RISE_M)), 0, 1)
        is_free = np.where(rise_m > MIN_RISE_M, height, 0)
        beyond_m = np.maximum((x0, y0) - points_m[:, :2], points_m[:, :2] - (x1, y1)).max(axis=1)
        away = np.clip(beyond_m / (FADE * max(x1 - x0, y1 - y0)), 0, 1).astype(np.float32)
        return np.asarray(share + (1 - share) * np.maximum(is_free, away))

    def _places_m(self) -> FloatArray:
        """Return the (N, 2) centres of texels, row by row from min_y."""
        x0, y0, x1, y1 = self._extent_m
        middle = (np.arange(self._size) + 0.5) / self._size
        x, y = np.meshgrid(x0 + middle * (x1 - x0), y0 + middle * (y1 - y0))
        return np.column_stack((x.ravel(), y.ravel()))

    def _search(self, low_m: Floats, top_m: Floats) -> Floats:
        """Return the share of each texel, given the heights of ground and of all things."""
        x0, y0, x1, y1 = self._extent_m
        texel_m = ((x1 - x0) / self._size, (y1 - y0) / self._size)
        lean_y, lean_x = np.gradient(low_m)
        reach = min(STEPS_PX[-1], self._size - 1)
        around_m = np.pad(top_m, reach, mode="edge")
        total = np.zeros_like(low_m)
        rows, columns = low_m.shape
        for azimuth in np.arange(AZIMUTHS) * (2 * pi / AZIMUTHS):
            slope = np.zeros_like(low_m)
            for step in STEPS_PX:
                dx, dy = round(step * np.cos(azimuth)), round(step * np.sin(azimuth))
                if step > reach or (dx, dy) == (0, 0):
                    continue
                there = around_m[reach + dy : reach + dy + rows, reach + dx : reach + dx + columns]
                rise = there - low_m - (lean_x * np.float32(dx) + lean_y * np.float32(dy))
                away_m = np.float32(np.hypot(dx * texel_m[0], dy * texel_m[1]))
                np.maximum(slope, rise / away_m, out=slope)
            total += 1 / (1 + slope * slope)
        share = total / np.float32(AZIMUTHS)
        return np.asarray(cv2.GaussianBlur(share, (3, 3), 0), np.float32)


def _object_height_m(surface: Surface, xy_m: FloatArray) -> FloatArray:
    """Return the (N,) heights of the topmost object that stays; NaN where there is none."""
    moving = [p.instance_ids for p in surface.scene.placements if p.is_moving]
    moving_ids = np.concatenate([np.zeros(0, np.uint32), *moving])
    height_m = np.full(len(xy_m), np.nan)
    below_m = np.full(len(xy_m), np.inf)
    rows = np.arange(len(xy_m))
    for _ in range(LAYERS):
        found_m, ids = surface.object_heights_m(xy_m[rows], below_m[rows])
        height_m[rows] = found_m
        again = np.flatnonzero(np.isin(ids, moving_ids) & (ids > 0))
        if not len(again):
            break
        rows = rows[again]
        below_m[rows] = found_m[again] - UNDER
        height_m[rows] = np.nan
    return height_m
