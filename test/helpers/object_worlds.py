"""A world of three convex objects: a sphere, a box and a mesh.

A test knows their shapes and poses by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

BOX_M, BOX_POSITION_M, BOX_QUAT = (1.2, 0.8, 0.6), (1.5, 0.4, 1.0), (0.0, 0.1, 0.38, 0.92)
SPHERE_RADIUS_M, SPHERE_POSITION_M = 0.7, (-0.6, -0.3, 1.1)
WEDGE_POSITION_M, WEDGE_QUAT, WEDGE_SCALE = (-0.2, 1.6, 0.0), (0.0, 0.0, 0.6, 0.8), 1.5


def wedge() -> trimesh.Trimesh:
    """Return a mesh without symmetry: half of a box, cut from edge to edge."""
    points = [(0, 0, 0), (1, 0, 0), (0, 0.7, 0), (0, 0, 0.9), (1, 0, 0.3), (0, 0.7, 0.9)]
    return trimesh.convex.convex_hull(np.array(points, np.float64))


def object_config(folder: Path, sensors: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Write the mesh into a folder, and return the configuration of the world."""
    wedge().export(folder / "wedge.ply")
    camera = {
        "name": "camera",
        "width_px": 64,
        "height_px": 48,
        "fx_px": 52.0,
        "fy_px": 50.0,
        "modalities": ["rgb", "depth", "semantic_0", "instance"],
    }
    labels = {"sphere": ("ball", 20), "box": ("crate", 21)}
    sphere, box = (
        {"shape": shape, "label": label, "semantic_id": number}
        for shape, (label, number) in labels.items()
    )
    return {
        "backend": "analytic",
        "stage": {"preset": "plane", "extent_m": 30.0, "resolution_px": 33},
        "materials": {"texture_size_px": 64, "mask": {"size_px": 32, "relief": 0}},
        "environment": {"ground_beyond": False},
        "assets": {
            "rocks": [],
            "primitives": [
                {**sphere, "radius_m": SPHERE_RADIUS_M, "position_m": SPHERE_POSITION_M},
                {**box, "size_m": BOX_M, "position_m": BOX_POSITION_M, "quat_xyzw": BOX_QUAT},
            ],
            "objects": [
                {
                    "name": "the_wedge",
                    "file": str(folder / "wedge.ply"),
                    "label": "wedge",
                    "semantic_id": 22,
                    "position_m": WEDGE_POSITION_M,
                    "quat_xyzw": WEDGE_QUAT,
                    "scale": WEDGE_SCALE,
                }
            ],
        },
        "sensors": {
            **(sensors or {"cameras": [camera]}),
            "motion": {
                "kind": "around_target",
                "target_m": [0.3, 0.4, 0.6],
                "target_noise_m": 1.0,
                "distance_m": [3.0, 6.0],
                "elevation_deg": [10.0, 50.0],
                "roll_deg": [-20.0, 20.0],
            },
        },
    }


def true_meshes() -> dict[str, trimesh.Trimesh]:
    """Return the objects' surfaces in ``map`` by label."""
    ball = trimesh.creation.icosphere(5, SPHERE_RADIUS_M)
    ball.apply_translation(SPHERE_POSITION_M)
    crate = trimesh.creation.box(BOX_M)
    crate.apply_transform(pose_matrix(BOX_POSITION_M, BOX_QUAT))
    body = wedge()
    low, high = body.bounds
    body.apply_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    body.apply_scale(WEDGE_SCALE)
    body.apply_transform(pose_matrix(WEDGE_POSITION_M, WEDGE_QUAT))
    return {"ball": ball, "crate": crate, "wedge": body}


def pose_matrix(position_m: Any, quat_xyzw: Any) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a pose."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    T[:3, 3] = position_m
    return T
