"""Figures of the audit of light, and what renders for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oaisys_core.render.base import Backend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import FloatArray

LIMIT = 0.01
"""Largest relative error of radiance."""


@dataclass(frozen=True)
class LightFigure:
    """A measured figure and what a formula says.

    Attributes:
        name: What was measured.
        measured, expected: In the unit that the name says; scene units if it says none.
        limit: Largest relative error that is allowed.
    """

    name: str
    measured: float
    expected: float
    limit: float = LIMIT

    @property
    def error(self) -> float:
        """Relative error."""
        return self.measured / self.expected - 1

    @property
    def is_met(self) -> bool:
        """Whether the error is within the limit; a figure that is no number is not."""
        return abs(self.error) <= self.limit


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
