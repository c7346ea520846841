"""Sizes of leaves, needles, blades and petals, in metres and independent of the plant's size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oaisys_core.types import FloatArray

CLASS_RATIO = 1.5
"""Largest over smallest size of the plants that share a mesh, which scales its organs, too."""

MARGIN = 1.06 * CLASS_RATIO**0.5
"""Factor between the limits of an organ's size and the sizes that are drawn."""


@dataclass(frozen=True)
class OrganSize:
    """Least and largest size of an organ of a species.

    Attributes:
        length_m, width_m: (least, largest); the upper is at least 1.6 times the lower.
    """

    length_m: tuple[float, float]
    width_m: tuple[float, float]

    def drawn(
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


ORGANS: dict[str, dict[str, OrganSize]] = {
    # Picea abies: needles of 1 to 2.5 cm.
    "spruce": {"leaf": OrganSize((0.010, 0.025), (0.0010, 0.0020))},
    # Pinus sylvestris: needles of 3 to 7 cm, 1 to 2 mm wide.
    "pine": {"leaf": OrganSize((0.030, 0.070), (0.0010, 0.0020))},
    # Pinus mugo: needles of 3 to 8 cm, 1.5 to 2.5 mm wide.
    "dwarf_pine": {"leaf": OrganSize((0.030, 0.080), (0.0012, 0.0025))},
    # Juniperus communis: needles of 8 to 20 mm, 1 to 2 mm wide.
    "juniper": {"leaf": OrganSize((0.008, 0.020), (0.0010, 0.0020))},
    # Erica: needles of 4 to 8 mm, flowers of 3 to 6 mm.
    "heather": {
        "leaf": OrganSize((0.004, 0.008), (0.0006, 0.0014)),
        "flower": OrganSize((0.003, 0.006), (0.002, 0.004)),
    },
    # Betula pendula: blades of 3 to 7 cm, 2 to 5 cm wide.
    "birch": {"leaf": OrganSize((0.030, 0.070), (0.020, 0.050))},
    # Quercus robur: 7 to 14 cm, 4 to 8 cm wide.
    "oak": {"leaf": OrganSize((0.070, 0.140), (0.040, 0.080))},
    # Crataegus monogyna: leaves of 2 to 6 cm, 2 to 5 cm wide; petals of 4 to 8 mm.
    "hawthorn": {
        "leaf": OrganSize((0.020, 0.060), (0.018, 0.050)),
        "flower": OrganSize((0.004, 0.008), (0.004, 0.008)),
    },
    # Salix: leaves of 4 to 12 cm, 0.8 to 2.5 cm wide.
    "willow": {"leaf": OrganSize((0.040, 0.120), (0.008, 0.025))},
    # A small-leaved shrub as Lonicera or Ligustrum: 2 to 6 cm, 1 to 3 cm wide.
    "shrub": {"leaf": OrganSize((0.020, 0.060), (0.010, 0.030))},
    # Dactylis, Deschampsia: blades as long as the tuft is high, 3 to 8 mm wide.
    "grass_tuft": {"blade": OrganSize((0.02, 2.0), (0.003, 0.008))},
    # Festuca, Poa, Lolium: 2 to 6 mm wide.
    "meadow": {"blade": OrganSize((0.02, 0.6), (0.002, 0.006))},
    # The same, with petals of daisies, hawkweed and clover of 8 to 20 mm.
    "flower_meadow": {
        "blade": OrganSize((0.02, 0.6), (0.002, 0.006)),
        "flower": OrganSize((0.008, 0.022), (0.005, 0.016)),
    },
    # Carex: 4 to 12 mm wide.
    "sedge": {"blade": OrganSize((0.05, 2.0), (0.004, 0.012))},
    # Phragmites australis: leaves of 20 to 60 cm, 1 to 3 cm wide.
    "reed": {"blade": OrganSize((0.10, 0.60), (0.010, 0.030))},
    # Dryopteris: leaflets of 2 to 15 cm, 1 to 2.5 cm wide.
    "fern": {"leaf": OrganSize((0.020, 0.150), (0.010, 0.025))},
    # Pteridium aquilinum: leaflets of 1 to 5 cm, 4 to 16 mm wide.
    "bracken": {"leaf": OrganSize((0.010, 0.050), (0.004, 0.016))},
}
"""Organs by species, from floras of central Europe."""
