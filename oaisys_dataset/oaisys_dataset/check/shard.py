"""The check of one world's files: manifest, tar file, images, lidar scans and legend."""

from __future__ import annotations

import hashlib
import mmap
import tarfile
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import DISTANCES, INSTANCE, POINTS, SEMANTIC_0, semantic_level
from oaisys_dataset.check.head import PlannedPart
from oaisys_dataset.check.manifests import check_manifests
from oaisys_dataset.check.object_rows import ObjectRowsCheck
from oaisys_dataset.check.report import ShardResult
from oaisys_dataset.manifest import FrameRecord, ImageRecord, WorldLegend
from oaisys_dataset.places import MAX_WHOLE_BYTES, StoragePlace
from oaisys_dataset.records import is_intact
from oaisys_dataset.scans import PointsRecord, ScanRecord, read_scan
from oaisys_dataset.shards import (
    LEGEND,
    count_ids,
    pixels_sha256,
    read_pixels,
    tar_name,
)

COPIED_BYTES = 1 << 26
"""Bytes of a remote file that are copied at once."""

MAX_HEAD_BYTES = 1 << 16
"""Bytes of what a tar file says of a member; names have 255."""


def check_shard(place: StoragePlace, part: PlannedPart, world: int) -> ShardResult:
    """Check the manifest of a world, its tar file and every image in it."""
    result = ShardResult(world)
    records, scans = check_manifests(place, part.info, part.due, result)
    name = tar_name(world)
    try:
        with _map(place, name) as data:
            members = _members(data)
            images = [image for record in records for image in record.images.values()]
            _check_members([*images, *(scan.points for scan in scans)], members, result)
            legend = _legend(data, members)
            objects = ObjectRowsCheck(place, records, legend, result)
            for record in records:
                _check_frame(record, data, legend, objects, result)
            for scan in scans:
                _check_scan(scan, data, legend, result)
    except (OaisysError, OSError, ValueError, tarfile.TarError) as error:
        result.note("shard", name, str(error))
    return result


@contextmanager
def _map(place: StoragePlace, name: str) -> Iterator[mmap.mmap]:
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


class _TarHeads:
    """The part of a file object that reads the heads of a tar file's members, but no more."""

    def __init__(self, data: mmap.mmap) -> None:
        self.seek, self.tell, self._data = data.seek, data.tell, data

    def read(self, size: int) -> bytes:
        """Read a head.

        Raises:
            ValueError: It is longer than `MAX_HEAD_BYTES`, as a name of gigabytes would be.
        """
        if size > MAX_HEAD_BYTES:
            raise ValueError(f"a member's head has {size} bytes, more than {MAX_HEAD_BYTES}")
        return self._data.read(size)


def _members(data: mmap.mmap) -> dict[str, tuple[int, int]]:
    """Return offset and size of each member of a tar file."""
    data.seek(0)
    heads = cast("IO[bytes]", _TarHeads(data))
    with tarfile.open(fileobj=heads, mode="r:") as tar:
        members = {each.name: (each.offset_data, each.size) for each in tar.getmembers()}
        end = tar.offset + 2 * tarfile.BLOCKSIZE
        if not any(data[tar.offset : end]) and members:
            # By the size first: a sparse file takes no room on a disk, but would in memory.
            if len(data) > end + tarfile.RECORDSIZE or any(data[end:]):
                raise ValueError(f"{len(data) - end} bytes follow the end of the tar file")
            return members
    raise ValueError("a member's head was changed: the tar file ends before its end")


def _check_members(
    files: Sequence[ImageRecord | PointsRecord],
    members: dict[str, tuple[int, int]],
    result: ShardResult,
) -> None:
    """Check that manifests and tar file have the same files at the same places."""
    name = tar_name(result.world)
    recorded: set[str] = set()
    for each in files:
        if each.file in recorded:
            result.note("manifest", each.file, "two lines have this file")
        recorded.add(each.file)
        place = members.get(each.file)
        if place is None:
            result.note("shard", each.file, f"it is not in {name}")
        elif place != (each.offset, each.size):
            result.note("shard", each.file, f"it is at {place}, not at the recorded place")
    for extra in sorted(set(members) - recorded - {LEGEND}):
        result.note("manifest", extra, f"it is in {name}, but no line of the manifest has it")


def _legend(data: mmap.mmap, members: dict[str, tuple[int, int]]) -> WorldLegend:
    if LEGEND not in members:
        raise ValueError(f"it has no {LEGEND}")
    offset, size = members[LEGEND]
    if size > MAX_WHOLE_BYTES:
        raise ValueError(f"{LEGEND} has {size} bytes, more than {MAX_WHOLE_BYTES}")
    text = data[offset : offset + size]
    if not is_intact(text):
        raise ValueError(f"{LEGEND} was changed: its hash differs")
    return WorldLegend.from_json(text, "legend")


def _check_frame(
    record: FrameRecord,
    data: mmap.mmap,
    legend: WorldLegend,
    objects: ObjectRowsCheck,
    result: ShardResult,
) -> None:
    """Check the bytes, the pixels and the ids of a frame's images, and its rows of objects."""
    whole = hashlib.sha256()
    for modality, image in sorted(record.images.items()):
        name = f"{record.frame_id}/{modality}"
        file = data[image.offset : image.offset + image.size]
        result.images += 1
        result.image_bytes += len(file)
        if hashlib.sha256(file).hexdigest() != image.sha256:
            result.note("hash", name, f"the bytes of {image.file} are not those recorded")
        try:
            pixels = read_pixels(file, modality, image.file)
        except (OaisysError, KeyError) as error:
            result.note("image", name, str(error))
            continue
        if (pixels.dtype.name, pixels.shape) != (image.dtype, image.shape):
            text = f"{pixels.dtype.name} {pixels.shape}, recorded {image.dtype} {image.shape}"
            result.note("image", name, text)
        pixels_hash = pixels_sha256(pixels)
        if pixels_hash != image.pixels_sha256:
            result.note("hash", name, "its pixels are not those recorded")
        whole.update(f"{modality} {pixels_hash}\n".encode())
        if text := _wrong_values(modality, pixels):
            result.note("image", name, text)
        counts = count_ids(pixels) if _is_of_ids(modality) else {}
        unknown = counts.keys() - _ids_of_legend(modality, legend)
        if unknown:
            result.note("legend", name, f"ids {_show(unknown)} are not in the legend")
        if modality == INSTANCE:
            objects.check(record, pixels)
        if modality == SEMANTIC_0:
            _check_label_pixels(record, counts, result)
    result.prints[record.frame_id] = whole.digest()[:16]


def _check_label_pixels(
    record: FrameRecord, counts: Mapping[int, int], result: ShardResult
) -> None:
    """Compare the recorded number of pixels of each label with those counted in the image."""
    if {int(each): count for each, count in record.label_pixels.items()} != counts:
        text = f"label_pixels are {dict(record.label_pixels)}, expected {counts}"
        result.note("manifest", record.frame_id, text)


def _check_scan(
    record: ScanRecord, data: mmap.mmap, legend: WorldLegend, result: ShardResult
) -> None:
    """Check the bytes, the points and the ids of a lidar scan."""
    name, points = f"{record.scan_id}/{POINTS}", record.points
    file = data[points.offset : points.offset + points.size]
    result.scans += 1
    if hashlib.sha256(file).hexdigest() != points.sha256:
        result.note("hash", name, f"the bytes of {points.file} are not those recorded")
    try:
        found = read_scan(record, file).data
    except OaisysError as error:
        result.note("image", name, str(error))
        return
    names = found.dtype.names or ()
    if (len(found), names) != (points.count, points.fields):
        text = f"{len(found)} points with {', '.join(names)}, recorded {points.count}"
        result.note("image", name, f"{text} with {', '.join(points.fields)}")
    if not all(np.isfinite(found[axis]).all() for axis in "xyz"):
        result.note("image", name, "some coordinates are not finite")
    for modality, field in ((SEMANTIC_0, "label"), (INSTANCE, "instance")):
        if field in names and (
            unknown := count_ids(found[field]).keys() - _ids_of_legend(modality, legend)
        ):
            result.note("legend", name, f"ids {_show(unknown)} are not in the legend")


def _wrong_values(modality: str, pixels: NDArray[Any]) -> str:
    """Return what is wrong with pixels; empty for nothing. Sensor faults are not wrong."""
    if modality in DISTANCES and (np.isfinite(pixels) & (pixels <= 0)).any():
        return "some depths are not positive"
    return ""


def _is_of_ids(modality: str) -> bool:
    return modality == INSTANCE or semantic_level(modality) is not None


def _ids_of_legend(modality: str, legend: WorldLegend) -> set[int]:
    return {0, *(legend.instances if modality == INSTANCE else legend.labels)}


def _show(ids: set[int]) -> str:
    return ", ".join(map(str, sorted(ids)[:5])) + (", ..." if len(ids) > 5 else "")
