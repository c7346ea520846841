"""Where a reconstruction has no surface although some view saw the truth there.

A line along the truth's normal finds the border of a hole where it is; distances alone would
shrink a hole by their tolerance all around. A gap is a hole if any of its truth is further than
`FAR_VOXELS` from all of the reconstruction; what is that far is a hole, whatever the line meets.
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
"""How far from the truth, along its normal, a surface may lie and still close a hole; and the width
of the surveyed area's rim, where a missing surface is none."""

FAR_VOXELS = 1
"""Truth that is further than this from all of the reconstruction lies in a hole."""


@dataclass(frozen=True)
class Holes:
    """Holes in some part of the visible truth.

    Attributes:
        count: Connected gaps in which some truth is further than `FAR_VOXELS` from the
            reconstruction.
        area_m2, largest_m2: Of the truth in all of them, and in the largest.
        ratio: That area as a share of the part.
    """

    count: int
    area_m2: float
    largest_m2: float
    ratio: float


def gaps(points: SurfacePoints, mesh_scene: Any, voxel_size_m: float) -> NDArray[np.bool_]:
    """Return (N,) at which points nothing lies within `HOLE_VOXELS` along the normal, both ways.

    Args:
        points: On the truth.
        mesh_scene: The reconstruction, as `raycasting_scene` makes it.
        voxel_size_m: Size of a voxel.
    """
    reach_m = HOLE_VOXELS * voxel_size_m
    normals = points.normals
    rays = np.column_stack((points.points_m - reach_m * normals, 2 * reach_m * normals))
    # The rays are as long as the line, so what lies on it is met before 1.
    met = mesh_scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
    return np.asarray(met > 1)


def find_holes(
    points: SurfacePoints,
    is_gap: NDArray[np.bool_],
    to_mesh_m: FloatArray,
    voxel_size_m: float,
) -> Holes:
    """Join gaps, and what is further than `FAR_VOXELS` away, to holes.

    Args:
        points: All (N) points of the part.
        is_gap: (N,) of `gaps`.
        to_mesh_m: (N,) distance to the reconstruction.
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
    """Return (N,) the number of the connected group of each point.

    Points are connected that fall into the same or neighbouring cells.
    """
    cells, index = np.unique(np.floor(points_m / cell_m), axis=0, return_inverse=True)
    # Neighbours over a cell's corner are the square root of 3 apart.
    pairs = cKDTree(cells).query_pairs(1.8, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    _, group = connected_components(graph, directed=False)
    return np.asarray(group[index.ravel()], np.intp)


def off_the_rim(visible: SurfacePoints, voxel_size_m: float) -> NDArray[np.bool_]:
    """Return (N,) which points lie further than `HOLE_VOXELS` inside the surveyed area.

    The area is made of square cells with visible points in them, from above; gaps inside it (the
    blind side of a rock) do not make a rim. Where it is all rim, all of it counts.
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
