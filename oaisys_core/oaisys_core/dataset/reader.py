"""The typed reader of data sets: samples by index, by id or streamed, without Blender."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tarfile import BLOCKSIZE
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from oaisys_core.dataset.manifest import (
    DatasetInfo,
    FrameRecord,
    ImageRecord,
    WorldFailure,
    WorldLegend,
)
from oaisys_core.dataset.places import StoragePlace, open_place
from oaisys_core.dataset.shards import (
    HEAD,
    LEGEND,
    failed_worlds,
    finished_worlds,
    manifest_name,
    padded,
    read_failure,
    read_pixels,
    tar_name,
)
from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.types import FloatArray, ShortRepr

READERS = 8
"""Manifests that are read at the same time, because a remote place takes long to answer."""

__all__ = ["Dataset", "DatasetSample", "FrameRecords", "WorldLegend", "open_dataset"]


def open_dataset(place: str | Path) -> Dataset:
    """Return the data set in a folder or at a URL, with the worlds that are finished.

    Raises:
        InvalidInputError: There is no data set, or it cannot be read.
    """
    opened = open_place(place)
    try:
        info = DatasetInfo.from_json(opened.read(HEAD), HEAD)
    except NotFoundError as error:
        expected = f"a data set, with its {HEAD}"
        raise InvalidInputError("dataset", str(place), expected) from error
    worlds = finished_worlds(opened)
    with ThreadPoolExecutor(READERS) as threads:
        manifests = list(threads.map(lambda world: _indexed(opened, world), worlds))
    return Dataset(opened, info, manifests)


@dataclass(frozen=True, repr=False)
class DatasetSample(ShortRepr):
    """A frame with its pixels.

    Attributes:
        record: Its line in the manifest.
        arrays: Pixels by modality: ``rgb`` (H, W, 3) uint8, ``depth`` (H, W) float32 metres along
            z and ``+inf`` where nothing is hit, ``semantic_0`` (H, W) uint16, ``instance`` (H, W)
            int32, ``normal`` (H, W, 3) float32; others see `modality_spec`.
    """

    record: FrameRecord
    arrays: Mapping[str, NDArray[Any]]

    @property
    def K(self) -> FloatArray:  # noqa: N802 - the field's name for the camera matrix
        """The 3x3 camera matrix; pixel centres are at integers."""
        return self.record.camera.K

    @property
    def T_map_camera(self) -> FloatArray:  # noqa: N802 - the frames are in the name
        """(4, 4) pose of the optical frame (x right, y down, z forward) in ``map``."""
        return self.record.pose


class WorldManifest(NamedTuple):
    """Where the lines of a world's manifest are.

    Attributes:
        world: The world.
        split: Its split.
        ends: (N,) end of each line, in bytes.
    """

    world: int
    split: str
    ends: NDArray[np.int64]


class FrameRecords(Sequence[FrameRecord]):
    """The frames of a data set, read from the manifests when they are asked for.

    Only the manifest of one world is in memory at a time.
    """

    def __init__(self, place: StoragePlace, manifests: Sequence[WorldManifest]) -> None:
        self._place = place
        self._manifests = manifests
        self._firsts = np.cumsum([0, *(len(manifest.ends) for manifest in manifests)])
        self._held: tuple[int, bytes] | None = None

    def __len__(self) -> int:
        return int(self._firsts[-1])

    @overload
    def __getitem__(self, index: int) -> FrameRecord: ...
    @overload
    def __getitem__(self, index: slice) -> list[FrameRecord]: ...
    def __getitem__(self, index: int | slice) -> FrameRecord | list[FrameRecord]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        wanted = index + len(self) if index < 0 else index
        if not 0 <= wanted < len(self):
            raise IndexError(f"received {index}, the data set has {len(self)} frames")
        number = int(np.searchsorted(self._firsts, wanted, side="right")) - 1
        return self.line(self._manifests[number], wanted - int(self._firsts[number]))

    def __iter__(self) -> Iterator[FrameRecord]:
        for manifest in self._manifests:
            yield from self.of_world(manifest)

    def of_world(self, manifest: WorldManifest) -> Iterator[FrameRecord]:
        """Yield the frames of a world."""
        for line in range(len(manifest.ends)):
            yield self.line(manifest, line)

    def line(self, manifest: WorldManifest, line: int) -> FrameRecord:
        """Return a line of a world's manifest; -1 is the last one."""
        line %= len(manifest.ends)
        name = manifest_name(manifest.world)
        held = self._held
        if held is None or held[0] != manifest.world:
            held = self._held = (manifest.world, self._place.read(name))
        begin = int(manifest.ends[line - 1]) if line else 0
        text = held[1][begin : int(manifest.ends[line])]
        return FrameRecord.from_json(text, f"{name}:{line + 1}")


class Dataset(Sequence[DatasetSample]):
    """A data set, or one split of it.

    Attributes:
        place: Where it is.
        info: What it is.
        records: The manifest: its frames without pixels.
    """

    def __init__(
        self, place: StoragePlace, info: DatasetInfo, manifests: Sequence[WorldManifest]
    ) -> None:
        self.place = place
        self.info = info
        self.records = FrameRecords(place, manifests)
        self._manifests = tuple(manifests)

    @cached_property
    def worlds(self) -> tuple[int, ...]:
        """The worlds that are finished, in order."""
        return tuple(manifest.world for manifest in self._manifests)

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits that have a world, in the order of their first worlds."""
        return tuple(dict.fromkeys(manifest.split for manifest in self._manifests))

    @cached_property
    def failures(self) -> tuple[WorldFailure, ...]:
        """The worlds that could not be made."""
        return tuple(read_failure(self.place, world) for world in failed_worlds(self.place))

    def split(self, name: str) -> Dataset:
        """Return one split.

        Raises:
            NotFoundError: No world is in it.
        """
        chosen = [manifest for manifest in self._manifests if manifest.split == name]
        if not chosen:
            raise NotFoundError(
                f"split {name!r}: there are only {', '.join(self.splits) or 'none'}"
            )
        return Dataset(self.place, self.info, chosen)

    def legend(self, world: int) -> WorldLegend:
        """Return what the ids in a world's label images mean.

        Raises:
            NotFoundError: The world is not in the data set.
            InvalidInputError: The legend cannot be read.
        """
        last = self.records.line(self._manifest(world), -1)
        name = tar_name(world)
        begin = max(padded(image.offset + image.size) for image in last.images.values())
        head = self.place.read(name, begin, BLOCKSIZE)
        if head[: len(LEGEND) + 1] != f"{LEGEND}\0".encode():
            raise InvalidInputError("file", name, f"a tar file whose last member is {LEGEND}")
        try:
            size = int(head[124:136].rstrip(b"\0 "), 8)
        except ValueError as error:
            raise InvalidInputError("file", name, f"a readable tar file ({error})") from error
        data = self.place.read(name, begin + BLOCKSIZE, size)
        return WorldLegend.from_json(data, f"{name}: {LEGEND}")

    def of_world(self, world: int) -> Iterator[FrameRecord]:
        """Yield the records of a world's frames.

        Raises:
            NotFoundError: The world is not in the data set.
        """
        return self.records.of_world(self._manifest(world))

    def record(self, frame_id: str) -> FrameRecord:
        """Return the record of a frame by its id, such as ``000012_0003_camera``.

        Raises:
            NotFoundError: There is no such frame.
        """
        world = frame_id.partition("_")[0]
        if world.isdecimal() and int(world) in self.worlds:
            for record in self.of_world(int(world)):
                if record.frame_id == frame_id:
                    return record
        raise NotFoundError(f"frame {frame_id!r}: not in {self.place.url}")

    def files(self, record: FrameRecord) -> dict[str, bytes]:
        """Return the image files of a frame by modality, as the shard has them."""
        images = record.images
        begin = min(image.offset for image in images.values())
        end = max(image.offset + image.size for image in images.values())
        data = memoryview(self.place.read(tar_name(record.world), begin, end - begin))
        return {modality: _cut(data, image, begin) for modality, image in images.items()}

    def sample(self, record: FrameRecord, modalities: Sequence[str] = ()) -> DatasetSample:
        """Return a frame with its pixels, in all modalities or in some.

        Raises:
            InvalidInputError: An image cannot be decoded.
        """
        names = list(modalities or record.images)
        arrays = {
            modality: read_pixels(file, modality, record.images[modality].file)
            for modality, file in self.files(record).items()
            if modality in names
        }
        return DatasetSample(record, {name: arrays[name] for name in names})

    def stream(self, modalities: Sequence[str] = ()) -> Iterator[DatasetSample]:
        """Yield all frames in order, world by world."""
        for record in self.records:
            yield self.sample(record, modalities)

    def __iter__(self) -> Iterator[DatasetSample]:
        return self.stream()

    def __len__(self) -> int:
        return len(self.records)

    @overload
    def __getitem__(self, index: int) -> DatasetSample: ...
    @overload
    def __getitem__(self, index: slice) -> list[DatasetSample]: ...
    def __getitem__(self, index: int | slice) -> DatasetSample | list[DatasetSample]:
        if isinstance(index, slice):
            return [self.sample(record) for record in self.records[index]]
        return self.sample(self.records[index])

    def _manifest(self, world: int) -> WorldManifest:
        number = bisect_left(self.worlds, world)
        if number == len(self._manifests) or self._manifests[number].world != world:
            raise NotFoundError(f"world {world}: not in {self.place.url}")
        return self._manifests[number]


def _indexed(place: StoragePlace, world: int) -> WorldManifest:
    """Return where the lines of a manifest are."""
    name = manifest_name(world)
    text = place.read(name)
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n")) + 1
    if not len(ends) or ends[-1] != len(text):
        raise InvalidInputError("file", name, "lines, each with its end")
    try:
        split = json.loads(text[: ends[0]])["split"]
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(f"{name}:1", text[:80], f"a frame's record ({error!r})") from error
    return WorldManifest(world, str(split), ends)


def _cut(data: memoryview, image: ImageRecord, begin: int) -> bytes:
    first = image.offset - begin
    return bytes(data[first : first + image.size])
