"""The layout of ``oaisys render``, read back with its own reader and rendered again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.output.reader import read_labels, read_samples
from oaisys_core.simulation import Simulation
from oaisys_core.verification.recorded_samples import open_records
from oaisys_dataset import Dataset
from oaisys_dataset.formats.export import export_dataset


def test_it_is_what_oaisys_render_writes(rendered: Dataset, tmp_path: Path) -> None:
    counts = export_dataset(rendered, "files", tmp_path / "out")
    assert counts == {"samples": 6, "frames": 6}
    for world in rendered.worlds:
        batch = tmp_path / f"out/batch_{world + 1:04d}"
        assert read_labels(batch) == rendered.legend(world).labels
        samples = list(read_samples(batch))
        for sample, record in zip(samples, rendered.of_world(world), strict=True):
            assert (sample.batch_id, sample.sample_id) == (world + 1, record.view + 1)
            assert np.array_equal(sample.frames[0].T_map_camera, record.pose)
            for modality, image in rendered.sample(record).arrays.items():
                frame = sample.frame("camera", modality)
                assert frame.intrinsics == record.camera
                assert np.array_equal(frame.data, image)


def test_a_sample_of_it_is_rendered_again_with_equal_depth(
    rendered: Dataset, tmp_path: Path
) -> None:
    export_dataset(rendered.split("val"), "files", tmp_path / "out")
    records = open_records(tmp_path / "out")
    (recorded,) = records.read([(3, 2)])
    simulation = Simulation(config_from_mapping(rendered.info.config))
    again = simulation.repeat(recorded.outline)
    simulation.close()
    for frame in recorded.frames:
        assert np.array_equal(again.frame(frame.sensor, frame.modality).data, frame.data)
