"""What a batch and a sample change of a simulation, and how it is undone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from oaisys_core.backend.base import Backend
from oaisys_core.module import Module
from oaisys_core.world.batch import Batch


class ModuleStates:
    """What modules hold, as it is now; what they hold is replaced by them, never changed."""

    def __init__(self, modules: Sequence[Module]) -> None:
        self._states = [(module, dict(vars(module))) for module in modules]

    def restore(self) -> None:
        """Bring it back."""
        for module, state in self._states:
            vars(module).clear()
            vars(module).update(state)


class Undo:
    """The simulation as it is before a sample."""

    def __init__(self, batch: Batch, modules: Sequence[Module], backend: Backend) -> None:
        """Remember it; the batch's world is another object from here on."""
        self._batch = batch
        self._backend = backend
        self._modules = ModuleStates(modules)
        self._world, self._metadata = batch.world, batch.metadata
        self._sample_id, self._last_rig_poses = batch.sample_id, dict(batch.last_rig_poses)
        labels = dict(self._world.semantic_labels)
        batch.world = replace(self._world, semantic_labels=labels)

    def restore(self) -> None:
        """Bring it back; once."""
        batch = self._batch
        changed = batch.world.scene()
        self._modules.restore()
        batch.world, batch.metadata = self._world, self._metadata
        batch.sample_id, batch.last_rig_poses = self._sample_id, self._last_rig_poses
        if changed.differs_from(self._world.scene()):
            self._backend.update(self._world.scene())
