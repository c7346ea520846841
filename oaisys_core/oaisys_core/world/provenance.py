"""Provenance: what is recorded of a sample so that it can be rendered again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FLOW, RGB, ModuleMetadata, Pose, SampleOutline
from oaisys_core.world.batch import pose_to_state

MAX_METADATA_BYTES = 1 << 20
"""Largest size of the metadata in force, which is stored with every sample."""

PARTS = ("sensor", "environment", "asset", "render", "custom")


def metadata_text(metadata: ModuleMetadata) -> str:
    """Return the metadata in force as canonical JSON, without the pose, which is stored separately.

    Raises:
        InvalidInputError: It is longer than `MAX_METADATA_BYTES`, or not representable in JSON.
    """
    parts = {name: dict(getattr(metadata, name) or {}) for name in PARTS}
    parts["sensor"].pop("pose", None)
    given = {name: part for name, part in parts.items() if part}
    text = json.dumps(given, default=_plain, sort_keys=True, separators=(",", ":"))
    if len(text) > MAX_METADATA_BYTES:
        expected = f"at most {MAX_METADATA_BYTES} bytes of metadata in force, as JSON"
        raise InvalidInputError("metadata", f"{len(text)} bytes", expected)
    return text


def previous_poses_text(cameras: Iterable[PlacedCamera], last_rig_poses: Mapping[str, Pose]) -> str:
    """Return, as JSON, the previous rig pose of each camera whose images depend on it."""
    poses = {
        camera.name: pose_to_state(last_rig_poses[camera.name])
        for camera in cameras
        if camera.name in last_rig_poses and depends_on_past(camera)
    }
    return json.dumps(poses, sort_keys=True, separators=(",", ":")) if poses else ""


def depends_on_past(camera: PlacedCamera) -> bool:
    """Return whether the images of a camera depend on its pose at the previous sample."""
    return FLOW in camera.modalities or bool(camera.shutter_share and RGB in camera.modalities)


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
    previous = _mapping("provenance.previous_poses_json", how.previous_poses_json or "{}")
    batch = {
        "id": outline.batch_id,
        "seed": how.batch_seed,
        "stage_seed": how.stage_seed,
        "asset_seed": how.asset_seed,
        "sample_id": outline.sample_id,
        "pose": pose_to_state(outline.rig_pose),
        "last_rig_poses": previous,
        **{name: metadata.get(name, {}) for name in PARTS},
    }
    return {"last_batch_id": outline.batch_id, "batch": batch}


def _mapping(field: str, text: str) -> Mapping[str, Any]:
    try:
        found = json.loads(text)
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
