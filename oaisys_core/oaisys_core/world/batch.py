"""The current batch: its state, how that is rolled back, and how it is recorded to be restored."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json
from oaisys_core.output.records import previous_rig_poses
from oaisys_core.scene import PlacedCamera, PlacedLidar
from oaisys_core.types import ModuleMetadata, Pose, SampleOutline
from oaisys_core.world.module import World

MAX_METADATA_BYTES = 1 << 20
"""Largest size of the metadata in force, which is stored with every sample."""

DRAWN = "drawn"
"""Key of the metadata in force with what was drawn of the configuration."""

PARTS = ("sensor", "environment", "asset", "render", "custom")


@dataclass(frozen=True)
class BatchSeeds:
    """The seeds of a batch.

    Attributes:
        seed: Of its random draws.
        stage_seed: Of its ground and materials; another one on a reused stage.
        asset_seed: Of its objects; another one if they were kept from an earlier batch.
    """

    seed: int
    stage_seed: int
    asset_seed: int


@dataclass
class Batch:
    """A world, and what has been set since it was built.

    Attributes:
        metadata: All metadata since the batch began, merged.
        in_force: Metadata with which a new batch reaches the current state of the modules.
        sample_id: Id of the last sample; 0 before the first.
        last_rig_poses: By sensor name, the pose of the rig when that sensor last rendered.
        drawn: What was drawn of the configuration for this world, by path.
    """

    id: int
    seeds: BatchSeeds
    world: World = field(default_factory=World)
    metadata: ModuleMetadata = field(default_factory=ModuleMetadata)
    in_force: ModuleMetadata = field(default_factory=ModuleMetadata)
    sample_id: int = 0
    last_rig_poses: Mapping[str, Pose] = field(default_factory=dict)
    drawn: Mapping[str, Any] = field(default_factory=dict)

    def to_state(self, rig_pose: Pose) -> dict[str, Any]:
        """Return JSON-compatible data from which `from_state` restores the batch."""
        return {
            "id": self.id,
            **vars(self.seeds),
            "sample_id": self.sample_id,
            "pose": _pose_to_state(rig_pose),
            "last_rig_poses": _poses_to_state(self.last_rig_poses),
            **_parts(self.in_force),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Batch:
        """Return the batch of a state, with an empty world; inverse: `to_state`.

        Raises:
            InvalidInputError: The state is damaged.
        """
        try:
            return cls._from_state(state)
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise InvalidInputError("state", state, f"the state of a world ({error!r})") from error

    @classmethod
    def _from_state(cls, state: Mapping[str, Any]) -> Batch:
        parts = {name: state[name] for name in PARTS}
        parts["sensor"] = {**state["sensor"], "pose": _pose_from_state(state["pose"])}
        return cls(
            id=int(state["id"]),
            seeds=BatchSeeds(
                seed=int(state["seed"]),
                stage_seed=int(state["stage_seed"]),
                asset_seed=int(state.get("asset_seed", state["seed"])),
            ),
            metadata=ModuleMetadata(**parts),
            sample_id=int(state["sample_id"]),
            last_rig_poses={n: _pose_from_state(p) for n, p in state["last_rig_poses"].items()},
        )


class Snapshot:
    """The attributes of some objects, which replace the values of their attributes at a change."""

    def __init__(self, *objects: object) -> None:
        self._states = [(each, dict(vars(each))) for each in objects]

    def restore(self) -> None:
        """Set all attributes back."""
        for each, state in self._states:
            vars(each).clear()
            vars(each).update(state)


def metadata_text(metadata: ModuleMetadata, drawn: Mapping[str, Any] | None = None) -> str:
    """Return metadata as canonical JSON, without the pose, which is stored separately.

    Args:
        metadata: The metadata.
        drawn: What was drawn of the configuration, for readers: it is drawn again from the seeds.

    Raises:
        InvalidInputError: It is longer than `MAX_METADATA_BYTES`, or not representable in JSON.
    """
    given = {name: part for name, part in _parts(metadata).items() if part}
    given |= {DRAWN: dict(drawn)} if drawn else {}
    text = json.dumps(given, default=_plain, sort_keys=True, separators=(",", ":"))
    if len(text) > MAX_METADATA_BYTES:
        expected = f"at most {MAX_METADATA_BYTES} bytes of metadata in force, as JSON"
        raise InvalidInputError("metadata", f"{len(text)} bytes", expected)
    return text


def previous_poses_text(
    sensors: Iterable[PlacedCamera | PlacedLidar], last_rig_poses: Mapping[str, Pose]
) -> str:
    """Return, as JSON, the previous rig pose of each sensor whose data depend on it."""
    dependent = [sensor.name for sensor in sensors if sensor.depends_on_past]
    poses = _poses_to_state({n: last_rig_poses[n] for n in dependent if n in last_rig_poses})
    return json.dumps(poses, sort_keys=True, separators=(",", ":")) if poses else ""


def state_of(outline: SampleOutline) -> dict[str, Any]:
    """Return the state of a simulation that has just rendered a recorded sample.

    It equals `Simulation.state`, except that ``last_rig_poses`` are those before the sample.

    Raises:
        InvalidInputError: The record was written by an earlier version, which stored too little.
    """
    how = outline.provenance
    if not how.metadata_json:
        expected = "the metadata in force, which the version that wrote this record did not store"
        raise InvalidInputError("provenance.metadata_json", how.metadata_json, expected)
    metadata = _mapping("provenance.metadata_json", how.metadata_json)
    batch = {
        "id": outline.batch_id,
        "seed": how.batch_seed,
        "stage_seed": how.stage_seed,
        "asset_seed": how.asset_seed,
        "sample_id": outline.sample_id,
        "pose": _pose_to_state(outline.rig_pose),
        "last_rig_poses": _poses_to_state(previous_rig_poses(how)),
        **{name: metadata.get(name, {}) for name in PARTS},
    }
    return {"last_batch_id": outline.batch_id, "batch": batch}


def _parts(metadata: ModuleMetadata) -> dict[str, dict[str, Any]]:
    """Return the parts of metadata, without the pose."""
    parts = {name: dict(getattr(metadata, name) or {}) for name in PARTS}
    parts["sensor"].pop("pose", None)
    return parts


def _poses_to_state(poses: Mapping[str, Pose]) -> dict[str, Any]:
    return {name: _pose_to_state(pose) for name, pose in poses.items()}


def _pose_to_state(pose: Pose) -> dict[str, Any]:
    """Return a pose as JSON-compatible data."""
    return {"position_m": list(pose.position_m), "quat_xyzw": list(pose.quat_xyzw)}


def _pose_from_state(state: Mapping[str, Any]) -> Pose:
    return Pose(tuple(state["position_m"]), tuple(state["quat_xyzw"]))


def _mapping(field: str, text: str) -> Mapping[str, Any]:
    try:
        found = parse_json(text)
    except ValueError as error:
        raise InvalidInputError(field, text[:80], f"JSON ({error})") from error
    if not isinstance(found, Mapping):
        raise InvalidInputError(field, text[:80], "a JSON object")
    return found


def _plain(value: Any) -> Any:
    """Return a value from a caller in the same process in a form that JSON supports."""
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return dict(value)
    raise InvalidInputError("metadata", repr(value), "a value that JSON can represent")
