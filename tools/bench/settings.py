"""Settings of a run of the benchmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

CONFIG = Path(__file__).parents[2] / "config" / "simulator.yaml"

Say = Callable[[float, str], None]
"""Takes the share of a topic that is done, and what comes next."""


def say_of_part(say: Say, index: int, parts: int, name: str) -> Say:
    """Return what takes the progress of one of several equal parts of a topic."""
    return lambda share, text: say((index + share) / parts, f"{name}: {text}")


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        out: Folder of the results, and of the references that are kept between runs.
        runs: Values per figure, unless a topic says otherwise.
        quick: Fewer values, and references of fewer samples.
        width_px, height_px: Image size.
        with_final: Whether the slowest preset is measured.
        plain_views: Number of views for the topic ``plain``.
        device: ``render.device`` of everything that Blender renders.
        worlds: Worlds of the panel; none: all, or a few with ``quick``.
        views_seed: Seed of the panel's random views.
        against: Root of another checkout to compare the panel's times with; None: no comparison.
    """

    out: Path
    runs: int = 5
    quick: bool = False
    width_px: int = 640
    height_px: int = 480
    with_final: bool = False
    plain_views: int = 1
    device: str = "auto"
    worlds: tuple[str, ...] = ()
    views_seed: int = 1
    against: Path | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON-able data; inverse: `from_dict`."""
        against = None if self.against is None else str(self.against)
        return asdict(self) | {"out": str(self.out), "against": against}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Settings:
        """Return what `to_dict` was called on."""
        against = None if data["against"] is None else Path(data["against"])
        paths = {"out": Path(data["out"]), "against": against}
        return cls(**(data | paths | {"worlds": tuple(data["worlds"])}))


def camera(width_px: int, height_px: int) -> dict[str, Any]:
    """Return the part of a configuration with one camera of a size."""
    focal_px = 541.14 * width_px / 640
    size = {"width_px": width_px, "height_px": height_px, "fx_px": focal_px, "fy_px": focal_px}
    return {"sensors": {"cameras": [{"name": "camera", **size}]}}
