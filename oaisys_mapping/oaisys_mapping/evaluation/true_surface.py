"""The true surface as points: what the poses could see of it, how often, and the rest."""

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
"""Edge of the square of truth that a point stands for: so dense that no hole falls between."""

MOST_POINTS = 2_000_000
"""Points spread over a surface; where it is larger, each stands for more of it."""

MOST_POINTS_BEYOND = 200_000
"""Points spread over the part of the truth that no view can reach."""

ON_EDGE = 1e-4
"""Weight of a triangle's corner below which a place lies on the edge that is opposite."""

OVERLAP = 2
"""Views that must see a place for it to be in the overlap area."""


@dataclass(frozen=True, repr=False)
class TrueSurface(ShortRepr):
    """A true mesh made ready to measure reconstructions against; made by `true_surface`.

    Attributes:
        mesh: The truth.
        scene: `raycasting_scene` of it.
        visible: Points that some view sees.
        times_seen: (N,) by how many views each of them is seen, counted up to `OVERLAP`.
        unseen: Points that no view sees: near what they see, and far from it.
        visible_share: Visible part of all of the truth's area.
    """

    mesh: TriangleMesh
    scene: Any
    visible: SurfacePoints
    times_seen: NDArray[np.uint8]
    unseen: tuple[SurfacePoints, ...]

    @property
    def visible_share(self) -> float:
        """Visible part of all of the truth's area."""
        visible_m2 = _area_m2(self.visible)
        return visible_m2 / (visible_m2 + sum(map(_area_m2, self.unseen)))

    def past_the_rim(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) which points lie beyond the outer rim of an open truth.

        The ground goes on beyond the stage, and is mapped there, but the true mesh ends: nothing
        is known of it. Those are points outside of the truth as seen from above whose nearest
        place on it is an edge of only one triangle.
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
        # The edges from corner 0 to 1, 1 to 2 and 2 to 0, where one weight is none.
        on_edge = np.column_stack((t, 1 - s - t, s)) < ON_EDGE
        # A corner of the rim belongs to triangles, too, of which no edge is part of it.
        at_corner = np.column_stack((1 - s - t, s, t)) > 1 - ON_EDGE
        on_rim = self._is_rim[self.mesh.triangles[ids]]
        past[rows] = (on_edge & is_open | at_corner & on_rim).any(axis=1)
        return np.asarray(past)

    @cached_property
    def _is_rim(self) -> NDArray[np.bool_]:
        """(V,) which vertices are ends of open edges."""
        triangles = self.mesh.triangles
        is_rim = np.zeros(len(self.mesh.vertices_m), bool)
        for first, second in ((0, 1), (1, 2), (2, 0)):
            is_rim[triangles[self._is_open[:, first]][:, (first, second)]] = True
        return is_rim

    @cached_property
    def _is_open(self) -> NDArray[np.bool_]:
        """(T, 3) which edges of triangles belong to no other; none where no vertex is shared."""
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
    """Spread points over the truth and decide which of them the views see.

    Args:
        truth: Its triangles wound counter-clockwise from outside.
        views: The cameras; None: everything is visible, from everywhere.
        voxel_size_m: A point stands for the square of `SPACING_VOXELS` of them.
        max_range_m: Depth beyond which nothing is seen.
        rng: Gives the points.
        on_progress: Told what is being done.

    Raises:
        InvalidInputError: The truth has no surface, or the views see nothing of it.
    """
    if not len(truth.triangles):
        raise InvalidInputError("truth", "0 triangles", "a mesh with a surface")
    on_progress("points on the truth")
    spacing_m = SPACING_VOXELS * voxel_size_m
    scene = raycasting_scene(truth.vertices_m, truth.triangles)
    if views is None:
        points = _spread(truth, np.arange(len(truth.triangles)), spacing_m, MOST_POINTS, rng)
        often = np.full(len(points.points_m), OVERLAP, np.uint8)
        return TrueSurface(truth, scene, points, often, ())
    is_near = within_reach(truth, views, max_range_m)
    if not is_near.any():
        raise _nothing_seen(views)
    near = _spread(truth, np.flatnonzero(is_near), spacing_m, MOST_POINTS, rng)
    times_seen = views_seeing(near, views, scene, max_range_m, OVERLAP, on_progress)
    seen = times_seen > 0
    if not seen.any():
        raise _nothing_seen(views)
    unseen = [near.only(~seen)]
    far_ids = np.flatnonzero(~is_near)
    if triangle_areas_m2(truth.vertices_m, truth.triangles[far_ids]).sum() > 0:
        unseen.append(_spread(truth, far_ids, spacing_m, MOST_POINTS_BEYOND, rng))
    return TrueSurface(truth, scene, near.only(seen), times_seen[seen], tuple(unseen))


def _spread(
    truth: TriangleMesh,
    ids: NDArray[np.intp],
    spacing_m: float,
    most: int,
    rng: np.random.Generator,
) -> SurfacePoints:
    """Return points on the triangles ``ids`` of the truth, which they know by those ids."""
    points = sample_surface(truth.vertices_m, truth.triangles[ids], spacing_m, most, rng)
    return SurfacePoints(points.points_m, points.normals, points.area_m2, ids[points.triangle_ids])


def _nothing_seen(views: Sequence[PosedCamera]) -> InvalidInputError:
    return InvalidInputError("views", f"{len(views)} views", "views that see the truth")
