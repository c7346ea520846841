"""Configuration of the sun by date, time and place."""

from __future__ import annotations

from typing import Annotated

from pydantic import AwareDatetime, Field, model_validator

from oaisys_core.config.section import Range, Section, Within


class SunFromTimeConfig(Section):
    """The sun by time and place on Earth, the Moon or Mars; it overrides elevation and azimuth.

    On the Moon and Mars (``stage.body``) it is that of an ephemeris, which the extra
    ``oaisys_core[ephemeris]`` has.

    Attributes:
        date_time: Date and time with UTC offset, such as ``2026-06-21T12:00:00+02:00``.
        latitude_deg, longitude_deg: Place on the body; north and east are positive. The latitude
            is the angle of the vertical with the equator (planetographic on Mars). None: the
            origin of ``map`` on an elevation model that says where it lies.
        north_offset_deg: Direction of true north in ``map``, counter-clockwise from +y. None: as
            the elevation model says, or 0 without one.
        later_h: Range of hours that are added, for a random time of day.
        s_per_sample: Seconds between one sample and the next.
        earthshine: Whether Earth throws sunlight on the Moon; only there.
    """

    date_time: AwareDatetime
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    longitude_deg: float | None = Field(default=None, ge=-180, le=360)
    north_offset_deg: float | None = Field(default=None, ge=-360, le=360)
    later_h: Annotated[Range, Within(-8784.0, 8784.0)] = (0.0, 0.0)
    s_per_sample: float = Field(default=0.0, ge=-1e7, le=1e7)
    earthshine: bool = False

    @model_validator(mode="after")
    def _whole_place(self) -> SunFromTimeConfig:
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            raise ValueError("expected latitude_deg and longitude_deg, or neither of them")
        return self
