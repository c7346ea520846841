"""Copies a world of a data set under another number; everything else stays as it is."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import INSTANCE
from oaisys_dataset.manifest import FrameRecord
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.reader import Dataset
from oaisys_dataset.records import frame_id, is_intact
from oaisys_dataset.scans import EncodedScan, ScanRecord
from oaisys_dataset.shards import (
    EncodedFrame,
    manifest_name,
    objects_name,
    scans_name,
    writing_shard,
)

if TYPE_CHECKING:
    import pyarrow as pa


def copy_world(dataset: Dataset, world: int, place: StoragePlace, number: int) -> int:
    """Write a world of a data set as the world of another number of another set.

    Args:
        dataset: What has the world.
        world: Its number there.
        place: Where the other set is.
        number: Its number there.

    Returns:
        The number of its frames.

    Raises:
        InvalidInputError: A line, an image or the table of objects is not as it was written.
        RenderError: It could not be written; the place does not have the world.
    """
    _check_lines(dataset, manifest_name(world))
    scans: list[ScanRecord] = []
    if dataset.scans.has_world(world):
        _check_lines(dataset, scans_name(world))
        scans = list(dataset.scans.of_world(world))
    table = _objects(dataset, world)
    frames = list(dataset.of_world(world))
    with writing_shard(place, number) as shard:
        for view in sorted({each.view for each in (*frames, *scans)}):
            for record in (each for each in frames if each.view == view):
                shard.add_encoded(_frame(dataset, record, number, table))
            for scan in (each for each in scans if each.view == view):
                shard.add_scan(_scan(dataset, scan, number))
        shard.finish(dataset.legend(world))
    return len(frames)


def _check_lines(dataset: Dataset, name: str) -> None:
    """Raise if a line of a manifest was changed after it had been written."""
    for number, line in enumerate(dataset.place.read(name).splitlines(), start=1):
        if not is_intact(line):
            raise InvalidInputError(f"{name}:{number}", "a changed line", "the hash of its content")


def _objects(dataset: Dataset, world: int) -> pa.Table | None:
    """Return the table of a world's objects; None if it has none."""
    if not dataset.has_objects(world):
        return None
    table = dataset.objects_table(world)
    from oaisys_dataset.objects import is_intact as is_table_intact

    if not is_table_intact(table):
        raise InvalidInputError(objects_name(world), "changed rows", "the hash of its rows")
    return table


def _frame(
    dataset: Dataset, record: FrameRecord, number: int, table: pa.Table | None
) -> EncodedFrame:
    """Return a frame of the world that has another number now."""
    name = frame_id(number, record.view, record.sensor)
    files = dataset.files(record)
    images = {
        modality: replace(image, file=_renamed(image.file, record.id, name), offset=0)
        for modality, image in record.images.items()
    }
    renumbered = replace(record, frame_id=name, world=number, images=images)
    rows = None
    if table is not None and INSTANCE in record.images:
        rows = _renumbered_rows(table, record.frame_id, name, number)
    return EncodedFrame(renumbered, files, rows)


def _scan(dataset: Dataset, record: ScanRecord, number: int) -> EncodedScan:
    """Return a lidar scan of the world that has another number now."""
    name, points = frame_id(number, record.view, record.sensor), record.points
    file = dataset.scan_file(record)
    points = replace(points, file=_renamed(points.file, record.id, name), offset=0)
    return EncodedScan(replace(record, scan_id=name, world=number, points=points), file)


def _renamed(file: str, before: str, now: str) -> str:
    if not file.startswith(f"{before}."):
        raise InvalidInputError("file", file, f"a name that begins with {before}.")
    return f"{now}{file[len(before) :]}"


def _renumbered_rows(table: pa.Table, before: str, now: str, world: int) -> pa.RecordBatch:
    """Return the rows of a frame with its id and world in another data set."""
    import pyarrow as pa
    import pyarrow.compute as pc

    rows = table.filter(pc.equal(table["frame_id"], before)).combine_chunks()
    for column, value in (("frame_id", now), ("world", world)):
        place = rows.schema.get_field_index(column)
        kind = rows.schema.field(column).type
        rows = rows.set_column(place, column, pa.array([value] * len(rows), kind))
    batches = rows.replace_schema_metadata(None).to_batches()
    return batches[0] if batches else pa.RecordBatch.from_pylist([], schema=rows.schema)
