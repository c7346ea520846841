"""Jobs of the audit of light."""

from __future__ import annotations

from oaisys_core.render.blender import BlenderBackend
from oaisys_core.verification.light.checks import figures
from oaisys_core.verification.light.light_figure import LightFigure


def light_figures() -> list[LightFigure]:
    """The figures of Cycles."""
    return figures(BlenderBackend(), "audit", lambda: None)
