"""Conversion of a sample's data other than images and points to JSON and back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.documents import parse_json, read_text
from oaisys_core.output.files import write_text
from oaisys_core.scene.rig_motion import RigMotion
from oaisys_core.types import Odometry, PinholeIntrinsics, Pose, Provenance, Sample

MAX_RECORD_BYTES = 64_000_000
"""Size of a sample's or an export's record."""


def sample_record(sample: Sample, files: Mapping[tuple[str, str], str]) -> dict[str, Any]:
    """Return the record of a sample; ``files`` are its files by sensor and modality."""
    sensors: dict[str, Any] = {}
    for frame in sample.frames:
        sensor = sensors.setdefault(
            frame.sensor,
            {
                "intrinsics": intrinsics_record(frame.intrinsics),
                "T_map_camera": frame.T_map_camera.tolist(),
                "images": {},
            },
        )
        sensor["images"][frame.modality] = files[frame.sensor, frame.modality]
    lidars = {
        scan.sensor: {
            "T_map_lidar": scan.T_map_lidar.tolist(),
            "points": files[scan.sensor, scan.modality],
        }
        for scan in sample.scans
    }
    return {
        "batch_id": sample.batch_id,
        "sample_id": sample.sample_id,
        "rig_pose": asdict(sample.rig_pose),
        "odometry": None if sample.odometry is None else asdict(sample.odometry),
        "provenance": asdict(sample.provenance),
        "render_time_s": sample.render_time_s,
        "sensors": sensors,
        "lidars": lidars,
    }


def intrinsics_record(intrinsics: PinholeIntrinsics) -> dict[str, Any]:
    """Return the fields of a camera and its K matrix; inverse: `intrinsics_from_record`."""
    return {**asdict(intrinsics), "K": np.asarray(intrinsics.K).tolist()}


def intrinsics_from_record(record: Mapping[str, Any]) -> PinholeIntrinsics:
    """Return the intrinsics of a record."""
    fields = {name: value for name, value in record.items() if name != "K"}
    return PinholeIntrinsics(**{**fields, "distortion": tuple(fields["distortion"])})


def pose_from_record(record: Mapping[str, Any]) -> Pose:
    """Return the pose of a record."""
    return Pose(tuple(record["position_m"]), tuple(record["quat_xyzw"]))


def odometry_from_record(record: Mapping[str, Any] | None) -> Odometry | None:
    """Return the odometry of a record, if it has one."""
    if record is None:
        return None
    return Odometry(pose_from_record(record["pose"]), record["sigma_m"], record["sigma_rad"])


def provenance_from_record(record: Mapping[str, Any]) -> Provenance:
    """Return the provenance of a record.

    Raises:
        InvalidInputError: It has other fields.
    """
    try:
        return Provenance(**record)
    except TypeError as error:
        expected = f"the fields of a sample's provenance ({error})"
        raise InvalidInputError("provenance", sorted(record), expected) from error


def previous_rig_poses(provenance: Provenance) -> dict[str, Pose]:
    """Return the rig's pose at the previous sample of each sensor whose data depend on it.

    Raises:
        InvalidInputError: The record is damaged.
    """
    text = provenance.previous_poses_json or "{}"
    try:
        return {name: pose_from_record(pose) for name, pose in parse_json(text).items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        expected = f"the JSON of poses by the sensor's name ({quote(error)})"
        raise InvalidInputError("provenance.previous_poses_json", text[:80], expected) from error


def motion_to_record(provenance: Provenance) -> RigMotion | None:
    """Return the rig's motion during a sample; None if nothing measured depends on it.

    Raises:
        InvalidInputError: The record is damaged.
    """
    return RigMotion.from_text(provenance.motion_json) if provenance.motion_json else None


def write_json(path: Path, record: object) -> None:
    """Write a record as a JSON file, atomically; inverse: `read_json`."""
    write_text(path, json.dumps(record, indent=2) + "\n")


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        InvalidInputError: It cannot be read.
    """
    try:
        return parse_json(read_text(path, MAX_RECORD_BYTES))
    except (OSError, ValueError) as error:
        raise InvalidInputError("file", str(path), f"a readable JSON file ({error})") from error
