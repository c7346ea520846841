"""What tests of passes and updates have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray
from synthetic_worlds import settings

from oaisys_core.render.blender import BlenderBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import FloatArray, Frame, Progress, TriangleMesh


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def samples(scenes: Sequence[Scene], cameras: Sequence[PlacedCamera]) -> list[tuple[Frame, ...]]:
    """Frames of a world, then of what each update makes of it, one camera for each."""
    backend = BlenderBackend()
    backend.build(scenes[0], ignore)
    frames = [backend.render_all([cameras[0]], settings(), ignore)]
    for scene, camera in zip(scenes[1:], cameras[1:], strict=True):
        backend.update(scene)
        frames.append(backend.render_all([camera], settings(), ignore))
    return frames


def pictures(scene: Scene, cases: Sequence[tuple[PlacedCamera, RenderSettings]]) -> list[Frame]:
    """The first frame of each case in one world."""
    backend = BlenderBackend()
    backend.build(scene, ignore)
    return [backend.render_all([camera], wanted, ignore)[0] for camera, wanted in cases]


def updated_surface(
    scenes: Sequence[Scene], xy_m: FloatArray
) -> list[tuple[TriangleMesh, FloatArray]]:
    """Mesh and heights of a world, and of what each update makes of it."""
    backend = BlenderBackend()
    backend.build(scenes[0], ignore)
    found = [(backend.ground_truth_mesh(), backend.surface_height_m(xy_m))]
    for scene in scenes[1:]:
        backend.update(scene)
        found.append((backend.ground_truth_mesh(), backend.surface_height_m(xy_m)))
    return found


def evaluated(
    scenes: Sequence[Scene],
) -> list[tuple[NDArray[np.float64], NDArray[np.float64], dict[str, int]]]:
    """Poses of instances and of objects as Cycles gets them, and how much Blender holds.

    For a world, then for what each update makes of it.
    """
    backend = BlenderBackend()
    backend.build(scenes[0], ignore)
    found = [_evaluated()]
    for scene in scenes[1:]:
        backend.update(scene)
        found.append(_evaluated())
    return found


def _evaluated() -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, int]]:
    shown = bpy.context.evaluated_depsgraph_get().object_instances
    instances: list[Any] = []
    objects: list[Any] = []
    for each in shown:
        if each.is_instance:
            instances.append(each.matrix_world.copy())
        elif each.object.name.startswith("instance_"):
            objects.append(each.matrix_world.copy())
    kinds = ("objects", "meshes", "materials", "node_groups")
    counts = {kind: len(getattr(bpy.data, kind)) for kind in kinds}
    return np.array(instances), np.array(objects), counts
