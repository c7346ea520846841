"""Passes of other packages: further modalities, computed from what each pixel sees."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from numpy.typing import NDArray

from oaisys_core import extensions
from oaisys_core.backend.surface import Surface, View
from oaisys_core.errors import ConfigError, RenderError
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import ModalitySpec


class GeometryPass(ABC):
    """Computes one modality; its entry point's name is the modality's. It must keep no state."""

    spec: ModalitySpec
    """What its pixels are."""

    @abstractmethod
    def compute(self, surface: Surface, view: View, camera: PlacedCamera) -> NDArray[Any]:
        """Return the image, (H, W) or (H, W, channels) as ``spec`` says."""


def computed(surface: Surface, view: View, camera: PlacedCamera, modality: str) -> NDArray[Any]:
    """Return an installed pass's image.

    Raises:
        ConfigError: There is no such pass, or it is none.
        RenderError: Its image is not what it says.
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
