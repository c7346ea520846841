"""Instance ids that stay when something is added elsewhere.

The rocks and primitives count from 1, each group from a block of its own, objects and movers from
fixed ones; what metadata adds takes its id from its name. All of it is below 65536 in worlds of
usual size, so that ids fit 16-bit images, and below 2**31 in any.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ROCKS = 10_000
"""Ids kept for rocks and primitives, unless the configuration has more of them."""

FIRST_OBJECT_ID, FIRST_MOVER_ID = 60_001, 62_501
AFTER_OBJECTS_ID = 65_536
"""First id that is not kept for objects and movers."""

FAR = 2**20
"""Size of the far blocks, one per group: for what does not fit below the first of them."""

FIRST_ADDED_ID = 2**30


class IdBlock(NamedTuple):
    """Where the ids of a group begin, how many it holds, and where those beyond it begin."""

    first: int
    size: int
    far_first: int

    def ids(self, count: int) -> NDArray[np.uint32]:
        """Return the ids of the first ``count`` things of the group."""
        index = np.arange(count)
        beyond = self.far_first + index - self.size
        return np.where(index < self.size, self.first + index, beyond).astype(np.uint32)

    def holds(self, instance_id: int) -> bool:
        """Return whether an id may be one of the group's."""
        is_far = self.far_first <= instance_id < (self.far_first // FAR + 1) * FAR
        return self.first <= instance_id < self.first + self.size or is_far


def rock_block(count: int) -> IdBlock:
    """Return the block of rocks and primitives, of which the configuration has up to ``count``."""
    return IdBlock(1, min(max(ROCKS, count), FIRST_OBJECT_ID - 1), FAR)


def group_blocks(rocks: IdBlock, counts: Sequence[int]) -> list[IdBlock]:
    """Return the blocks of groups; one does not depend on those after it.

    Args:
        rocks: The block before them.
        counts: How many things each group has at most, without metadata's factors.
    """
    blocks = []
    first = rocks.first + rocks.size
    for number, count in enumerate(counts, start=2):
        if first < AFTER_OBJECTS_ID and first + count > FIRST_OBJECT_ID:
            first = AFTER_OBJECTS_ID
        if first + count > FAR:
            blocks.append(IdBlock(number * FAR, count, number * FAR + count))
            continue
        blocks.append(IdBlock(first, count, number * FAR))
        first += count
    return blocks


def added_id(name: str) -> int:
    """Return the id of a thing that metadata adds under a name."""
    digest = hashlib.sha256(name.encode()).digest()
    return FIRST_ADDED_ID + int.from_bytes(digest[:8], "big") % FIRST_ADDED_ID
