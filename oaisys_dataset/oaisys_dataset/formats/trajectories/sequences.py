"""Frames of a data set as sequences: one camera in one world, in the order of time."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.images import MAX_IN_PNG, encode_image
from oaisys_core.types import DEPTH, RGB, FloatArray, PinholeIntrinsics
from oaisys_dataset.formats.base import write_file
from oaisys_dataset.records import world_name
from oaisys_dataset.shards import read_pixels

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord

LOST_DEPTH = "pixels whose depth is too large for 16 bits"
"""Name of their count."""


@dataclass(frozen=True)
class CameraSequence:
    """The frames of one camera in one world, in the order of their views.

    Attributes:
        records: Of the frames.
    """

    world: int
    sensor: str
    split: str
    records: tuple[FrameRecord, ...]

    @property
    def name(self) -> str:
        """The name of the sequence's folder, such as ``world_000012_camera``."""
        return f"{world_name(self.world)}_{self.sensor}"

    @property
    def views(self) -> tuple[int, ...]:
        """The number of each frame's view."""
        return tuple(record.view for record in self.records)

    @property
    def stamps_s(self) -> tuple[float, ...]:
        """The simulated time of each frame in its world."""
        return tuple(record.stamp_s for record in self.records)

    @property
    def poses(self) -> FloatArray:
        """The (N, 4, 4) poses ``T_map_camera`` of the optical frame."""
        return np.array([record.pose for record in self.records])

    def intrinsics(self) -> PinholeIntrinsics:
        """Return the camera of all frames.

        Raises:
            InvalidInputError: It changes within the sequence.
        """
        cameras = {record.camera for record in self.records}
        if len(cameras) > 1:
            expected = "one camera matrix for all views of a world; this format has no other"
            raise InvalidInputError(self.name, f"{len(cameras)} different ones", expected)
        return cameras.pop()


def camera_sequences(
    records: Iterable[FrameRecord],
) -> Iterator[tuple[int, list[CameraSequence]]]:
    """Yield each world with its sequences; cameras are in the order of the manifest.

    Only one world's records are in memory at a time.

    Raises:
        InvalidInputError: The times of a sequence do not increase.
    """
    for world, frames in itertools.groupby(records, lambda record: record.world):
        by_sensor: dict[str, list[FrameRecord]] = {}
        for record in frames:
            by_sensor.setdefault(record.sensor, []).append(record)
        yield world, [_sequence(each) for each in by_sensor.values()]


def _sequence(records: list[FrameRecord]) -> CameraSequence:
    first = records[0]
    in_order = tuple(sorted(records, key=lambda record: record.view))
    sequence = CameraSequence(first.world, first.sensor, first.split, in_order)
    if any(np.diff(sequence.stamps_s) <= 0):
        expected = "times that increase"
        raise InvalidInputError(f"{sequence.name}: stamp_s", sequence.stamps_s, expected)
    return sequence


def worlds_with_color(records: Iterable[FrameRecord]) -> Iterator[tuple[int, list[FrameRecord]]]:
    """Yield each world that has colour images, with their frames, one camera after the other.

    Raises:
        InvalidInputError: See `camera_sequences`.
    """
    for world, cameras in camera_sequences(records):
        frames = [record for camera in cameras for record in camera.records]
        colored = [record for record in frames if RGB in record.images]
        if colored:
            yield world, colored


def write_depth_png(
    folder: Path, name: str, record: FrameRecord, file: bytes, units_per_m: float
) -> int:
    """Write a frame's depth as a 16-bit PNG; return the number of pixels that do not fit into it.

    Args:
        folder: Of the export.
        name: Of the PNG file in it.
        record: Of the frame.
        file: The frame's file of depth in its shard.
        units_per_m: Units of the PNG file in a metre.
    """
    depth_m = read_pixels(file, DEPTH, record.images[DEPTH].file)
    units, lost = depth_units(depth_m, units_per_m)
    write_file(folder, name, encode_image(units))
    return lost


def depth_units(depth_m: NDArray[Any], units_per_m: float) -> tuple[NDArray[np.uint16], int]:
    """Return depth in whole units, and the number of pixels whose depth does not fit.

    Those pixels are 0, like the pixels without a measurement.
    """
    units = np.rint(depth_m.astype(np.float64) * units_per_m)
    fits = (units >= 0) & (units <= MAX_IN_PNG)
    lost = int(np.count_nonzero(np.isfinite(units) & ~fits))
    return np.where(fits, units, 0).astype(np.uint16), lost


def numbers(values: Iterable[float], separator: str = " ") -> str:
    """Return numbers as text from which they are read back without a change."""
    return separator.join(repr(float(value)) for value in values)


def write_lines(folder: Path, name: str, head: str, lines: Iterable[str]) -> None:
    """Write a text file; ``head`` is its first line, a comment, or empty for none."""
    text = [head] if head else []
    write_file(folder, name, "".join(f"{line}\n" for line in (*text, *lines)).encode())


def rate_hz(stamps_s: Sequence[float]) -> float:
    """Return the rate of images; 1 if there is only one."""
    return 1.0 if len(stamps_s) < 2 else float(1.0 / np.median(np.diff(stamps_s)))
