"""Renders a frame or lidar scan again from its line in the manifest, and compares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from oaisys_core.config import config_from_mapping, config_sha256
from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    Frame,
    RecordedSample,
    modality_spec,
)
from oaisys_core.verification.recorded_samples import Comparison, compare, compare_scan
from oaisys_dataset.manifest import DatasetInfo, FrameRecord
from oaisys_dataset.reader import Dataset, DatasetSample
from oaisys_dataset.scans import ScanRecord


def repeat_records(
    dataset: Dataset, ids: Sequence[str], least_psnr_db: float
) -> Iterator[tuple[str, list[Comparison]]]:
    """Render frames and lidar scans again; yield each one's id and the comparisons of its data.

    Raises:
        InvalidInputError: There is no such frame or scan, or the configuration in the data set is
            not that of the frame.
    """
    records = [(each, _record(dataset, each)) for each in ids]
    for part in dataset.info.parts:
        of_part = [each for each in records if dataset.info.part_of(each[1].world) == part]
        if of_part:
            yield from _repeat_part(dataset, part.info, of_part, least_psnr_db)


def _repeat_part(
    dataset: Dataset,
    info: DatasetInfo,
    records: Sequence[tuple[str, FrameRecord | ScanRecord]],
    least_psnr_db: float,
) -> Iterator[tuple[str, list[Comparison]]]:
    """Render records that have one configuration again, see `repeat_records`."""
    config = config_from_mapping(info.config)
    found = config_sha256(config)
    for _, record in records:
        if record.config_sha256 != found:
            expected = f"{found}, that of the configuration in the data set"
            raise InvalidInputError("config_sha256", record.config_sha256, expected)
    simulation = Simulation(config)
    try:
        for each, record in records:
            again = simulation.repeat(record.outline())
            if isinstance(record, ScanRecord):
                yield each, [compare_scan(dataset.scan(record), again.scan(record.sensor))]
            else:
                recorded = sample_from_record(dataset.sample(record))
                yield each, compare(recorded, again, least_psnr_db)
    finally:
        simulation.close()


def _record(dataset: Dataset, each: str) -> FrameRecord | ScanRecord:
    try:
        return dataset.scan_record(each) or dataset.record(each)
    except NotFoundError as error:
        example = f", such as {dataset.records[0].frame_id}" if len(dataset) else ""
        expected = f"the id of a frame or lidar scan of {dataset.place.url}{example}"
        raise InvalidInputError("frame", each, expected) from error


def sample_from_record(sample: DatasetSample) -> RecordedSample:
    """Return a frame of a data set as a recorded sample of one sensor."""
    record = sample.record
    frames = tuple(
        Frame(
            record.sensor,
            modality,
            # Ids have another sign in data sets than in the simulator, and the same bytes.
            np.ascontiguousarray(pixels).view(modality_spec(modality).dtype),
            record.camera,
            record.pose,
        )
        for modality, pixels in sample.arrays.items()
    )
    return RecordedSample(record.outline(), frames)
