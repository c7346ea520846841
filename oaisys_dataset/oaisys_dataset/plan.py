"""Which worlds a data set has: their numbers, their seeds and their splits.

A world depends on the data set's seed and its own number alone. So it is the same whoever renders
it, in whatever order, and a data set that is continued with more worlds keeps those that it has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import fsum, isfinite

from oaisys_core.errors import InvalidInputError

MAX_WORLDS = 1_000_000
"""Worlds of a data set, and views of a world, at most."""

MAX_SPLIT_LETTERS = 64

SPLITS = "train=0.8,val=0.1,test=0.1"
"""The splits by default, as `parse_splits` reads them."""


@dataclass(frozen=True)
class WorldTask:
    """A world to render.

    Attributes:
        index: Its number in the data set, from 0. It is batch ``index + 1`` of `oaisys render`.
        seed: Seed of all its random draws.
        split: The split to which all its frames belong.
        views: Number of its views.
    """

    index: int
    seed: int
    split: str
    views: int


def parse_splits(text: str) -> dict[str, float]:
    """Return the share of each split, by name, from a text such as `SPLITS`.

    Raises:
        InvalidInputError: A part is malformed, a name comes twice, or the sum is not 1.
    """
    shares: dict[str, float] = {}
    for part in text.split(","):
        name, equals, number = (piece.strip() for piece in part.partition("="))
        share = _number(number)
        is_name = name.isidentifier() and len(name) <= MAX_SPLIT_LETTERS
        if not (is_name and equals and isfinite(share) and share > 0) or name in shares:
            expected = f"names that differ, each with a share above 0, such as {SPLITS}"
            raise InvalidInputError("splits", part.strip(), expected)
        shares[name] = share
    total = fsum(shares.values())
    if abs(total - 1) > 1e-6:
        raise InvalidInputError("splits", text, f"shares whose sum is 1, not {total:g}")
    return shares


def world_tasks(
    seed: int, worlds: int, views: int, splits: Mapping[str, float]
) -> Iterator[WorldTask]:
    """Yield the worlds of a data set.

    Among the first N worlds, for any N, each split has its share to within about one world. Which
    world comes when is random already, so the assignment need not be.

    Args:
        seed: Seed of the data set.
        worlds: Number of worlds.
        views: Number of views of each world.
        splits: Share of each split, by name.
    """
    from oaisys_core import randomness  # imports numpy, which `oaisys --help` does not need

    counts = dict.fromkeys(splits, 0)
    for index in range(worlds):
        split = max(splits, key=lambda name: splits[name] * (index + 1) - counts[name])
        counts[split] += 1
        yield WorldTask(index, randomness.batch_seed(seed, index + 1), split, views)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
