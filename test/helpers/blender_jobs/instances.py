"""Casts rays at instances in a process that has Blender's Embree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import bpy  # noqa: F401
import numpy as np
from numpy.typing import NDArray

from oaisys_core.private.embree import blenders_embree
from oaisys_core.raycast.embree_instances import EmbreeInstanceTarget
from oaisys_core.raycast.prototype_meshes import PlacedPrototype, PrototypeMesh
from oaisys_core.raycast.targets.ray_target import RayTarget
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.types import FloatArray, TriangleMesh

Rays = tuple[FloatArray, FloatArray, FloatArray | None]


def casts(
    placed: Sequence[PlacedPrototype], views: Sequence[Rays], xy_m: FloatArray
) -> dict[str, Any]:
    """Return what rays find by Embree's own instances, and heights.

    Args:
        placed: The instances.
        views: Origins, directions and limits of `RayTarget.intersect`.
        xy_m: (N, 2) where heights are asked for.
    """
    embree = blenders_embree()
    assert embree is not None
    target = EmbreeInstanceTarget(placed, embree)
    found = [target.intersect(*view) for view in views]
    return {
        "found": found,
        "again": [target.intersect(*view) for view in views],
        "ids": [target.instance_ids_of(triangles) for _, triangles in found],
        "normals": [
            _normals(target, *view[:2], *hits) for view, hits in zip(views, found, strict=True)
        ],
        "heights_m": target.surface_height_m(xy_m),
    }


def mesh_casts(mesh: TriangleMesh, views: Sequence[Rays]) -> list[Any]:
    """Return what rays find of a mesh by Blender's Embree."""
    embree = blenders_embree()
    if embree is None:
        raise AssertionError("Blender came without its Embree")
    target = TriangleTarget([mesh], embree.mesh)
    target.prepare()
    return [target.intersect(origins_m, directions) for origins_m, directions, _ in views]


def resident_mb(placed: Sequence[PlacedPrototype], times: int) -> list[float]:
    """Return the memory in use after each of some structures was made and dropped."""
    embree = blenders_embree()
    assert embree is not None
    found = []
    for _ in range(times):
        anew = [replace(each, mesh=PrototypeMesh(each.mesh.prototype)) for each in placed]
        EmbreeInstanceTarget(anew, embree)
        del anew
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        found.append(int(pages) * 4096 / 1e6)
    return found


def _normals(
    target: RayTarget,
    origins_m: FloatArray,
    directions: FloatArray,
    depth_m: FloatArray,
    triangles: NDArray[np.int64],
) -> FloatArray:
    """Return the normals where rays hit."""
    hit = triangles >= 0
    points_m = origins_m + depth_m[hit][..., None] * directions[hit]
    return target.normals_of(triangles[hit], points_m)
