"""What rays can hit: the interface of every part of a scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import asin
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray

NO_ELEMENT = -1
"""Element of a ray that hits nothing."""


class RayCone(NamedTuple):
    """Bounds of the directions of rays.

    Attributes:
        axis: (x, y, z) unit vector in ``map``.
        half_angle_rad: The most that a ray deviates from it; 0: all are parallel.
    """

    axis: tuple[float, float, float]
    half_angle_rad: float = 0.0

    @property
    def elevation_rad(self) -> float:
        """Angle of the axis above the horizontal."""
        return asin(min(max(self.axis[2], -1.0), 1.0))

    @property
    def lowest_rad(self) -> float:
        """Angle of the lowest rays above the horizontal."""
        return self.elevation_rad - self.half_angle_rad


class RayTarget(ABC):
    """A part of a scene that rays can hit.

    Its elements, numbered from 0, are its triangles, or the whole of an exact solid.

    Attributes:
        top_m: Height that no point of it exceeds; ``-inf``: it is empty.
        has_images: Whether any element has an image of its own.
    """

    top_m: float
    has_images: bool = False

    def visible_pixels(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """Return (H, W) which pixels' rays may hit it; None: all."""
        return None

    @abstractmethod
    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the distance and the element of each ray's first hit.

        Args:
            origins_m: (..., 3) in ``map``, or (3,) for all rays.
            directions: (..., 3) of any length.
            limits: (...) distances; hits beyond them may be left out.

        Returns:
            (...) float64 distances in units of the directions' lengths, ``+inf`` for a miss, and
            (...) int64 elements, `NO_ELEMENT` for a miss.
        """

    @abstractmethod
    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the instance id of each element, 0 for `NO_ELEMENT`."""

    @abstractmethod
    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) elements at (N, 3) points on them.

        Those of triangles without area are 0.
        """

    def albedo_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) linear albedo of (N,) elements at (N, 3) points on them.

        NaN where an element has no image of its own.
        """
        return np.full(points_m.shape, np.nan)

    def triangles_of(self, elements: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the index of each element among the triangles of its object's own mesh."""
        return elements

    def occludes(
        self, origins_m: FloatArray, directions: FloatArray, cone: RayCone | None = None
    ) -> NDArray[np.bool_]:
        """Return (R,) whether (R, 3) rays from (R, 3) origins hit it anywhere.

        With a ``cone`` of all the rays, which begin above the ground, fewer may be cast.
        """
        return np.isfinite(self.intersect(origins_m, directions)[0])

    def surface_height_m(self, xy_m: ArrayLike) -> FloatArray:
        """Return the (N,) topmost heights at (N, 2) points, NaN where there is nothing."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        above_m = self.top_m + 1.0
        if not np.isfinite(above_m):
            return np.full(len(xy), np.nan)
        origins = np.column_stack((xy, np.full(len(xy), above_m)))
        down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
        distance_m, _ = self.intersect(origins, down)
        return np.where(np.isfinite(distance_m), above_m - distance_m, np.nan)
