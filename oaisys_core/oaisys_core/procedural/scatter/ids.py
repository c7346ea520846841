"""Instance ids that do not change when something is added elsewhere.

Rocks and primitives count from 1; each group has its own block of ids; objects and movers count
from fixed ids; an object that metadata adds gets its id from its name. In worlds of usual size the
ids of configured objects are below 65536, so that they fit into 16-bit images; all ids are below
2**31.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.assets import AssetsConfig

ROCKS = 10_000
"""Number of ids reserved for rocks and primitives, unless the configuration has more."""

FIRST_OBJECT_ID, FIRST_MOVER_ID = 60_001, 62_501
AFTER_OBJECTS_ID = 65_536
"""First id after those reserved for objects and movers."""

FAR = 2**20
"""Size of the overflow blocks, one per group, for ids that do not fit elsewhere."""

FIRST_ADDED_ID = 2**30

ON_LAND = 1000
"""Number of ids of a group, or of rocks of a kind, for what lies on the land around the stage."""


NO_OVERFLOW = -FAR
"""Where the overflow of blocks begins that have none: no id is so low."""


class IdBlock(NamedTuple):
    """The ids of a group: ``size`` ids from ``first``, and the overflow from ``far_first``."""

    first: int
    size: int
    far_first: int

    def ids(self, count: int) -> NDArray[np.uint32]:
        """Return the ids of the first ``count`` instances of the group."""
        index = np.arange(count)
        beyond = self.far_first + index - self.size
        return np.where(index < self.size, self.first + index, beyond).astype(np.uint32)

    def holds(self, instance_id: int) -> bool:
        """Return whether an id may belong to the group."""
        is_far = self.far_first <= instance_id < (self.far_first // FAR + 1) * FAR
        return self.first <= instance_id < self.first + self.size or is_far


def rock_block(count: int) -> IdBlock:
    """Return the block of rocks and primitives, given their largest number."""
    return IdBlock(1, min(max(ROCKS, count), FIRST_OBJECT_ID - 1), FAR)


def group_blocks(rocks: IdBlock, counts: Sequence[int]) -> list[IdBlock]:
    """Return the blocks of groups; a block does not depend on later groups.

    Args:
        rocks: The block of the rocks.
        counts: Largest configured number of instances of each group.
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


def land_blocks(groups: Sequence[IdBlock]) -> list[IdBlock]:
    """Return the blocks of what groups have on the land: below the objects' ids, the first on top.

    Where the groups' own ids reach so far, they are the last ones of the groups' overflow blocks.
    """
    ends = [each.first + each.size for each in groups if each.first < FIRST_OBJECT_ID]
    blocks = []
    for number, group in enumerate(groups, start=1):
        first = FIRST_OBJECT_ID - number * ON_LAND
        if first < max(ends, default=0):
            first = (group.far_first // FAR + 1) * FAR - ON_LAND
        blocks.append(IdBlock(first, ON_LAND, NO_OVERFLOW))
    return blocks


def rock_land_blocks(rocks: IdBlock, count: int, kinds: int) -> list[IdBlock]:
    """Return the blocks of what rocks of each kind have on the land: the last ones of the rocks'.

    Where the ``count`` rocks of the stage need these, they are the last ones of the overflow block.
    """
    end = rocks.first + rocks.size
    if count + kinds * ON_LAND > rocks.size:
        end = (rocks.far_first // FAR + 1) * FAR
    firsts = [end - number * ON_LAND for number in range(1, kinds + 1)]
    return [IdBlock(first, ON_LAND, NO_OVERFLOW) for first in firsts]


class InstanceIdPlan:
    """Assigns instance ids to everything in a configuration, whatever the numbers drawn."""

    def __init__(self, config: AssetsConfig) -> None:
        most = sum(group.count[1] for group in config.rocks) + len(config.primitives)
        rocks = rock_block(most)
        self.rock_land = rock_land_blocks(rocks, most, len(config.rocks))
        lowest = min((each.first for each in self.rock_land), default=FAR)
        self.rocks = rocks._replace(size=min(rocks.size, lowest - rocks.first))
        self.groups = group_blocks(rocks, [group.count[1] for group in config.groups])
        self.land = land_blocks(self.groups)
        self._fixed = (
            range(FIRST_OBJECT_ID, FIRST_OBJECT_ID + len(config.objects)),
            range(FIRST_MOVER_ID, FIRST_MOVER_ID + len(config.movers)),
        )

    def kind_of(self, instance_id: int) -> str:
        """Return ``rock``, ``group``, ``object`` or ``mover``."""
        for ids, kind in zip(self._fixed, ("object", "mover"), strict=True):
            if instance_id in ids:
                return kind
        rocks = (self.rocks, *self.rock_land)
        return "rock" if any(block.holds(instance_id) for block in rocks) else "group"

    def knows(self, instance_id: int) -> bool:
        """Return whether a batch of this configuration may use this id."""
        blocks = (self.rocks, *self.rock_land, *self.groups, *self.land)
        in_blocks = any(block.holds(instance_id) for block in blocks)
        return in_blocks or any(instance_id in ids for ids in self._fixed)


def id_of_added(name: str) -> int:
    """Return the id of an object that metadata adds under a name."""
    digest = hashlib.sha256(name.encode()).digest()
    return FIRST_ADDED_ID + int.from_bytes(digest[:8], "big") % FIRST_ADDED_ID
