"""Points on the true surface: visible ones, by how many views, and the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ShortRepr, TriangleMesh
from oaisys_mapping.evaluation.visibility import (
    PosedCamera,
    raycasting_scene,
    views_seeing,
    within_reach,
)
from oaisys_mapping.mesh import SurfacePoints, sample_surface, triangle_areas_m2
from oaisys_mapping.progress import ProgressCallback, ignore_progress

SPACING_VOXELS = 0.5
"""Spacing of points on the truth, dense enough for any hole to contain some."""

MAX_POINTS = 2_000_000
"""Points on a surface; on larger surfaces their spacing grows."""

MAX_POINTS_OUT_OF_REACH = 200_000
"""Points on the part of the truth that no view can reach."""

ON_EDGE = 1e-4
"""Barycentric coordinate of a corner below which a point lies on the opposite edge."""

OVERLAP_VIEWS = 2
"""Views that must see a point for it to be in the overlap."""


@dataclass(frozen=True, repr=False)
class TrueSurface(ShortRepr):
    """A true mesh prepared by `true_surface` for the evaluation of reconstructions.

    Attributes:
        mesh: The truth.
        scene: `raycasting_scene` of it.
        visible: The (N) points that some view sees.
        times_seen: (N,) how many views see each of them, counted up to `OVERLAP_VIEWS`.
        unseen: Points that no view sees, within reach and out of reach.
    """

    mesh: TriangleMesh
    scene: Any
    visible: SurfacePoints
    times_seen: NDArray[np.uint8]
    unseen: tuple[SurfacePoints, ...]

    @property
    def visible_share(self) -> float:
        """Share of the truth's area that is visible."""
        visible_m2 = _area_m2(self.visible)
        return visible_m2 / (visible_m2 + sum(map(_area_m2, self.unseen)))

    def past_the_rim(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) which of (N, 3) points lie beyond the outer rim of an open truth.

        The rendered ground continues beyond the true mesh and is mapped there. Such points lie
        outside the truth's bounding box as seen from above, and an edge of only one triangle is
        nearest to them.
        """
        low_m, high_m = self.mesh.vertices_m.min(axis=0), self.mesh.vertices_m.max(axis=0)
        past = ((points_m < low_m) | (points_m > high_m))[:, :2].any(axis=1)
        rows = np.flatnonzero(past)
        if not len(rows) or not self._is_open.any():
            return np.zeros(len(points_m), bool)
        query = o3d.core.Tensor(np.ascontiguousarray(points_m[rows], np.float32))
        found = self.scene.compute_closest_points(query)
        s, t = found["primitive_uvs"].numpy().T
        ids = found["primitive_ids"].numpy()
        is_open = self._is_open[ids]
        # The edges from corner 0 to 1, 1 to 2 and 2 to 0, where one coordinate is 0.
        on_edge = np.column_stack((t, 1 - s - t, s)) < ON_EDGE
        # A vertex on the rim also belongs to triangles without an edge on it.
        at_corner = np.column_stack((1 - s - t, s, t)) > 1 - ON_EDGE
        on_rim = self._is_rim[self.mesh.triangles[ids]]
        past[rows] = (on_edge & is_open | at_corner & on_rim).any(axis=1)
        return np.asarray(past)

    @cached_property
    def _is_rim(self) -> NDArray[np.bool_]:
        """(V,) which vertices lie on open edges."""
        triangles = self.mesh.triangles
        is_rim = np.zeros(len(self.mesh.vertices_m), bool)
        for first, second in ((0, 1), (1, 2), (2, 0)):
            is_rim[triangles[self._is_open[:, first]][:, (first, second)]] = True
        return is_rim

    @cached_property
    def _is_open(self) -> NDArray[np.bool_]:
        """(T, 3) which edges belong to one triangle only; none if no vertex is shared."""
        triangles = self.mesh.triangles.astype(np.int64)
        if len(self.mesh.vertices_m) >= 3 * len(triangles):
            return np.zeros((len(triangles), 3), bool)
        ends = np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=-1)
        key = ends.min(axis=-1) * len(self.mesh.vertices_m) + ends.max(axis=-1)
        _, index, count = np.unique(key, return_inverse=True, return_counts=True)
        return np.asarray(count[index].reshape(key.shape) == 1)


def _area_m2(points: SurfacePoints) -> float:
    return len(points.points_m) * points.area_m2


def true_surface(
    truth: TriangleMesh,
    views: Sequence[PosedCamera] | None,
    voxel_size_m: float,
    max_range_m: float,
    rng: np.random.Generator,
    on_progress: ProgressCallback = ignore_progress,
) -> TrueSurface:
    """Sample points on the truth and determine which of them the views see.

    Args:
        truth: The true mesh, its triangles counter-clockwise as seen from outside.
        views: The cameras; None: everything is visible.
        voxel_size_m: Size of a voxel; points are `SPACING_VOXELS` apart.
        max_range_m: Depth beyond which nothing is visible.
        rng: Draws the points.
        on_progress: Called with what is being done.

    Raises:
        InvalidInputError: The truth has no surface, or the views see nothing of it.
    """
    if not len(truth.triangles):
        raise InvalidInputError("truth", "0 triangles", "a mesh with a surface")
    on_progress("points on the truth")
    spacing_m = SPACING_VOXELS * voxel_size_m
    scene = raycasting_scene(truth.vertices_m, truth.triangles)
    if views is None:
        points = _sample(truth, np.arange(len(truth.triangles)), spacing_m, MAX_POINTS, rng)
        times_seen = np.full(len(points.points_m), OVERLAP_VIEWS, np.uint8)
        return TrueSurface(truth, scene, points, times_seen, ())
    is_near = within_reach(truth, views, max_range_m)
    if not is_near.any():
        raise _nothing_seen(views)
    near = _sample(truth, np.flatnonzero(is_near), spacing_m, MAX_POINTS, rng)
    times_seen = views_seeing(near, views, scene, max_range_m, OVERLAP_VIEWS, on_progress)
    seen = times_seen > 0
    if not seen.any():
        raise _nothing_seen(views)
    unseen = [near.only(~seen)]
    far_ids = np.flatnonzero(~is_near)
    if triangle_areas_m2(truth.vertices_m, truth.triangles[far_ids]).sum() > 0:
        unseen.append(_sample(truth, far_ids, spacing_m, MAX_POINTS_OUT_OF_REACH, rng))
    return TrueSurface(truth, scene, near.only(seen), times_seen[seen], tuple(unseen))


def _sample(
    truth: TriangleMesh,
    ids: NDArray[np.intp],
    spacing_m: float,
    max_points: int,
    rng: np.random.Generator,
) -> SurfacePoints:
    """Return points on the triangles ``ids`` of the truth, with triangle ids of the whole truth."""
    points = sample_surface(truth.vertices_m, truth.triangles[ids], spacing_m, max_points, rng)
    return SurfacePoints(points.points_m, points.normals, points.area_m2, ids[points.triangle_ids])


def _nothing_seen(views: Sequence[PosedCamera]) -> InvalidInputError:
    return InvalidInputError("views", f"{len(views)} views", "views that see the truth")
