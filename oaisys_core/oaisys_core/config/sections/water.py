"""Configuration of water on the stage. Lengths are in metres."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from oaisys_core.config.section import Labelled, LabelText, Positive
from oaisys_core.config.sections.density import Share

Channel = Annotated[float, Field(ge=0, le=1)]


class WaterConfig(Labelled):
    """Water up to a level: lakes and ponds, or a sea if it reaches the edge of the stage.

    Attributes:
        level_m: Height of the surface in ``map``.
        level_share: Height of the surface relative to the ground: 0 is its lowest point, 1 its
            highest.
        clarity_m: Depth at which two thirds of the bottom's colour are gone.
        color_srgb: Colour of deep water, sRGB-encoded, 0 to 1.
        waves: 0 for a mirror, 1 for the ripples of a fresh breeze; they change reflections only.
        wet_bank_m: Height above the level up to which the ground is wet and dark.
    """

    label: LabelText = "water"
    level_m: float | None = None
    level_share: Share | None = None
    clarity_m: Positive = 0.6
    color_srgb: tuple[Channel, Channel, Channel] = (0.13, 0.23, 0.24)
    waves: Share = 0.3
    wet_bank_m: float = Field(default=0.12, ge=0)

    @model_validator(mode="after")
    def _one_level(self) -> WaterConfig:
        if (self.level_m is None) == (self.level_share is None):
            raise ValueError("expected either level_m or level_share")
        return self
