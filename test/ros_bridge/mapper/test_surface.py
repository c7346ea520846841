"""Surfaces made small enough for a message."""

import numpy as np

from oaisys_mapping.mesh import ColoredMesh
from oaisys_ros_bridge.mapper.mesh_topics import at_most, cluster_vertices


def grid_mesh(cells: int, edge_m: float) -> ColoredMesh:
    """Return a flat square of 2 * cells**2 triangles at z = 3, coloured by its x."""
    x, y = np.meshgrid(np.arange(cells + 1), np.arange(cells + 1))
    vertices_m = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size))).astype(np.float64)
    vertices_m *= edge_m / cells
    vertices_m[:, 2] = 3.0
    colors = np.repeat((vertices_m[:, :1] / edge_m * 200).astype(np.uint8), 3, axis=1)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.column_stack((a, a + 1, a + cells + 2))
    upper = np.column_stack((a, a + cells + 2, a + cells + 1))
    return ColoredMesh(vertices_m, np.vstack((lower, upper)).astype(np.int32), colors)


def area_m2(mesh: ColoredMesh) -> float:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_clustering_keeps_a_plane_a_plane_of_nearly_its_size():
    mesh = grid_mesh(100, 10.0)

    small = cluster_vertices(mesh, 0.5)

    # 21 cells along an edge, as the last grid points begin one of their own: 20**2 squares.
    assert len(small.triangles) == 2 * 20**2
    np.testing.assert_allclose(small.vertices_m[:, 2], 3.0, atol=1e-9)
    assert 0.9 * 100.0 < area_m2(small) <= 100.0
    expected = small.vertices_m[:, 0] / 10.0 * 200
    assert np.abs(small.colors_rgb[:, 0] - expected).max() <= 2


def test_a_mesh_is_clustered_only_if_it_is_too_large():
    mesh = grid_mesh(50, 5.0)

    assert at_most(mesh, 5000, 0.2) is mesh
    assert 0 < len(at_most(mesh, 1000, 0.2).triangles) <= 1000
    assert 0 < len(at_most(mesh, 20, 0.2).triangles) <= 20
