"""What plants look like in Blender."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import SUNNY, camera, flat_world

from oaisys_core.color import linear
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.scene import MeshPrototype, PlacedCamera, Placement, Scene
from oaisys_core.types import ALBEDO, FloatArray, PinholeIntrinsics

pytestmark = pytest.mark.blender

VIEW = PinholeIntrinsics(48, 48, 1000.0, 1000.0, 23.5, 23.5)
ROW_M = 0.24
LIT = replace(SUNNY, sun_elevation_rad=1.4)


def rows() -> MeshPrototype:
    """Return a black square of four rows of needles, 2 mm wide and 4 mm apart, 1 m above ground."""
    parts = MeshBuilder()
    for left_m in np.arange(-2, 2) * ROW_M:
        x, y = left_m + np.array((0, 1, 1, 0)) * ROW_M, np.array((-1, -1, 1, 1)) * 2 * ROW_M
        corners = np.column_stack((x, y, np.ones(4)))
        numbers = (x - left_m) / 0.004
        faces = ((0, 1, 2), (0, 2, 3))
        parts.add(corners, faces, (0.02, 0.02, 0.02), translucency=0.2, needles=numbers)
    return parts.mesh("rows")


def trunk() -> MeshPrototype:
    """Return a trunk, 0.6 m thick, with a leaf far above."""
    parts = MeshBuilder()
    parts.rod((0, 0, 0), (0, 0, 3), 0.3, (0.3, 0.23, 0.18), sides=24)
    leaf = ((0, 0, 4), (0.1, 0, 4), (0, 0.1, 4))
    parts.add(leaf, ((0, 1, 2),), (0.2, 0.3, 0.1), translucency=0.4)
    return parts.mesh("trunk")


@cache
def albedos() -> dict[str, FloatArray]:
    views = {
        "near": (rows(), pose_looking_down(0.0, 0.0, 2.0)),
        "far": (rows(), pose_looking_down(0.0, 0.0, 15.0)),
        "trunk": (trunk(), pose_looking_at((0.0, -6.0, 1.5), (0.0, 0.0, 1.5))),
        "ground": (trunk(), pose_looking_down(9.0, 9.0, 2.0)),
    }
    jobs: list[tuple[Scene, PlacedCamera]] = []
    for shape, pose in views.values():
        T, ids = np.eye(4)[None], np.array([1], np.uint32)
        scene = replace(flat_world(), primitives=(), sky=LIT, prototypes=(shape,))
        scene = replace(scene, placements=(Placement(0, (10,), T, ids),))
        jobs.append((scene, camera(pose, VIEW, (ALBEDO,))))
    frames = in_blender("materials.views", jobs)
    light = (linear(of_view[0].data / 255) for of_view in frames)
    return dict(zip(views, light, strict=True))


def test_one_sees_through_the_gaps_between_needles_near_the_camera_only() -> None:
    near, far, ground = (float(albedos()[name].mean()) for name in ("near", "far", "ground"))
    assert near == pytest.approx((far + ground) / 2, rel=0.2)
    assert far < 0.2 * ground


def test_bark_has_plates_and_furrows() -> None:
    grey = albedos()["trunk"].mean(axis=-1)
    middle = grey[:, 16:32]
    assert middle.std() > 0.12 * middle.mean()
