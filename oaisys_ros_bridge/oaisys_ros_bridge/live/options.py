"""Options of a live page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class LiveOptions:
    """Options of a live page.

    Attributes:
        host, port: Of the page; port 0: a free one.
        out: Folder for pictures, bags and other files.
        still_quality: Quality of colour while the camera stands still.
        voxel_size_m, max_range_m: Of the map.
    """

    host: str
    port: int
    out: Path
    still_quality: str
    voxel_size_m: float
    max_range_m: float
