"""Reading of recorded samples, and comparison with samples that were rendered again."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from oaisys_core import extensions
from oaisys_core.config import canonical_json, load_config
from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.files.numbers import whole_of
from oaisys_core.output.reader import read_sample
from oaisys_core.output.records import read_json
from oaisys_core.output.writer import CONFIG, SAMPLE_DATA
from oaisys_core.types import (
    COLORS,
    FLOW,
    POINTS,
    RENDERED,
    FloatArray,
    Frame,
    FrameName,
    LidarScan,
    RecordedSample,
    Sample,
)

RECORDS = "oaisys.records"
"""Entry point group of functions ``(Path) -> RecordSource | None``; None for other files."""

WHITE_PER_MEAN = 4.0
"""Radiance, in units of its mean, that differences are compared with; more counts as much."""

SampleId = tuple[int, int]
"""Batch and sample."""


class RecordSource(Protocol):
    """A source of recorded samples."""

    def config_json(self) -> str | None:
        """Return the configuration as JSON, or None if it was not recorded."""

    def ids(self) -> Sequence[SampleId]:
        """Return the ids of all samples, the newest last."""

    def read(self, wanted: Collection[SampleId]) -> Iterator[RecordedSample]:
        """Yield samples in the order of recording."""


def open_records(path: Path) -> RecordSource:
    """Return the samples recorded in a file or folder.

    Raises:
        InvalidInputError: There are none.
    """
    if not path.exists():
        raise InvalidInputError("record", str(path), "a file or folder that exists")
    found = _folder_records(path)
    if found is not None:
        return found
    for name in sorted(extensions.names(RECORDS)):
        source: RecordSource | None = extensions.load(RECORDS, name)(path)
        if source is not None:
            return source
    expected = "a sample's JSON file or the folder of `oaisys render`, or a bag with ~/sample_info"
    raise InvalidInputError("record", str(path), expected)


class FolderRecords:
    """Samples written by `SampleWriter`.

    Args:
        files: Their JSON files.
        top: The folder of the run, with its configuration.
    """

    def __init__(self, files: Sequence[Path], top: Path) -> None:
        self._top = top
        records = {path: read_json(path) for path in files}
        self._files: dict[SampleId, Path] = {}
        for path, record in records.items():
            try:
                int(path.stem), path.parents[len(SAMPLE_DATA.parts)]
                self._files[int(record["batch_id"]), int(record["sample_id"])] = path
            except (KeyError, IndexError, TypeError, ValueError) as error:
                expected = "a sample's JSON file as `oaisys render` writes it"
                raise InvalidInputError("record", str(path), expected) from error

    def config_json(self) -> str | None:
        """Return the configuration of the run as JSON, or None if there is none."""
        path = self._top / CONFIG
        return canonical_json(load_config(path)) if path.is_file() else None

    def ids(self) -> Sequence[SampleId]:
        """Return the ids of all samples, the newest last."""
        return sorted(self._files)

    def read(self, wanted: Collection[SampleId]) -> Iterator[RecordedSample]:
        """Yield samples in the order of their ids."""
        for number in sorted(set(wanted) & self._files.keys()):
            path = self._files[number]
            sample = read_sample(path.parents[len(SAMPLE_DATA.parts)], int(path.stem))
            yield RecordedSample(sample.outline, sample.frames, scans=sample.scans)


def _folder_records(path: Path) -> FolderRecords | None:
    """Return the samples of a JSON file, a batch folder or a run folder."""
    depth = len(SAMPLE_DATA.parts)
    if path.is_file():
        if path.suffix != ".json":
            return None
        resolved = path.resolve()
        if len(resolved.parents) <= depth + 1:
            return None
        return FolderRecords([path], resolved.parents[depth + 1])
    if (path / SAMPLE_DATA).is_dir():
        return FolderRecords(sorted((path / SAMPLE_DATA).glob("*.json")), path.resolve().parent)
    files = sorted(path.glob(f"batch_*/{SAMPLE_DATA}/*.json"))
    return FolderRecords(files, path) if files else None


def choose_ids(source: RecordSource, names: Sequence[str], *, every: bool) -> list[SampleId]:
    """Return the ids of samples named ``BATCH/SAMPLE``; without names the newest one, or all.

    Raises:
        InvalidInputError: A name is invalid.
        NotFoundError: There is no such sample.
    """
    known = list(source.ids())
    if not known:
        raise NotFoundError("the record has no samples")
    if every or not names:
        return known if every else known[-1:]
    wanted = [_parse(name) for name in names]
    for number in wanted:
        if number not in known:
            first, last = (f"{batch}/{sample}" for batch, sample in (known[0], known[-1]))
            expected = f"one of the record's {len(known)} samples, {first} to {last}"
            raise InvalidInputError("sample", f"{number[0]}/{number[1]}", expected)
    return wanted


def _parse(name: str) -> SampleId:
    batch, sample = (whole_of(part) for part in (name.partition("/")[::2]))
    if batch is None or sample is None:
        raise InvalidInputError("sample", name, "BATCH/SAMPLE, such as 1/3")
    return batch, sample


class Comparison(NamedTuple):
    """The comparison of a frame or scan that was rendered again with the recorded one.

    Attributes:
        pixels: Pixels of the frame, or points of the scan.
        different_px: Those that differ in any bit.
        psnr_db: PSNR of colours, infinite if no pixel differs; None for other modalities.
        is_equal: Whether it is the same: byte by byte, or within the tolerance for colours. Always
            true for optical flow, which also depends on the unrecorded previous sample.
    """

    name: FrameName
    pixels: int
    different_px: int
    psnr_db: float | None
    is_equal: bool


def compare(record: RecordedSample, again: Sample, least_psnr_db: float) -> list[Comparison]:
    """Compare the frames and scans of a record with the same rendered again.

    Raises:
        NotFoundError: The record contains neither.
    """
    if not record.frames and not record.scans:
        outline = record.outline
        number = f"{outline.batch_id}/{outline.sample_id}"
        raise NotFoundError(f"sample {number}: none of its images and scans is in the record")
    images = [
        _compare(old, record.recorded(again.frame(old.sensor, old.modality)), least_psnr_db)
        for old in record.frames
    ]
    return images + [compare_scan(old, again.scan(old.sensor)) for old in record.scans]


def _compare(old: Frame, new: Frame, least_psnr_db: float) -> Comparison:
    name = FrameName(old.sensor, old.modality)
    pixels = old.data.shape[0] * old.data.shape[1]
    if (old.data.shape, old.data.dtype) != (new.data.shape, new.data.dtype):
        return Comparison(name, pixels, pixels, None, False)
    a, b = (np.ascontiguousarray(f.data).view(np.uint8).reshape(pixels, -1) for f in (old, new))
    different_px = int((a != b).any(axis=1).sum())
    if old.modality in RENDERED:  # equal within a tolerance, because of the denoiser
        first, second = _values(old), _values(new)
        white = 255 if old.modality in COLORS else WHITE_PER_MEAN * float(first.mean())
        error = np.mean((np.minimum(first, white) - np.minimum(second, white)) ** 2)
        psnr_db = float("inf") if error == 0 else float(10 * np.log10(white**2 / error))
        return Comparison(name, pixels, different_px, psnr_db, psnr_db >= least_psnr_db)
    is_equal = different_px == 0 or old.modality == FLOW
    return Comparison(name, pixels, different_px, None, is_equal)


def _values(frame: Frame) -> FloatArray:
    return frame.data.astype(np.float64)


def compare_scan(old: LidarScan, new: LidarScan) -> Comparison:
    """Compare a recorded scan with the same scan made again, point by point."""
    name = FrameName(old.sensor, POINTS)
    if (old.data.shape, old.data.dtype) != (new.data.shape, new.data.dtype):
        return Comparison(name, len(old.data), len(old.data), None, False)
    different = int((old.data != new.data).sum())
    return Comparison(name, len(old.data), different, None, not different)
