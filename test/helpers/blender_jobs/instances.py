"""Casts rays at instances in a process that has Blender's Embree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Must come before anything that loads Open3D, see oaisys_core.backend.raycast.triangles.
import bpy  # noqa: F401
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.embree import blenders_embree
from oaisys_core.backend.raycast.instance_arrays import PlacedPrototype, PrototypeMeshes
from oaisys_core.backend.raycast.instances import InstanceCaster
from oaisys_core.backend.raycast.triangles import RayCaster
from oaisys_core.types import FloatArray, TriangleMesh

Rays = tuple[FloatArray, FloatArray, FloatArray | None]


def casts(
    placed: Sequence[PlacedPrototype], views: Sequence[Rays], xy_m: FloatArray
) -> dict[str, Any]:
    """Return what rays find by Embree's own instances, and heights.

    Args:
        placed: The instances.
        views: Origins, directions and limits of `InstanceCaster.intersect`.
        xy_m: (N, 2) where heights are asked for.
    """
    embree = blenders_embree()
    assert embree is not None
    caster = InstanceCaster(placed, PrototypeMeshes(), embree)
    found = [caster.intersect(*view) for view in views]
    return {
        "found": found,
        "again": [caster.intersect(*view) for view in views],
        "ids": [caster.instance_ids_of(triangles) for _, triangles in found],
        "normals": [_normals(caster, triangles) for _, triangles in found],
        "heights_m": caster.surface_height_m(xy_m),
    }


def mesh_casts(mesh: TriangleMesh, views: Sequence[Rays]) -> list[Any]:
    """Return what rays find of a mesh by Blender's Embree."""
    embree = blenders_embree()
    if embree is None:
        raise AssertionError("Blender came without its Embree")
    caster = RayCaster([mesh], embree.mesh)
    caster.prepare()
    return [caster.intersect(origins_m, directions) for origins_m, directions, _ in views]


def resident_mb(placed: Sequence[PlacedPrototype], times: int) -> list[float]:
    """Return the memory in use after each of some structures was made and dropped."""
    embree = blenders_embree()
    found = []
    for _ in range(times):
        InstanceCaster(placed, PrototypeMeshes(), embree)
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        found.append(int(pages) * 4096 / 1e6)
    return found


def _normals(caster: InstanceCaster, triangles: NDArray[np.int64]) -> FloatArray:
    return caster.normals_of(triangles[triangles >= 0])
