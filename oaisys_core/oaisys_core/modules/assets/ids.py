"""The instance ids that a configuration may assign."""

from __future__ import annotations

from oaisys_core.config.sections.assets import AssetsConfig
from oaisys_core.scatter.ids import (
    FIRST_MOVER_ID,
    FIRST_OBJECT_ID,
    group_blocks,
    rock_block,
)


class InstanceIdPlan:
    """Assigns instance ids to everything in a configuration, whatever the numbers drawn."""

    def __init__(self, config: AssetsConfig) -> None:
        most = sum(group.count[1] for group in config.rocks) + len(config.primitives)
        self.rocks = rock_block(most)
        self.groups = group_blocks(self.rocks, [group.count[1] for group in config.groups])
        self._fixed = (
            range(FIRST_OBJECT_ID, FIRST_OBJECT_ID + len(config.objects)),
            range(FIRST_MOVER_ID, FIRST_MOVER_ID + len(config.movers)),
        )

    def kind_of(self, instance_id: int) -> str:
        """Return ``rock``, ``group``, ``object`` or ``mover``."""
        for ids, kind in zip(self._fixed, ("object", "mover"), strict=True):
            if instance_id in ids:
                return kind
        return "rock" if self.rocks.holds(instance_id) else "group"

    def knows(self, instance_id: int) -> bool:
        """Return whether a batch of this configuration may use this id."""
        in_blocks = any(block.holds(instance_id) for block in (self.rocks, *self.groups))
        return in_blocks or any(instance_id in ids for ids in self._fixed)
