"""Configuration of where a layer of the ground may lie: by slope, height, water and wind."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from oaisys_core.config.section import Section

Share = Annotated[float, Field(ge=0, le=1)]
SlopeDeg = Annotated[float, Field(ge=0, le=90)]
ShelterDeg = Annotated[float, Field(ge=-90, le=90)]


class ConditionConfig(Section):
    """Where a layer may lie; all given conditions must hold.

    Attributes:
        slope_deg: Range of slopes.
        height_m: Range of heights in ``map``; None for any height.
        height_share: Range of relative heights; 0 is the lowest point of the ground, 1 the highest.
        flow_share: Range of how much water runs by, as the share of the ground by which less does:
            0 is a crest, from 0.9 on are the gullies, from 0.98 on the largest channels; None for
            any. It comes from the area that drains through a place.
        debris_share: Range of how much rock that falls from steep parts comes to rest, as the share
            of the ground with less of it; ground without any has 0. None for any.
        crest_share: Range of how far the ground stands out of its surroundings, as the share of the
            ground that does so less: 0 is the deepest hollow, 1 the sharpest crest. None for any.
        crest_size_m: Size of the forms that ``crest_share`` tells apart.
        shelter_deg: Range of how far the ground upwind rises above a place: sheltered places, where
            snow and sand come to rest, have positive angles, windward ones and crests negative
            ones. None for any.
        wind_from_deg: Azimuth that the wind comes from, clockwise from the y axis of ``map``.
        soft_deg, soft_m, soft_share: Widths of the fades centred on the bounds.
    """

    slope_deg: tuple[SlopeDeg, SlopeDeg] = (0.0, 90.0)
    height_m: tuple[float, float] | None = None
    height_share: tuple[Share, Share] | None = None
    flow_share: tuple[Share, Share] | None = None
    debris_share: tuple[Share, Share] | None = None
    crest_share: tuple[Share, Share] | None = None
    crest_size_m: float = Field(default=4.0, gt=0)
    shelter_deg: tuple[ShelterDeg, ShelterDeg] | None = None
    wind_from_deg: float = Field(default=270.0, ge=0, le=360)
    soft_deg: float = Field(default=6.0, ge=0, le=90)
    soft_m: float = Field(default=0.5, ge=0)
    soft_share: float = Field(default=0.05, ge=0, le=1)

    @model_validator(mode="after")
    def _in_order(self) -> ConditionConfig:
        for name in (
            "slope_deg",
            "height_m",
            "height_share",
            "flow_share",
            "debris_share",
            "crest_share",
            "shelter_deg",
        ):
            bounds = getattr(self, name)
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError(f"{name}: received {list(bounds)}, expected [least, most]")
        return self
