"""Things scattered at random in large numbers.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from oaisys_core.config.section import Positive, PositiveRange, Range
from oaisys_core.config.sections.density import DensityConfig
from oaisys_core.config.sections.objects import Fraction, Name, ShapedConfig

MOST_INSTANCES = 1_000_000
"""Instances of one group at most, metadata's factors included."""

Count = Annotated[int, Field(ge=0, le=MOST_INSTANCES)]


class GroupConfig(ShapedConfig):
    """Things of one kind, scattered at random; its draws do not depend on any other group.

    Attributes:
        name: Key of its random stream, and of its metadata.
        count: (least, most) number of them; fewer are placed where there is no room.
        probability: How likely a batch has any of them.
        hidden: Whether they are left out of the picture; they keep their instance ids.
        variants: Different meshes of a built-in shape.
        detail: Triangles of a rock are 20 * 4**detail; None: by its size.
        size_m: (smallest, largest) longest axis.
        size_distribution: ``power_law`` (the number above size D goes as D**-size_exponent),
            ``uniform``, or ``normal`` (cut off at the range's ends).
        size_exponent: Of the power law.
        size_mean_m, size_std_m: Of the normal distribution; None: the range's middle, and a
            quarter of its width.
        spacing: Least distance of two of them, in units of their mean size.
        spacing_m: Least distance of two of them (Poisson-disk sampling).
        density: Where they are likely; all are multiplied.
        max_slope_deg: None stands on ground steeper than this.
        yaw_deg: (least, most) turn about the vertical.
        tilt_deg: Most that one leans at random, about either axis.
        align: Share of the ground's slope by which they lean with it: 0 stands upright, 1 at right
            angles to the ground.
        sink: (least, most) share of the height that is in the ground.
    """

    name: Name
    count: tuple[Count, Count]
    probability: Fraction = 1.0
    hidden: bool = False
    variants: int = Field(default=3, ge=1, le=64)
    detail: int | None = Field(default=None, ge=0, le=5)
    size_m: PositiveRange = (0.15, 1.2)
    size_distribution: Literal["power_law", "uniform", "normal"] = "power_law"
    size_exponent: Positive = 1.8
    size_mean_m: Positive | None = None
    size_std_m: Positive | None = None
    spacing: float = Field(default=0.5, ge=0, le=100)
    spacing_m: float = Field(default=0.0, ge=0)
    density: tuple[DensityConfig, ...] = ()
    max_slope_deg: float = Field(default=40.0, ge=0, le=90)
    yaw_deg: Range = (-180.0, 180.0)
    tilt_deg: float = Field(default=18.0, ge=0, le=90)
    align: Fraction = 1.0
    sink: tuple[Fraction, Fraction] = (0.15, 0.4)

    @field_validator("count", "sink")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("expected [least, most]")
        return value
