"""Reading the files that `SampleWriter` writes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oaisys_core.files.names import path_inside
from oaisys_core.output.images import read_image
from oaisys_core.output.points import read_points
from oaisys_core.output.record_types import Label, LabelId, SampleFile, check_as, check_camera
from oaisys_core.output.records import (
    intrinsics_from_record,
    odometry_from_record,
    pose_from_record,
    provenance_from_record,
    read_json,
)
from oaisys_core.output.writer import INTRINSICS, LABELS, SAMPLE_DATA
from oaisys_core.types import Frame, LidarScan, PinholeIntrinsics, Sample


@dataclass(frozen=True)
class _Labels:
    labels: dict[LabelId, Label]


def read_samples(batch: Path) -> Iterator[Sample]:
    """Yield the samples in a batch folder in order; inverse: `SampleWriter.write`.

    Raises:
        InvalidInputError: A file cannot be read.
    """
    for path in sorted((batch / SAMPLE_DATA).glob("*.json")):
        yield read_sample(batch, int(path.stem))


def read_sample(batch: Path, sample_id: int) -> Sample:
    """Return one sample of a batch folder.

    Raises:
        InvalidInputError: It does not exist, or a file cannot be read.
    """
    path = batch / SAMPLE_DATA / f"{sample_id:04d}.json"
    record = read_json(path)
    check_as(SampleFile, record, str(path))
    frames = tuple(
        Frame(
            sensor,
            modality,
            read_image(path_inside(batch, file), modality),
            intrinsics_from_record(entry["intrinsics"]),
            np.array(entry["T_map_camera"]),
        )
        for sensor, entry in record["sensors"].items()
        for modality, file in entry["images"].items()
    )
    scans = tuple(
        LidarScan(
            sensor, read_points(path_inside(batch, entry["points"])), np.array(entry["T_map_lidar"])
        )
        for sensor, entry in record.get("lidars", {}).items()
    )
    return Sample(
        batch_id=record["batch_id"],
        sample_id=record["sample_id"],
        rig_pose=pose_from_record(record["rig_pose"]),
        frames=frames,
        render_time_s=record["render_time_s"],
        provenance=provenance_from_record(record["provenance"]),
        odometry=odometry_from_record(record.get("odometry")),
        scans=scans,
    )


def read_intrinsics(batch: Path, sensor: str) -> PinholeIntrinsics:
    """Return the intrinsics of a sensor at its first sample of the batch."""
    path = path_inside(batch, sensor, INTRINSICS)
    return intrinsics_from_record(check_camera(read_json(path), str(path)))


def read_labels(batch: Path) -> dict[int, str]:
    """Return the label names of a batch by semantic id."""
    path = batch / LABELS
    return check_as(_Labels, {"labels": read_json(path)}, str(path)).labels
