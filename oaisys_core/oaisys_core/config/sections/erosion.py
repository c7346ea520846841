"""Configuration of the erosion of a ground.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from oaisys_core.config.section import Section

Repose = Annotated[float, Field(ge=5, le=85)]
"""Slope that is just stable."""


class BedsConfig(Section):
    """Layers of rock of differing hardness, which stand out as ledges or wear back as slopes.

    Attributes:
        count: Number of pairs of a soft bed and a hard one between the lowest and the highest
            point.
        contrast: By how much faster water cuts into the softest rock than into the hardest.
        repose_deg: Steepest stable slope of the hardest rock.
        hard_share: Share of the rock that is hard.
        dip_deg: Angle at which the beds dip, in a drawn direction.
    """

    count: int = Field(default=6, ge=1, le=100)
    contrast: float = Field(default=4.0, ge=1, le=100)
    repose_deg: Repose = 65.0
    hard_share: float = Field(default=0.35, gt=0, lt=1)
    dip_deg: float = Field(default=1.5, ge=0, le=60)


class ErosionConfig(Section):
    """Water and gravity that shape the ground, whatever it was drawn or read from.

    Attributes:
        age: Duration, in the time in which rivers adjust to the ground's edges: at 0.02 there are
            gullies, at 0.1 valleys, at 1 all is slopes.
        repose_deg: Steepest stable slope of loose ground, and of all that has no ``beds``.
        deposition: How readily water lays down what it carries: 0 not at all, 0.7 as rivers with
            fans and level floors.
        creep_m: Distance over which soil has crept in the end; it rounds ridges.
        beds: Layers of the rock; None for rock without.
        below_posting: Whether an elevation model keeps its heights, as means over its pixels, and
            erosion adds only what is finer; not for presets.
    """

    age: float = Field(default=0.06, gt=0, le=3)
    repose_deg: Repose = 36.0
    deposition: float = Field(default=0.7, ge=0, le=5)
    creep_m: float = Field(default=0.0, ge=0, le=1e5)
    beds: BedsConfig | None = None
    below_posting: bool = True

    @model_validator(mode="after")
    def _hard_rock_is_steeper(self) -> ErosionConfig:
        if self.beds is not None and self.beds.repose_deg < self.repose_deg:
            raise ValueError(
                f"beds.repose_deg: received {self.beds.repose_deg:g}, expected at least that of"
                f" loose ground, repose_deg ({self.repose_deg:g})"
            )
        return self
