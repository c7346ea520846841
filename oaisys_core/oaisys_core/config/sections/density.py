"""Where things are more or less likely to stand.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from oaisys_core.config.paths import ConfigFile
from oaisys_core.config.section import Positive, Range, Section

Share = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0)]


class NoiseDensity(Section):
    """Patches of fractal noise.

    Attributes:
        scale_m: Typical width of a patch.
        cover: Share of the ground that is in patches.
        softness: 0: patches end at once; 1: they fade over about half their width.
        least: Density between the patches.
    """

    kind: Literal["noise"]
    scale_m: Positive = 8.0
    cover: Share = 0.5
    softness: Share = 0.3
    least: Share = 0.0


class VoronoiDensity(Section):
    """Cells nearest to random points: some hold things, some none.

    Attributes:
        cell_m: Typical width of a cell.
        cover: Share of the cells that hold things.
        border_m: Width over which a cell fades towards its border.
        least: Density in the other cells.
    """

    kind: Literal["voronoi"]
    cell_m: Positive = 8.0
    cover: Share = 0.5
    border_m: NotNegative = 0.5
    least: Share = 0.0


class SlopeDensity(Section):
    """Ground of some slopes.

    Attributes:
        range_deg: (least, most) slope.
        fade_deg: Width of a linear fade, half of it on each side of a bound.
        least: Density elsewhere.
    """

    kind: Literal["slope"]
    range_deg: Range = (0.0, 25.0)
    fade_deg: NotNegative = 5.0
    least: Share = 0.0


class HeightDensity(Section):
    """Ground of some heights.

    Attributes:
        range_m: (least, most) height in ``map``; None: see ``range_share``.
        range_share: (least, most) height, 0 the ground's lowest and 1 its highest point.
        fade_m: Width of a linear fade, half of it on each side of a bound.
        least: Density elsewhere.
    """

    kind: Literal["height"]
    range_m: Range | None = None
    range_share: Range = (0.0, 0.5)
    fade_m: NotNegative = 0.5
    least: Share = 0.0


class ImageDensity(Section):
    """A grey image laid over the whole ground, its upper edge at the largest y.

    Attributes:
        file: 8- or 16-bit image; white is 1. Between its pixels it is interpolated linearly.
        invert: Whether black is 1.
        least: Density where it is 0.
    """

    kind: Literal["image"]
    file: ConfigFile
    invert: bool = False
    least: Share = 0.0


DensityConfig = Annotated[
    NoiseDensity | VoronoiDensity | SlopeDensity | HeightDensity | ImageDensity,
    Field(discriminator="kind"),
]
