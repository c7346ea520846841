"""How colour is rendered.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from oaisys_core.config.section import Section


class RenderConfig(Section):
    """How colour is rendered; depth and labels are exact at every quality.

    Attributes:
        quality: Preset of samples per pixel and bounces.
        exposure_ev: Exposure in stops.
    """

    quality: Literal["preview", "standard", "high", "final"] = "standard"
    exposure_ev: float = Field(default=0.0, ge=-20, le=20)
