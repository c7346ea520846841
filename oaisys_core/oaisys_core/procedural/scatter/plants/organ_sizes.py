"""Sizes of leaves, needles, blades and petals, in metres and independent of the plant's size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from oaisys_core.files.yaml_documents import parse_yaml
from oaisys_core.types import FloatArray

CLASS_RATIO = 1.5
"""Largest over smallest size of the plants that share a mesh, which scales its organs, too."""

STRICT = ConfigDict(extra="forbid")
"""Of the tables in ``plants.yaml``: an unknown key is an error."""

MARGIN = 1.06 * CLASS_RATIO**0.5
"""Factor between the limits of an organ's size and the sizes that are drawn."""


@dataclass(frozen=True)
class OrganSize:
    """Least and largest size of an organ of a species.

    Attributes:
        length_m, width_m: (least, largest); the upper is at least 1.6 times the lower.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    length_m: tuple[float, float]
    width_m: tuple[float, float]

    def draw(
        self, count: int, rng: np.random.Generator, factor: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return (count,) lengths and widths; long organs are wide.

        They lie within the limits, also in plants of a mesh for other sizes of its class.

        Args:
            factor: Unit of the plant in metres; the results are in such units.
        """
        share = rng.uniform(size=count)
        lengths, widths = (
            (low + (high - low) * share) / factor
            for low, high in (inner(self.length_m), inner(self.width_m))
        )
        return np.asarray(lengths), np.asarray(widths)

    @property
    def mean_width_m(self) -> float:
        """Mean of the widths that are drawn."""
        return sum(inner(self.width_m)) / 2

    @property
    def area_m2(self) -> float:
        """Area of a mean organ, which is half of its length times its width."""
        return sum(inner(self.length_m)) * sum(inner(self.width_m)) / 8


def inner(limits: tuple[float, float]) -> tuple[float, float]:
    """Return what may be drawn so that plants of the whole size class keep to the limits."""
    return limits[0] * MARGIN, limits[1] / MARGIN


TABLE = parse_yaml(Path(__file__).with_name("plants.yaml").read_text(encoding="utf-8"))
"""``plants.yaml``: the sizes of organs, and how woody plants grow."""

ORGANS = TypeAdapter(dict[str, dict[str, OrganSize]]).validate_python(TABLE["organs"])
"""Organs by species, from floras of central Europe."""
