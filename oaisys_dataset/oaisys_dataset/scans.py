"""Lidar scans of a data set: their records, and their files in shards.

A scan's points are a PCD file (`oaisys_core.output.points`) in its world's tar file. Its record is
a line of ``shards/world_000012.scans.jsonl``, which only worlds with lidars have.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

from numpy.typing import NDArray
from pydantic import Field

from oaisys_core.output.points import decode_points, encode_points
from oaisys_core.output.record_types import (
    Label,
    Matrix,
    Name,
    Number,
    Ordinal,
    PoseFields,
    ProvenanceFields,
    Seconds,
    Seed,
    Sha256,
    SplitName,
)
from oaisys_core.types import POINTS, LidarScan
from oaisys_dataset.records import FileRecord, SensorRecord


@dataclass(frozen=True)
class PointsRecord(FileRecord):
    """A file of points in a shard.

    Attributes:
        count: Number of points.
        fields: Names of their fields, see `oaisys_core.types.point_dtype`.
    """

    count: Number
    fields: Annotated[tuple[Name, ...], Field(min_length=3, max_length=100)]


@dataclass(frozen=True)
class ScanRecord(SensorRecord):
    """What is recorded of one scan of one lidar, and how to make it again.

    Attributes:
        scan_id: Names it in the data set: ``000012_0003_lidar`` is world, view and lidar.
        sensor: Name of the lidar.
        T_map_lidar: 4x4 pose of the lidar at the beginning of the scan (x forward, y left, z up)
            in ``map``.
        points: Its points.
        world, view, split, world_seed, config_sha256, stamp_s: See `FrameRecord`.
        provenance, rig_pose, worker, seconds, software: See `FrameRecord`.
    """

    id_field: ClassVar[str] = "scan_id"
    pose_field: ClassVar[str] = "T_map_lidar"

    scan_id: Name
    world: Ordinal
    view: Ordinal
    sensor: Name
    split: SplitName
    world_seed: Seed
    config_sha256: Sha256
    T_map_lidar: Matrix
    stamp_s: Seconds
    points: PointsRecord
    provenance: ProvenanceFields
    rig_pose: PoseFields
    worker: Label
    seconds: Seconds
    software: Mapping[Label, Label]

    @property
    def modalities(self) -> Iterable[str]:
        """The points."""
        return (POINTS,)


class EncodedScan(NamedTuple):
    """A scan whose points are a file in memory; the offset in its record is 0."""

    record: ScanRecord
    file: bytes


def encode_scan_points(scan_id: str, scan: LidarScan) -> tuple[PointsRecord, bytes]:
    """Return the record and the file of a scan's points."""
    file = encode_points(scan)
    record = PointsRecord(
        file=f"{scan_id}.{POINTS}.pcd",
        offset=0,
        size=len(file),
        sha256=hashlib.sha256(file).hexdigest(),
        count=len(scan.data),
        fields=scan.data.dtype.names or (),
    )
    return record, file


def read_scan(record: ScanRecord, file: bytes) -> LidarScan:
    """Return a scan from the bytes of its file.

    Raises:
        InvalidInputError: They are no file of points.
    """
    points: NDArray[Any] = decode_points(file, record.points.file)
    return LidarScan(record.sensor, points, record.pose)
