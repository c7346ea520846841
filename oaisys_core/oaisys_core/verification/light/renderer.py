"""What renders for the audit of light."""

from __future__ import annotations

import numpy as np

from oaisys_core.render.base import Backend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import FloatArray


class Renderer:
    """Renders radiance images with a backend."""

    def __init__(self, backend: Backend, quality: str) -> None:
        self._backend = backend
        self._quality = quality

    def image(self, scene: Scene, view: PlacedCamera, samples: int) -> FloatArray:
        """Return the (H, W) radiance in scene units, the mean of the bands, without bounces."""
        self._backend.build(scene, lambda _: None)
        settings = RenderSettings(self._quality, samples, 0, False, 0.0, 1)
        (frame,) = self._backend.render_all([view], settings, lambda _: None)
        return np.asarray(frame.data.astype(np.float64).mean(axis=-1))
