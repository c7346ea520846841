"""Rovers and landers, and how they stand."""

import numpy as np
import pytest

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.placement.ground_pose import footprint_of, pose_on_ground
from oaisys_core.procedural.scatter.vehicles import VEHICLES, WHEEL_X, WHEEL_Y
from oaisys_core.procedural.terrain.presets import make_ground


def test_a_bevelled_box_is_closed_and_lacks_its_edges() -> None:
    parts = MeshBuilder()
    parts.box((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (1, 1, 1), None, 0.1)
    mesh = parts.mesh("box")
    a, b, c = (mesh.vertices_m[mesh.triangles[:, i]].astype(float) for i in range(3))
    assert np.ptp(mesh.vertices_m, axis=0) == pytest.approx((1.0, 2.0, 3.0))
    # A prism of each edge's length between bevels, and the corners.
    edges = 4 * sum(0.1**2 / 2 * (length - 0.2) for length in (1, 2, 3))
    corners = 8 * (0.1**3 - 0.1**3 / 6)
    volume = (a * np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(6 - edges - corners, rel=1e-3)
    normals = np.cross(b - a, c - a)
    assert np.allclose(normals.sum(axis=0), 0, atol=1e-6), "closed"
    assert ((a - (1, 2, 3)) * normals).sum(axis=1).min() > 0, "seen from outside"


def test_a_rover_on_uneven_ground_touches_it_with_most_wheels() -> None:
    ground = make_ground("mounds", 40.0, 257, np.random.default_rng(0))
    foot_m = footprint_of(VEHICLES["rover"]()).foot_m
    rng = np.random.default_rng(1)
    wheels = np.array([(x, side * WHEEL_Y, 0.0) for x in WHEEL_X for side in (-1, 1)])
    gaps = []
    for x, y, yaw_rad in rng.uniform((-15, -15, -3), (15, 15, 3), (60, 3)):
        T = pose_on_ground(ground, (x, y), yaw_rad, foot_m)
        points = wheels @ T[:3, :3].T + T[:3, 3]
        gaps.append(points[:, 2] - ground.height_at(points[:, :2]))
    gaps_m = np.array(gaps)
    assert (gaps_m < 0.02).mean() > 0.7
    assert np.quantile(gaps_m, 0.03) > -0.2
