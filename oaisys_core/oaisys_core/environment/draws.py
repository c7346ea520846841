"""NamedDraws that depend on a seed, a redraw's number and a name alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from oaisys_core import randomness

T = TypeVar("T")


@dataclass(frozen=True)
class NamedDraws:
    """All random numbers of one redraw; names draw independently of each other.

    Attributes:
        seed: Of the batch.
        index: Counts the redraws of a batch, from 0.
    """

    seed: int
    index: int = 0

    def rng(self, name: str) -> np.random.Generator:
        """Return the generator of a name, always in its first state."""
        return randomness.stream(self.seed, name, self.index)

    def number(self, name: str, ends: tuple[float, float]) -> float:
        """Return a number that is uniform in the range."""
        least, most = ends
        return least if least == most else float(self.rng(name).uniform(least, most))

    def pick(self, name: str, things: Sequence[T]) -> T:
        """Return one of the things, any as likely as any other."""
        return things[int(self.rng(name).integers(len(things)))]

    def pick_shuffled(self, name: str, things: Sequence[T]) -> T:
        """Return another thing at each redraw until all had their turn, in random order."""
        turn, place = divmod(self.index, len(things))
        order = randomness.stream(self.seed, name, turn).permutation(len(things))
        return things[int(order[place])]
