"""The ground beyond the stage as a ray target, which most rays need not be cast at."""

from __future__ import annotations

from math import tan
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.targets.ray_target import NO_ELEMENT, RayCone, RayTarget
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.types import FloatArray, TriangleMesh

ZONES = 96
"""Number of zones around the stage whose highest points bound how steeply rays may rise."""

INNER_ZONE_M = 1.0
"""Width of the first one."""

ROUNDING = 1e-9
"""Relative error that a computed slope has at most."""

_TARGETS: WeakKeyDictionary[FarGround, TriangleTarget] = WeakKeyDictionary()


def far_triangles(far_ground: FarGround) -> TriangleTarget:
    """Return what rays meet of the ground beyond a stage, but for the level plane; made once."""
    found = _TARGETS.get(far_ground)
    if found is None:
        triangles = far_ground.triangles[: far_ground.cast_triangles]
        vertices_m = far_ground.vertices_m[: triangles.max() + 1].astype(np.float64)
        # Near the stage, where pixels are finest, float32 must be most precise.
        origin_m = _edge_centre_m(far_ground) if far_ground.is_land else None
        found = TriangleTarget([TriangleMesh(vertices_m, triangles)], origin_m=origin_m)
        _TARGETS[far_ground] = found
    return found


def _edge_centre_m(far_ground: FarGround) -> FloatArray:
    x0, y0, x1, y1 = far_ground.stage.extent_m
    return np.array(((x0 + x1) / 2, (y0 + y1) / 2, float(far_ground.vertices_m[0, 2])))


class FarGroundTarget(RayTarget):
    """The ground beyond the stage; only land has heights.

    Attributes:
        far_ground: What it is the target of.
    """

    def __init__(self, far_ground: FarGround) -> None:
        """Build what rays are cast at."""
        self.far_ground = far_ground
        self._triangles = far_triangles(far_ground)
        self._triangles.prepare()
        self.top_m = self._triangles.top_m if far_ground.is_land else -np.inf
        self._level_element = far_ground.cast_triangles
        self._level_m = far_ground.level_m
        x0, y0, x1, y1 = far_ground.stage.extent_m
        self._low_m, self._high_m = np.array((x0, y0)), np.array((x1, y1))
        self._inset_m = (self._high_m - self._low_m) / 2 * (1 - far_ground.inner_share)
        self._zone_offsets_m, self._zone_tops_m = self._zones()

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`; ``directions`` are (R, 3)."""
        found = np.full(len(directions), np.inf)
        elements = np.full(len(directions), NO_ELEMENT, np.int64)
        if limits is not None and self._end_on_stage(origins_m, directions, limits):
            return found, elements
        rays = np.flatnonzero(self._may_meet(origins_m, directions, limits))
        if not len(rays):
            return found, elements
        origins = origins_m if origins_m.ndim == 1 else origins_m[rays]
        found[rays], elements[rays] = self._triangles.intersect(origins, directions[rays])
        if self._level_m is not None:
            level_m = self._to_level(self._level_m, origins, directions[rays])
            elements[rays] = np.where(level_m < found[rays], self._level_element, elements[rays])
            found[rays] = np.minimum(found[rays], level_m)
        return found, elements

    def occludes(
        self, origins_m: FloatArray, directions: FloatArray, cone: RayCone | None = None
    ) -> NDArray[np.bool_]:
        """See `RayTarget`; rays of a cone that are steeper than all of it are not even cast."""
        if not len(directions):
            return np.zeros(0, np.bool_)
        if cone is None:
            return self._occludes_any(origins_m, directions)
        if tan(cone.lowest_rad) > self._steepest(origins_m):
            return np.zeros(len(directions), np.bool_)
        if cone.half_angle_rad:
            return self._occludes_any(origins_m, directions)
        return self._triangles.occludes(origins_m, directions)

    def _occludes_any(self, origins_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Return (R,) whether rays in any directions hit it."""
        found = np.zeros(len(directions), np.bool_)
        rays = np.flatnonzero(self._may_meet(origins_m, directions, None))
        if not len(rays):
            return found
        origins_m, directions = origins_m[rays], directions[rays]
        found[rays] = self._triangles.occludes(origins_m, directions)
        if self._level_m is not None:
            found[rays] |= np.isfinite(self._to_level(self._level_m, origins_m, directions))
        return found

    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        normals = np.tile((0.0, 0.0, 1.0), (len(elements), 1))
        on_triangle = elements != self._level_element
        normals[on_triangle] = self._triangles.normals_of(
            elements[on_triangle], points_m[on_triangle]
        )
        return normals

    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return zeros: it is ground."""
        return np.zeros(elements.shape, np.uint32)

    def _end_on_stage(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> bool:
        """Return whether all rays begin and end within the innermost vertices around the stage."""
        low, high = self._low_m + self._inset_m, self._high_m - self._inset_m
        xy = origins_m[..., :2]
        if not np.isfinite(limits).all() or (xy < low).any() or (xy > high).any():
            return False
        for axis in range(2):
            ends_m = origins_m[..., axis] + directions[:, axis] * limits
            if ends_m.min() <= low[axis] or ends_m.max() >= high[axis]:
                return False
        return True

    def _may_meet(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None
    ) -> NDArray[np.bool_]:
        """Return (R,) which rays may hit it: those that leave the stage before their limit."""
        low, high = self._low_m + self._inset_m, self._high_m - self._inset_m
        xy = origins_m[..., :2]
        if (xy < low).any() or (xy > high).any():
            is_low = origins_m[..., 2] <= self._triangles.top_m
            return np.asarray(is_low | (directions[:, 2] < 0))
        steepest = self._steepest(origins_m)
        x, y, z = directions.T
        most_level = np.hypot(np.abs(x).max(initial=0.0), np.abs(y).max(initial=0.0))
        if z.min(initial=np.inf) > steepest * most_level:
            return np.zeros(len(directions), np.bool_)
        may = np.asarray(z <= steepest * np.hypot(x, y))
        if not may.any():
            return may
        # By component: loops over two values at a time take five times as long.
        leaves = np.full(len(directions), np.inf)
        for axis in range(2):
            along = directions[:, axis]
            with np.errstate(divide="ignore", invalid="ignore"):
                of_axis = (np.where(along > 0, high[axis], low[axis]) - xy[..., axis]) / along
            np.minimum(leaves, of_axis, out=leaves, where=along != 0)
        may &= leaves < (np.inf if limits is None else limits)
        return may

    def _steepest(self, origins_m: FloatArray) -> float:
        """Return a bound of the slopes of rays from points on the stage that meet a triangle."""
        inside_m = np.inf
        for axis in range(2):
            along_m = origins_m[..., axis]
            least_m, most_m = along_m.min() - self._low_m[axis], self._high_m[axis] - along_m.max()
            inside_m = min(inside_m, float(least_m), float(most_m))
        rise_m = self._zone_tops_m - origins_m[..., 2].min()
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = rise_m / (self._zone_offsets_m + inside_m)
        return float(np.where(rise_m > 0, slopes, 0.0).max()) * (1 + ROUNDING)

    def _zones(self) -> tuple[FloatArray, FloatArray]:
        """Return the (Z,) distances from the edge and highest points of zones of triangles."""
        far_ground = self.far_ground
        vertices_m = far_ground.vertices_m.astype(np.float64)
        triangles = far_ground.triangles[: far_ground.cast_triangles]
        xy = vertices_m[:, :2]
        offsets_m = np.maximum(self._low_m - xy, xy - self._high_m).max(axis=1).clip(0.0)
        nearest_m = offsets_m[triangles].min(axis=1)
        tops_m = vertices_m[:, 2][triangles].max(axis=1)
        outermost_m = max(float(nearest_m.max()), 2 * INNER_ZONE_M)
        starts_m = np.concatenate(([0.0], np.geomspace(INNER_ZONE_M, outermost_m, ZONES - 1)))
        zone = np.searchsorted(starts_m, nearest_m, side="right") - 1
        highest_m = np.full(ZONES, -np.inf)
        np.maximum.at(highest_m, zone, tops_m)
        return starts_m, highest_m

    def _to_level(
        self, level_m: float, origins_m: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Return (R,) distances to the level plane outside the stage, ``+inf`` for a miss."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t = (level_m - origins_m[..., 2]) / directions[:, 2]
            xy = origins_m[..., :2] + t[:, None] * directions[:, :2]
        outside = ((xy < self._low_m) | (xy > self._high_m)).any(axis=1)
        return np.where((t > 0) & np.isfinite(t) & outside, t, np.inf)
