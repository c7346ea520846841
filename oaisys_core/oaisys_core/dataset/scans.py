"""Lidar scans of a data set: their records, and their files in shards.

A scan's points are a PCD file (`oaisys_core.output.points`) in its world's tar file. Its record is
a line of ``shards/world_000012.scans.jsonl``, which only worlds with lidars have.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from oaisys_core.dataset.manifest import (
    VARYING_FIELDS,
    contradictions,
    record_fields,
    recorded_outline,
    signed,
)
from oaisys_core.output.points import decode_points, encode_points
from oaisys_core.output.record_types import (
    Bytes,
    Label,
    Matrix,
    Name,
    Number,
    Place,
    PoseFields,
    ProvenanceFields,
    Seconds,
    Seed,
    Sha256,
    SplitName,
    checked_as,
)
from oaisys_core.types import POINTS, FloatArray, LidarScan, SampleOutline


@dataclass(frozen=True)
class PointsRecord:
    """A file of points in a shard.

    Attributes:
        file: Name of the member of the tar file.
        offset, size: Where the file's bytes begin in the tar file, and how many they are.
        sha256: Hash of the file's bytes.
        count: Number of points.
        fields: Names of their fields, see `oaisys_core.types.point_dtype`.
    """

    file: Name
    offset: Bytes
    size: Bytes
    sha256: Sha256
    count: Number
    fields: Annotated[tuple[Name, ...], Field(min_length=3, max_length=100)]


@dataclass(frozen=True)
class ScanRecord:
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

    scan_id: Name
    world: Place
    view: Place
    sensor: Name
    split: SplitName
    world_seed: Seed
    config_sha256: Label
    T_map_lidar: Matrix
    stamp_s: Seconds
    points: PointsRecord
    provenance: ProvenanceFields
    rig_pose: PoseFields
    worker: Label
    seconds: Seconds
    software: Mapping[Label, Label]

    @property
    def pose(self) -> FloatArray:
        """``T_map_lidar`` as a (4, 4) array."""
        return np.array(self.T_map_lidar, np.float64)

    def contradictions(self) -> Iterator[tuple[str, object, str]]:
        """Yield each field that contradicts others: its name, its value, what was expected."""
        yield from contradictions(self, self.scan_id, "scan_id", "T_map_lidar")

    def outline(self) -> SampleOutline:
        """Return the outline from which `Simulation.repeat` makes this scan again."""
        return recorded_outline(self, (POINTS,))

    def to_json(self) -> str:
        """Return the record and its hash as one line, without its end; inverse: `from_json`."""
        return signed(asdict(self), VARYING_FIELDS)

    @classmethod
    def from_json(cls, line: str | bytes, name: str = "line") -> ScanRecord:
        """Return the record of a line; errors call it ``name``.

        Raises:
            InvalidInputError: It is not the record of a scan.
        """
        return checked_as(cls, record_fields(cls, line, name), name)


class EncodedScan(NamedTuple):
    """A scan whose points are a file in memory; the offset in its record is 0."""

    record: ScanRecord
    file: bytes


def encoded_points(scan_id: str, scan: LidarScan) -> tuple[PointsRecord, bytes]:
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
