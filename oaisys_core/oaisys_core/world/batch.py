"""The current batch, and how it is saved, restored and rolled back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from oaisys_core.backend.base import Backend
from oaisys_core.module import Module, World
from oaisys_core.types import ModuleMetadata, Pose


@dataclass
class Batch:
    """A world, and what has been set since it was built.

    Attributes:
        seed: Seed of its random draws.
        stage_seed: Seed of its ground and materials; another one on a reused stage.
        asset_seed: Seed of its objects; another one if they were kept from an earlier batch.
        metadata: All metadata since the batch began, merged.
        sample_id: Id of the last sample; 0 before the first.
        last_rig_poses: By camera name, the pose of the rig when that camera last rendered.
    """

    id: int
    seed: int
    stage_seed: int
    asset_seed: int
    world: World = field(default_factory=World)
    metadata: ModuleMetadata = field(default_factory=ModuleMetadata)
    sample_id: int = 0
    last_rig_poses: dict[str, Pose] = field(default_factory=dict)

    def to_state(self, rig_pose: Pose, in_force: ModuleMetadata) -> dict[str, Any]:
        """Return JSON-compatible data from which `from_state` restores the batch.

        Args:
            rig_pose: Current pose of the rig.
            in_force: Metadata with which a new batch reaches the state of this one.
        """
        return {
            "id": self.id,
            "seed": self.seed,
            "stage_seed": self.stage_seed,
            "asset_seed": self.asset_seed,
            "sample_id": self.sample_id,
            "pose": pose_to_state(rig_pose),
            "last_rig_poses": {n: pose_to_state(p) for n, p in self.last_rig_poses.items()},
            "sensor": {k: v for k, v in (in_force.sensor or {}).items() if k != "pose"},
            "environment": dict(in_force.environment or {}),
            "asset": dict(in_force.asset or {}),
            "render": dict(in_force.render or {}),
            "custom": dict(in_force.custom),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Batch:
        """Return the batch of a state, with an empty world; inverse: `to_state`."""
        metadata = ModuleMetadata(
            sensor={**state["sensor"], "pose": _pose_from_state(state["pose"])},
            environment=state["environment"],
            asset=state["asset"],
            render=state["render"],
            custom=state["custom"],
        )
        return cls(
            id=int(state["id"]),
            seed=int(state["seed"]),
            stage_seed=int(state["stage_seed"]),
            asset_seed=int(state.get("asset_seed", state["seed"])),
            metadata=metadata,
            sample_id=int(state["sample_id"]),
            last_rig_poses={n: _pose_from_state(p) for n, p in state["last_rig_poses"].items()},
        )


class ModuleSnapshot:
    """The state of all modules; modules replace their attributes and never mutate them."""

    def __init__(self, modules: Sequence[Module]) -> None:
        self._states = [(module, dict(vars(module))) for module in modules]

    def restore(self) -> None:
        """Restore the state of the modules."""
        for module, state in self._states:
            vars(module).clear()
            vars(module).update(state)


class SampleSnapshot:
    """The state of the simulation before a sample, to which it can be rolled back."""

    def __init__(self, batch: Batch, modules: Sequence[Module], backend: Backend) -> None:
        """Save the state; the batch's world becomes a copy that the sample may change."""
        self._batch = batch
        self._backend = backend
        self._modules = ModuleSnapshot(modules)
        self._world, self._metadata = batch.world, batch.metadata
        self._sample_id, self._last_rig_poses = batch.sample_id, dict(batch.last_rig_poses)
        labels = dict(self._world.semantic_labels)
        batch.world = replace(self._world, semantic_labels=labels)

    def restore(self) -> None:
        """Roll the simulation back; may be called once."""
        batch = self._batch
        changed = batch.world.scene()
        self._modules.restore()
        batch.world, batch.metadata = self._world, self._metadata
        batch.sample_id, batch.last_rig_poses = self._sample_id, self._last_rig_poses
        if changed.differs_from(self._world.scene()):
            self._backend.update(self._world.scene())


def pose_to_state(pose: Pose) -> dict[str, Any]:
    """Return a pose as JSON-compatible data."""
    return {"position_m": list(pose.position_m), "quat_xyzw": list(pose.quat_xyzw)}


def _pose_from_state(state: Mapping[str, Any]) -> Pose:
    return Pose(tuple(state["position_m"]), tuple(state["quat_xyzw"]))
