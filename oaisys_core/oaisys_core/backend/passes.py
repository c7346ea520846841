"""Images of what a camera sees, by modality: everything but colour, alike in all backends."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.flow import PoseMemory
from oaisys_core.backend.geometry_pass import computed
from oaisys_core.backend.surface import Surface, View
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import (
    ALBEDO,
    DEPTH,
    FLOW,
    INSTANCE,
    NORMAL,
    RANGE,
    RGB,
    Frame,
    semantic_level,
)


def geometry_frames(surface: Surface, camera: PlacedCamera, memory: PoseMemory) -> dict[str, Frame]:
    """Return the frames that a camera asks for beside its colours, by modality."""
    if set(camera.modalities) <= {RGB, ALBEDO}:
        return {}
    return frames_of(surface, surface.view(camera), camera, memory)


def frames_of(
    surface: Surface, view: View, camera: PlacedCamera, memory: PoseMemory
) -> dict[str, Frame]:
    """Return, of one view, the frames that its camera asks for beside its colours."""
    return {
        modality: frame_of(camera, modality, _image(surface, view, camera, memory, modality))
        for modality in camera.modalities
        if modality not in (RGB, ALBEDO)
    }


def frame_of(camera: PlacedCamera, modality: str, image: NDArray[Any]) -> Frame:
    """Return an image as the frame of a camera."""
    return Frame(camera.name, modality, image, camera.intrinsics, camera.T_map_camera)


def _image(
    surface: Surface, view: View, camera: PlacedCamera, memory: PoseMemory, modality: str
) -> NDArray[Any]:
    """Return an image as `modality_spec` describes it."""
    level = semantic_level(modality)
    if level is not None:
        return surface.semantic_ids(view, level)
    if modality == DEPTH:
        return view.depth_m.astype(np.float32)
    if modality == RANGE:
        return np.asarray(view.depth_m * np.linalg.norm(view.directions, axis=-1), np.float32)
    if modality == INSTANCE:
        return view.instance_ids
    if modality == NORMAL:
        return np.asarray(surface.normals(view) @ camera.T_map_camera[:3, :3], np.float32)
    if modality == FLOW:
        return memory.flow(view, camera, surface.scene)
    return computed(surface, view, camera, modality)
