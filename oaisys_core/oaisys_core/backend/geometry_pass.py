"""Images of everything but colour, by modality, and the base class of further modalities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core import extensions
from oaisys_core.backend.flow import PoseMemory
from oaisys_core.backend.surface import Surface, View
from oaisys_core.errors import ConfigError, RenderError
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
    ModalitySpec,
    semantic_level,
)


class GeometryPass(ABC):
    """Computes one modality, whose name is that of its entry point. It must not keep state."""

    spec: ModalitySpec
    """Type and meaning of its pixels."""

    @abstractmethod
    def compute(self, surface: Surface, view: View, camera: PlacedCamera) -> NDArray[Any]:
        """Return the image, (H, W) or (H, W, channels), of the dtype in ``spec``."""


def compute_extension_pass(
    surface: Surface, view: View, camera: PlacedCamera, modality: str
) -> NDArray[Any]:
    """Return the image of an installed pass.

    Raises:
        ConfigError: There is no such pass, or it is not a `GeometryPass`.
        RenderError: Its image does not have the shape and dtype of its ``spec``.
    """
    kind = extensions.load(extensions.PASSES, modality)
    if not (isinstance(kind, type) and issubclass(kind, GeometryPass)):
        raise ConfigError(f"{extensions.PASSES}: {modality!r} is {kind!r}, expected a GeometryPass")
    image = kind().compute(surface, view, camera)
    shape = view.depth_m.shape + ((kind.spec.channels,) if kind.spec.channels > 1 else ())
    if image.shape != shape or image.dtype != kind.spec.dtype:
        received = f"{image.dtype} {image.shape}"
        raise RenderError(f"{modality}: received {received}, expected {kind.spec.dtype} {shape}")
    return image


def geometry_frames(surface: Surface, camera: PlacedCamera, memory: PoseMemory) -> dict[str, Frame]:
    """Cast rays and return a camera's frames except colour and albedo, by modality."""
    if set(camera.modalities) <= {RGB, ALBEDO}:
        return {}
    return frames_of(surface, surface.view(camera), camera, memory)


def frames_of(
    surface: Surface, view: View, camera: PlacedCamera, memory: PoseMemory
) -> dict[str, Frame]:
    """Return the frames of a view except colour and albedo, by modality."""
    return {
        modality: frame_of(camera, modality, _image(surface, view, camera, memory, modality))
        for modality in camera.modalities
        if modality not in (RGB, ALBEDO)
    }


def frame_of(camera: PlacedCamera, modality: str, image: NDArray[Any]) -> Frame:
    """Return an image as a frame of a camera."""
    return Frame(camera.name, modality, image, camera.intrinsics, camera.T_map_camera)


def _image(
    surface: Surface, view: View, camera: PlacedCamera, memory: PoseMemory, modality: str
) -> NDArray[Any]:
    """Return the image of one modality, see `modality_spec`."""
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
    return compute_extension_pass(surface, view, camera, modality)
