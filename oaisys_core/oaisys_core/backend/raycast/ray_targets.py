"""What rays can hit: triangle meshes, instances and exact solids behind one interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.instances import InstanceCaster
from oaisys_core.backend.raycast.solids import Solid
from oaisys_core.backend.raycast.triangles import NO_TRIANGLE, Caster
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray

NO_ELEMENT = NO_TRIANGLE
"""Element of a ray that hits nothing."""

MAX_VISIBLE_SHARE = 0.7
"""If a target is visible in a larger share of the pixels, all rays are cast at it."""


class RayTarget(ABC):
    """A part of a scene; its elements, numbered from 0, are its triangles, or the whole solid."""

    def visible_pixels(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """Return (H, W) which pixels' rays may hit it; None: all."""
        return None

    @abstractmethod
    def nearest(
        self, origin_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return (...) distances along (..., 3) rays, ``+inf`` for a miss, and (...) elements.

        Hits beyond (...) ``limits`` may be left out.
        """

    @abstractmethod
    def instance_ids(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the (N,) uint32 instance ids of (N,) elements."""

    @abstractmethod
    def normals(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) elements at (N, 3) points on them."""

    @abstractmethod
    def height_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the (N,) topmost heights at (N, 2) points, NaN where there is nothing."""


class TriangleCaster(Caster, Protocol):
    """The common interface of `RayCaster` and `InstanceCaster`."""

    def instance_ids_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayCaster.instance_ids_of`."""

    def normals_of(self, triangle_ids: NDArray[np.int64]) -> FloatArray:
        """See `RayCaster.normals_of`."""

    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `RayCaster.surface_height_m`."""


class TriangleTarget(RayTarget):
    """Triangles that a caster holds."""

    def __init__(self, caster: TriangleCaster) -> None:
        self._caster = caster

    def nearest(
        self, origin_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`."""
        return self._caster.intersect(origin_m, directions)

    def instance_ids(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayTarget`."""
        return self._caster.instance_ids_of(elements)

    def normals(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        return self._caster.normals_of(elements)

    def height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        return self._caster.surface_height_m(xy_m)


class InstanceTarget(TriangleTarget):
    """Instances; only rays that may hit one are cast, and only as far as their limits."""

    def __init__(self, caster: InstanceCaster) -> None:
        super().__init__(caster)
        self._instances = caster

    def visible_pixels(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """See `RayTarget`."""
        if any(camera.intrinsics.distortion):
            return None
        found = self._instances.visible_pixels(camera)
        if found is None or np.count_nonzero(found) > MAX_VISIBLE_SHARE * found.size:
            return None
        return found

    def nearest(
        self, origin_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`."""
        return self._instances.intersect(origin_m, directions, limits)


class SolidTarget(RayTarget):
    """One exact solid."""

    def __init__(self, solid: Solid, instance_id: int, top_m: float) -> None:
        """Take a solid whose highest point is at most at ``top_m``."""
        self._solid = solid
        self._instance_id = instance_id
        self._top_m = top_m

    def nearest(
        self, origin_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`."""
        distances = self._solid.intersect(origin_m, directions)
        return distances, np.where(np.isfinite(distances), 0, NO_ELEMENT)

    def instance_ids(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayTarget`."""
        return np.full(elements.shape, self._instance_id, np.uint32)

    def normals(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        return self._solid.normals_at(points_m)

    def height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        above_m = self._top_m + 1.0
        origins = np.column_stack((xy_m, np.full(len(xy_m), above_m)))
        down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
        distances = self._solid.intersect(origins, down)
        return np.where(np.isfinite(distances), above_m - distances, np.nan)
