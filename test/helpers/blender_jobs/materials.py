"""What tests of the ground's material have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
from synthetic_worlds import settings

from oaisys_core.backend.blender import BlenderBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import Frame, Progress


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def views(cases: Sequence[tuple[Scene, PlacedCamera]]) -> list[tuple[Frame, ...]]:
    """Frames of one camera in each world."""
    backend = BlenderBackend()
    frames = []
    for scene, camera in cases:
        backend.build(scene, ignore)
        frames.append(backend.render_all([camera], settings(samples=16), ignore))
    return frames


def blocks(scenes: Sequence[Scene]) -> list[dict[str, int]]:
    """How many images, materials and node groups there are after each world was built."""
    backend = BlenderBackend()
    counts = []
    for scene in scenes:
        backend.build(scene, ignore)
        kinds = ("images", "materials", "node_groups")
        counts.append({kind: len(getattr(bpy.data, kind)) for kind in kinds})
    return counts
