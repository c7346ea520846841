"""Lidar scans of a data set: their records, and their files in shards.

A scan's points are a PCD file (`oaisys_core.output.points`) in its world's tar file. Its record is
a line of ``shards/world_000012.scans.jsonl``, which only worlds with lidars have.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.dataset.manifest import (
    VARYING_FIELDS,
    record_fields,
    recorded_outline,
    shortened,
    signed,
)
from oaisys_core.errors import InvalidInputError
from oaisys_core.output.points import decode_points, encode_points
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

    file: str
    offset: int
    size: int
    sha256: str
    count: int
    fields: tuple[str, ...]


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

    scan_id: str
    world: int
    view: int
    sensor: str
    split: str
    world_seed: int
    config_sha256: str
    T_map_lidar: tuple[tuple[float, ...], ...]
    stamp_s: float
    points: PointsRecord
    provenance: Mapping[str, Any]
    rig_pose: Mapping[str, Any]
    worker: str
    seconds: float
    software: Mapping[str, str]

    @property
    def pose(self) -> FloatArray:
        """``T_map_lidar`` as a (4, 4) array."""
        return np.array(self.T_map_lidar, np.float64)

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
        data = record_fields(cls, line, name)
        try:
            rows = tuple(tuple(float(value) for value in row) for row in data["T_map_lidar"])
            points = data["points"]
            points = PointsRecord(**{**points, "fields": tuple(points["fields"])})
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InvalidInputError(
                name, shortened(line), f"a scan's record ({error!r})"
            ) from error
        return cls(**{**data, "T_map_lidar": rows, "points": points})


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
