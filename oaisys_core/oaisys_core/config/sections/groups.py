"""Configuration of groups of scattered objects.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from oaisys_core.config.section import OneForBoth, Positive, PositiveRange, Range
from oaisys_core.config.sections.density import DensityConfig
from oaisys_core.config.sections.objects import Fraction, Name, ShapedConfig

MAX_INSTANCES = 1_000_000
"""Largest number of instances of a group, including factors from metadata."""

Count = Annotated[int, Field(ge=0, le=MAX_INSTANCES)]

CountRange = Annotated[tuple[Count, Count], OneForBoth()]
FractionRange = Annotated[tuple[Fraction, Fraction], OneForBoth()]


class GroupConfig(ShapedConfig):
    """Randomly scattered objects of one kind, independent of all other groups.

    Attributes:
        name: Unique name, which is also the key of its metadata and random stream.
        count: (least, most) number of instances; fewer are placed if there is no room.
        probability: Probability that a batch has any of them.
        hidden: Whether they are invisible; they keep their instance ids.
        variants: Number of different meshes of a built-in shape; None has 24 of a rock, and 3 of
            others. Those of plants are dealt to classes of sizes that differ by a factor of up to
            1.5, at least one for each.
        detail: A rock has 20 * 4**detail triangles; None derives it from the size.
        size_m: (smallest, largest) size along the longest axis.
        size_distribution: ``power_law`` (the number above size D goes as D**-size_exponent),
            ``uniform``, or ``normal`` (truncated to the range).
        size_exponent: Exponent of the power law.
        size_mean_m, size_std_m: Parameters of the normal distribution; None uses the middle and a
            quarter of the width of the range.
        spacing: Least distance between two instances, in units of their mean size.
        spacing_m: Least distance between two instances in metres (Poisson-disk sampling). Without
            it, built-in plants stand in clumps some 10 times as wide, except meadows and moss.
        density: Densities over the ground, which are multiplied.
        max_slope_deg: Steepest ground on which they are placed.
        yaw_deg: (least, most) rotation about the vertical.
        tilt_deg: Largest random tilt about either horizontal axis; None is 4 for built-in plants
            (0 for meadows and moss) and 18 for all others.
        align: Share of the ground's slope by which they tilt: 0 stands upright, 1 is perpendicular
            to the ground; None is 0.2 for built-in plants (1 for meadows and moss) and 1 for all
            others.
        sink: (least, most) share of the height below the ground; None is [0, 0.03] for built-in
            plants, [0.1, 0.6] for built-in rocks, of which half are in the lowest eighth of the
            range, and [0.15, 0.4] for all others.
        beyond_stage: Whether they also stand on the land around the stage, fewer with the distance;
            None: rocks do, and built-in plants if ``size_m`` reaches 1 m.
    """

    name: Name
    count: CountRange
    probability: Fraction = 1.0
    hidden: bool = False
    variants: int | None = Field(default=None, ge=1, le=64)
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
    tilt_deg: float | None = Field(default=None, ge=0, le=90)
    align: Fraction | None = None
    sink: FractionRange | None = None
    beyond_stage: bool | None = None

    @field_validator("count", "sink")
    @classmethod
    def _check_order(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and value[0] > value[1]:
            raise ValueError("expected [least, most]")
        return value
