"""Random draws that depend only on a seed, the index of the redraw and a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from oaisys_core import randomness

T = TypeVar("T")


@dataclass(frozen=True)
class NamedDraws:
    """The random draws of one redraw; draws with different names are independent.

    Attributes:
        seed: Seed of the batch.
        index: Index of the redraw within the batch, from 0.
    """

    seed: int
    index: int = 0

    def rng(self, name: str) -> np.random.Generator:
        """Return a new generator for a name."""
        return randomness.stream(self.seed, name, self.index)

    def number(self, name: str, bounds: tuple[float, float]) -> float:
        """Return a number drawn uniformly from a range."""
        least, most = bounds
        return least if least == most else float(self.rng(name).uniform(least, most))

    def pick(self, name: str, options: Sequence[T]) -> T:
        """Return one of the options, drawn uniformly."""
        return options[int(self.rng(name).integers(len(options)))]

    def pick_shuffled(self, name: str, options: Sequence[T]) -> T:
        """Return one option per redraw, in random order, none twice before all were returned."""
        turn, place = divmod(self.index, len(options))
        order = randomness.stream(self.seed, name, turn).permutation(len(options))
        return options[int(order[place])]
