"""What tests of cameras have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from synthetic_worlds import settings

from oaisys_core.backend.blender import BlenderBackend
from oaisys_core.backend.blender.cycles import BASE_EXPOSURE_EV
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import Frame, Progress


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def views(cases: Sequence[tuple[Scene, PlacedCamera]], samples: int = 1) -> list[tuple[Frame, ...]]:
    """Frames of one camera in each world."""
    backend = BlenderBackend()
    frames = []
    for scene, camera in cases:
        backend.build(scene, ignore)
        linear = settings(samples, exposure_ev=-BASE_EXPOSURE_EV)
        wanted = replace(linear, view_transform="raw")
        frames.append(backend.render_all([camera], wanted, ignore))
    return frames
