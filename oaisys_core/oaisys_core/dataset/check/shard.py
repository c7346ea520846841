"""The check of one world's files: manifest, tar file, images and legend."""

from __future__ import annotations

import hashlib
import mmap
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.dataset.check.report import Finding
from oaisys_core.dataset.manifest import (
    DatasetInfo,
    FrameRecord,
    ImageRecord,
    WorldLegend,
    frame_id,
    is_intact,
)
from oaisys_core.dataset.places import StoragePlace
from oaisys_core.dataset.shards import (
    LEGEND,
    manifest_name,
    pixels_sha256,
    read_pixels,
    tar_name,
)
from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.output.records import pose_from_record, provenance_from_record
from oaisys_core.types import DEPTH, INSTANCE, RANGE, semantic_level

COPIED_BYTES = 1 << 26
"""Bytes of a remote file that are copied at once."""

ROTATION_TOLERANCE = 1e-6


@dataclass
class ShardResult:
    """What was found in the files of a world.

    Attributes:
        splits: The splits that its frames name.
        seeds: The seeds that its frames name.
        prints: By frame id, a hash of all pixels of the frame.
        records: The frames whose files are as recorded.
        legend: Its legend; None if it cannot be read.
    """

    world: int
    findings: list[Finding] = field(default_factory=list)
    splits: set[str] = field(default_factory=set)
    seeds: set[int] = field(default_factory=set)
    prints: dict[str, bytes] = field(default_factory=dict)
    records: int = 0
    images: int = 0
    image_bytes: int = 0

    def found(self, check: str, subject: str, text: str) -> None:
        """Add a finding."""
        self.findings.append(Finding(check, subject, text))


def check_shard(place: StoragePlace, info: DatasetInfo, world: int) -> ShardResult:
    """Check the manifest of a world, its tar file and every image in it."""
    result = ShardResult(world)
    records = _checked_records(place, info, result)
    result.records = len(records)
    result.splits = {record.split for record in records}
    result.seeds = {record.world_seed for record in records}
    _check_views(records, info, result)
    name = tar_name(world)
    try:
        with _mapped(place, name) as data:
            members = _members(data)
            _check_members(records, members, result)
            legend = _legend(data, members)
            for record in records:
                _check_frame(record, data, legend, result)
    except (OaisysError, OSError, ValueError, tarfile.TarError) as error:
        result.found("shard", name, str(error))
    return result


def _checked_records(
    place: StoragePlace, info: DatasetInfo, result: ShardResult
) -> list[FrameRecord]:
    """Return the records that can be read."""
    name = manifest_name(result.world)
    *lines, rest = place.read(name).split(b"\n")
    if rest:
        result.found("manifest", name, f"its last line is cut off: {rest[:40]!r}")
    records = []
    for number, line in enumerate(lines, start=1):
        try:
            record = FrameRecord.from_json(line, f"{name}:{number}")
            _check_record(record, info, result)
        except (OaisysError, KeyError, TypeError, ValueError) as error:
            result.found("manifest", f"{name}:{number}", str(error))
            continue
        if not is_intact(line):
            result.found("manifest", record.frame_id, "the line was changed: its hash differs")
        records.append(record)
    if not records:
        result.found("manifest", name, "it has no frame")
    for each, count in Counter(record.frame_id for record in records).items():
        if count > 1:
            result.found("manifest", each, f"{count} lines have this id")
    return records


def _check_record(record: FrameRecord, info: DatasetInfo, result: ShardResult) -> None:
    """Compare a record with itself, with its world and with the head of the data set."""
    name = record.frame_id
    expected_id = frame_id(result.world, record.view, record.sensor)
    if name != expected_id or record.world != result.world:
        result.found("manifest", name, f"received world {record.world}, expected {expected_id}")
    provenance = provenance_from_record(record.provenance)
    pose_from_record(record.rig_pose)
    for sha256 in {record.config_sha256, provenance.config_sha256} - {info.config_sha256}:
        text = f"configuration {sha256[:12]}, expected {info.config_sha256[:12]} of dataset.json"
        result.found("manifest", name, text)
    if provenance.batch_seed != record.world_seed:
        text = f"provenance has seed {provenance.batch_seed}, the record {record.world_seed}"
        result.found("manifest", name, text)
    if record.split not in info.splits:
        result.found("split", name, f"{record.split!r}, expected one of {', '.join(info.splits)}")
    camera, T = record.camera, record.pose
    if not np.array_equal(camera.K, record.intrinsics["K"]):
        result.found("camera", name, "K differs from its focal lengths and principal point")
    is_rigid = T.shape == (4, 4) and np.allclose(T[3], (0, 0, 0, 1))
    if not is_rigid or not _is_rotation(T[:3, :3]) or not np.isfinite(T).all():
        result.found("camera", name, "T_map_camera is no rigid transform")
    size = (camera.height_px, camera.width_px)
    for modality, image in record.images.items():
        if image.shape[:2] != size:
            text = f"{image.shape[1]}x{image.shape[0]} pixels, its camera has {size[1]}x{size[0]}"
            result.found("image", f"{name}/{modality}", text)
        if not image.file.startswith(f"{name}.{modality}."):
            text = f"its file is {image.file}, expected one of this frame and modality"
            result.found("manifest", f"{name}/{modality}", text)


def _is_rotation(R: NDArray[np.float64]) -> bool:
    is_orthonormal = np.allclose(R @ R.T, np.eye(3), atol=ROTATION_TOLERANCE)
    return bool(is_orthonormal and np.linalg.det(R) > 0)


def _check_views(records: Sequence[FrameRecord], info: DatasetInfo, result: ShardResult) -> None:
    """Check that all views are there, and that the frames of a sensor have the same images."""
    name = manifest_name(result.world)
    if records:
        missing = sorted(set(range(info.views)) - {record.view for record in records})
        if missing:
            shown = ", ".join(map(str, missing[:5]))
            result.found("missing", name, f"{len(missing)} of {info.views} views: {shown}")
    if len(result.splits) > 1:
        text = f"a world belongs to one split, its frames to {', '.join(sorted(result.splits))}"
        result.found("split", name, text)
    if len(result.seeds) > 1:
        result.found("manifest", name, "its frames have different seeds of the world")


@contextmanager
def _mapped(place: StoragePlace, name: str) -> Iterator[mmap.mmap]:
    """Yield an object as memory; that of a remote place is copied to a temporary file."""
    size = place.size(name)
    if not size:
        raise InvalidInputError("file", name, "a tar file, not an empty one")
    with tempfile.TemporaryFile(prefix="oaisys-check-") as copied:
        if place.folder is None:
            for offset in range(0, size, COPIED_BYTES):
                copied.write(place.read(name, offset, min(COPIED_BYTES, size - offset)))
            copied.flush()
            with mmap.mmap(copied.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield data
        else:
            with (
                Path(place.folder, name).open("rb") as file,
                mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
            ):
                yield data


def _members(data: mmap.mmap) -> dict[str, tuple[int, int]]:
    """Return offset and size of each member of a tar file."""
    data.seek(0)
    with tarfile.open(fileobj=data, mode="r:") as tar:
        members = {each.name: (each.offset_data, each.size) for each in tar.getmembers()}
        if not any(data[tar.offset : tar.offset + 2 * tarfile.BLOCKSIZE]) and members:
            return members
    raise ValueError("a member's head was changed: the tar file ends before its end")


def _check_members(
    records: Sequence[FrameRecord], members: dict[str, tuple[int, int]], result: ShardResult
) -> None:
    """Check that manifest and tar file have the same images at the same places."""
    name = tar_name(result.world)
    recorded: dict[str, ImageRecord] = {}
    for image in (image for record in records for image in record.images.values()):
        if image.file in recorded:
            result.found("manifest", image.file, "two frames have this file")
        recorded[image.file] = image
        place = members.get(image.file)
        if place is None:
            result.found("shard", image.file, f"it is not in {name}")
        elif place != (image.offset, image.size):
            result.found("shard", image.file, f"it is at {place}, not at the recorded place")
    for extra in sorted(set(members) - set(recorded) - {LEGEND}):
        result.found("manifest", extra, f"it is in {name}, but no line of the manifest has it")


def _legend(data: mmap.mmap, members: dict[str, tuple[int, int]]) -> WorldLegend:
    if LEGEND not in members:
        raise ValueError(f"it has no {LEGEND}")
    offset, size = members[LEGEND]
    text = data[offset : offset + size]
    if not is_intact(text):
        raise ValueError(f"{LEGEND} was changed: its hash differs")
    return WorldLegend.from_json(text)


def _check_frame(
    record: FrameRecord, data: mmap.mmap, legend: WorldLegend, result: ShardResult
) -> None:
    """Check the bytes, the pixels and the ids of a frame's images."""
    whole = hashlib.sha256()
    for modality, image in sorted(record.images.items()):
        name = f"{record.frame_id}/{modality}"
        file = data[image.offset : image.offset + image.size]
        result.images += 1
        result.image_bytes += len(file)
        if hashlib.sha256(file).hexdigest() != image.sha256:
            result.found("hash", name, f"the bytes of {image.file} are not those recorded")
        try:
            pixels = read_pixels(file, modality, image.file)
        except (OaisysError, KeyError) as error:
            result.found("image", name, str(error))
            continue
        if (pixels.dtype.name, pixels.shape) != (image.dtype, image.shape):
            text = f"{pixels.dtype.name} {pixels.shape}, recorded {image.dtype} {image.shape}"
            result.found("image", name, text)
        pixels_hash = pixels_sha256(pixels)
        if pixels_hash != image.pixels_sha256:
            result.found("hash", name, "its pixels are not those recorded")
        whole.update(f"{modality} {pixels_hash}\n".encode())
        if text := _wrong_values(modality, pixels):
            result.found("image", name, text)
        unknown = _ids(modality, pixels) - _known(modality, legend)
        if unknown:
            result.found("legend", name, f"ids {_shown(unknown)} are not in the legend")
    result.prints[record.frame_id] = whole.digest()[:16]


def _wrong_values(modality: str, pixels: NDArray[Any]) -> str:
    """Return what is wrong with pixels; empty for nothing. Sensor faults are not wrong."""
    if modality in (DEPTH, RANGE) and (np.isfinite(pixels) & (pixels <= 0)).any():
        return "some depths are not positive"
    return ""


def _ids(modality: str, pixels: NDArray[Any]) -> set[int]:
    """Return the ids in an image of labels or instances; none for other images."""
    if modality != INSTANCE and semantic_level(modality) is None:
        return set()
    if pixels.min(initial=0) >= 0 and pixels.max(initial=0) < pixels.size:
        return set(np.flatnonzero(np.bincount(pixels.ravel())).tolist())
    return set(np.unique(pixels).tolist())


def _known(modality: str, legend: WorldLegend) -> set[int]:
    return {0, *(legend.instances if modality == INSTANCE else legend.labels)}


def _shown(ids: set[int]) -> str:
    return ", ".join(map(str, sorted(ids)[:5])) + (", ..." if len(ids) > 5 else "")
