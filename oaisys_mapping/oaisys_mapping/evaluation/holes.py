"""Holes: places where a view saw the truth but the reconstruction has no surface.

A gap is where a line along the truth's normal meets no surface. This gives a hole's exact border; a
distance threshold would shrink it by the threshold. A gap counts as a hole if any of its truth is
further than `FAR_VOXELS` from the whole reconstruction. Truth that far always counts as a hole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from oaisys_core.types import FloatArray
from oaisys_mapping.mesh import SurfacePoints

HOLE_VOXELS = 2
"""Distance along the truth's normal within which a surface closes a hole; also the width of the rim
of the surveyed area, where holes do not count."""

FAR_VOXELS = 1
"""Truth further than this from the whole reconstruction lies in a hole."""


@dataclass(frozen=True)
class Holes:
    """Holes in a part of the visible truth.

    Attributes:
        count: Number of connected holes.
        area_m2, largest_m2: Area of the truth in all of them, and in the largest.
        ratio: Their area as a share of the part's area.
    """

    count: int
    area_m2: float
    largest_m2: float
    ratio: float


def gaps(points: SurfacePoints, mesh_scene: Any, voxel_size_m: float) -> NDArray[np.bool_]:
    """Return (N,) which points have no surface within `HOLE_VOXELS` along the normal, both ways.

    Args:
        points: Points on the truth.
        mesh_scene: `raycasting_scene` of the reconstruction.
        voxel_size_m: Size of a voxel.
    """
    reach_m = HOLE_VOXELS * voxel_size_m
    normals = points.normals
    rays = np.column_stack((points.points_m - reach_m * normals, 2 * reach_m * normals))
    # The rays are as long as the line, so hits on it are at or before 1.
    met = mesh_scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
    return np.asarray(met > 1)


def find_holes(
    points: SurfacePoints,
    is_gap: NDArray[np.bool_],
    to_mesh_m: FloatArray,
    voxel_size_m: float,
) -> Holes:
    """Group gaps, and points further than `FAR_VOXELS` away, into holes.

    Args:
        points: The (N) points of the part.
        is_gap: (N,) from `gaps`.
        to_mesh_m: (N,) distances to the reconstruction.
        voxel_size_m: Size of a voxel.
    """
    is_far = to_mesh_m > FAR_VOXELS * voxel_size_m
    chosen = np.flatnonzero(is_gap | is_far)
    if not len(chosen):
        return Holes(0, 0.0, 0.0, 0.0)
    group = _groups(points.points_m[chosen], 2 * float(np.sqrt(points.area_m2)))
    is_hole = np.zeros(group.max() + 1, bool)
    is_hole[group[is_far[chosen]]] = True
    areas_m2 = np.bincount(group)[is_hole] * points.area_m2
    area_m2 = float(areas_m2.sum())
    whole_m2 = len(points.points_m) * points.area_m2
    return Holes(len(areas_m2), area_m2, float(areas_m2.max(initial=0.0)), area_m2 / whole_m2)


def _groups(points_m: FloatArray, cell_m: float) -> NDArray[np.intp]:
    """Return the (N,) index of each point's connected group.

    Points in the same or in neighbouring cells are connected.
    """
    cells, index = np.unique(np.floor(points_m / cell_m), axis=0, return_inverse=True)
    # Diagonal neighbours are the square root of 3 apart.
    pairs = cKDTree(cells).query_pairs(1.8, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    _, group = connected_components(graph, directed=False)
    return np.asarray(group[index.ravel()], np.intp)


def inside_the_rim(visible: SurfacePoints, voxel_size_m: float) -> NDArray[np.bool_]:
    """Return (N,) which points lie further than `HOLE_VOXELS` inside the surveyed area.

    The area consists of the square cells that contain visible points as seen from above. Gaps
    inside it, as behind a rock, have no rim. If the whole area is rim, all points count as inside.
    """
    cell_m = max(voxel_size_m, 2 * float(np.sqrt(visible.area_m2)))
    rim = int(np.ceil(HOLE_VOXELS * voxel_size_m / cell_m))
    xy_m = visible.points_m[:, :2]
    cells = np.floor((xy_m - xy_m.min(axis=0)) / cell_m).astype(np.intp) + rim + 1
    seen = np.zeros(cells.max(axis=0) + rim + 2, bool)
    seen[tuple(cells.T)] = True
    area = ndimage.binary_fill_holes(ndimage.binary_closing(seen, np.ones((3, 3))))
    inside = ndimage.binary_erosion(area, np.ones((3, 3)), iterations=rim)[tuple(cells.T)]
    return np.asarray(inside if inside.any() else np.ones_like(inside))
