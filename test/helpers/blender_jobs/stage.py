"""What the tests of stages do inside Blender."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from oaisys_core import geometry
from oaisys_core.config import config_from_mapping
from oaisys_core.procedural.terrain.detail import DetailedGround
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata


def refined_views(stage: dict[str, Any], places: list[tuple[float, float]]) -> dict[str, Any]:
    """Render from above each place, in turn; return depths, colours, poses, heights and meshes."""
    camera = {"name": "front", "width_px": 64, "height_px": 48, "modalities": ["rgb", "depth"]}
    world = Simulation(
        config_from_mapping(
            {
                "stage": stage,
                "assets": {"rocks": []},
                "materials": {
                    "texture_size_px": 64,
                    "layers": [{"texture": "sand", "label": "sand", "semantic_id": 1}],
                },
                "sensors": {"cameras": [camera]},
                "render": {"quality": "preview"},
            }
        )
    )
    world.step_batch()
    found: dict[str, Any] = {"depth": [], "rgb": [], "surface": [], "ground": []}
    for x, y in places:
        z = float(world.query_height([(x, y, 0.0)]).ground_height_m[0]) + 3.0
        pose = geometry.pose_looking_down(x, y, z)
        frames = world.step_sample(ModuleMetadata(sensor={"pose": pose})).frames
        colour, depth = (frame.data for frame in frames)
        k, T = frames[1].intrinsics, frames[1].T_map_camera
        v, u = np.mgrid[: k.height_px, : k.width_px]
        rays = np.stack(
            ((u - k.cx_px) / k.fx_px, (v - k.cy_px) / k.fy_px, np.ones(u.shape)), axis=-1
        )
        points = (rays * depth[..., None] @ T[:3, :3].T + T[:3, 3]).reshape(-1, 3)
        found["depth"].append(depth)
        found["rgb"].append(colour)
        found["surface"].append(points)
        found["ground"].append(world.query_height(points).ground_height_m)
    mesh = world.ground_truth_mesh()
    found["mesh"] = (len(mesh.vertices_m), len(mesh.triangles))
    ground = world.scene.ground
    found["scene"] = (len(ground.vertices_m()), len(ground.triangles()))
    shown = bpy.data.objects["ground"].data
    corners = np.empty(len(shown.loops) * 3, np.float32)
    shown.corner_normals.foreach_get("vector", corners)
    found["corner_normals"] = corners.reshape(-1, 3)
    normals = ground.shading_normals() if isinstance(ground, DetailedGround) else None
    if normals is not None:
        found["normals"] = normals[ground.triangles().ravel()]
    return found
