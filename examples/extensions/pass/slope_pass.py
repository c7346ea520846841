"""A pass: the slope of what each pixel sees, in degrees; NaN for nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.geometry_pass import GeometryPass
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import ModalitySpec


class SlopePass(GeometryPass):
    """Angle between the surface and the horizontal."""

    spec = ModalitySpec(np.dtype(np.float32), 1)

    def compute(self, surface: Surface, view: View, camera: PlacedCamera) -> NDArray[Any]:
        """Return (H, W) degrees."""
        up = np.clip(np.abs(surface.normals(view)[..., 2]), 0.0, 1.0)
        slope_deg = np.degrees(np.arccos(up))
        return np.where(view.is_hit, slope_deg, np.nan).astype(np.float32)
