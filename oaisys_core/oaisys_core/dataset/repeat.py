"""Renders a frame of a data set again from its line in the manifest, and compares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from oaisys_core.config import config_from_mapping, config_sha256
from oaisys_core.dataset.reader import Dataset, DatasetSample
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, RecordedSample, modality_spec
from oaisys_core.verification.recorded_samples import Comparison, compared


def repeated(
    dataset: Dataset, frame_ids: Sequence[str], least_psnr_db: float
) -> Iterator[tuple[str, list[Comparison]]]:
    """Render frames again, and yield each one's id and the comparisons of its images.

    Raises:
        NotFoundError: There is no such frame.
        InvalidInputError: The configuration in the data set is not that of the frame.
    """
    samples = [dataset.sample(dataset.record(frame_id)) for frame_id in frame_ids]
    config = config_from_mapping(dataset.info.config)
    found = config_sha256(config)
    for sample in samples:
        if sample.record.config_sha256 != found:
            expected = f"{found}, that of the configuration in the data set"
            raise InvalidInputError("config_sha256", sample.record.config_sha256, expected)
    simulation = Simulation(config)
    try:
        for sample in samples:
            recorded = recorded_sample(sample)
            again = simulation.repeat(recorded.outline)
            yield sample.record.frame_id, compared(recorded, again, least_psnr_db)
    finally:
        simulation.close()


def recorded_sample(sample: DatasetSample) -> RecordedSample:
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
