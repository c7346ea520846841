"""Optical depths within clouds: towards the sun, towards the zenith and towards the ground."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np

from oaisys_core.procedural.environment.clouds.field import GRID, SLABS, CloudField, Slab
from oaisys_core.procedural.environment.clouds.tile import Tile

MIN_SUN_RAD = radians(3.0)
"""Lower suns shine into clouds as this one does: they are far from them, on a round body."""


class Depths:
    """Sums up the extinction of clouds from their tops down; slabs are asked for in that order.

    Attributes:
        to_sun: (GRID, GRID) depth of the slabs so far along a ray from each texel of the base to
            the sun.
    """

    def __init__(self, field: CloudField, sun_elevation_rad: float, sun_azimuth_rad: float) -> None:
        """Sum up the extinction towards the zenith.

        Args:
            field: The clouds.
            sun_elevation_rad: Elevation of the sun above the horizon.
            sun_azimuth_rad: Its azimuth from +x, counter-clockwise.
        """
        elevation_rad = max(sun_elevation_rad, MIN_SUN_RAD)
        self._field = field
        self._way_m = field.slab_m / sin(elevation_rad)
        aside = self._way_m * cos(elevation_rad) / field.texel_m
        self._aside = aside * sin(sun_azimuth_rad), aside * cos(sun_azimuth_rad)
        self._below = np.zeros((GRID, GRID), np.float32)
        for index in range(SLABS):
            self._below += field.slab(index).on_grid(field.excess) * np.float32(field.slab_m)
        self._above = np.zeros_like(self._below)
        self.to_sun = np.zeros_like(self._below)

    def next_slab(self, index: int, slab: Slab) -> Tile:
        """Return the depths at the middle of the next slab down: to sun, zenith and ground."""
        extinction = slab.on_grid(self._field.excess)
        # Whole texels: sums of interpolated values would blur with each slab.
        rows, columns = (round((index + 0.5) * each) for each in self._aside)
        of_way = extinction * np.float32(self._way_m)
        of_slab = extinction * np.float32(self._field.slab_m)
        depths = np.empty((GRID, GRID, 3), np.float32)
        depths[..., 0] = np.roll(self.to_sun, (rows, columns), axis=(0, 1)) + of_way / 2
        depths[..., 1] = self._above + of_slab / 2
        depths[..., 2] = self._below - of_slab / 2
        self.to_sun += np.roll(of_way, (-rows, -columns), axis=(0, 1))
        self._above += of_slab
        self._below -= of_slab
        return Tile(depths)
