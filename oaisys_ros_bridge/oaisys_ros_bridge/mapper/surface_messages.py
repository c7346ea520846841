"""Surfaces made small enough for a message."""

from __future__ import annotations

import numpy as np

from oaisys_mapping.mesh import ColoredMesh


def clustered(mesh: ColoredMesh, cell_m: float) -> ColoredMesh:
    """Return the mesh with one vertex per cell of a grid: the mean of those that were in it.

    Vertex clustering as in Rossignac and Borrel, "Multi-resolution 3D approximations for rendering
    complex scenes", 1993; triangles that fall into fewer than three cells go.
    """
    cells = np.floor(mesh.vertices_m / cell_m).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    x, y, z = cells.T
    _, height, depth = (cells.max(axis=0, initial=0) + 1).tolist()
    _, cluster = np.unique((x * height + y) * depth + z, return_inverse=True)
    cluster = cluster.ravel()
    count = np.bincount(cluster)[:, None]
    vertices_m = np.column_stack([np.bincount(cluster, v) for v in mesh.vertices_m.T]) / count
    colors = np.column_stack([np.bincount(cluster, c) for c in mesh.colors_rgb.T]) / count
    triangles = cluster[mesh.triangles]
    a, b, c = triangles.T
    kept = (a != b) & (b != c) & (c != a)
    return ColoredMesh(
        vertices_m, triangles[kept].astype(np.int32), np.rint(colors).astype(np.uint8)
    )


def at_most(mesh: ColoredMesh, triangles: int, cell_m: float) -> ColoredMesh:
    """Return the mesh, clustered if it has more than ``triangles`` triangles.

    Cells begin at ``cell_m`` and grow by half until the mesh is small enough.
    """
    small = mesh
    while len(small.triangles) > triangles:
        small = clustered(mesh, cell_m)
        cell_m *= 1.5
    return small
