"""Configuration of the densities of scattered objects.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from oaisys_core.config.section import ByKind, Range, Section, Size
from oaisys_core.files.path_fields import ConfigFile

Share = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0)]


class NoiseDensity(Section):
    """Patches of fractal noise.

    Attributes:
        scale_m: Typical width of a patch.
        cover: Share of the ground inside patches.
        softness: 0 for sharp borders; with 1 patches fade over about half their width.
        least: Density outside the patches.
    """

    kind: Literal["noise"]
    scale_m: Size = 8.0
    cover: Share = 0.5
    softness: Share = 0.3
    least: Share = 0.0


class VoronoiDensity(Section):
    """Voronoi cells of random points, of which only some contain objects.

    Attributes:
        cell_m: Typical width of a cell.
        cover: Share of the cells that contain objects.
        border_m: Width over which a cell fades towards its border.
        least: Density in the other cells.
    """

    kind: Literal["voronoi"]
    cell_m: Size = 8.0
    cover: Share = 0.5
    border_m: NotNegative = 0.5
    least: Share = 0.0


class SlopeDensity(Section):
    """Ground in a range of slopes.

    Attributes:
        range_deg: (least, most) slope.
        fade_deg: Width of the linear fade centred on each bound.
        least: Density elsewhere.
    """

    kind: Literal["slope"]
    range_deg: Range = (0.0, 25.0)
    fade_deg: NotNegative = 5.0
    least: Share = 0.0


class HeightDensity(Section):
    """Ground in a range of heights.

    Attributes:
        range_m: (least, most) height in ``map``; None to use ``range_share``.
        range_share: (least, most) relative height; 0 is the lowest point of the ground, 1 the
            highest.
        fade_m: Width of the linear fade centred on each bound.
        least: Density elsewhere.
    """

    kind: Literal["height"]
    range_m: Range | None = None
    range_share: Range = (0.0, 0.5)
    fade_m: NotNegative = 0.5
    least: Share = 0.0


class MoistureDensity(Section):
    """Ground in a range of moistures, by how much water drains towards each place.

    Attributes:
        range_share: (least, most) moisture by rank: 0 is the driest place of the stage, 0.9 is
            wetter than 90 % of it. Exactly flat ground has 0.5 everywhere.
        fade_share: Width of the linear fade centred on each bound.
        least: Density elsewhere.
    """

    kind: Literal["moisture"]
    range_share: Range = (0.6, 1.0)
    fade_share: NotNegative = 0.2
    least: Share = 0.0


class LayerDensity(Section):
    """Where a layer of the ground lies, as dense as its weight there.

    Attributes:
        label: Label of the layer on level 0, or a list of several; where `materials.pools` have
            drawn none of them, it is 0 everywhere.
        least: Density elsewhere.
    """

    kind: Literal["layer"]
    label: str | Annotated[tuple[str, ...], Field(min_length=1)]
    least: Share = 0.0

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels, of which a single one may be given without a list."""
        return (self.label,) if isinstance(self.label, str) else self.label


class ImageDensity(Section):
    """A grey image over the whole ground, with its upper edge at the largest y.

    Attributes:
        file: 8- or 16-bit image; white is 1. It is interpolated linearly between pixels.
        invert: Whether black is 1.
        least: Density where the image is 0.
    """

    kind: Literal["image"]
    file: ConfigFile
    invert: bool = False
    least: Share = 0.0


DensityConfig = Annotated[
    NoiseDensity
    | VoronoiDensity
    | SlopeDensity
    | HeightDensity
    | MoistureDensity
    | LayerDensity
    | ImageDensity,
    ByKind(),
]
