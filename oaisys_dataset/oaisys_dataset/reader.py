"""The typed reader of data sets: samples by index, by id or streamed, without Blender."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tarfile import BLOCKSIZE
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import NDArray

from oaisys_core.errors import ConfigError, InvalidInputError, NotFoundError, one_of
from oaisys_core.files.numbers import whole_of
from oaisys_core.types import FloatArray, LidarScan, ShortRepr
from oaisys_dataset.manifest import (
    DatasetInfo,
    FrameRecord,
    ImageRecord,
    WorldFailure,
    WorldLegend,
)
from oaisys_dataset.manifest_lines import (
    ManifestLines,
    WorldManifest,
    index_manifests,
)
from oaisys_dataset.places import MAX_WHOLE_BYTES, StoragePlace, open_place
from oaisys_dataset.scans import ScanRecord, read_scan
from oaisys_dataset.shards import (
    HEAD,
    LEGEND,
    SHARDS,
    manifest_name,
    objects_name,
    read_failure,
    read_head,
    read_pixels,
    scans_name,
    tar_name,
    tar_size,
    whole_worlds,
    world_failures,
)

if TYPE_CHECKING:
    import pyarrow as pa

    from oaisys_dataset.objects import ObjectRow

__all__ = ["Dataset", "DatasetSample", "ManifestLines", "WorldLegend", "open_dataset"]


def open_dataset(place: str | Path) -> Dataset:
    """Return the data set in a folder or at a URL, with the worlds that are finished.

    Raises:
        InvalidInputError: There is no data set, it cannot be read, or it has worlds or splits
            beyond those of its head.
    """
    opened = open_place(place)
    info = read_head(opened)
    worlds = whole_worlds(opened)
    if worlds and max(worlds) >= info.worlds:
        info = read_head(opened)  # a run may have begun to add worlds
        if max(worlds) >= info.worlds:
            expected = f"{max(worlds) + 1} or more, as there is world {max(worlds)}"
            raise InvalidInputError(f"{HEAD}: worlds", info.worlds, expected)
    manifests = index_manifests(opened, worlds, manifest_name, FrameRecord.from_json)
    _check_splits(info, manifests, manifest_name)
    return Dataset(opened, info, manifests)


MAX_GAP_BYTES = 1 << 16
"""Between two images of a frame in its tar file: the head of a member and what fills its block."""


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
        self.records = ManifestLines(place, FrameRecord, manifest_name, manifests)
        self._manifests = tuple(manifests)
        self._held_objects: tuple[int, pa.Table] | None = None

    @cached_property
    def worlds(self) -> tuple[int, ...]:
        """The worlds that are finished, in order."""
        return tuple(manifest.world for manifest in self._manifests)

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits that have a world, in the order of their first worlds."""
        return tuple(dict.fromkeys(manifest.split for manifest in self._manifests))

    @cached_property
    def scans(self) -> ManifestLines[ScanRecord]:
        """The records of the lidar scans; empty if the rig has no lidar."""
        worlds: Iterable[int] = ()
        configs = (part.info.config for part in self.info.parts)
        if any(config.get("sensors", {}).get("lidars") for config in configs):
            names = set(self.place.names(SHARDS))
            worlds = (world for world in self.worlds if scans_name(world) in names)
        found = index_manifests(self.place, worlds, scans_name, ScanRecord.from_json)
        _check_splits(self.info, found, scans_name)
        return ManifestLines(self.place, ScanRecord, scans_name, found)

    @cached_property
    def failures(self) -> tuple[WorldFailure, ...]:
        """The worlds that could not be made."""
        return tuple(read_failure(self.place, world) for world in world_failures(self.place))

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
        name = tar_name(world)
        begin = self._end_of_data(world)
        head = self.place.read(name, begin, BLOCKSIZE)
        if head[: len(LEGEND) + 1] != f"{LEGEND}\0".encode():
            raise InvalidInputError("file", name, f"a tar file whose last member is {LEGEND}")
        try:
            size = int(head[124:136].rstrip(b"\0 "), 8)
        except ValueError as error:
            raise InvalidInputError("file", name, f"a readable tar file ({error})") from error
        if size > MAX_WHOLE_BYTES:
            expected = f"at most {MAX_WHOLE_BYTES} bytes"
            raise InvalidInputError(f"{name}: {LEGEND}", f"{size} bytes", expected)
        data = self.place.read(name, begin + BLOCKSIZE, size)
        return WorldLegend.from_json(data, f"{name}: {LEGEND}")

    def of_world(self, world: int) -> Iterator[FrameRecord]:
        """Yield the records of a world's frames.

        Raises:
            NotFoundError: The world is not in the data set.
        """
        return self.records.of_world(world)

    def record(self, frame_id: str) -> FrameRecord:
        """Return the record of a frame by its id, such as ``000012_0003_camera``.

        Raises:
            NotFoundError: There is no such frame.
        """
        world = whole_of(frame_id.partition("_")[0])
        if world is not None and world in self.worlds:
            for record in self.of_world(world):
                if record.frame_id == frame_id:
                    return record
        raise NotFoundError(f"frame {frame_id!r}: not in {self.place.url}")

    def scan(self, record: ScanRecord) -> LidarScan:
        """Return a lidar scan with its points.

        Raises:
            InvalidInputError: The points are others than recorded, or cannot be decoded.
        """
        points = record.points
        scan = read_scan(record, self.scan_file(record))
        found = (len(scan.data), scan.data.dtype.names)
        if found != (points.count, points.fields):
            expected = f"{points.count} with {', '.join(points.fields)}, as recorded"
            raise InvalidInputError(f"{points.file}: points", found, expected)
        return scan

    def scan_file(self, record: ScanRecord) -> bytes:
        """Return the file of a lidar scan, as the shard has it.

        Raises:
            InvalidInputError: It is another one than recorded.
        """
        tar, points = tar_name(record.world), record.points
        return points.verify(self.place.read(tar, points.offset, points.size), tar)

    def scans_beside(self, record: FrameRecord) -> dict[str, LidarScan]:
        """Return the lidar scans of a frame's view by the lidar's name."""
        if not self.scans.has_world(record.world):
            return {}
        found = (scan for scan in self.scans.of_world(record.world) if scan.view == record.view)
        return {scan.sensor: self.scan(scan) for scan in found}

    def has_objects(self, world: int) -> bool:
        """Return whether a world has a table of its objects."""
        return self.place.exists(objects_name(world))

    def objects_table(self, world: int) -> pa.Table:
        """Return the table of a world's objects, see `oaisys_dataset.objects.COLUMNS`.

        Raises:
            NotFoundError: The world has none: no camera has ``instance``, or it was rendered by an
                earlier version.
            InvalidInputError: It cannot be read, or has objects that the world's legend has not.
            ConfigError: pyarrow is not installed.
        """
        try:
            from oaisys_dataset.objects import check_legend, decode_objects
        except ImportError as error:
            text = "`oaisys_dataset[objects]` has what tables of objects need"
            raise ConfigError(f"{error}; {text}") from error
        if self._held_objects is None or self._held_objects[0] != world:
            name = objects_name(world)
            table = decode_objects(self.place.read(name), name)
            check_legend(table, self.legend(world), name)
            self._held_objects = (world, table)
        return self._held_objects[1]

    def objects(self, record: FrameRecord) -> list[ObjectRow]:
        """Return the objects that show in a frame, in the order of their ids.

        Raises:
            NotFoundError, InvalidInputError: See `objects_table`.
        """
        table = self.objects_table(record.world)
        from oaisys_dataset.objects import rows_of_frame

        return rows_of_frame(table, record.frame_id)

    def scan_record(self, scan_id: str) -> ScanRecord | None:
        """Return the record of a lidar scan by its id; None if there is no such scan."""
        world = whole_of(scan_id.partition("_")[0])
        if world is None or not self.scans.has_world(world):
            return None
        scans = self.scans.of_world(world)
        return next((scan for scan in scans if scan.scan_id == scan_id), None)

    def files(self, record: FrameRecord) -> dict[str, bytes]:
        """Return the image files of a frame by modality, as the shard has them.

        Raises:
            InvalidInputError: One of them is another one than recorded.
        """
        return self._files(record, record.images)

    def _files(self, record: FrameRecord, wanted: Iterable[str]) -> dict[str, bytes]:
        """Return some of the image files of a frame, all of which are read at once."""
        images = record.images
        begin = min(image.offset for image in images.values())
        end = max(image.offset + image.size for image in images.values())
        tar = tar_name(record.world)
        whole = sum(image.size + MAX_GAP_BYTES for image in images.values())
        if end - begin > whole:
            expected = f"files beside each other in {tar}, within {whole} bytes"
            raise InvalidInputError(f"{record.frame_id}: images", f"{end - begin} bytes", expected)
        data = memoryview(self.place.read(tar, begin, end - begin))
        if len(data) < end - begin:
            expected = f"files within {tar}, which ends at {begin + len(data)}"
            raise InvalidInputError(f"{record.frame_id}: images", f"an end at {end}", expected)
        files = {modality: _cut(data, images[modality], begin) for modality in wanted}
        return {name: images[name].verify(file, tar) for name, file in files.items()}

    def sample(self, record: FrameRecord, modalities: Sequence[str] = ()) -> DatasetSample:
        """Return a frame with its pixels, in all modalities or in some.

        Raises:
            InvalidInputError: An image is another one than recorded, or cannot be decoded.
        """
        files = self._files(record, modalities or record.images)
        arrays = {
            modality: _pixels(file, modality, record.images[modality])
            for modality, file in files.items()
        }
        return DatasetSample(record, arrays)

    def stream(self, modalities: Sequence[str] = ()) -> Iterator[DatasetSample]:
        """Yield all frames in order, world by world."""
        for record in self.records:
            yield self.sample(record, modalities)

    def __iter__(self) -> Iterator[DatasetSample]:
        return self.stream()

    def __len__(self) -> int:
        return len(self.records)

    def _end_of_data(self, world: int) -> int:
        """Return where the last member of a tar file begins, its legend."""
        images = self.records.last_of_world(world).images.values()
        ends = [image.offset + image.size for image in images]
        if self.scans.has_world(world):
            points = self.scans.last_of_world(world).points
            ends.append(points.offset + points.size)
        return tar_size(max(ends))

    @overload
    def __getitem__(self, index: int) -> DatasetSample: ...
    @overload
    def __getitem__(self, index: slice) -> list[DatasetSample]: ...
    def __getitem__(self, index: int | slice) -> DatasetSample | list[DatasetSample]:
        if isinstance(index, slice):
            return [self.sample(record) for record in self.records[index]]
        return self.sample(self.records[index])


def _check_splits(
    info: DatasetInfo, manifests: Iterable[WorldManifest], name_of: Callable[[int], str]
) -> None:
    """Raise if a world is in a split that the head of its data set has not."""
    for manifest in manifests:
        if manifest.split not in info.splits:
            expected = f"{one_of(info.splits, manifest.split)}, as {HEAD} says"
            raise InvalidInputError(f"{name_of(manifest.world)}:1: split", manifest.split, expected)


def _pixels(file: bytes, modality: str, image: ImageRecord) -> NDArray[Any]:
    pixels = read_pixels(file, modality, image.file)
    if (pixels.dtype.name, pixels.shape) != (image.dtype, image.shape):
        expected = f"{image.dtype} {image.shape}, as recorded"
        raise InvalidInputError(image.file, f"{pixels.dtype.name} {pixels.shape}", expected)
    return pixels


def _cut(data: memoryview, image: ImageRecord, begin: int) -> bytes:
    first = image.offset - begin
    return bytes(data[first : first + image.size])
